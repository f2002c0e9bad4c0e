"""Ranges as they are written on the command line: `-1..1`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import UserError

SEPARATOR = ".."


@dataclass(frozen=True)
class Range:
    """From `low` to `high`, both finite, low < high."""

    low: float
    high: float

    @property
    def width(self) -> float:
        """High - low."""
        return self.high - self.low

    def at(self, share: float) -> float:
        """Return low + share (high - low), for a share in [0, 1]."""
        return self.low + share * self.width


def range_of(text: str, what: str) -> Range:
    """Return the range that `text` says, LOW..HIGH; raise UserError with `what`, the option and entry, for another."""
    low, dots, high = text.partition(SEPARATOR)
    try:
        ends = (float(low), float(high)) if dots else None
    except ValueError:
        ends = None
    if ends is None or not all(map(math.isfinite, ends)) or not ends[0] < ends[1]:
        raise UserError(f"{what} takes a range LOW..HIGH of finite numbers, LOW below HIGH, found {text!r}")
    return Range(*ends)
