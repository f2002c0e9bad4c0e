"""Poles of models that are held against each other: in an order, and in words."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def sorted_poles(A: Array) -> Array:
    """Return the eigenvalues of A [1/s], sorted, without what rounding makes of zeros."""
    return np.sort_complex(np.round(np.linalg.eigvals(A), 6) + 0.0)  # no -0


def alike(a: Array, b: Array) -> bool:
    """Whether sorted poles are the same but for a few per cent."""
    return len(a) == len(b) and bool(np.allclose(a, b, rtol=0.05, atol=0.05))


def poles_text(poles: Array) -> str:
    """Return poles as text."""
    return ", ".join(f"{p.real:.3g}" if abs(p.imag) < 1e-6 else f"{p.real:.3g}{p.imag:+.3g}i" for p in poles)
