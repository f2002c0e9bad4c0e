"""The proof of a design, recomputed from its numbers by eigenvalues; a solver's status is never trusted."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigh, solve_triangular

from fmu_export.errors import UserError

from .companion import chain_form, generator
from .homogeneity import chain, homogeneous_norm, norm_polynomial, to_blocks

if TYPE_CHECKING:
    from .design import Design

Array = np.ndarray

IDENTITY_TOLERANCE = 1e-8
"""Relative residual allowed in the identities (1), which hold exactly but for rounding."""


class CertificateError(UserError):
    """A design does not prove what it claims; the message names the inequality and its margin."""


@dataclass(frozen=True, slots=True)
class Certificate:
    """Margins of a design; every one must be positive (`identities`: at most 1e-8).

    The margins of matrix inequalities are relative to P, which makes them the same in all coordinates: `decrease` is
    -lambda_max of (A_0 + b k)' P + P (A_0 + b k) + alpha (G_d' P + P G_d) + disturbance terms, relative to P [1/s],
    `monotone` is lambda_min of G_d' P + P G_d relative to P [1], `positive` is lambda_min / lambda_max of P after its
    diagonal is scaled to 1, `hurwitz` is minus the largest real part of the poles of A + b k_lin [1/s]. `identities` is
    the largest relative residual of A_0 G_d - G_d A_0 = -mu A_0 and G_d b = b. `matched_disturbance` [V] is the bound on
    a disturbance added to the control up to which ||x||_d provably still decreases everywhere (mu = 1; 0 for mu < 1).
    """

    decrease: float
    monotone: float
    positive: float
    hurwitz: float
    identities: float
    matched_disturbance: float

    def as_dict(self) -> dict[str, float]:
        """Return the margins by name."""
        return asdict(self)


def relative_eigenvalues(M: Array, P: Array) -> Array:
    """Return the eigenvalues of the symmetric M relative to P > 0, ascending: those of P^(-1/2) M P^(-1/2)."""
    d = 1.0 / np.sqrt(np.diag(P))
    return eigh(d[:, None] * (M + M.T) / 2 * d, d[:, None] * P * d, eigvals_only=True)


def decrease_matrix(design: Design, alpha: float) -> Array:
    """Return (A_0 + b k)' P + P (A_0 + b k) + alpha (G_d' P + P G_d), the left side of (2) and (11)."""
    closed = design.A + np.outer(design.b, design.k_lin) + alpha * generator(design.Phi, design.mu)
    return closed.T @ design.P + design.P @ closed


def disturbance_terms(design: Design) -> Array:
    """Return what Remark 3 adds to inequality (2): psi I, and for a matched disturbance |d| <= d_max at mu = 1

    P b b' P / tau + tau d_max^2 P >= 2 |y' P b| d_max on the unit sphere, with the tau of the design.
    """
    P, b = design.P, design.b
    extra = design.psi * np.eye(len(b))
    if design.d_max > 0.0:
        Pb = P @ b
        extra = extra + np.outer(Pb, Pb) / design.tau + design.tau * design.d_max**2 * P
    return extra


def certify(design: Design) -> Certificate:
    """Return the certificate of `design`, or raise CertificateError that names the inequality and its margin."""
    P = design.P
    d = 1.0 / np.sqrt(np.maximum(np.diag(P), 1e-300))
    scaled = eigh(d[:, None] * P * d, eigvals_only=True)
    positive = float(scaled[0] / scaled[-1])
    if np.abs(P - P.T).max() > 1e-9 * np.abs(P).max():
        raise CertificateError(f"P must be symmetric, found an asymmetry of {np.abs(P - P.T).max():.3g}")
    if not positive > 1e-14 or np.diag(P).min() <= 0.0:
        raise CertificateError(f"P > 0 fails: smallest eigenvalue relative to the largest {positive:.3g}")
    G = generator(design.Phi, design.mu)
    certificate = Certificate(
        decrease=-float(relative_eigenvalues(decrease_matrix(design, design.alpha) + disturbance_terms(design), P)[-1]),
        monotone=float(relative_eigenvalues(G.T @ P + P @ G, P)[0]),
        positive=positive,
        hurwitz=-float(np.linalg.eigvals(design.A + np.outer(design.b, design.k_lin)).real.max()),
        identities=_identity_residual(design, G),
        matched_disturbance=largest_matched_disturbance(design),
    )
    _require(certificate.hurwitz, "A + b k_lin Hurwitz", "1/s")
    _require(certificate.monotone, "G_d' P + P G_d > 0", "relative to P")
    name = "(A_0 + b k)' P + P (A_0 + b k) + alpha (G_d' P + P G_d) <= 0"
    robust = design.psi > 0.0 or design.d_max > 0.0
    _require(
        certificate.decrease, name.replace(" <=", " + disturbance terms <=") if robust else name, "1/s relative to P"
    )
    if certificate.identities > IDENTITY_TOLERANCE:
        raise CertificateError(
            f"A_0 G_d - G_d A_0 = -mu A_0 and G_d b = b fail: relative residual {certificate.identities:.3g}, "
            f"allowed {IDENTITY_TOLERANCE:g}"
        )
    return certificate


def _require(margin: float, inequality: str, unit: str) -> None:
    if not margin > 0.0:
        raise CertificateError(f"{inequality} fails: margin {margin:.3g} ({unit}), must be positive")


def _identity_residual(design: Design, G: Array) -> float:
    """Return the larger relative residual of the identities (1), in chain coordinates, where scales are comparable."""
    form = chain_form(design.A, design.b)
    A_0 = design.A - np.outer(design.b, design.row)
    residuals = (
        (A_0 @ G - G @ A_0 + design.mu * form.A_0, np.abs(A_0) @ np.abs(G) + np.abs(G) @ np.abs(A_0)),
        ((G @ design.b - design.b)[:, None], (np.abs(G) @ np.abs(design.b) + np.abs(design.b))[:, None]),
    )
    return max(float(np.abs(residual).max() / max(scale.max(), 1e-300)) for residual, scale in residuals)


def largest_matched_disturbance(design: Design) -> float:
    """Return the largest d_max [V] for which this P proves d||x||_d/dt < 0 for all x and |d| < d_max; 0 for mu < 1.

    With S = -P^(-1/2) M P^(-1/2) > 0, M the left side of (11) at alpha = 0, and c = P^(1/2) b, some tau must give
    S - c c'/tau - tau d^2 I >= 0. For a given tau the largest d^2 is lambda_min(S - c c'/tau)/tau; a scan over tau finds
    the best. For mu < 1 the disturbance dominates near the origin and only practical convergence can be claimed.
    """
    if design.mu < 1.0:
        return 0.0
    L = np.linalg.cholesky(design.P)
    inner = solve_triangular(L, decrease_matrix(design, 0.0), lower=True)
    S = -solve_triangular(L, inner.T, lower=True)
    S = (S + S.T) / 2
    c = L.T @ design.b
    reach = float(c @ c)
    best = 0.0
    for tau in np.geomspace(1e-4, 1e4, 801) * reach:
        best = max(best, float(np.linalg.eigvalsh(S - np.outer(c, c) / tau)[0]) / tau)
    return float(np.sqrt(best))


def norm_of(design: Design, x: Array) -> float:
    """Return ||x||_d for the design's P and dilation."""
    Pz = to_blocks(design.Phi.tolist(), design.P.tolist())
    z = (design.Phi @ np.asarray(x, float)).tolist()
    return homogeneous_norm(norm_polynomial(Pz, z, chain(design.n), design.mu), design.mu)


def settling_time_bound(design: Design, x0: Array) -> float:
    """Return T(x0) [s] by which the linear closed loop has reached the origin: r0^mu / (mu alpha), r0 = ||x0||_d.

    It follows from d||x||_d/dt <= -alpha ||x||_d^(1-mu); at mu = 1 it is the bound r0/alpha of Corollary 1. It holds for
    the ideal law, a_min = 0 and b_max above r0, and unlimited voltage.
    """
    return norm_of(design, x0) ** design.mu / (design.mu * design.alpha)
