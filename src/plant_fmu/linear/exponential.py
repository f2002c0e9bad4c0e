"""A step of a linear model under held inputs, by the matrix exponential: scaling, a Taylor polynomial, and doubling.

    x' = A x + B w,   w constant over h:   x(t + h) = x + E x + G w,   E = e^(A h) - I,   G = h phi(A h) B,

with phi(X) = I + X/2! + X^2/3! + ..., so that e^X - I = X phi(X). From X to 2 X: phi becomes phi + E phi/2, then E becomes
2 E + E^2. Computing with E, not with e^(A h), keeps the slow modes of a stiff model, and of short steps, to full precision.

First the states are scaled by powers of two, which rounds nothing (balancing: B. N. Parlett and C. Reinsch, Numer. Math. 13
(1969), 293-304), so that a model in unsuitable units is not halved more often than its dynamics ask for.

Standard library only: the unit's step code.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import frexp, isfinite, ldexp

from fmu_export.errors import UserError

Matrix = list[list[float]]

DEGREE = 15
"""Of the polynomial for phi: beyond it, less than 2^-16/17! = 4e-20 is left out of numbers near 1."""

BALANCING_SWEEPS = 24
"""Most passes over the states; each about halves the distance, in orders of magnitude, from a balanced matrix."""

MOST_DOUBLINGS = 32
"""Each doubling may double the rounding error of modes slower than the fastest: 2^-53 becomes 5e-7."""


def held_input(A: Sequence[Sequence[float]], B: Sequence[Sequence[float]], h: float) -> tuple[Matrix, Matrix]:
    """Return (E, G), (n, n) and (n, m), with x(t + h) = x + E x + G w for x' = A x + B w; A is (n, n), B is (n, m), h [s].

    Raises UserError where h is so long that E and G are not numbers, or not to be computed in double precision.
    """
    X = [[entry * h for entry in row] for row in A]
    try:
        if _is_finite(X):
            exponents = _balance(X)
            doublings = max(0, frexp(max(_row_sum(row, -1) for row in X))[1] + 1)
            if doublings <= MOST_DOUBLINGS:
                E, phi = _exponential(X, doublings)
                E = _rescaled(E, exponents)
                G = [[h * entry for entry in row] for row in _product(_rescaled(phi, exponents), B)]
                if _is_finite(E) and _is_finite(G):
                    return E, G
    except OverflowError:  # of ldexp
        pass
    raise UserError(f"a communication step must be shorter for the plant's fastest mode to be computed, found {h:g} s")


def _is_finite(M: Matrix) -> bool:
    """Return whether the sum of magnitudes in each row is a number."""
    return all(isfinite(_row_sum(row, -1)) for row in M)


def _exponential(X: Matrix, doublings: int) -> tuple[Matrix, Matrix]:
    """Return (e^X - I, phi(X)) from those of X 2^-doublings."""
    indices = range(len(X))
    X = [[ldexp(entry, -doublings) for entry in row] for row in X]
    phi = _phi(X)
    E = _product(X, phi)
    for _ in range(doublings):
        change = _product(E, phi)
        phi = [[phi[i][j] + 0.5 * change[i][j] for j in indices] for i in indices]
        square = _product(E, E)
        E = [[2.0 * E[i][j] + square[i][j] for j in indices] for i in indices]
    return E, phi


def _row_sum(row: Sequence[float], without: int) -> float:
    """Return the sum of magnitudes, without the entry of that index."""
    total = 0.0
    for j, entry in enumerate(row):
        if j != without:
            total += abs(entry)
    return total


def _balance(X: Matrix) -> list[int]:
    """Scale X to D^-1 X D, D = diag(2^e_i), in place, and return e: rows and columns of like size, or below 1."""
    n = len(X)
    exponents = [0] * n
    for _ in range(BALANCING_SWEEPS):
        moved = False
        for i in range(n):
            row = max(1.0, _row_sum(X[i], i))
            column = max(1.0, _row_sum([X[j][i] for j in range(n)], i))
            shift = int((frexp(row)[1] - frexp(column)[1]) / 2)
            if shift != 0:
                moved = True
                exponents[i] += shift
                for j in range(n):
                    if j != i:
                        X[i][j] = ldexp(X[i][j], -shift)
                        X[j][i] = ldexp(X[j][i], shift)
        if not moved:
            break
    return exponents


def _rescaled(M: Matrix, exponents: Sequence[int]) -> Matrix:
    """Return D M D^-1, D = diag(2^e_i)."""
    return [[ldexp(entry, exponents[i] - exponents[j]) for j, entry in enumerate(row)] for i, row in enumerate(M)]


def _phi(X: Matrix) -> Matrix:
    """Return the Taylor polynomial I + X/2 (I + X/3 (...)) of phi(X), for |X| <= 1/2."""
    n = len(X)
    phi = [[1.0 if i == j else 0.0 for j in range(n)] for i in range(n)]
    for k in range(DEGREE + 1, 1, -1):
        term = _product(X, phi)
        phi = [[(1.0 if i == j else 0.0) + term[i][j] / k for j in range(n)] for i in range(n)]
    return phi


def _product(M: Sequence[Sequence[float]], N: Sequence[Sequence[float]]) -> Matrix:
    """Return M N, each entry added from the first to the last term."""
    columns = range(len(N[0]))
    made: Matrix = []
    for row in M:
        sums = [0.0 for _ in columns]
        for factor, other in zip(row, N, strict=True):
            for j in columns:
                sums[j] += factor * other[j]
        made.append(sums)
    return made
