"""Chain coordinates of a controllable single-input system x' = A x + b u of any order n.

    z = Phi x,   z_i' = z_{i+1} (i < n),   z_n' = u + row x,   row = e_n' Phi A.

Phi has the rows q, q A, ..., q A^(n-1) with q = e_n' C^-1 and C = [b, A b, ..., A^(n-1) b]. It is the transformation of
section III-B of the paper, without the paper's assumption that A has a zero eigenvalue.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from fmu_export.errors import UserError

Array = np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class ChainForm:
    """Phi (n, n), row (n,) and A_0 = A - b row (n, n), which is nilpotent: Phi A_0 Phi^-1 is the upper shift."""

    Phi: Array
    row: Array
    A_0: Array


def checked_system(A: Array, b: Array) -> tuple[Array, Array]:
    """Return A as (n, n) and b as (n,) arrays of finite numbers, n >= 1; raise UserError that says what is wrong."""
    A = np.asarray(A, dtype=float)
    b = np.asarray(b, dtype=float)
    b = b[:, 0] if b.ndim == 2 and b.shape[1] == 1 else b
    if A.ndim != 2 or A.shape[0] != A.shape[1] or A.shape[0] == 0:
        raise UserError(f"A must be a square matrix, found shape {A.shape}")
    if b.shape != (A.shape[0],):
        raise UserError(f"b must have {A.shape[0]} entries to fit A, found shape {b.shape}")
    if not (np.isfinite(A).all() and np.isfinite(b).all()):
        raise UserError("A and b must be finite, found a NaN or an infinity")
    return A, b


def time_scale(A: Array) -> float:
    """Return a frequency omega [1/s] typical of A: with time in 1/omega, the powers of A neither explode nor vanish."""
    radius = max(abs(np.linalg.eigvals(A)), default=0.0)
    return float(radius) if radius > 1e-12 * (1.0 + np.linalg.norm(A)) else 1.0


def chain_form(A: Array, b: Array) -> ChainForm:
    """Return Phi, row and A_0 of (A, b).

    Raises UserError where the pair is not controllable in the Kalman sense, or so nearly not that fewer than four
    digits of Phi would be right (judged in scaled time, with the columns of C normalized).
    """
    A, b = checked_system(A, b)
    n = len(b)
    omega = time_scale(A)
    scaled = A / omega
    columns = [b]
    for _ in range(n - 1):
        columns.append(scaled @ columns[-1])
    C = np.column_stack(columns)
    norms = np.linalg.norm(C, axis=0)
    condition = np.linalg.cond(C / norms) if norms.all() else np.inf
    if condition > 1e12:
        raise UserError(f"(A, b) must be controllable; the condition of its controllability matrix is {condition:.3g}")
    try:
        rows = np.array([[float(entry) for entry in row] for row in _chain_rows(A.tolist(), b.tolist())])
    except OverflowError:
        raise UserError("A and b must be of moderate size, found a chain form beyond the range of numbers") from None
    return ChainForm(Phi=rows[:n], row=rows[n], A_0=A - np.outer(b, rows[n]))


def _chain_rows(A: Sequence[Sequence[float]], b: Sequence[float]) -> list[list[Fraction]]:
    """Return the rows q, q A, ..., q A^n exactly: their entries span many decades, and every processor has the same bits."""
    n = len(b)
    M = [[Fraction(entry) for entry in row] for row in A]
    krylov = [[Fraction(entry) for entry in b]]  # b, A b, ...
    for _ in range(n - 1):
        krylov.append([_dot(row, krylov[-1]) for row in M])
    rows = [_dual(krylov)]
    for _ in range(n):
        rows.append([_dot(rows[-1], column) for column in zip(*M, strict=True)])
    return rows


def _dot(a: Sequence[Fraction], b: Sequence[Fraction]) -> Fraction:
    return sum((p * q for p, q in zip(a, b, strict=True)), Fraction(0))


def _dual(krylov: Sequence[Sequence[Fraction]]) -> list[Fraction]:
    """Return q with q v = 0 for all v of `krylov` but the last, for which it is 1, by Gaussian elimination."""
    n = len(krylov)
    rows = [[*v, Fraction(i == n - 1)] for i, v in enumerate(krylov)]
    for k in range(n):
        pivot = next((i for i in range(k, n) if rows[i][k]), None)
        if pivot is None:
            raise UserError("(A, b) must be controllable; its controllability matrix is singular")
        rows[k], rows[pivot] = rows[pivot], rows[k]
        for i in range(n):
            if i != k and rows[i][k]:
                factor = rows[i][k] / rows[k][k]
                rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return [rows[k][n] / rows[k][k] for k in range(n)]


def weights(n: int, mu: float) -> Array:
    """Return w_i = 1 + mu (n - i), i = 1..n: the exponents of the dilation in chain coordinates."""
    return 1.0 + mu * np.arange(n - 1, -1, -1)


def generator(Phi: Array, mu: float) -> Array:
    """Return G_d = Phi^-1 diag(w) Phi, the generator of the dilation d(s) = exp(s G_d) in the coordinates of x.

    With it A_0 G_d - G_d A_0 = -mu A_0 and G_d b = b. At mu = 1 it is the paper's diag(4, 3, 2, 1) of Lemma 3; for other
    mu the paper's diag(4 mu, ..., mu) only renames r, and this general form (reference [7] of the paper) is meant.
    """
    n = len(Phi)
    return np.linalg.solve(Phi, weights(n, mu)[:, None] * Phi)
