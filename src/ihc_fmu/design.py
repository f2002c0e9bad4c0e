"""From a linear model and a linear controller to an implicit homogeneous controller, by matrix inequalities (CVXPY).

All semidefinite programs are posed in chain coordinates with time scaled by omega and the control by its bound, where
every number is of order one, and the result is brought back to x = (theta, delta, theta', delta') or whatever the
coordinates of (A, b) are. The solver's word is not taken: `certify` recomputes the inequalities by eigenvalues.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from filing.files import write_file
from fmu_export.errors import UserError, shown
from fmu_export.reading import parse_json, read_text

from .certificate import Certificate, CertificateError, certify
from .companion import chain_form, checked_system, weights

Array = np.ndarray

FORMAT = "qube-ihc design 1"
SOLVER_TIME = 120.0
"""Longest time for one semidefinite program [s]."""
LOWEST_ALPHA = 1e-6
"""Smallest alpha that is tried for the largest feasible one, relative to the decay rate of the slowest pole."""
LARGEST = 1e300
"""Numbers of a file are smaller."""
SCALES = (1e-9, 1e9)
"""Bounds on what scales the problem: beyond, neither the solver nor double precision resolves it."""
SLACK = 1e-6
"""Strictness demanded of the solver, relative: its result must satisfy the inequalities after rounding."""

BALANCES = (1.0, 0.0, 0.5)
"""Shares of alpha for which the coordinates of the program are balanced, one after the other until the result proves itself:
near mu = 0 the solver stops early, in one case of four too early."""

_QUIET = np.errstate(over="ignore", invalid="ignore", divide="ignore")
"""Numbers beyond the range end in a refusal by `checked_system`, `chain_form` or the certificate, not in warnings."""

PAPER_A = ((0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0, 149.2751, -0.0104, 0.0), (0.0, 261.6091, -0.0103, 0.0))
PAPER_B = (0.0, 0.0, 49.7275, 49.1493)
PAPER_K_LIN = (2.0, -30.0, 2.0, -2.5)
"""A [1/s, 1/s^2], b [rad/(s^2 V)] and the manufacturer's k_lin [V/rad, V s/rad] of the paper's section V."""


class InfeasibleError(UserError):
    """The matrix inequalities have no solution for the given numbers, or the solver found none (`numerical`)."""

    def __init__(self, message: str, *, numerical: bool = False) -> None:
        super().__init__(message)
        self.numerical = numerical


@dataclass(frozen=True, eq=False)
class Design:
    """A certified implicit homogeneous controller for x' = A x + b u; it cannot be made without its certificate.

    A (n, n), b (n,), k_lin (n,): model and linear controller u = k_lin x, which the IHC equals on ||x||_d = 1.
    P (n, n): its ellipsoid x' P x <= 1 is the unit ball of ||x||_d. mu in (0, 1]: minus the degree of homogeneity.
    alpha [1/s]: proven decrease d||x||_d/dt <= -alpha ||x||_d^(1-mu). u_max [V]: the largest |k x| on the unit ball.
    psi, d_max [V], tau: the terms of Remark 3 that the proof includes (0: none). method: how it was designed.
    """

    A: Array
    b: Array
    k_lin: Array
    P: Array
    mu: float
    alpha: float
    psi: float = 0.0
    d_max: float = 0.0
    tau: float = 1.0
    method: str = "given"
    Phi: Array = field(init=False)
    row: Array = field(init=False)
    certificate: Certificate = field(init=False)

    @_QUIET
    def __post_init__(self) -> None:
        A, b = checked_system(self.A, self.b)
        n = len(b)
        for name, shape in (("k_lin", (n,)), ("P", (n, n))):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape:
                raise UserError(f"{name} must be of shape {shape} to fit A, found shape {value.shape}")
            if not np.isfinite(value).all():
                raise UserError(f"{name} must be finite, found {value[~np.isfinite(value)][0]}")
            object.__setattr__(self, name, value)
        _check_scalars(self.mu, self.alpha, self.psi, self.d_max, self.tau)
        form = chain_form(A, b)
        for name, value in (("A", A.copy()), ("b", b.copy()), ("Phi", form.Phi), ("row", form.row)):
            object.__setattr__(self, name, value)
        for name in ("A", "b", "k_lin", "P", "Phi", "row"):
            getattr(self, name).setflags(write=False)  # what is certified stays as it is
        object.__setattr__(self, "certificate", certify(self))

    @property
    def n(self) -> int:
        """The order of the system."""
        return len(self.b)

    @property
    def k(self) -> Array:
        """The homogeneous gain k = k_lin + row, eq. (10), shape (n,)."""
        return self.k_lin + self.row

    @cached_property
    def kz(self) -> Array:
        """The homogeneous gain in chain coordinates, k Phi^-1, shape (n,)."""
        return np.linalg.solve(self.Phi.T, self.k)

    @property
    def u_max(self) -> float:
        """The largest |k x| on the unit ball, sqrt(k P^-1 k') [V]."""
        return float(np.sqrt(self.k @ np.linalg.solve(self.P, self.k)))

    @property
    def extent(self) -> Array:
        """The largest |x_i| on the unit ball, sqrt((P^-1)_ii), shape (n,)."""
        return np.sqrt(np.diag(np.linalg.inv(self.P)))

    def scaled_to(self, *, u_max: float | None = None, index: int | None = None, bound: float | None = None) -> Design:
        """Return the design with P scaled by an explicit rule, which leaves (11) untouched.

        Either the largest |k x| on the unit ball becomes `u_max` [V], or the largest |x_index| there becomes `bound`
        (index 1 is the pendulum angle delta). Raises UserError where not exactly one rule is given.
        """
        if (u_max is None) == (bound is None or index is None):
            raise UserError("the scale of P needs one rule: u_max, or index and bound")
        size = u_max if u_max is not None else bound
        if size is None or not 0.0 < size < np.inf:
            raise UserError(f"the bound on the unit ball must be positive and finite, found {size}")
        if index is not None and not 0 <= index < self.n:
            raise UserError(f"the bounded state must be one of 0..{self.n - 1}, found {index}")
        factor = (self.u_max if index is None else self.extent[index]) / size
        if self.psi or self.d_max:
            raise UserError("a design with the terms of Remark 3 cannot be rescaled: psi and d_max fix the scale of P")
        return replace(self, P=self.P * float(factor) ** 2)

    def to_json(self) -> str:
        """Return the design with its derived numbers and certificate as JSON; floats are exact."""
        given = {f.name: _plain(getattr(self, f.name)) for f in fields(self) if f.init}
        derived = {
            "k": _plain(self.k),
            "row": _plain(self.row),
            "Phi": _plain(self.Phi),
            "u_max": self.u_max,
            "certificate": self.certificate.as_dict(),
        }
        return json.dumps({"format": FORMAT, **given, "derived": derived}, indent=1) + "\n"

    def save(self, path: Path) -> None:
        """Write the JSON to `path`, whole or not at all; raises UserError where it cannot be written."""
        write_file(path, self.to_json())

    @classmethod
    def from_json(cls, text: str) -> Design:
        """Return the design of `to_json`; the derived numbers are computed anew and the certificate is checked.

        Raises UserError for text that is not a design, and CertificateError for one that proves nothing.
        """
        data = parse_json(text, "a design")
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            found = data.get("format") if isinstance(data, dict) else type(data).__name__
            raise UserError(f"the format must be {FORMAT!r}, found {shown(found)}")
        names = {f.name for f in fields(cls) if f.init}
        given = {name: value for name, value in data.items() if name in names}
        missing = {"A", "b", "k_lin", "P", "mu", "alpha"} - given.keys()
        unknown = data.keys() - names - {"format", "derived"}
        if missing or unknown:
            raise UserError(f"a design has missing {sorted(missing)} and unknown {shown(sorted(unknown))} entries")
        return cls(**{name: _entry(name, value) for name, value in given.items()})

    @classmethod
    def load(cls, path: Path) -> Design:
        """Read a design file; errors name the file."""
        text = read_text(path, "design")
        try:
            return cls.from_json(text)
        except CertificateError as error:
            raise CertificateError(f"{path}: {error}") from None
        except UserError as error:
            raise UserError(f"{path}: {error}") from None


_LEVELS = {"A": 2, "P": 2, "b": 1, "k_lin": 1}
"""Lists in lists that an entry of a file is; the others are numbers, and `method` a text."""


def _entry(name: str, value: object) -> Any:
    """Return an entry of a file in its type; raise UserError that names it."""
    if name == "method":
        if not isinstance(value, str):
            raise UserError(f"method must be a text, found {shown(value)}")
        return value
    levels = _LEVELS.get(name, 0)
    if not _is_numbers(value, levels):
        kind = ("a number", "a list of numbers", "a list of rows of numbers, all of one length")[levels]
        raise UserError(f"{name} must be {kind}, found {shown(value)}")
    return np.array(value, dtype=float) if levels else value


def _is_numbers(value: object, levels: int) -> bool:
    if not levels:
        return not isinstance(value, bool) and isinstance(value, int | float) and abs(value) < LARGEST
    if not isinstance(value, list) or not all(_is_numbers(v, levels - 1) for v in value):
        return False
    return levels < 2 or len({len(row) for row in value}) <= 1


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _check_scalars(mu: float, alpha: float, psi: float, d_max: float, tau: float = 1.0) -> None:
    if not 0.0 < mu <= 1.0:
        raise UserError(f"mu must lie in (0, 1], found {mu}")
    if not 0.0 < alpha < np.inf:
        raise UserError(f"alpha must be positive and finite [1/s], found {alpha}")
    if not 0.0 < tau < np.inf:
        raise UserError(f"tau must be positive and finite, found {tau}")
    for name, value in (("psi", psi), ("d_max", d_max)):
        if not 0.0 <= value < np.inf:
            raise UserError(f"{name} must be non-negative and finite, found {value}")
    if d_max > 0.0 and mu < 1.0:
        raise UserError(f"a matched disturbance d_max > 0 can be rejected only at mu = 1, found mu = {mu}")


@dataclass(frozen=True, eq=False)
class _Scaled:
    """The problem with time in 1/omega and the control in u_max: z' = N z + e_n v, x = T z.

    z = D Phi x with D = diag(omega^(n-1), ..., 1) omega / u_max; or any other coordinates, see `to`.
    """

    N: Array
    e: Array
    W: Array  # the generator
    T: Array  # x = T z
    k: Array  # the homogeneous gain, |k z| <= 1 on the unit ball
    omega: float
    u_max: float

    def to(self, P: Array) -> _Scaled:
        """Return the problem in coordinates in which z' P z is a sum of squares."""
        L_t = np.linalg.cholesky(P).T
        inverse = np.linalg.inv(L_t)
        return replace(
            self,
            N=L_t @ self.N @ inverse,
            e=L_t @ self.e,
            W=L_t @ self.W @ inverse,
            T=self.T @ inverse,
            k=self.k @ inverse,
        )

    def balanced(self, alpha: float) -> _Scaled:
        """Return the problem in coordinates in which a first solution of the decrease alone is the unit matrix.

        Chain coordinates of higher order make P ill-conditioned beyond what a solver can resolve; these do not. Where
        alpha is too large for the Lyapunov equation to have a positive solution, nothing changes.
        """
        closed = self.N + np.outer(self.e, self.k) + alpha / self.omega * self.W
        if np.linalg.eigvals(closed).real.max() >= 0.0:
            return self
        return self.to(solve_continuous_lyapunov(closed.T, -np.eye(len(self.e))))


def _scale(A: Array, b: Array, k_lin: Array | None, mu: float, u_max: float) -> _Scaled:
    form = chain_form(A, b)
    n = len(b)
    kz = np.zeros(n) if k_lin is None else np.linalg.solve(form.Phi.T, k_lin + form.row)
    omega = abs(kz[0]) ** (1.0 / n) if k_lin is not None else 10.0  # |kz_1| is the product of the poles
    omega = omega if omega > 0.0 else 1.0
    D = omega ** np.arange(n, 0, -1) / u_max
    return _Scaled(
        N=np.eye(n, k=1),
        e=np.eye(n)[-1],
        W=np.diag(weights(n, mu)),
        T=np.linalg.inv(D[:, None] * form.Phi),
        k=kz / D / u_max,
        omega=omega,
        u_max=u_max,
    )


def _solve(problem: Any, what: str) -> None:
    """Solve with Clarabel, an interior-point method; raise InfeasibleError that says what has no solution."""
    import warnings  # noqa: PLC0415

    import cvxpy as cp  # noqa: PLC0415 - slow to import, needed only here

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an inaccurate solution is judged by its certificate
        try:
            problem.solve(solver=cp.CLARABEL, time_limit=SOLVER_TIME)
        except cp.SolverError:
            message = f"{what}: the solver failed numerically on the matrix inequalities"
            raise InfeasibleError(message, numerical=True) from None
    if problem.status == cp.USER_LIMIT:
        message = (
            f"{what}: the solver reached its limit of iterations or of {SOLVER_TIME:g} s on the matrix inequalities"
        )
        raise InfeasibleError(message, numerical=True)
    if problem.status not in {cp.OPTIMAL, cp.OPTIMAL_INACCURATE}:
        raise InfeasibleError(f"{what}: the matrix inequalities have no solution (solver: {problem.status})")


def _sym(M: Any) -> Any:
    return (M + M.T) / 2


@dataclass(frozen=True, kw_only=True)
class Options:
    """What both designs take besides the model.

    mu: homogeneity, (0, 1]. alpha [1/s]: decrease to be proven. u_max [V]: bound on |k x| on the unit ball, the scale of
    P. delta_max: instead or as well, a bound on |x_index| on it. beta: G_d X + X G_d' >= 2 beta X, which keeps the
    dilation monotone with a margin. psi, d_max: the terms of Remark 3.
    """

    mu: float = 1.0
    alpha: float = 0.2
    u_max: float | None = 1.5
    delta_max: float | None = None
    index: int = 1
    beta: float = 0.1
    psi: float = 0.0
    d_max: float = 0.0

    def __post_init__(self) -> None:
        _check_scalars(self.mu, self.alpha, self.psi, self.d_max)
        if self.u_max is None and self.delta_max is None:
            raise UserError("the scale of P needs a rule: u_max, delta_max or both")
        for name in ("u_max", "delta_max"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise UserError(f"{name} must be positive and finite, found {value}")
        for name in ("u_max", "delta_max", "psi", "d_max"):  # 0 is for none
            value = getattr(self, name)
            if value and not SCALES[0] <= value <= SCALES[1]:
                raise UserError(f"{name} must lie in [{SCALES[0]:g}, {SCALES[1]:g}], found {value}")
        if not 0.0 < self.beta < 1.0:
            raise UserError(f"beta must lie in (0, 1), found {self.beta}")


@_QUIET
def inverse_design(A: Array, b: Array, k_lin: Array, options: Options | None = None) -> Design:
    """Return the IHC that equals the stabilizing LC u = k_lin x on its unit sphere, eqs. (10) and (11).

    With X = P^-1 and A_cl = A + b k_lin = A_0 + b k: maximize log det X, the largest unit ball, subject to

        A_cl X + X A_cl' + alpha (G_d X + X G_d') + disturbance terms <= 0,   G_d X + X G_d' >= 2 beta X,
        k X k' <= u_max^2   and/or   X_ii <= delta_max^2.

    Raises UserError for a pair that is not controllable or a k_lin that does not stabilize it, InfeasibleError where
    alpha is beyond the largest feasible one, CertificateError where the result fails its proof.
    """
    options = options or Options()
    A, b = checked_system(A, b)
    k_lin = _checked_gain(k_lin, A, b)
    return _optimize(A, b, k_lin, options)


@_QUIET
def direct_design(A: Array, b: Array, options: Options | None = None) -> Design:
    """Return the IHC designed without a linear controller, eq. (9): k = y X^-1 with X and y free.

    The objective and the bounds are those of `inverse_design`; |k x| <= u_max on the unit ball is the inequality
    [[u_max^2, y], [y', X]] >= 0. The result's k_lin = k - row is the linear controller that it equals on the unit sphere.
    Raises as `inverse_design`.
    """
    options = options or Options()
    A, b = checked_system(A, b)
    if options.u_max is None:
        raise UserError("a direct design needs u_max: without it k would grow beyond bounds")
    return _optimize(A, b, None, options)


def _checked_gain(k_lin: Array, A: Array, b: Array) -> Array:
    k_lin = np.asarray(k_lin, dtype=float)
    if k_lin.shape != b.shape or not np.isfinite(k_lin).all():
        raise UserError(f"k_lin must have {len(b)} finite entries, found shape {k_lin.shape}")
    slowest = _slowest(A, b, k_lin)
    if slowest >= 0.0:
        chain_form(A, b)  # refuses a pair for which no gain might
        raise UserError(
            f"k_lin must stabilize (A, b): the largest real part of the poles is {slowest:.4g} 1/s{_hint(A, b, k_lin)}"
        )
    return k_lin


def _slowest(A: Array, b: Array, k: Array) -> float:
    return float(np.linalg.eigvals(A + np.outer(b, k)).real.max())


def _hint(A: Array, b: Array, k_lin: Array) -> str:
    """Return what would make a gain that does not stabilize do so: its sign, or another order of its entries."""
    if _slowest(A, b, -k_lin) < 0.0:
        return "; -k_lin does: the law is u = +k_lin x here, not u = -K x"
    half, rest = divmod(len(b), 2)
    if rest or half < 2:
        return ""
    grouped = k_lin.reshape(half, 2).T.ravel()  # given as angle, rate, angle, rate
    mixed = k_lin.reshape(2, half).T.ravel()
    for gain, order in ((grouped, "(angle, rate, angle, rate)"), (mixed, "(angle, angle, rate, rate)")):
        for sign, law in ((1.0, ""), (-1.0, " and the sign of u = -K x")):
            if _slowest(A, b, sign * gain) < 0.0:
                return f"; k_lin seems to be in the order {order}{law}, unlike A"
    return ""


def _optimize(A: Array, b: Array, k_lin: Array | None, options: Options) -> Design:
    """Solve for X, and y where k_lin is None; for a matched disturbance also over a grid of its multiplier tau."""
    what = f"alpha = {options.alpha:g} 1/s, mu = {options.mu:g}"
    if not options.d_max:
        for share in BALANCES[:-1]:
            try:
                return _optimize_for(A, b, k_lin, options, 1.0, what, share)
            except CertificateError:
                continue
        return _optimize_for(A, b, k_lin, options, 1.0, what, BALANCES[-1])
    best: Design | None = None
    for tau in _multipliers(options):
        try:
            found = _optimize_for(A, b, k_lin, options, tau, what)
        except (InfeasibleError, CertificateError):
            continue
        if best is None or np.linalg.slogdet(found.P)[1] < np.linalg.slogdet(best.P)[1]:
            best = found
    if best is None:
        raise InfeasibleError(f"{what}: no P proves the rejection of |d| <= {options.d_max:g} V")
    return best


def _multipliers(options: Options) -> Array:
    """Return candidates for tau: the term tau d_max^2 P costs the decay rate tau d_max^2, so it is below some 1/s."""
    return np.geomspace(1e-2, 1e2, 25) / options.d_max**2


def _optimize_for(
    A: Array, b: Array, k_lin: Array | None, options: Options, tau: float, what: str, share: float = 1.0
) -> Design:
    import cvxpy as cp  # noqa: PLC0415

    p = _scale(A, b, k_lin, options.mu, options.u_max or 1.0)
    if k_lin is not None:
        p = p.balanced(share * options.alpha)
    n = len(b)
    X = cp.Variable((n, n), symmetric=True)
    y = cp.Variable((1, n)) if k_lin is None else None
    drift = p.N @ X + (p.e[:, None] @ y if y is not None else np.outer(p.e, p.k) @ X)
    monotone = _sym(p.W @ X) * 2
    decrease = _sym(drift) * 2 + (options.alpha / p.omega) * monotone + SLACK * X
    if options.d_max:  # in scaled time and control: b b'/tau -> e e'/(tau u_max^2 / omega)...
        decrease = (
            decrease + np.outer(p.e, p.e) * (p.omega / (tau * p.u_max**2)) + (tau * options.d_max**2 / p.omega) * X
        )
    constraints = [monotone >> 2 * options.beta * (1 + SLACK) * X, *_size_constraints(p, X, y, options)]
    if options.psi:  # psi I in the coordinates of x, by a Schur complement
        TX = p.T @ X
        corner = -(p.omega / options.psi) * np.eye(n)
        constraints.append(cp.bmat([[decrease, TX.T], [TX, corner]]) << 0)
    else:
        constraints.append(decrease << 0)
    problem = cp.Problem(cp.Maximize(cp.log_det(X)), constraints)
    _solve(problem, what)
    X_value = np.asarray(X.value)
    P = _to_x(p, np.linalg.inv(X_value))
    gain = k_lin
    if y is not None:
        kz = np.linalg.solve(X_value, np.asarray(y.value)[0]) * p.u_max
        gain = kz @ np.linalg.inv(p.T) - chain_form(A, b).row
    assert gain is not None
    method = "direct (9)" if k_lin is None else "inverse (10)-(11)"
    return Design(A, b, gain, P, options.mu, options.alpha, options.psi, options.d_max, tau, method)


def _size_constraints(p: _Scaled, X: Any, y: Any, options: Options) -> list[Any]:
    import cvxpy as cp  # noqa: PLC0415

    constraints: list[Any] = []
    if y is not None:
        constraints.append(cp.bmat([[np.eye(1), y], [y.T, X]]) >> 0)
    elif options.u_max is not None:
        constraints.append(p.k @ X @ p.k <= 1.0)
    if options.delta_max is not None:
        if not 0 <= options.index < len(p.N):
            raise UserError(f"the bounded state must be one of 0..{len(p.N) - 1}, found {options.index}")
        row = p.T[options.index] / options.delta_max
        constraints.append(row @ X @ row <= 1.0)
    return constraints


def _to_x(p: _Scaled, Pz: Array) -> Array:
    T_inverse = np.linalg.inv(p.T)
    P = T_inverse.T @ Pz @ T_inverse
    return (P + P.T) / 2


@_QUIET
def largest_alpha(
    A: Array,
    b: Array,
    k_lin: Array,
    mu: float = 1.0,
    tolerance: float = 1e-4,
    progress: Callable[[float, float], None] | None = None,
) -> float:
    """Return the largest alpha [1/s] for which (11) has a solution, within the relative `tolerance`, from below.

    For a fixed alpha, (11) is a linear feasibility problem in P; feasibility is monotone in alpha, so it is bisected
    between 0 and the decay rate of the slowest pole, which bounds it because every w_i is at least 1. `progress(low, high)`
    is called with the interval. Raises InfeasibleError where none is found down to LOWEST_ALPHA of that rate, `numerical`
    where the solver could not decide there.
    """
    A, b = checked_system(A, b)
    k_lin = _checked_gain(k_lin, A, b)
    p = _scale(A, b, k_lin, mu, 1.0)
    low, high = 0.0, -float(np.linalg.eigvals(A + np.outer(b, k_lin)).real.max())
    lowest = LOWEST_ALPHA * high
    feasible: bool | None = True
    while high - low > tolerance * high and high > lowest:
        if progress is not None:
            progress(low, high)
        middle = (low + high) / 2
        q = p.balanced(middle)
        feasible = _feasible(q.N + np.outer(q.e, q.k), q.W, middle / p.omega)
        low, high = (middle, high) if feasible else (low, middle)
    if not low:
        why = (
            "the matrix inequalities have no solution"
            if feasible is False
            else "the solver cannot decide, numerically,"
        )
        raise InfeasibleError(f"{why} for any alpha down to {high:.2g} 1/s", numerical=feasible is None)
    return low


def _feasible(closed: Array, W: Array, alpha: float) -> bool | None:
    """Decide (11) in scaled coordinates: maximize t with I <= P <= 1e8 I, -(...) >= t I and W P + P W >= t I.

    None where the solver fails or the margin is within its errors.
    """
    import cvxpy as cp  # noqa: PLC0415

    n = len(W)
    P = cp.Variable((n, n), symmetric=True)
    t = cp.Variable()
    monotone = _sym(P @ W) * 2
    decrease = _sym(P @ closed) * 2 + alpha * monotone
    constraints = [
        P >> np.eye(n),
        P << 1e8 * np.eye(n),
        decrease << -t * np.eye(n),
        monotone >> t * np.eye(n),
        t <= 1.0,
    ]
    problem = cp.Problem(cp.Maximize(t), constraints)
    try:
        _solve(problem, "feasibility")
    except InfeasibleError:
        return None
    margin = float(t.value)  # type: ignore[arg-type]
    return margin > 0.0 if abs(margin) > 1e-6 else None
