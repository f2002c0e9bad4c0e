"""Vectors and matrices as sequences of numbers: what the laws compute with, in the order in which their C does.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from fmu_export.errors import UserError

Vector = Sequence[float]
Matrix = Sequence[Sequence[float]]

REFINEMENTS = 3
"""Of a solution, iteratively."""

CANCELLED = 1e-3
"""Of its terms' sizes: a sum that is smaller has lost digits that count and is added anew in twice the precision."""

SPLIT = 134217729.0
"""2^27 + 1: halves a double's digits, T. J. Dekker, Numer. Math. 18 (1971), 224-242."""

MOST_EXACT = 2.0**900
"""Sum of the sizes of products up to which `exact_dot` splits their factors."""


def solve(M: Matrix, B: Matrix, name: str = "Phi") -> list[list[float]]:
    """Return M^-1 B by Gaussian elimination with partial pivoting; M is (n, n), B is (n, m).

    Raises UserError where M is singular; the sentence calls it `name`.
    """
    n = len(M)
    rows = [[*M[i], *B[i]] for i in range(n)]
    for k in range(n):
        pivot = max(range(k, n), key=lambda i: abs(rows[i][k]))
        rows[k], rows[pivot] = rows[pivot], rows[k]
        head = rows[k][k]
        if head == 0.0 or not isfinite(head):
            raise UserError(f"{name} must be regular, found a singular matrix")
        for i in range(k + 1, n):
            factor = rows[i][k] / head
            for j in range(k, len(rows[i])):
                rows[i][j] -= factor * rows[k][j]
    for k in range(n - 1, -1, -1):
        for j in range(n, len(rows[k])):
            rest = 0.0
            for i in range(k + 1, n):
                rest += rows[k][i] * rows[i][j]
            rows[k][j] = (rows[k][j] - rest) / rows[k][k]
    return [row[n:] for row in rows]


def refined(M: Matrix, x: Vector, b: Vector) -> list[float]:
    """Return the solution x of M x = b after REFINEMENTS iterative refinements, which make entries that should be 0 tiny."""
    solution = list(x)
    for _ in range(REFINEMENTS):
        residual = [[right - dot(row, solution)] for row, right in zip(M, b, strict=True)]
        solution = [entry + change for entry, (change,) in zip(solution, solve(M, residual), strict=True)]
    return solution


def transpose(M: Matrix) -> list[list[float]]:
    """Return M'."""
    return [list(column) for column in zip(*M, strict=True)]


def indefinite_block(P: Matrix) -> int:
    """Return the size of the first leading block of a symmetric P (n, n) that is not positive definite; 0 where none is.

    By the pivots of Gaussian elimination, all positive where P is positive definite (Sylvester).
    """
    rows = [list(row) for row in P]
    for k, pivoted in enumerate(rows):
        if not pivoted[k] > 0.0:
            return k + 1
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / pivoted[k]
            for j in range(k, len(rows)):
                rows[i][j] -= factor * pivoted[j]
    return 0


def dot(a: Vector, b: Vector) -> float:
    """Return a' b, added from the first to the last: `sum` compensates rounding since Python 3.12."""
    total = 0.0
    for p, q in zip(a, b, strict=True):
        total += p * q
    return total


def product(M: Matrix, x: Vector) -> list[float]:
    """Return M x."""
    return [dot(row, x) for row in M]


def exact_dot(a: Vector, b: Vector) -> float:
    """Return a' b to full precision although its terms cancel, for products below 2^900; others as `dot`.

    States near an axis of the dilation have block coordinates far smaller than their terms, and the norm magnifies them.
    The second sum is that of T. Ogita, S. M. Rump and S. Oishi, SIAM J. Sci. Comput. 26 (2005), 1955-1988, Dot2.
    """
    total, size = 0.0, 0.0
    for p, q in zip(a, b, strict=True):
        term = p * q
        total += term
        size += abs(term)
    if not CANCELLED * size > abs(total) or size > MOST_EXACT:
        return total
    total, rest = 0.0, 0.0
    for p, q in zip(a, b, strict=True):
        term, error = _two_product(p, q)
        after = total + term
        part = after - total
        rest += ((total - (after - part)) + (term - part)) + error
        total = after
    return total + rest


def _two_product(a: float, b: float) -> tuple[float, float]:
    """Return a b as the rounded product and its error, exactly."""
    a_high, b_high = _high(a), _high(b)
    a_low, b_low = a - a_high, b - b_high
    product = a * b
    return product, a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)


def _high(a: float) -> float:
    t = SPLIT * a
    return t - (t - a)
