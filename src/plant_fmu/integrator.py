"""Classical fourth-order Runge-Kutta steps under zero-order hold of the inputs.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

State = tuple[float, ...]


def rk4_step(f: Callable[[Sequence[float]], State], x: State, h: float) -> State:
    """Return x(t + h) for x' = f(x); local error O(h^5)."""
    half, sixth = 0.5 * h, h / 6.0
    k1 = f(x)
    k2 = f([a + half * b for a, b in zip(x, k1, strict=True)])
    k3 = f([a + half * b for a, b in zip(x, k2, strict=True)])
    k4 = f([a + h * b for a, b in zip(x, k3, strict=True)])
    return tuple([a + sixth * (p + 2.0 * (q + r) + s) for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True)])


def substeps(step: float, largest: float) -> int:
    """Return the smallest number of equal substeps of `step` that are not longer than `largest`, up to rounding."""
    return max(1, -int(-(step / largest) * (1.0 - 1e-9) // 1.0))
