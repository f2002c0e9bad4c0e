"""What the controller sees of an angle: seeded noise, encoder counts, delay.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from math import cos, floor, isfinite, log, pi, sqrt

from fmu_export.errors import UserError

_MASK = (1 << 64) - 1
_GOLDEN = 0x9E3779B97F4A7C15


def quantize(angle: float, counts: int, offset: float) -> float:
    """Return the angle [rad] that an encoder of `counts` per turn reports; `counts` = 0 is an ideal sensor."""
    return counted(angle, 2.0 * pi / counts if counts else 0.0, offset)


def counted(value: float, resolution: float, offset: float) -> float:
    """Return what a counting sensor reports: r floor(value/r + offset), r the resolution; `resolution` = 0 is an ideal one.

    `offset` in [0, 1] is where inside its count the sensor was zeroed. 0.5 rounds to the nearest count, which no real
    encoder does on purpose; a uniformly random offset is what zeroing by hand gives.
    """
    if resolution == 0.0:
        return value
    count = value / resolution + offset
    return resolution * floor(count) if isfinite(count) else count


def next_random(state: int) -> tuple[int, int]:
    """Return (new state, 64 random bits) of the SplitMix64 generator (Steele, Lea and Flood, OOPSLA 2014)."""
    state = (state + _GOLDEN) & _MASK
    z = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK
    return state, z ^ (z >> 31)


def next_gaussian(state: int) -> tuple[int, float]:
    """Return (new state, a standard normal number) by the Box-Muller transformation of two SplitMix64 draws."""
    state, first = next_random(state)
    state, second = next_random(state)
    radius = sqrt(-2.0 * log(((first >> 11) + 1) * 2.0**-53))  # the argument lies in (0, 1]
    return state, radius * cos(2.0 * pi * ((second >> 11) * 2.0**-53))


def delay_in_steps(delay: float, step: float) -> int:
    """Return the measurement delay as a number of communication steps.

    Raises UserError where the delay is not a multiple of the step.
    """
    steps = round(delay / step)
    if abs(delay / step - steps) > 1e-6:
        raise UserError(
            f"measurement_delay must be a multiple of the communication step, found {delay:g} s with a step of {step:g} s"
        )
    return steps
