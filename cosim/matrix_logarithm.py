"""The principal logarithm of a real matrix, with NumPy alone: SciPy's takes longer to load than a short run."""

from __future__ import annotations

import numpy as np

Array = np.ndarray

_NEAR = 0.2
"""Largest magnitude of an eigenvalue of X in the series; 13 terms leave 0.2^27."""
_TERMS = 13
_MOST_ROOTS = 60


def logarithm(M: Array) -> Array:
    """Return log M (n, n), real; NaN where M has none: an eigenvalue that is 0, negative or not finite.

    log M = 2^k log M^(1/2^k), each square root by the iteration Y <- (Y + Z^-1)/2, Z <- (Z + Y^-1)/2 from Y = M, Z = I;
    then log R = 2 artanh X with X = (R - I)(R + I)^-1. Source: N. J. Higham, "Functions of Matrices" (SIAM, 2008), (6.15)
    and chapter 11.
    """
    eye, none = np.eye(len(M)), np.full_like(M, np.nan)
    try:
        values = np.linalg.eigvals(M)
        if (
            not np.isfinite(values).all()
            or ((values.real <= 0.0) & (np.abs(values.imag) < 1e-12 * np.abs(values))).any()
        ):
            return none
        R, factor = M, 2.0
        while np.abs((values - 1.0) / (values + 1.0)).max(initial=0.0) > _NEAR:
            R, values, factor = _root(R), np.sqrt(values + 0j), 2.0 * factor
        X = np.linalg.solve((R + eye).T, (R - eye).T).T
    except np.linalg.LinAlgError:
        return none
    square, term, total = X @ X, X, X.copy()
    for k in range(1, _TERMS):
        term = term @ square
        total += term / (2 * k + 1)
    return factor * total


def _root(M: Array) -> Array:
    """Return the principal square root; raise LinAlgError where the iteration does not end."""
    Y, Z = M, np.eye(len(M))
    for _ in range(_MOST_ROOTS):
        following = 0.5 * (Y + np.linalg.inv(Z))
        Z = 0.5 * (Z + np.linalg.inv(Y))
        change = np.abs(following - Y).max()
        Y = following
        if change <= 1e-9 * np.abs(Y).max():  # squared, in the next one
            return Y
    raise np.linalg.LinAlgError("no square root")
