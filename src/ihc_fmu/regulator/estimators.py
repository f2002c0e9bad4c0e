"""A linear Kalman filter of state, disturbances and biases, one sample at a time.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from typing import NamedTuple

from ..homogeneity import LEAST_ESTIMATE, Matrix, Vector, dot, flushed


class KalmanFilter(NamedTuple):
    """x+ = F x + G (u + d), d+ = d, b+ = decay b, y = C x + b, with the constant gain M (n + m + p, p) of the innovation."""

    F: Matrix
    G: Matrix
    C: Matrix
    M: Matrix
    decay: float


class Estimate(NamedTuple):
    """Estimates: state x (n,), what disturbs the inputs d (m,), biases of the outputs b (p,)."""

    x: Vector
    d: Vector
    b: Vector


def kalman_step(f: KalmanFilter, last: Estimate, u: Vector, y: Vector) -> Estimate:
    """Return the new estimate from the last one, the inputs u (m,) held since, and the measured outputs y (p,).

    The model predicts x under u + d; d and, but for its decay, b stay; the innovation y - (C x + b) corrects all three.
    """
    driven = [u_i + d_i for u_i, d_i in zip(u, last.d, strict=True)]
    x = [dot(f_i, last.x) + dot(g_i, driven) for f_i, g_i in zip(f.F, f.G, strict=True)]
    b = [f.decay * b_i for b_i in last.b]
    innovation = [y_i - (dot(c_i, x) + b_i) for y_i, c_i, b_i in zip(y, f.C, b, strict=True)]
    predicted = [*x, *last.d, *b]
    corrected = [
        flushed(value + dot(row, innovation), LEAST_ESTIMATE) for value, row in zip(predicted, f.M, strict=True)
    ]
    n, m = len(x), len(last.d)
    return Estimate(corrected[:n], corrected[n : n + m], corrected[n + m :])
