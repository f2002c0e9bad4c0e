"""The proof of a design, recomputed from its numbers; a solver's status is never trusted.

Margins are computed by eigenvalues in coordinates in which P is the unit matrix. Whether the inequalities hold is decided
besides in exact arithmetic, for the numbers as they are: no rounding proves what does not hold.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from fractions import Fraction
from math import lcm
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fmu_export.errors import UserError

from .homogeneity import homogeneous_norm, norm_polynomial
from .quantity import vector

if TYPE_CHECKING:
    from .candidate import Candidate

Array = np.ndarray
Exact = list[list[Fraction]]

IDENTITY_TOLERANCE = 1e-8
"""Relative residual allowed in the identities (1), which hold exactly but for rounding."""
FLATTEST = 1e-14
"""P's smallest eigenvalue relative to the largest, its diagonal scaled to 1, must be above this: rounding of its entries."""


class CertificateError(UserError):
    """A design does not prove what it claims; the message names the inequality and its margin.

    Examples
    --------
    >>> from ihc_fmu import CertificateError, Design, System
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> try:
    ...     Design(cart, P=[[1, 0.5], [0.5, 0.3]], mu=1.0, alpha=2.0)
    ... except CertificateError as error:
    ...     print(error)
    (A + B K)' P + P (A + B K) + alpha (G_d' P + P G_d) <= 0 fails: margin -7.73 (1/s relative to P), must be positive
    """


@dataclass(frozen=True, slots=True)
class Certificate:
    """Margins of a design; every one must be positive (`identities`: at most 1e-8).

    The margins of matrix inequalities are relative to P, which makes them the same in all coordinates.

    Parameters
    ----------
    decrease
        -lambda_max of (A + B K)' P + P (A + B K) + alpha (G_d' P + P G_d) + disturbance terms, relative to P [1/s]: (11).
    monotone
        lambda_min of G_d' P + P G_d relative to P [1].
    positive
        lambda_min / lambda_max of P after its diagonal is scaled to 1.
    hurwitz
        Minus the largest real part of the poles of A + B K [1/s].
    identities
        Largest relative residual of A_0 G_d - G_d A_0 = -mu A_0 and G_d B = B, eq. (1).
    matched_disturbance
        Bound on the Euclidean norm of a disturbance added to the control [units of u] up to which ||x||_d provably still
        decreases everywhere (mu = 1; 0 for mu < 1).

    Examples
    --------
    >>> from ihc_fmu import Design, System
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> certificate = Design(cart, P=[[1, 0.5], [0.5, 0.3]], mu=1.0, alpha=0.5).certificate
    >>> round(certificate.hurwitz, 3), round(certificate.matched_disturbance, 3)
    (2.0, 4.0)
    >>> all(certificate.as_dict()[margin] > 0.0 for margin in ("decrease", "monotone", "positive"))
    True
    """

    decrease: float
    monotone: float
    positive: float
    hurwitz: float
    identities: float
    matched_disturbance: float

    def as_dict(self) -> dict[str, float]:
        """Return the margins by name.

        Returns
        -------
        dict[str, float]
            In the order above.
        """
        return asdict(self)


def certify(design: Candidate) -> Certificate:
    """Return the certificate of `design`, or raise CertificateError that names the inequality and its margin."""
    P, form = design.P, design.form
    if np.abs(P - P.T).max() > 1e-9 * np.abs(P).max():
        raise CertificateError(f"P must be symmetric, found an asymmetry of {np.abs(P - P.T).max():.3g}")
    positive, L_t = _positivity(P, form.T_inverse)
    unit = UnitBall(design, L_t)
    exact = _ExactSides(design)
    certificate = Certificate(
        decrease=-float(np.linalg.eigvalsh(unit.decrease(design.alpha) + unit.disturbance_terms())[-1]),
        monotone=float(np.linalg.eigvalsh(unit.W + unit.W.T)[0]),
        positive=positive,
        hurwitz=-float(np.linalg.eigvals(design.A + design.B @ design.K).real.max()),
        identities=_identity_residual(design),
        matched_disturbance=unit.largest_matched_disturbance(),
    )
    _require(certificate.hurwitz > 0.0, "A + B K Hurwitz", certificate.hurwitz, "1/s")
    _require(
        certificate.monotone > 0.0 and is_positive(exact.monotone()),
        "G_d' P + P G_d > 0",
        certificate.monotone,
        "relative to P",
    )
    name = "(A + B K)' P + P (A + B K) + alpha (G_d' P + P G_d) <= 0"
    robust = design.psi > 0.0 or design.d_max > 0.0
    _require(
        certificate.decrease > 0.0 and is_positive(exact.decrease()),
        name.replace(" <=", " + disturbance terms <=") if robust else name,
        certificate.decrease,
        "1/s relative to P",
    )
    if certificate.identities > IDENTITY_TOLERANCE:
        raise CertificateError(
            f"A_0 G_d - G_d A_0 = -mu A_0 and G_d B = B fail: relative residual {certificate.identities:.3g}, "
            f"allowed {IDENTITY_TOLERANCE:g}"
        )
    return certificate


