"""Design of the sliding mode controllers that the IHC is compared with: first-order, and super-twisting.

The paper compares with "a first-order SMC" and prints no gains. Both variants here are designed from (A, b) alone: a
surface s = c x with c b = 1 on which the poles are prescribed, and u = -c A x - kappa s - rho sign(s), so that
s' = -kappa s - rho sign(s).

The super-twisting law of the pendulum has the same surface and linear part, that of any other design the surface that the
design's certificate proves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fmu_export.errors import UserError

from .companion import chain_form
from .linear_algebra import product, transpose

Array = np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class SlidingMode:
    """c (n,): surface, c b = 1. k_eq (n,) = -(c A + kappa c): linear part [V per state]. rho [V]: switching gain."""

    c: Array
    k_eq: Array
    rho: float


FITTED_POLES = (-1.08, -12.6 + 17.0j, -12.6 - 17.0j)
FITTED_KAPPA = 19.3
FITTED_RHO = 1.17


def polynomial_of(roots: Sequence[complex]) -> list[complex]:
    """Return the coefficients of prod(s - root), highest power first, by plain arithmetic."""
    coefficients = [1.0 + 0.0j]
    for root in roots:
        shifted = [root * value for value in coefficients]
        coefficients = [a - b for a, b in zip([*coefficients, 0.0j], [0.0j, *shifted], strict=True)]
    return coefficients


def sliding_mode_design(A: Array, b: Array, poles: Array, kappa: float, rho: float) -> SlidingMode:
    """Return the SMC whose sliding motion has the n - 1 `poles` [1/s] and that reaches s = 0 with rate kappa [1/s].

    c = e_n' C^-1 prod(A - p_i I): by Ackermann's formula the motion on c x = 0 has the poles p_i. Raises UserError for
    the wrong number of poles, unstable ones, or complex ones that are not in conjugate pairs.
    """
    A, b = np.asarray(A, float), np.asarray(b, float)
    poles = np.asarray(poles, complex)
    if poles.shape != (len(b) - 1,) or (np.real(poles) >= 0).any():
        raise UserError(f"the surface needs {len(b) - 1} stable poles, found {poles}")
    coefficients = polynomial_of(poles.tolist())
    if max(abs(c.imag) for c in coefficients) > 1e-9 * max(map(abs, coefficients)):
        raise UserError(f"complex poles must come in conjugate pairs, found {poles}")
    if kappa < 0.0 or rho < 0.0:
        raise UserError(f"kappa and rho must be non-negative, found {kappa} 1/s and {rho} V")
    columns = transpose(chain_form(A, b).Phi.tolist())  # Phi's rows are q, qA, ..., so c = sum of coefficient times row
    c = product(columns, [value.real for value in reversed(coefficients)])
    k_eq = [-(of_A + kappa * entry) for of_A, entry in zip(product(transpose(A.tolist()), c), c, strict=True)]
    return SlidingMode(c=np.array(c), k_eq=np.array(k_eq), rho=rho)


def fitted_smc(A: Array, b: Array) -> SlidingMode:
    """Return SMC1: poles -1.08, -12.6 +- 17i, kappa = 19.3 1/s, rho = 1.17 V.

    A fit to what the paper prints of its SMC: the margins over the LC in Tables I and II at G = 0, 60 and 200, and the
    energy. Its linear part is near k_lin: [1.65, -26.97, 1.70, -2.65].
    """
    return sliding_mode_design(A, b, np.array(FITTED_POLES), FITTED_KAPPA, FITTED_RHO)


def linear_pole_smc(A: Array, b: Array, k_lin: Array) -> SlidingMode:
    """Return SMC2: its linear part is exactly k_lin; the surface keeps all closed-loop poles but the fastest real one.

    That pole becomes the reaching rate kappa; rho = 1 V. Raises UserError where the closed loop has no real pole.
    """
    A, b = np.asarray(A, float), np.asarray(b, float)
    poles = np.linalg.eigvals(A + np.outer(b, k_lin))
    real = np.flatnonzero(np.abs(poles.imag) < 1e-9 * np.abs(poles).max())
    if not real.size:
        raise UserError("the linear closed loop must have a real pole to serve as the reaching rate, found none")
    fastest = real[np.argmin(poles[real].real)]
    return sliding_mode_design(A, b, np.delete(poles, fastest), kappa=-float(poles[fastest].real), rho=1.0)


TUNED_POLES = (-7.18, -16.76 + 11.73j, -16.76 - 11.73j)
TUNED_KAPPA = 20.5
TUNED_RATE = 0.383


def tuned_sta(A: Array, b: Array) -> tuple[SlidingMode, float]:
    """Return surface and linear part of the pendulum's super-twisting law, its rho 0, and its rate L [V/s].

    The best that a search over poles, kappa and L found on the nonlinear pendulum, with the Kalman filter and encoders: the
    smallest steady state times settling time at no more energy and variation of the voltage than the shipped IHC has there.
    """
    return sliding_mode_design(A, b, np.array(TUNED_POLES), TUNED_KAPPA, 0.0), TUNED_RATE


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """s = S x, S (m, n); K_s (m, n) = -(S A + kappa S): linear part [input per state]; rates (m,): L [input per second]."""

    S: Array
    K_s: Array
    rates: Array


def certified_surface(A: Array, B: Array, K: Array, P: Array) -> Surface:
    """Return the surface S = (B' P B)^-1 B' P of a design, on which s' = -kappa s + w + d under u = K_s x + w.

    On S x = 0 x' P x decreases whatever the inputs: it does under K, (A + B K)' P + P (A + B K) < 0, and there other inputs
    add nothing to it. So the sliding motion is stable for every certified design. kappa is that of the linear controller in
    the mean over the unit ball, -tr(S (A + B K) P^-1 S')/tr(S P^-1 S') > 0 [1/s], so that K_s is near K. The rates are
    those of what the linear part answers to the ball's largest S_i x, kappa |S_i x|, within 1/kappa.
    """
    S = np.linalg.pinv(B.T @ P @ B) @ B.T @ P
    of_ball = np.linalg.solve(P, S.T)
    kappa = -float(np.trace(S @ (A + B @ K) @ of_ball) / np.trace(S @ of_ball))
    return Surface(S, -(S @ A + kappa * S), kappa**2 * np.sqrt(np.diag(S @ of_ball)))
