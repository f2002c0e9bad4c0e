"""The Kalman filter of the pendulum's controller: the constant gain of `velocity.kalman_step`.

The filter's state is (theta, delta, theta', delta', d, beta): the pendulum's, a disturbance voltage d that enters with
the motor voltage, and the bias beta of the measured pendulum angle, y = (theta, delta + beta).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi

import numpy as np

from fmu_export.errors import UserError
from rotary_pendulum import linearization

from ..kalman import Noise, kalman_filter
from .nominal_model import NominalModel
from .velocity import BIAS_DECAY

Array = np.ndarray

SAME = 1e-6
"""Two gains that differ by no more than this, relative to the largest entry of its row, are the same."""
FARTHEST = 15.0
"""Noises are looked for within this many natural logarithms of the usual ones."""


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

    Upper rows in [1] and [1/s], row 5 in V/rad, row 6 in [1]. Raises UserError as `kalman_filter`.
    """
    if not (np.isfinite(A).all() and np.isfinite(b).all()):
        raise UserError(
            "there is no Kalman filter for this nominal model: its inertias must have a positive determinant"
        )
    o = options or KalmanOptions()
    variance = o.resolution**2 / 12.0 * (1e-3 / h) if h > 0.0 else 0.0
    noise = Noise(
        inputs=[o.voltage_noise],
        disturbances=[o.disturbance_noise],
        biases=[0.0, o.bias_noise],
        outputs=[variance, variance],
        leak=BIAS_DECAY,
    )
    return kalman_filter(A, b[:, None], np.eye(2, 4), h, noise).M[[0, 1, 2, 3, 4, 6]]


def noises_of(M: Array, A: Array, b: Array, h: float) -> KalmanOptions | None:
    """Return the noises for which `kalman_gain` is M (6, 2), by least squares in their logarithms; None: for none.

    The resolution, which only scales them all, is the usual one. Raises UserError as `kalman_gain`.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 - heavy

    if not np.isfinite(M).all():
        return None
    usual, names = KalmanOptions(), ("voltage_noise", "disturbance_noise", "bias_noise")
    first = kalman_gain(A, b, h, usual)
    sizes = np.maximum(np.abs(M), np.abs(first)).max(axis=1, keepdims=True)
    if (np.abs(first - M) <= SAME * sizes).all():
        return usual

    def noises(logs: Array) -> KalmanOptions:
        return replace(usual, **{n: getattr(usual, n) * float(np.exp(x)) for n, x in zip(names, logs, strict=True)})

    def difference(logs: Array) -> Array:
        return ((kalman_gain(A, b, h, noises(logs)) - M) / sizes).ravel()

    found = least_squares(
        difference, np.zeros(len(names)), bounds=(-FARTHEST, FARTHEST), ftol=1e-15, xtol=1e-12, gtol=1e-15
    )
    return noises(found.x) if np.abs(found.fun).max() <= SAME else None
