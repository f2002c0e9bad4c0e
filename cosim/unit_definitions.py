"""What an FMU's UnitDefinitions say of a unit: SI value = factor value + offset, in powers of the base units."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fmpy.model_description import ModelDescription

BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True, slots=True)
class Scale:
    """A unit by its base units' exponents in the order of BASES; SI value = factor value + offset."""

    exponents: tuple[int, ...]
    factor: float = 1.0
    offset: float = 0.0


def scale_of(description: ModelDescription, unit: str) -> Scale | None:
    """Return what the FMU says of `unit`; None where it does not define it by base units, or not sensibly."""
    found = next((u.baseUnit for u in description.unitDefinitions if u.name == unit), None)
    if found is None:
        return None
    factor, offset = float(found.factor), float(found.offset)
    if not (math.isfinite(factor) and math.isfinite(offset) and factor != 0.0):
        return None
    return Scale(tuple(int(getattr(found, base)) for base in BASES), factor, offset)


def conversion(source: Scale, target: Scale) -> tuple[float, float] | None:
    """Return (factor, offset) from one unit to the other; None where they are of different quantities."""
    if source.exponents != target.exponents:
        return None
    return source.factor / target.factor, (source.offset - target.offset) / target.factor


def scale_text(source: Scale | None, target: Scale | None) -> str:
    """Return what to write so that a wire converts, for the end of a message; empty where the FMUs do not say."""
    found = None if source is None or target is None else conversion(source, target)
    if found is None:
        return ""
    factor, offset = found
    return f"; it converts with factor = {factor!r}" + (f" and offset = {offset!r}" if offset else "")
