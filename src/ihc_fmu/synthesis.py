"""Designs by matrix inequalities: from a linear controller (inverse), or without one (direct).

The solver's word is not taken: a `Design` proves itself from its numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_lyapunov

from fmu_export.errors import UserError

from .block_form import BlockForm
from .certificate import CertificateError
from .design import Design, check_scalars
from .integral import check_degree, largest_mu
from .lmi import InfeasibleError, Limit, Problem, decay, is_refuted, search, solve
from .system import QUIET, System

Array = np.ndarray

SCALES = (1e-9, 1e9)
"""Bounds on what scales the problem: beyond, neither the solver nor double precision resolves it."""
SLACK = 1e-6
"""Strictness demanded of the solver, relative: its result must satisfy the inequalities after rounding."""
SEARCH_TIME = 300.0
"""Longest time for one search [s]."""
MULTIPLIERS = 25
"""Values of tau that are tried for a matched disturbance."""
FASTER, RATES = 3.0, 20
"""Factor between the rates that a direct design tries from alpha on, and their number."""
MUS = (1.0, 0.75, 0.5, 0.25)
"""Degrees that are tried where none is given."""
SHARE_OF_ALPHA, SHARE_OF_LIMIT, ROUGH = 0.5, 0.5, 1e-2
"""What is chosen: alpha relative to the largest one, which is found to ROUGH, and u_max relative to the limits' room."""
ROUNDS, WIDEST, NARROWEST, SETTLED = 12, 1e6, 2.0, 0.05
"""Of the largest unit ball: most programs, widest and narrowest bounds on X in each, and ln X that counts as no change."""
DIRECT_MARGIN = 1.2
"""Of the closed form of a direct design: it is for this multiple of alpha."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """What both designs take besides the model.

    mu: homogeneity, (0, 1]. alpha [1/s]: decrease to be proven. u_max: bound on |(K - K_0) x| on the unit ball, a number
    or one for each input, the scale of P. delta_max: instead or as well, a bound on |x_index| on it. beta:
    G_d X + X G_d' >= 2 beta X, which keeps the dilation monotone with a margin. psi, d_max: the terms of Remark 3.
    """

    mu: float = 1.0
    alpha: float = 0.2
    u_max: float | Sequence[float] | None = 1.5
    delta_max: float | None = None
    index: int = 1
    beta: float = 0.1
    psi: float = 0.0
    d_max: float = 0.0

    def __post_init__(self) -> None:
        check_scalars(self.mu, self.alpha, self.psi, self.d_max)
        if self.u_max is None and self.delta_max is None:
            raise UserError("the scale of P needs a rule: u_max, delta_max or both")
        bounds = [] if self.u_max is None else np.atleast_1d(np.asarray(self.u_max, dtype=float)).tolist()
        sizes = [
            *(("u_max", value) for value in bounds),
            *([] if self.delta_max is None else [("delta_max", self.delta_max)]),
        ]
        for name, value in sizes:
            if not 0.0 < value < np.inf:
                raise UserError(f"{name} must be positive and finite, found {value}")
        for name, value in (*sizes, ("psi", self.psi), ("d_max", self.d_max)):  # 0 is for none
            if value and not SCALES[0] <= value <= SCALES[1]:
                raise UserError(f"{name} must lie in [{SCALES[0]:g}, {SCALES[1]:g}], found {value}")
        if not 0.0 < self.beta < 1.0:
            raise UserError(f"beta must lie in (0, 1), found {self.beta}")

    def bounds(self, m: int) -> Array | None:
        """Return u_max for each of m inputs."""
        if self.u_max is None:
            return None
        bounds = np.atleast_1d(np.asarray(self.u_max, dtype=float))
        if bounds.shape not in ((1,), (m,)):
            several = "" if m == 1 else f" or {m} numbers, one for each input"
            raise UserError(f"u_max must be a number{several}, found {len(bounds)}")
        return np.broadcast_to(bounds, (m,))


Say = Callable[[str], object] | None


@QUIET
def inverse_design(system: System, options: Options | None = None, say: Say = None) -> Design:
    """Return the IHC that equals the stabilizing LC u = K x of `system` on its unit sphere, eqs. (10) and (11).

    With X = P^-1 and A_cl = A + B K = A_0 + B (K - K_0): maximize log det X, the largest unit ball, subject to

        A_cl X + X A_cl' + alpha (G_d X + X G_d') + disturbance terms <= 0,   G_d X + X G_d' >= 2 beta X,
        (K - K_0)_i X (K - K_0)_i' <= u_max_i^2   and/or   X_ii <= delta_max^2,

    in coordinates in which a P that satisfies the inequalities, found by `search`, is the unit matrix. `say` is told how the
    search goes. Raises UserError for a pair that is not controllable or a K that does not stabilize it, InfeasibleError
    where no P is found for alpha, `numerical` where none is refuted either.
    """
    options = options or Options()
    options.bounds(system.m)
    _check_gain(system)
    problem, omega = _closed_loop(system, options.beta)
    a = options.alpha / omega
    what = f"alpha = {options.alpha:g} 1/s, mu = {options.mu:g}"
    found = search(problem, options.mu, a, Limit(SEARCH_TIME, say))
    if not found.complete:
        if is_refuted(found.problem, options.mu, a):
            raise InfeasibleError(f"{what}: the matrix inequalities have no solution")
        raise InfeasibleError(f"{what}: no solution of the matrix inequalities was found", numerical=True)
    return _largest_ball(system, found.problem.S, omega, options, what)


@QUIET
def direct_design(system: System, options: Options | None = None) -> Design:
    """Return the IHC designed without a linear controller, eq. (9): K - K_0 = Y X^-1 with X and Y free.

    The objective and the bounds are those of `inverse_design`; |(K - K_0)_i x| <= u_max_i on the unit ball is the inequality
    [[u_max_i^2, Y_i], [Y_i', X]] >= 0. The result's K is the linear controller that it equals on the unit sphere; a gain of
    `system` is not used. It begins at the solution in closed form (R. W. Bass; see D. L. Kleinman, IEEE Trans. Automatic
    Control 15(6), 1970) of

        (A_0 + a G_d) X + X (A_0 + a G_d)' = 2 gamma B B',   Y = -gamma B',   a = 1.2 alpha,

    whose X is positive definite for every controllable pair. For an alpha so slow that its unit ball, beside the
    system's own motion, is flat beyond double precision, faster ones are tried: what decreases faster decreases at alpha
    too. Raises as `inverse_design`.
    """
    options = options or Options()
    bounds = options.bounds(system.m)
    if bounds is None:
        raise UserError("a direct design needs u_max: without it K would grow beyond bounds")
    what = f"alpha = {options.alpha:g} 1/s, mu = {options.mu:g}"
    system = system.changed(K=None)
    failed: InfeasibleError | None = None
    for rate in options.alpha * FASTER ** np.arange(RATES):
        try:
            S = _closed_form(system, options, float(rate), bounds)
            return _largest_ball(system, S, float(rate), options, what)
        except InfeasibleError as error:
            failed = failed or error
    assert failed is not None
    raise failed


def _closed_form(system: System, options: Options, rate: float, bounds: Array) -> Array:
    """Return S for which x = S y has the unit ball y' y <= 1 of the direct design in closed form with alpha = `rate`."""
    form = _normal(system.form, rate)
    B = form.Bz / rate * bounds
    F = form.N / rate + DIRECT_MARGIN * np.diag(form.weights(options.mu))
    try:
        X = solve_continuous_lyapunov(F, B @ B.T)
        L = np.linalg.cholesky(X)
        size = float((B * np.linalg.solve(X, B)).sum(axis=0).max())
    except (LinAlgError, ValueError):
        message = f"alpha = {rate:g} 1/s, mu = {options.mu:g}: the direct design is beyond double precision"
        raise InfeasibleError(message, numerical=True) from None
    room = 4.0 / size  # X = 2 gamma X_1 with the gamma that makes the largest Y_i X^-1 Y_i' 1, in units of the bounds
    return form.T_inverse @ L * np.sqrt(room)


def _check_gain(system: System) -> None:
    if system.K is None:
        raise UserError("an inverse design needs a linear controller: K, k_lin or lqr in the system")
    slowest = _slowest(system, system.K)
    if slowest >= 0.0:
        _ = system.form  # refuses a pair for which no gain might
        raise UserError(
            f"K must stabilize (A, B): the largest real part of the poles is {slowest:.4g} 1/s{_hint(system)}"
        )


def _slowest(system: System, K: Array) -> float:
    return float(np.linalg.eigvals(system.A + system.B @ K).real.max())


def _hint(system: System) -> str:
    """Return what would make a gain that does not stabilize do so: its sign, or another order of its entries."""
    K, n = system.K, system.n
    assert K is not None
    if _slowest(system, -K) < 0.0:
        return "; -K does: the law is u = +K x here, not u = -K x"
    half, rest = divmod(n, 2)
    if rest or half < 2:
        return ""
    grouped = K[:, np.arange(n).reshape(half, 2).T.ravel()]  # given as angle, rate, angle, rate
    mixed = K[:, np.arange(n).reshape(2, half).T.ravel()]
    for gain, order in ((grouped, "(angle, rate, angle, rate)"), (mixed, "(angle, angle, rate, rate)")):
        for sign, law in ((1.0, ""), (-1.0, " and the sign of u = -K x")):
            if _slowest(system, sign * gain) < 0.0:
                return f"; K seems to be in the order {order}{law}, unlike A"
    return ""


def _normal(form: BlockForm, omega: float) -> BlockForm:
    """Return the form with blocks scaled so that N has blocks of norm omega."""
    factors = [1.0]
    for here, following in reversed(list(pairwise(form.blocks))):
        factors.insert(0, factors[0] * omega / float(np.linalg.norm(form.N[here, following], 2)))
    return form.scaled(factors)


def _closed_loop(system: System, beta: float) -> tuple[Problem, float]:
    """Return the inequalities of an inverse design, and omega [1/s], in which its time is scaled.

    omega is the geometric mean of the closed loop's poles.
    """
    assert system.K is not None
    form = system.form
    closed = form.T @ (system.A + system.B @ system.K) @ form.T_inverse
    omega = float(np.exp(np.linalg.slogdet(closed)[1] / system.n))
    form = _normal(form, omega)
    closed = form.T @ (system.A + system.B @ system.K) @ form.T_inverse / omega
    slowest = float(np.linalg.eigvals(closed).real.max()) * omega
    if slowest >= 0.0:
        raise UserError(
            "K must stabilize (A, B) whatever the rounding: the largest real part of the poles is "
            f"{_slowest(system, system.K):.4g} 1/s as given, but {slowest:.4g} 1/s in scaled block coordinates"
        )
    return Problem(closed, np.diag(np.array(form.exponents, dtype=float)), form.T_inverse, beta), omega


def _largest_ball(system: System, S: Array, omega: float, options: Options, what: str) -> Design:
    """Return the design with the largest unit ball; x = S y, and P = I serves in y, with time in 1/omega.

    For a matched disturbance also over a grid of its multiplier tau.
    """
    program = _Program(system, S, omega, options, what)
    if not options.d_max:
        return program.design(1.0)
    best: Design | None = None
    for tau in np.geomspace(1e-2, 1e2, MULTIPLIERS) / options.d_max**2:  # tau d_max^2 is a rate, below some 1/s
        try:
            found = program.design(float(tau))
        except (InfeasibleError, CertificateError):
            continue
        if best is None or np.linalg.slogdet(found.P)[1] < np.linalg.slogdet(best.P)[1]:
            best = found
    if best is None:
        raise InfeasibleError(f"{what}: no P proves the rejection of |d| <= {options.d_max:g}")
    return best


class _Program:
    """The program for the largest unit ball; without a gain in `system`, a gain is designed too."""

    def __init__(self, system: System, S: Array, omega: float, options: Options, what: str) -> None:
        self.system, self.omega, self.options, self.what = system, omega, options, what
        self.bounds = options.bounds(system.m)
        form = system.form
        self.K_0, self.G = form.K_0, form.generator(options.mu)
        if options.delta_max is not None and not 0 <= options.index < system.n:
            raise UserError(f"the bounded state must be one of 0..{system.n - 1}, found {options.index}")
        self.S = S if system.K is None else S * self._room(S)

    def _sizes(self, S: Array) -> list[Array]:
        """Return rows f of the bounds f X f' <= 1 in the coordinates y, x = S y."""
        rows = []
        if self.system.K is not None and self.bounds is not None:
            rows += list((self.system.K - self.K_0) @ S / self.bounds[:, None])
        if self.options.delta_max is not None:
            rows.append(S[self.options.index] / self.options.delta_max)
        return rows

    def _room(self, S: Array) -> float:
        """Return the factor with which X = I meets the bounds."""
        largest = max((float(np.linalg.norm(row)) for row in self._sizes(S)), default=1.0)
        return 1.0 / largest if largest > 0.0 else 1.0

    def design(self, tau: float) -> Design:
        """Return the design with the multiplier tau; where the solver fails, the largest ball until then, or the first.

        The program is solved in the coordinates of its last solution until that does not change; where the solver fails,
        with narrower bounds on the change.
        """
        S, largest, found, failed = self.S, WIDEST, None, None
        complete = False
        for _ in range(ROUNDS):
            try:
                X, Y = self._solved(S, tau, largest)
                made = self._made(S, X, Y, tau, "inverse (10)-(11)" if Y is None else "direct (9)")
                following = S @ np.linalg.cholesky(X)
            except (InfeasibleError, CertificateError, LinAlgError) as error:
                failed, largest = failed or error, largest**0.5
                if largest < NARROWEST:
                    break
                continue
            found, S = made, following
            complete = float(np.abs(np.log(np.linalg.eigvalsh(X))).max()) < SETTLED
            if complete:
                return found
        if found is None:
            found = self._first(tau, failed)
        return replace(found, method=f"{found.method}, ball not maximized")

    def _first(self, tau: float, failed: Exception | None) -> Design:
        """Return the design whose unit ball is y' y <= 1 in the first coordinates."""
        if self.options.psi or self.options.d_max:
            raise failed or InfeasibleError(self.what)
        try:
            if self.system.K is not None:
                return self._made(self.S, np.eye(self.system.n), None, tau, "inverse (10)-(11)")
            assert self.bounds is not None
            Y = -(np.linalg.solve(self.S, self.system.B) * self.bounds**2).T  # of the closed form, whose X is I here
            scale = float(max(np.linalg.norm(row) / bound for row, bound in zip(Y, self.bounds, strict=True)))
            return self._made(self.S, np.eye(self.system.n), Y / scale, tau, "direct (9)")
        except (CertificateError, LinAlgError) as error:
            message = f"{self.what}: what was found does not prove itself in double precision: {error}"
            raise InfeasibleError(message, numerical=True) from failed

    def _solved(self, S: Array, tau: float, largest: float) -> tuple[Array, Array | None]:
        """Return X, and Y where a gain is designed, in the coordinates y, x = S y, with I/largest <= X <= largest I."""
        import cvxpy as cp  # noqa: PLC0415

        n, options, inverse = self.system.n, self.options, np.linalg.inv(S)
        gain = self.K_0 if self.system.K is None else self.system.K
        W, B = inverse @ self.G @ S, inverse @ self.system.B
        X = cp.Variable((n, n), symmetric=True)
        Y = cp.Variable((self.system.m, n)) if self.system.K is None else None
        drift = (inverse @ (self.system.A + self.system.B @ gain) @ S / self.omega) @ X
        if Y is not None and self.bounds is not None:  # Y in units of the bounds
            drift = drift + (B * self.bounds / self.omega) @ Y
        monotone = W @ X + (W @ X).T
        decrease = drift + drift.T + (options.alpha / self.omega) * monotone + SLACK * X
        if options.d_max:
            decrease = decrease + B @ B.T / (tau * self.omega) + (tau * options.d_max**2 / self.omega) * X
        constraints: list[Any] = [
            monotone >> 2 * options.beta * (1 + SLACK) * X,
            X >> np.eye(n) / largest,
            X << np.eye(n) * largest,
        ]
        constraints += [row @ X @ row <= 1.0 for row in self._sizes(S)]
        if Y is not None:
            rows = [Y[i : i + 1] for i in range(self.system.m)]
            constraints += [cp.bmat([[np.eye(1), row], [row.T, X]]) >> 0 for row in rows]
        if options.psi:  # psi I in the coordinates of x, by a Schur complement
            SX = S @ X
            constraints.append(cp.bmat([[decrease, SX.T], [SX, -(self.omega / options.psi) * np.eye(n)]]) << 0)
        else:
            constraints.append(decrease << 0)
        solve(cp.Problem(cp.Maximize(cp.log_det(X)), constraints), self.what)
        if Y is None or self.bounds is None:
            return np.asarray(X.value), None
        return np.asarray(X.value), self.bounds[:, None] * np.asarray(Y.value)

    def _made(self, S: Array, X: Array, Y: Array | None, tau: float, method: str) -> Design:
        o, inverse = self.options, np.linalg.inv(S)
        P = inverse.T @ np.linalg.inv(X) @ inverse
        system = self.system
        if Y is not None:
            system = system.changed(K=self.K_0 + np.linalg.solve(X, Y.T).T @ inverse)
        return Design(system, (P + P.T) / 2, o.mu, o.alpha, o.psi, o.d_max, tau, method)


@QUIET
def largest_alpha(
    system: System, mu: float = 1.0, tolerance: float = 1e-4, say: Say = None, beta: float = 0.0
) -> float:
    """Return the largest alpha [1/s] for which a solution of (11) is found, within the relative `tolerance`, from below.

    It lies below the decay rate of the slowest pole, because every w_i is at least 1. `say` is told how the search goes.
    Raises InfeasibleError where no solution is found for any alpha.
    """
    _check_gain(system)
    problem, omega = _closed_loop(system, beta)
    found = search(problem, mu, np.inf, Limit(SEARCH_TIME, say), tolerance / 10)
    if found.mu < mu:
        rate = decay(problem) * omega
        refuted = is_refuted(found.problem, mu, found.a)
        why = (
            "the matrix inequalities have no solution"
            if refuted
            else "no solution of the matrix inequalities was found"
        )
        raise InfeasibleError(f"{why} for any alpha down to {1e-5 * rate:.2g} 1/s", numerical=not refuted)
    return found.a * omega


@dataclass(frozen=True)
class Choice:
    """Options of a design, and why those that nobody gave are what they are: a sentence each."""

    options: Options
    reasons: tuple[str, ...]


@QUIET
def chosen_options(
    system: System,
    mu: float | None = None,
    alpha: float | None = None,
    u_max: Sequence[float] | None = None,
    say: Say = None,
    **rest: Any,
) -> Choice:
    """Return options for an inverse design: what is not given is chosen from the system.

    mu is 1, with integral action 1/2, or the first of MUS below at which a solution is found; alpha [1/s] half of the
    largest one at that mu; u_max half of the room that the limits leave around the equilibrium, without limits 1 for each
    input. `rest` are other options. Raises as `largest_alpha`, and UserError for a mu that integral action does not have.
    """
    reasons = []
    most = largest_mu(system)
    if mu is not None and system.integral is not None:
        check_degree(mu)
    if alpha is None or mu is None:
        mus = tuple(m for m in MUS if m <= most) if mu is None else (mu,)
        found, largest = _first_mu(system, mus, alpha, say)
        if mu is None:
            why = "rejects disturbances" if found == 1.0 else "the largest of those tried"
            reasons.append(f"mu = {found:g}: {'the largest for integral action' if found == most < 1.0 else why}")
        if alpha is None:
            alpha = SHARE_OF_ALPHA * largest
            reasons.append(f"alpha = {alpha:.4g} 1/s: half of the largest one for which a solution is found")
        mu = found
    if u_max is None and rest.get("delta_max") is None:
        u_max, reason = _bounds_from_limits(system)
        reasons.append(reason)
    return Choice(Options(mu=mu, alpha=alpha, u_max=u_max, **rest), tuple(reasons))


def _first_mu(system: System, mus: Sequence[float], alpha: float | None, say: Say) -> tuple[float, float]:
    """Return the first mu for which alpha, or any, is feasible, and the largest alpha there."""
    for mu in mus:
        try:
            largest = largest_alpha(system, mu, ROUGH, say, Options.beta)
        except InfeasibleError:
            if mu == mus[-1]:
                raise
            continue
        if alpha is None or alpha < largest or mu == mus[-1]:
            return mu, largest
    raise AssertionError


def _bounds_from_limits(system: System) -> tuple[list[float], str]:
    room = np.minimum(system.upper - system.u_eq, system.u_eq - system.lower)  # type: ignore[operator]
    limited = np.isfinite(room)
    least, most = (scale / SHARE_OF_LIMIT for scale in SCALES)
    for q, size in zip(system.inputs, room, strict=True):
        if np.isfinite(size) and not least <= size <= most:
            raise UserError(
                f"limits must leave a room of {least:g} to {most:g} around the inputs at the equilibrium, half of which is "
                f"u_max where none is given, found {size:g} for {q.name}"
            )
    bounds = np.where(limited, SHARE_OF_LIMIT * room, 1.0).tolist()
    shown = ", ".join(
        f"{bound:g}{'' if q.unit == '1' else ' ' + q.unit}" for bound, q in zip(bounds, system.inputs, strict=True)
    )
    half = "half of the room within the limits"
    source = half if limited.all() else "1 without limits" if not limited.any() else f"{half}, without limits 1"
    return bounds, f"u_max = {shown}: the homogeneous part of the control on the unit ball; {source}"
