"""Classical fourth-order Runge-Kutta steps under zero-order hold of the inputs.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

State = tuple[float, ...]

LEAST = 2.0**-300
"""States, voltages and torques below this, about 5e-91, count as 0 from one communication step to the next: eq. (5)
multiplies three of them, and on subnormal numbers processors are many times slower."""


def flushed(value: float) -> float:
    """Return `value`, 0 where it is smaller in magnitude than LEAST; NaN stays."""
    return 0.0 if 0.0 < abs(value) < LEAST else value


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
    return max(1, -int(-min(step / largest, 1e18) * (1.0 - 1e-9) // 1.0))