def _positivity(P: Array, T_inverse: Array) -> tuple[float, Array]:
    """Return lambda_min/lambda_max of P with its diagonal scaled to 1, and L' with T^-T P T^-1 = L L'."""
    smallest = float(np.diag(P).min())
    positive = smallest
    if smallest > 0.0:
        d = 1.0 / np.sqrt(np.diag(P))
        values = np.linalg.eigvalsh(d[:, None] * P * d)
        positive = float(values[0] / values[-1])
    Pz = T_inverse.T @ P @ T_inverse
    try:
        if positive <= FLATTEST:
            raise np.linalg.LinAlgError
        return positive, np.linalg.cholesky((Pz + Pz.T) / 2).T
    except np.linalg.LinAlgError:
        raise CertificateError(f"P > 0 fails: smallest eigenvalue relative to the largest {positive:.3g}") from None


def _require(holds: bool, inequality: str, margin: float, unit: str) -> None:
    if not holds:
        raise CertificateError(f"{inequality} fails: margin {margin:.3g} ({unit}), must be positive")


class UnitBall:
    """The closed loop in coordinates y = L' T x in which x' P x = y' y, so that matrices there are relative to P."""

    def __init__(self, design: Candidate, L_t: Array) -> None:
        form, inverse = design.form, np.linalg.inv(L_t)
        self.design = design
        self.closed = L_t @ (form.T @ (design.A + design.B @ design.K) @ form.T_inverse) @ inverse
        self.W = L_t @ (form.weights(design.mu)[:, None] * inverse)
        self.B = L_t @ form.Bz
        self.to_x = form.T_inverse @ inverse

    def decrease(self, alpha: float) -> Array:
        """Return (A + B K)' P + P (A + B K) + alpha (G_d' P + P G_d), the left side of (2) and (11)."""
        F = self.closed + alpha * self.W
        return F + F.T

    def disturbance_terms(self) -> Array:
        """Return what Remark 3 adds to inequality (2): psi I, and for a matched disturbance |d| <= d_max at mu = 1

        P B B' P / tau + tau d_max^2 P >= 2 |y' P B| d_max on the unit sphere, with the tau of the design.
        """
        d = self.design
        extra = d.psi * self.to_x.T @ self.to_x
        if d.d_max > 0.0:
            extra = extra + self.B @ self.B.T / d.tau + d.tau * d.d_max**2 * np.eye(d.n)
        return extra

    def largest_matched_disturbance(self) -> float:
        """Return the largest d_max for which this P proves d||x||_d/dt < 0 for all x and |d| < d_max; 0 for mu < 1.

        With S = -(decrease at alpha = 0) > 0, some tau must give S - B B'/tau - tau d^2 I >= 0. For a given tau the largest
        d^2 is lambda_min(S - B B'/tau)/tau; a scan over tau finds the best. For mu < 1 the disturbance dominates near the
        origin and only practical convergence can be claimed.
        """
        if self.design.mu < 1.0:
            return 0.0
        S, reach = -self.decrease(0.0), self.B @ self.B.T
        taus = np.geomspace(1e-4, 1e4, 801) * float(np.linalg.norm(reach, 2))
        rates = np.linalg.eigvalsh(S - reach / taus[:, None, None])[:, 0] / taus
        return float(np.sqrt(max(0.0, rates.max())))


class _ExactSides:
    """The left sides of the inequalities as fractions: what the numbers of the design mean, without rounding."""

    def __init__(self, design: Candidate) -> None:
        self.design = design
        self.P = _exact((design.P + design.P.T) / 2)
        self.PG = _product(self.P, _exact(design.form.generator(design.mu)))

    def monotone(self) -> Exact:
        """Return G_d' P + P G_d."""
        return _plus_transpose(self.PG)

    def decrease(self) -> Exact:
        """Return minus the left side of (11), with the terms of Remark 3."""
        d = self.design
        BK = _product(_exact(d.B), _exact(d.K))
        closed = [[a + b for a, b in zip(p, q, strict=True)] for p, q in zip(_exact(d.A), BK, strict=True)]
        alpha, n = Fraction(d.alpha), d.n
        terms = [(-1, _plus_transpose(_product(self.P, closed))), (-alpha, self.monotone())]
        if d.psi > 0.0:
            terms.append((-Fraction(d.psi), [[Fraction(i == j) for j in range(n)] for i in range(n)]))
        if d.d_max > 0.0:
            PB = _product(self.P, _exact(d.B))
            terms += [
                (-1 / Fraction(d.tau), _product(PB, [list(column) for column in zip(*PB, strict=True)])),
                (-Fraction(d.tau) * Fraction(d.d_max) ** 2, self.P),
            ]
        return [[sum((c * M[i][j] for c, M in terms), Fraction(0)) for j in range(n)] for i in range(n)]


