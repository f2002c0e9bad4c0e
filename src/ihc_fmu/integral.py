"""Integral action of a homogeneous controller (HPIC): a constant disturbance of the inputs leaves no error.

    u = u_h + v,   v' = q r^(1 - 2 mu) K_i y,   K_i = -Gamma B' P,   Gamma = Gamma' > 0,   mu <= 1/2,

with u_h the homogeneous law, r the norm in it, y = d(-ln r) x, and q = 1/(y' P G_d y) where r = ||x||_d, so that y' P y = 1;
q = 1 where r is one of its limits a_min and b_max. For a constant disturbance d of the inputs let w = v + d and

    V = f + w' Gamma^-1 w / 2,   f = r^(2 - 2 mu)/(2 - 2 mu)          where r = ||x||_d,
                                 f = r^(2 - 2 mu) y' P y / 2 + const.  where r is a limit.

With the constants that make V continuous, what B w adds to V' is what Gamma^-1 v' takes away:

    V' = q r^(2 - 3 mu) y' (P (A + B K) + (A + B K)' P) y / 2 < 0  for x != 0.

That is inequality (11) of the design's certificate. Besides, the proof needs Gamma > 0 and mu <= 1/2 only: whatever the
limits a_min and b_max, x -> 0 and B (v + d) -> 0 from every state (LaSalle). Without limits of the norm the closed loop is
homogeneous of degree -mu in (x, w), with the weights of the dilation and 1 - mu, and so comes to rest in finite time.
What is proven is the law in continuous time, with the exact norm, the true state and inputs that are not limited.

Source: A. Polyakov, Generalized Homogeneity in Systems and Control, Springer 2020; the form without limits of the norm.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from fmu_export.errors import UserError

from .certificate import CertificateError, is_positive

if TYPE_CHECKING:
    from .candidate import Candidate
    from .system import System

Array = np.ndarray

LARGEST_MU = 0.5
"""Of integral action: beyond, r^(1 - 2 mu) has no bound near the origin."""
SHARE_OF_BOUND = 0.5
"""The root of Gamma relative to u_max, the largest |(K - K_0) x| on the unit ball: a model of order 1 gets a double pole."""


@dataclass(frozen=True, eq=False)
class IntegralAction:
    """K_i = -Gamma B' P (m, n) [u/s per unit of x] with its proof: Gamma (m, m) [u^2], symmetric and positive definite.

    K_i is what rounding leaves of that product. Raises CertificateError unless Gamma > 0, decided in exact arithmetic.
    """

    K_i: Array
    Gamma: Array

    def __post_init__(self) -> None:
        G = self.Gamma
        if not (np.isfinite(self.K_i).all() and np.isfinite(G).all()):
            raise CertificateError("the integral action's gain must be finite")
        if not (G == G.T).all() or not is_positive([[Fraction(entry) for entry in row] for row in G.tolist()]):
            raise CertificateError("Gamma > 0 fails: the integral action has no proof")


def integral_action(design: Candidate) -> IntegralAction | None:
    """Return the integral action that the system of a design asks for, None: none.

    Raises UserError for mu > 1/2, for a linear PI controller that is not stable, and for one that no Gamma comes near.
    """
    wanted = design.system.integral
    if wanted is None:
        return None
    check_degree(design.mu)
    if isinstance(wanted, str):
        return _of(design, np.diag((SHARE_OF_BOUND * design.u_max) ** 2))
    _check_linear_pi(design.A + design.B @ design.K, design.B, wanted)
    return _of(design, nearest(wanted, design.B, design.P, design.extent, design.u_max))


def largest_mu(system: System) -> float:
    """Return the largest mu that a design of the system may have."""
    return 1.0 if system.integral is None else LARGEST_MU


def check_degree(mu: float) -> None:
    """Raise UserError for a mu with which there is no integral action."""
    if mu > LARGEST_MU:
        raise UserError(f"integral action needs mu <= {LARGEST_MU:g}, found mu = {mu:g}")


def nearest(K_i: Array, B: Array, P: Array, states: Array, inputs: Array) -> Array:
    """Return Gamma > 0 (m, m) for which -Gamma B' P comes near K_i (m, n): Gamma^-1 K_i + B' P is smallest.

    In the Frobenius norm, with states and inputs divided by the sizes `states` (n,) and `inputs` (m,): with sizes of 1 the
    gain of the authors' toolbox. Raises UserError where rows of K_i depend on each other and where Gamma is not positive.
    """
    from scipy.linalg import solve_continuous_lyapunov  # noqa: PLC0415 - heavy, and a run needs none of it

    K = K_i / inputs[:, None] * states
    M = -(B * inputs).T @ P * states
    if np.linalg.matrix_rank(K) < len(K):
        raise UserError("integral must have independent rows, one for each input")
    Q = solve_continuous_lyapunov(K @ K.T, M @ K.T + K @ M.T)
    if np.linalg.eigvalsh((Q + Q.T) / 2)[0] <= 0.0:
        raise UserError(
            "integral must resemble -Gamma B' P for some Gamma > 0 to become homogeneous, found none; "
            '"direct" chooses a gain'
        )
    Gamma = inputs[:, None] * np.linalg.inv((Q + Q.T) / 2) * inputs
    return (Gamma + Gamma.T) / 2


def _of(design: Candidate, Gamma: Array) -> IntegralAction:
    return IntegralAction(-Gamma @ design.B.T @ design.P, Gamma)


def _check_linear_pi(closed: Array, B: Array, K_i: Array) -> None:
    """Refuse a linear PI controller u = K x + v, v' = K_i x that does not stabilize."""
    m = B.shape[1]
    poles = np.linalg.eigvals(np.block([[closed, B], [K_i, np.zeros((m, m))]]))
    if poles.real.max() >= 0.0:
        raise UserError(
            "integral must be that of a linear controller u = K x + v, v' = K_i x that stabilizes: the largest real part of "
            f"its poles is {poles.real.max():.4g} 1/s"
        )
