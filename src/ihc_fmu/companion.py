"""Chain coordinates of a controllable single-input system x' = A x + b u of any order n.

    z = Phi x,   z_i' = z_{i+1} (i < n),   z_n' = u + row x,   row = e_n' Phi A.

Phi has the rows q, q A, ..., q A^(n-1) with q = e_n' C^-1 and C = [b, A b, ..., A^(n-1) b]. It is the transformation of
section III-B of the paper, without the paper's assumption that A has a zero eigenvalue.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    q = np.linalg.solve((C / norms).T, np.eye(n)[-1]) / norms[-1]
    rows = [q]
    for _ in range(n):
        rows.append(rows[-1] @ scaled)
    # q is that of the scaled matrix: with time unscaled it is q / omega^(n-1), and each further row gains a factor omega
    scale = omega ** np.arange(1 - n, 2)
    rows = [factor * r for factor, r in zip(scale, rows, strict=True)]
    Phi = np.array(rows[:n])
    return ChainForm(Phi=Phi, row=rows[n], A_0=A - np.outer(b, rows[n]))


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
