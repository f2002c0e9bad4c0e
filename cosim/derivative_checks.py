"""What derivatives by differences must be to be believed; errors count relative to the largest entry of their row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .derivatives import Jacobian
from .errors import UserError

Array = np.ndarray

LARGEST_ERROR = 1e-2
"""Relative to the largest entry of a row, in units of the variables' sizes: beyond, a model is refused."""
NOTABLE_ERROR = 1e-5
"""What is said."""
NOISE = 1e-8
"""Entries of a matrix found by steps that are so small, relative to the largest of their row, are 0."""
DIGITS = 9
"""Digits that entries of a matrix found by steps have."""


def largest(J: Array, sizes: Array) -> Array:
    """Return the largest |J_ij| size_j of each row, shape (r, 1)."""
    return (np.abs(J) * sizes).max(axis=1, keepdims=True, initial=0.0)


def place(M: Array) -> tuple[int, int]:
    """Return row and column of the largest entry."""
    i, j = divmod(int(np.argmax(M)), M.shape[1])
    return i, j


def relative(error: Array, J: Array, sizes: Array) -> Array:
    """Return errors relative to the largest entry of their row; 0 in rows of zeros whose error is rounding."""
    rows = largest(J, sizes)
    scaled = error * sizes
    return np.divide(scaled, rows, out=np.where(scaled > 1e-9, np.inf, 0.0), where=rows > 0.0)


def without_noise(M: Array, again: Array, sizes: Array) -> Array:
    """Return M with zeros below what two ways to it differ by in its row, and DIGITS digits in the others."""
    least = np.maximum((np.abs(M - again) * sizes).max(axis=1, keepdims=True, initial=0.0), NOISE * largest(M, sizes))
    kept = np.where(np.abs(M) * sizes <= least, 0.0, M)
    return np.vectorize(lambda value: float(f"{value:.{DIGITS}g}"), otypes=[float])(kept)


def check_smooth(numeric: Jacobian, sizes: Array, rows: Sequence[str], columns: Sequence[str]) -> None:
    """Raise UserError that names the entry whose derivative does not settle or differs from side to side."""
    error = relative(numeric.error, numeric.J, sizes)
    if error.max(initial=0.0) > LARGEST_ERROR:
        i, j = place(error)
        raise UserError(
            f"{rows[i]} has no derivative by {columns[j]} that differences agree on: it is not smooth there (counted or "
            "noisy sensor, dry friction, switch); turn that off with --set, or leave it out"
        )
    kink = relative(numeric.kink, numeric.J, sizes)
    if kink.max(initial=0.0) > LARGEST_ERROR:
        i, j = place(kink)
        raise UserError(
            f"{rows[i]} has different derivatives by {columns[j]} to both sides: a limit or dry friction is at work there; "
            "turn that off with --set, or choose another equilibrium"
        )


def check_contradiction(
    J: Array, found: Jacobian, sizes: Array, rows: Sequence[str], columns: Sequence[str], counted: Sequence[str]
) -> None:
    """Raise UserError where an FMU's directional derivative is not what good differences give.

    `counted` says, a sentence each, which outputs do not change because they are counted.
    """
    sure = np.isfinite(found.error) & (relative(found.error, found.J, sizes) < NOTABLE_ERROR)
    wrong = np.where(sure, relative(np.abs(J - found.J), found.J, sizes), 0.0)
    if wrong.max(initial=0.0) > LARGEST_ERROR:
        i, j = place(wrong)
        hints = () if J[i].any() else counted or ["so it is of a sensor that counts, whose resolution --set turns off"]
        raise UserError(
            f"the FMU contradicts itself: its directional derivative of {rows[i]} by {columns[j]} is {J[i, j]:.6g}, "
            f"differences give {found.J[i, j]:.6g}" + "".join(f"; {text}" for text in hints)
        )
