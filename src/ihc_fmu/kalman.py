"""Design of the Kalman filter with disturbance and bias: the constant gain of `velocity.kalman_step`.

The filter's state is (theta, delta, theta', delta', d, beta): the pendulum's, a disturbance voltage d that enters with
the motor voltage, and the bias beta of the measured pendulum angle, y = (theta, delta + beta). Without the bias the
filter would take an encoder zeroed a fraction of a count beside upright for a disturbance.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import frexp, inf, nan, pi

import numpy as np

from fmu_export.errors import UserError
from rotary_pendulum import linearization

from .homogeneity import Matrix, product, solve, transpose
from .pendulum.nominal_model import NominalModel
from .pendulum.velocity import BIAS_DECAY

Array = np.ndarray

TAYLOR_TERMS = 20
"""Of the exponential of a matrix smaller than 1/2: the rest is below rounding."""

DOUBLINGS = 60
CONVERGED = 1e-18
"""The Riccati equation is solved by at most so many doublings, until one changes the covariance by less than this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KalmanOptions:
    """Noise intensities: of the voltage, of its slow disturbance, of the bias; and the encoders' resolution.

    The measurement's variance is resolution^2/12 at 1 ms, in inverse proportion to the sample time.
    """

    voltage_noise: float = 2e-5  # [V^2 s]
    disturbance_noise: float = 0.15  # [V^2/s]
    bias_noise: float = 3e-9  # [rad^2/s]
    resolution: float = 2 * pi / 2048  # [rad]


def linearize(m: NominalModel) -> tuple[Array, Array]:
    """Return (A, b) of the nominal model at the upright equilibrium, for the motor voltage as input."""
    return linearization.linearize(m.pendulum, m.torque_per_volt)


def kalman_gain(A: Array, b: Array, h: float, options: KalmanOptions | None = None) -> Array:
    """Return the steady-state gain M (6, 2) of the current estimator for x' = A x + b V sampled every `h` [s].

    Upper rows in [1] and [1/s], row 5 in V/rad, row 6 in [1]. Process noise is integrated exactly over a sample (Van
    Loan, IEEE Trans. Automatic Control 23(3), 1978); the stationary covariance solves the discrete Riccati equation.
    Raises UserError for an `h` that is not positive and finite, and a model for which there is no such gain.
    """
    if not 0.0 < h < inf:
        raise UserError(f"the sample time must be positive and finite, found {h} s")
    if not (np.isfinite(A).all() and np.isfinite(b).all()):
        raise UserError(
            "there is no Kalman filter for this nominal model: its inertias must have a positive determinant"
        )
    o = options or KalmanOptions()
    F = np.zeros((6, 6))
    F[:4, :4], F[:4, 4], F[5, 5] = A, b, -BIAS_DECAY
    B = np.concatenate([b, [0.0, 0.0]])
    Q = o.voltage_noise * np.outer(B, B) + np.diag([0.0, 0.0, 0.0, 0.0, o.disturbance_noise, o.bias_noise])
    block = exponential((np.block([[-F, Q], [np.zeros((6, 6)), F.T]]) * h).tolist())
    transposed = [row[6:] for row in block[6:]]
    noise = multiplied(transpose(transposed), [row[6:] for row in block[:6]])
    C = [[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0, 0.0, 1.0]]
    variance = o.resolution**2 / 12.0 * (1e-3 / h)
    try:
        seen = multiplied(C, stationary_covariance(transposed, C, noise, variance))
        innovation = plus(multiplied(seen, transpose(C)), [[variance, 0.0], [0.0, variance]])
        M = np.array(transpose(solve(innovation, seen)))
    except UserError:
        M = np.full((6, 2), nan)
    if not np.isfinite(M).all():
        raise UserError("there is no Kalman filter for this nominal model: its Riccati equation has no solution")
    return M


def multiplied(A: Matrix, B: Matrix) -> list[list[float]]:
    """Return A B by plain arithmetic: every processor and library gives the same bits."""
    columns = transpose(B)
    return [product(columns, row) for row in A]


def plus(A: Matrix, B: Matrix) -> list[list[float]]:
    """Return A + B."""
    return [[a + b for a, b in zip(p, q, strict=True)] for p, q in zip(A, B, strict=True)]


def exponential(M: Matrix) -> list[list[float]]:
    """Return e^M by its Taylor series, of M halved until its rows sum up to less than 1/2, and by squaring."""
    size = max(sum(map(abs, row)) for row in M)
    halvings = max(0, frexp(size)[1] + 1)
    unit = [[1.0 if i == j else 0.0 for j in range(len(M))] for i in range(len(M))]
    small = [[entry * 0.5**halvings for entry in row] for row in M]
    found = unit
    for k in range(TAYLOR_TERMS, 0, -1):
        found = plus(unit, [[entry / k for entry in row] for row in multiplied(small, found)])
    for _ in range(halvings):
        found = multiplied(found, found)
    return found


def stationary_covariance(F_t: Matrix, C: Matrix, Q: Matrix, variance: float) -> list[list[float]]:
    """Return X = F (X - X C' (C X C' + variance I)^-1 C X) F' + Q, given F', by structure-preserving doubling.

    A <- A W A, G <- G + A W G A', X <- X + A' X W A with W = (I + G X)^-1 (Chu, Fan, Lin and Wang, Int. J. Control 77(8),
    2004), from A = F', G = C' C/variance, X = Q; converges quadratically.
    """
    A, X = [list(row) for row in F_t], [list(row) for row in Q]
    G = [[entry / variance for entry in row] for row in multiplied(transpose(C), C)]
    unit = [[1.0 if i == j else 0.0 for j in range(len(A))] for i in range(len(A))]
    for _ in range(DOUBLINGS):
        both = solve(plus(unit, multiplied(G, X)), [a + g for a, g in zip(A, G, strict=True)])
        WA, WG = [row[: len(A)] for row in both], [row[len(A) :] for row in both]
        change = multiplied(transpose(A), multiplied(X, WA))
        G = plus(G, multiplied(multiplied(A, WG), transpose(A)))
        A = multiplied(A, WA)
        X = plus(X, change)
        if max(abs(d) for row in change for d in row) <= CONVERGED * max(abs(x) for row in X for x in row):
            break
    return X
