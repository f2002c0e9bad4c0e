"""Estimators, one sample at a time: a linear Kalman filter, the homogeneous observer.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from ..homogeneity import Exponents
from ..linear_algebra import Matrix, Vector, dot, solve, transpose
from ..sampled_unit import LEAST_ESTIMATE, flushed, weighed


class KalmanFilter(NamedTuple):
    """x+ = F x + G (u + d), d+ = d, b+ = decay b, y = C x + b, with the constant gain M (n + m + p, p) of the innovation.

    What of an innovation is within half of a sensor's count, `counts` (p,), has the `weight`.
    """

    F: Matrix
    G: Matrix
    C: Matrix
    M: Matrix
    decay: float
    counts: Vector
    weight: float


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
    innovation = [
        weighed(y_i - (dot(c_i, x) + b_i), count, f.weight)
        for y_i, c_i, b_i, count in zip(y, f.C, b, f.counts, strict=True)
    ]
    predicted = [*x, *last.d, *b]
    corrected = [
        flushed(value + dot(row, innovation), LEAST_ESTIMATE) for value, row in zip(predicted, f.M, strict=True)
    ]
    n, m = len(x), len(last.d)
    return Estimate(corrected[:n], corrected[n : n + m], corrected[n + m :])


class HomogeneousObserver(NamedTuple):
    """x' = A x + B u + S (C x - y), S = L_0 + q^(nu (I + G_0)) (L - L_0), q = |C x - y| limited to [q_min, q_max].

    In the block coordinates of (A', C'), with exponents e: G_0 = (T^-1 diag(e) T)', Lz = T^-T (L - L_0), so that
    S = L_0 + T' diag(q^(nu (1 + e_j))) Lz. At nu = 0 it is the linear observer with the gain L.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    T: Matrix
    exponents: Exponents
    L_0: Matrix
    Lz: Matrix
    nu: float
    q_min: float
    q_max: float


def observer_step(o: HomogeneousObserver, h: float, last: Vector, u: Vector, y: Vector) -> list[float]:
    """Return the state after `h` [s], (I - h (A + S C))^-1 (x + h B u - h S y), x (n,) the last one.

    The semi-implicit step of the authors' toolbox: S is that of the last state. Raises UserError, a ValueError, where the
    matrix is singular.
    """
    S = observer_gain(o, last, y)
    outputs = transpose(o.C)
    M = [
        [(1.0 if i == j else 0.0) - h * (a + dot(S[i], outputs[j])) for j, a in enumerate(row)]
        for i, row in enumerate(o.A)
    ]
    right = [[x_i + h * (dot(b, u) - dot(s, y))] for x_i, b, s in zip(last, o.B, S, strict=True)]
    return [flushed(x_i, LEAST_ESTIMATE) for (x_i,) in solve(M, right, "I - h (A + S C)")]


def observer_gain(o: HomogeneousObserver, x: Vector, y: Vector) -> list[list[float]]:
    """Return S (n, p) for the state x and the measured outputs y."""
    errors = [dot(row, x) - y_i for row, y_i in zip(o.C, y, strict=True)]
    q = min(o.q_max, max(o.q_min, sqrt(dot(errors, errors))))
    scaled = []
    for e, row in zip(o.exponents, o.Lz, strict=True):
        power = q ** (o.nu * (1 + e))
        scaled.append([power * entry for entry in row])
    columns = transpose(scaled)
    return [
        [l_0 + dot(t, column) for l_0, column in zip(row, columns, strict=True)]
        for row, t in zip(o.L_0, transpose(o.T), strict=True)
    ]
