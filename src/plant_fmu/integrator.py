"""What a communication step is divided into, and what is too small to count.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

LEAST = 2.0**-300
"""States, voltages and torques below this, about 5e-91, count as 0 from one communication step to the next: eq. (5)
multiplies three of them, and on subnormal numbers processors are many times slower."""


def flushed(value: float) -> float:
    """Return `value`, 0 where it is smaller in magnitude than LEAST; NaN stays."""
    return 0.0 if 0.0 < abs(value) < LEAST else value


def substeps(step: float, largest: float) -> int:
    """Return the smallest number of equal substeps of `step` that are not longer than `largest`, up to rounding."""
    return max(1, -int(-min(step / largest, 1e18) * (1.0 - 1e-9) // 1.0))
