"""States from measured angles: the manufacturer's velocity filter, an observer for the swing-up, a Kalman filter.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, sqrt

from ..sampled_unit import LEAST, LEAST_ESTIMATE, flushed, weighed
from .nominal_model import NominalModel, predict

State = tuple[float, float, float, float]

BIAS_DECAY = 1e-3
"""Rate [1/s] at which the Kalman filter forgets the bias, which no measurement pins down for ever."""


def filter_decay(cutoff: float, h: float) -> float:
    """Return exp(-cutoff h), the discrete pole of the velocity filter for the sample time `h` [s]."""
    return flushed(exp(-cutoff * h), LEAST)


def filter_velocity(cutoff: float, decay: float, lag: float, angle: float) -> tuple[float, float]:
    """Return (velocity [rad/s], new lag state [rad]) of the manufacturer's filter T(s) = w s/(s + w), Remark 4.

    With the angle held between samples, w s/(s + w) is exactly v = w (angle - lag), lag <- decay lag + (1 - decay) angle.
    """
    return flushed(cutoff * (angle - lag), LEAST), flushed(decay * lag + (1.0 - decay) * angle, LEAST)


def alpha_beta_gains(acceleration_noise: float, resolution: float, h: float) -> tuple[float, float]:
    """Return (gain on the angle [1], gain on the velocity [1/s]) of the steady-state Kalman filter of one angle.

    The angle's acceleration is white noise of intensity `acceleration_noise` [rad^2/s^3]; its measurement has the
    variance r = resolution^2/12 at 1 ms, in inverse proportion to `h` [s]. With beta = h times the velocity gain, the
    stationary Riccati equation reduces to alpha^2 + (alpha - 2) beta + beta^2/6 = 0 and
    beta^2 = (1 - alpha) q h^3 / r, solved here by bisection on beta up to 3 - sqrt(3), where alpha is 1.
    """
    variance = resolution * resolution / 12.0 * (1e-3 / h)
    index = acceleration_noise * (h * h * h) / variance
    low, high = 0.0, min(sqrt(index), 3.0 - sqrt(3.0))
    for _ in range(100):
        beta = 0.5 * (low + high)
        alpha = 0.5 * (sqrt(8.0 * beta + beta * beta / 3.0) - beta)
        if beta * beta < (1.0 - alpha) * index:
            low = beta
        else:
            high = beta
    beta = 0.5 * (low + high)
    return 0.5 * (sqrt(8.0 * beta + beta * beta / 3.0) - beta), beta / h


def observe(
    model: NominalModel, gains: tuple[float, float], x: State, voltage: float, h: float, theta: float, delta: float
) -> State:
    """Return the new estimate of (theta, delta, theta', delta') from the last one `x` and the measured angles.

    One Runge-Kutta step of the nominal model under the `voltage` that was applied predicts; each channel is corrected
    by the constant gains of `alpha_beta_gains`.
    """
    alpha, beta = gains
    p_theta, p_delta, p_theta_dot, p_delta_dot = predict(model, *x, voltage, h)
    e_theta, e_delta = theta - p_theta, delta - p_delta
    return (
        flushed(p_theta + alpha * e_theta, LEAST_ESTIMATE),
        flushed(p_delta + alpha * e_delta, LEAST_ESTIMATE),
        flushed(p_theta_dot + beta * e_theta, LEAST_ESTIMATE),
        flushed(p_delta_dot + beta * e_delta, LEAST_ESTIMATE),
    )


def kalman_step(
    model: NominalModel,
    M: Sequence[Sequence[float]],
    count: tuple[float, float],
    x: State,
    disturbance: float,
    bias: float,
    voltage: float,
    h: float,
    theta: float,
    delta: float,
) -> tuple[State, float, float]:
    """Return the new (x, disturbance [V], bias [rad]) from the last ones and the measured angles.

    The nominal model predicts x under the `voltage` that was applied plus the disturbance, the bias decays; the errors of
    theta and of delta + bias correct all six by the constant gain M (6, 2) of `kalman.kalman_gain`, each `weighed` with
    `count`, the resolution [rad] and the weight of what is within half of it.
    """
    p = predict(model, *x, voltage + disturbance, h)
    bias *= exp(-BIAS_DECAY * h)
    e_1, e_2 = weighed(theta - p[0], *count), weighed(delta - (p[1] + bias), *count)
    predicted = (*p, disturbance, bias)
    theta, delta, theta_dot, delta_dot, disturbance, bias = [
        flushed(value + (row[0] * e_1 + row[1] * e_2), LEAST_ESTIMATE) for value, row in zip(predicted, M, strict=True)
    ]
    return (theta, delta, theta_dot, delta_dot), disturbance, bias