def _exact(M: Array) -> Exact:
    return [[Fraction(entry) for entry in row] for row in M.tolist()]


def _product(A: Exact, B: Exact) -> Exact:
    columns = list(zip(*B, strict=True))
    return [[sum((a * b for a, b in zip(row, column, strict=True)), Fraction(0)) for column in columns] for row in A]


def _plus_transpose(M: Exact) -> Exact:
    return [[M[i][j] + M[j][i] for j in range(len(M))] for i in range(len(M))]


def is_positive(M: Exact) -> bool:
    """Return whether a symmetric matrix is positive definite: its leading principal minors are positive (Sylvester).

    They are found without fractions, by E. H. Bareiss, Math. Comp. 22 (1968), 565-578.
    """
    common = lcm(*(entry.denominator for row in M for entry in row))
    rows = [[int(entry * common) for entry in row] for row in M]
    previous = 1
    for k in range(len(rows)):
        pivot = rows[k][k]
        if pivot <= 0:
            return False
        for i in range(k + 1, len(rows)):
            for j in range(k + 1, len(rows)):
                rows[i][j] = (pivot * rows[i][j] - rows[i][k] * rows[k][j]) // previous
        previous = pivot
    return True


def _identity_residual(design: Candidate) -> float:
    """Return the larger relative residual of the identities (1), in block coordinates, where scales are comparable.

    There G_d is diag(w), so that what is left of both is what T (A + B K_0) T^-1 and T B have besides N and B_k.
    """
    form, w = design.form, design.form.weights(design.mu)
    parts = form.T @ design.A @ form.T_inverse, form.T @ design.B @ form.K_0 @ form.T_inverse
    residual = (parts[0] + parts[1]) * (w[None, :] - w[:, None] + design.mu)
    scale = max(float((np.abs(part) * (w[None, :] + w[:, None])).max()) for part in parts)
    lost = form.T @ design.B - form.Bz
    scale, size = max(scale, 1e-300), max(float(np.abs(form.Bz).max()), 1e-300)
    return max(float(np.abs(residual).max()) / scale, float(np.abs(lost).max()) / size)


def norm_of(design: Candidate, x: ArrayLike) -> float:
    """Return the homogeneous norm ||x||_d, the root r of x' d(1/r)' P d(1/r) x = 1.

    Parameters
    ----------
    design
        Whose P and dilation d count.
    x
        Deviation of the states from the equilibrium, shape (n,).

    Returns
    -------
    float
        0 at the origin, 1 on the unit sphere x' P x = 1.

    Raises
    ------
    UserError
        For another length, and for entries that are not finite.

    Examples
    --------
    >>> from ihc_fmu import Design, System, norm_of
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> design = Design(cart, P=[[1, 0.5], [0.5, 0.3]], mu=1.0, alpha=0.5)
    >>> norm_of(design, [1.0, 0.0]), round(norm_of(design, [0.01, 0.0]), 6)  # the position has the weight 2
    (1.0, 0.1)
    """
    form = design.form
    Pz = (form.T_inverse.T @ design.P @ form.T_inverse).tolist()
    z = (form.T @ _state(design, x)).tolist()
    return homogeneous_norm(norm_polynomial(Pz, z, form.exponents, design.mu), design.mu)


def _state(design: Candidate, x: ArrayLike) -> Array:
    states = design.system.states
    state = vector("x", x, states)
    if not np.isfinite(state).all():
        i = int(np.argmin(np.isfinite(state)))
        raise UserError(f"x must be finite, found {state[i]} for {states[i].name}")
    return state


def settling_time_bound(design: Candidate, x0: ArrayLike) -> float:
    """Return the time by which the linear closed loop has reached the origin: r0^mu / (mu alpha), r0 = ||x0||_d.

    It follows from d||x||_d/dt <= -alpha ||x||_d^(1-mu); at mu = 1 it is the bound r0/alpha of Corollary 1. It holds for
    the ideal law, a_min = 0 and b_max above r0, and unlimited inputs.

    Parameters
    ----------
    design
        The certified design.
    x0
        Where the states begin, as deviation from the equilibrium, shape (n,).

    Returns
    -------
    float
        The bound T(x0) [s].

    Raises
    ------
    UserError
        As `norm_of`.

    Examples
    --------
    >>> from ihc_fmu import Design, System, settling_time_bound
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> design = Design(cart, P=[[1, 0.5], [0.5, 0.3]], mu=1.0, alpha=0.5)
    >>> settling_time_bound(design, [1.0, 0.0])
    2.0
    """
    return norm_of(design, x0) ** design.mu / (design.mu * design.alpha)
