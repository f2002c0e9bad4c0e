"""Design of a steady-state Kalman filter for any linear model with disturbances of its inputs and biases of its outputs.

    x' = A x + B (u + d + w),   d' = noise,   beta' = -leak beta + noise,   y = C x + beta + noise,

sampled every h. The filter's state is (x, d, beta). Without the biases a sensor zeroed a fraction of a count beside the
equilibrium would be taken for a disturbance. Plain arithmetic: every processor and library gives the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import frexp, inf

import numpy as np

from fmu_export.errors import UserError, counted

from .block_form import RANK, combination, scaling
from .linear_algebra import Matrix, product, solve, transpose

Array = np.ndarray

NONE = "there is no Kalman filter for this model: "
"""How refusals of a model begin."""
TAYLOR_TERMS = 20
"""Of the exponential of a matrix smaller than 1/2: the rest is below rounding."""

DOUBLINGS = 60
CONVERGED = 1e-18
"""The Riccati equation is solved by at most so many doublings, until one changes the covariance by less than this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """How uncertain model and sensors are; 0 in `disturbances` and `biases` leaves them out.

    inputs (m,): intensity of white noise on the inputs, [u^2 s]. disturbances (m,): of what moves their disturbances,
    [u^2/s]. biases (p,): of what moves the outputs' biases, [y^2/s]. outputs (p,): variance of a sample, [y^2]. leak [1/s]:
    rate at which biases are forgotten.
    """

    inputs: Sequence[float]
    disturbances: Sequence[float]
    biases: Sequence[float]
    outputs: Sequence[float]
    leak: float = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class KalmanDesign:
    """x+ = F x + G (u + d), d+ = d, beta+ = decay beta; M corrects (x, d, beta) by the innovation y - (C x + beta).

    F (n, n), G (n, m), M (n + m + p, p), rows of what is left out 0.
    """

    F: Array
    G: Array
    M: Array
    decay: float


def kalman_filter(
    A: Array, B: Array, C: Array, h: float, noise: Noise, names: Sequence[str] | None = None
) -> KalmanDesign:
    """Return the steady-state filter for A (n, n), B (n, m), C (p, n), sampled every `h` [s].

    Process noise is integrated exactly over a sample (C. F. Van Loan, IEEE Trans. Automatic Control 23(3), 1978); the
    stationary covariance solves the discrete Riccati equation. `names` (n + m + p,) are those of states, disturbances and
    biases. Raises UserError for an `h` that is not positive and finite, for what cannot be observed, by its name, and a
    model for which there is no such gain.
    """
    if not 0.0 < h < inf:
        raise UserError(f"the sample time must be positive and finite, found {h} s")
    if not all(np.isfinite(M).all() for M in (A, B, C)):
        raise UserError(f"{NONE}it is not finite")
    (n, m), p = B.shape, len(C)
    moved = [n + i for i, q in enumerate(noise.disturbances) if q > 0.0]
    biased = [n + m + i for i, q in enumerate(noise.biases) if q > 0.0]
    kept = [*range(n), *moved, *biased]
    F = np.zeros((n + m + p, n + m + p))
    F[:n, :n], F[:n, n : n + m] = A, B
    F[range(n + m, n + m + p), range(n + m, n + m + p)] = -noise.leak
    Q = np.zeros_like(F)
    for column, q in zip(B.T, noise.inputs, strict=True):
        Q[:n, :n] += q * np.outer(column, column)
    Q += np.diag([0.0] * n + [*noise.disturbances, *noise.biases])
    seen = np.hstack([C, np.zeros((p, m)), np.eye(p)])
    which = np.ix_(kept, kept)
    if len(kept) - n > p:
        count = len(kept) - n
        raise UserError(f"{count} disturbances and biases cannot be told from {counted(p, 'measured output')}")
    kept_names = () if names is None else [str(names[i]) for i in kept]
    _check_detectable(F[which], seen[:, kept], kept_names)
    M = np.zeros((n + m + p, p))
    M[kept] = _gain(F[which], Q[which], seen[:, kept], h, noise.outputs)
    held = np.zeros((n + m, n + m))
    held[:n, :n], held[:n, n:] = A, B
    step = np.array(exponential((held * h).tolist()))
    return KalmanDesign(step[:n, :n], step[:n, n:], M, float(np.exp(-noise.leak * h)))


def _gain(F: Array, Q: Array, C: Array, h: float, variances: Sequence[float]) -> Array:
    """Return the gain of the current estimator, (N, p)."""
    N, outputs = len(F), C.tolist()
    block = exponential((np.block([[-F, Q], [np.zeros((N, N)), F.T]]) * h).tolist())
    transposed = [row[N:] for row in block[N:]]
    noise = multiplied(transpose(transposed), [row[N:] for row in block[:N]])
    R = [[v if i == j else 0.0 for j in range(len(C))] for i, v in enumerate(variances)]
    try:
        reduced = multiplied(outputs, stationary_covariance(transposed, outputs, noise, variances))
        innovation = plus(multiplied(reduced, transpose(outputs)), R)
        M = np.array(transpose(solve(innovation, reduced)))
    except (UserError, OverflowError, ZeroDivisionError):
        M = np.full((N, len(C)), np.nan)
    if not np.isfinite(M).all():
        raise UserError(f"{NONE}its Riccati equation has no solution")
    return M


def _check_detectable(F: Array, C: Array, names: Sequence[str]) -> None:
    """Raise UserError that names the combination of states that no output sees and that does not decay (Hautus' test)."""
    s = scaling(F.T, C.T)
    F_s = F / s.states * s.states[:, None] / s.omega
    C_s = C / s.states * s.inputs[:, None] / s.omega
    for value in np.linalg.eigvals(F_s):
        if value.real < -RANK:
            continue
        _, sizes, directions = np.linalg.svd(np.vstack([F_s - value * np.eye(len(F)), C_s]))
        if sizes[-1] < RANK:
            direction = directions[-1].conj()
            direction = (direction / direction[np.argmax(np.abs(direction))]).real / s.states
            raise UserError(f"no measured output tells {combination(direction, names)} from nothing")


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
    power = unit
    for k in range(TAYLOR_TERMS, 0, -1):
        power = plus(unit, [[entry / k for entry in row] for row in multiplied(small, power)])
    for _ in range(halvings):
        power = multiplied(power, power)
    return power


def stationary_covariance(F_t: Matrix, C: Matrix, Q: Matrix, variances: Sequence[float]) -> list[list[float]]:
    """Return X = F (X - X C' (C X C' + R)^-1 C X) F' + Q, given F', R = diag(variances), by structure-preserving doubling.

    A <- A W A, G <- G + A W G A', X <- X + A' X W A with W = (I + G X)^-1 (Chu, Fan, Lin and Wang, Int. J. Control 77(8),
    2004), from A = F', G = C' R^-1 C, X = Q; converges quadratically.
    """
    A, X = [list(row) for row in F_t], [list(row) for row in Q]
    G = multiplied(
        transpose(C), [[entry / variance for entry in row] for row, variance in zip(C, variances, strict=True)]
    )
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
