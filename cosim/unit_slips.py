"""Units that are mistaken for others, as factors between numbers: degrees for rad, mV for V."""

from __future__ import annotations

import math
from collections.abc import Iterable

SCALE_TOLERANCE = 2.5
"""A factor is taken for one of those between units where it is so near; parameters may differ besides."""

_DEGREE = math.radians(1.0)
_RAD = {1.0 / _DEGREE: "degrees instead of rad", _DEGREE: "units of 57.3 rad instead of rad"}
_DEG = {_DEGREE: "radians instead of degrees", 1.0 / _DEGREE: "units of 0.0175 degrees instead of degrees"}
_ANGLES = {
    "rad": _RAD | {0.5 / math.pi: "revolutions instead of rad"},
    "rad/s": _RAD | {30.0 / math.pi: "rpm instead of rad/s"},
    "deg": _DEG | {1.0 / 360.0: "revolutions instead of degrees"},
    "deg/s": _DEG | {1.0 / 6.0: "rpm instead of deg/s"},
}


def slips(unit: str) -> dict[float, str]:
    """Return factors by which numbers of a quantity in another unit are too large, with what they are in, in words."""
    of = "" if unit == "1" else f" of {unit}"
    return {**_ANGLES.get(unit, {}), 1e3: f"thousandths{of}", 1e-3: f"thousands{of}"}


def nearest(factor: float, scales: Iterable[float]) -> float:
    """Return the factor between units that is nearest, with its sign; NaN where none is near."""
    if not 0.0 < abs(factor) < math.inf:
        return math.nan
    best = min(scales, key=lambda scale: abs(math.log(abs(factor) / scale)))
    return math.copysign(best, factor) if abs(math.log(abs(factor) / best)) <= math.log(SCALE_TOLERANCE) else math.nan
