"""Design of the Kalman filter with disturbance and bias: the constant gain of `velocity.kalman_step`.

The filter's state is (theta, delta, theta', delta', d, beta): the pendulum's, a disturbance voltage d that enters with
the motor voltage, and the bias beta of the measured pendulum angle, y = (theta, delta + beta). Without the bias the
filter would take an encoder zeroed a fraction of a count beside upright for a disturbance.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from fmu_export.errors import UserError

from .nominal_model import NominalModel
from .velocity import BIAS_DECAY

Array = np.ndarray


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
    determinant = m.arm_inertia * m.pendulum_inertia - m.coupling**2
    from_arm = np.array([m.pendulum_inertia, m.coupling]) / determinant  # accelerations per torque on the arm
    from_pendulum = np.array([m.coupling, m.arm_inertia]) / determinant
    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2:, 1] = m.gravity_torque * from_pendulum
    A[2:, 2] = -(m.arm_damping + m.motor_damping) * from_arm
    A[2:, 3] = -m.pendulum_damping * from_pendulum
    return A, np.concatenate([[0.0, 0.0], m.torque_per_volt * from_arm])


def kalman_gain(A: Array, b: Array, h: float, options: KalmanOptions | None = None) -> Array:
    """Return the steady-state gain M (6, 2) of the current estimator for x' = A x + b V sampled every `h` [s].

    Upper rows in [1] and [1/s], row 5 in V/rad, row 6 in [1]. Process noise is integrated exactly over a sample (Van
    Loan, IEEE Trans. Automatic Control 23(3), 1978); the stationary covariance solves the discrete Riccati equation.
    Raises UserError for an `h` that is not positive and finite, and a model for which there is no such gain.
    """
    if not 0.0 < h < np.inf:
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
    block = expm(np.block([[-F, Q], [np.zeros((6, 6)), F.T]]) * h)
    transition = block[6:, 6:].T
    C = np.zeros((2, 6))
    C[0, 0] = C[1, 1] = C[1, 5] = 1.0
    R = o.resolution**2 / 12.0 * (1e-3 / h) * np.eye(2)
    try:
        covariance = solve_discrete_are(transition.T, C.T, transition @ block[:6, 6:], R)
    except np.linalg.LinAlgError:
        raise UserError(
            "there is no Kalman filter for this nominal model: its Riccati equation has no solution"
        ) from None
    return np.linalg.solve(C @ covariance @ C.T + R, C @ covariance).T
