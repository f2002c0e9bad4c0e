"""A step of the classical fourth-order Runge-Kutta method under zero-order hold of the inputs.

Standard library only: this module travels inside the Python FMUs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

State = tuple[float, ...]


def rk4_step(f: Callable[[Sequence[float]], State], x: State, h: float) -> State:
    """Return x(t + h) for x' = f(x); local error O(h^5). The entries of x may also be NumPy arrays, all of one shape."""
    half, sixth = 0.5 * h, h / 6.0
    k1 = f(x)
    k2 = f([a + half * b for a, b in zip(x, k1, strict=True)])
    k3 = f([a + half * b for a, b in zip(x, k2, strict=True)])
    k4 = f([a + h * b for a, b in zip(x, k3, strict=True)])
    return tuple([a + sixth * (p + 2.0 * (q + r) + s) for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True)])
