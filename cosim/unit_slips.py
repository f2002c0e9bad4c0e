"""Units that are mistaken for others, as factors between numbers: degrees for rad, mV for V."""

from __future__ import annotations

import math
from collections.abc import Iterable

SCALE_TOLERANCE = 2.5
"""A factor is taken for one of those between units where it is so near; parameters may differ besides."""


def slips(unit: str) -> dict[float, str]:
    """Return factors by which numbers of a quantity in another unit are too large, with what it is in, in words."""
    instead = "" if unit == "1" else f" instead of {unit}"
    found = {1e3: f"thousandths{instead}", 1e-3: f"thousands{instead}"}
    if unit not in _TURNS:
        return found
    angles = {math.degrees(1.0): "degrees instead of rad", math.radians(1.0): "units of 57.3 rad instead of rad"}
    return {**angles, **_TURNS[unit], **found}


_TURNS = {"rad": {0.5 / math.pi: "revolutions instead of rad"}, "rad/s": {30.0 / math.pi: "rpm instead of rad/s"}}


def nearest(factor: float, scales: Iterable[float]) -> float:
    """Return the factor between units that is nearest, with its sign; NaN where none is near."""
    if not 0.0 < abs(factor) < math.inf:
        return math.nan
    best = min(scales, key=lambda scale: abs(math.log(abs(factor) / scale)))
    return math.copysign(best, factor) if abs(math.log(abs(factor) / best)) <= math.log(SCALE_TOLERANCE) else math.nan
