"""Units of variables, and what an FMU's UnitDefinitions say of one: SI value = factor value + offset, in base units."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fmpy.model_description import ModelDescription, ScalarVariable

from fmu_export.units import base_unit, same_unit

from .errors import UserError

if TYPE_CHECKING:
    from .structure import Wire

NO_UNIT = "1"

BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


_POWER = re.compile(r"(?<=[^\W\d_])\^?(-?\d+)")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def shown_unit(unit: str) -> str:
    """Return a unit as tables and pictures show it, such as V² s for V2.s; empty where there is none."""
    return "" if unit == NO_UNIT else _POWER.sub(lambda power: power[1].translate(_RAISED), unit).replace(".", " ")


def with_unit(name: str, unit: str) -> str:
    """Return what stands beside an axis or above a column: the name, and the unit where there is one."""
    shown = shown_unit(unit)
    return f"{name} [{shown}]" if shown else name


def declared_unit(variable: ScalarVariable) -> str | None:
    """Return the unit that a variable or its type declares; None where neither does."""
    unit = variable.unit if variable.unit is not None else getattr(variable.declaredType, "unit", None)
    return None if unit is None else str(unit).strip() or NO_UNIT


def unit_of(variable: ScalarVariable) -> str:
    """Return the declared unit, else the one in brackets at the end of the description: many FMUs of PythonFMU have none."""
    declared = declared_unit(variable)
    if declared is not None:
        return declared
    match = re.search(r"\[([^\[\]]{1,40})\]\s*$", variable.description or "")
    return match[1].strip() if match else NO_UNIT


def unit_in(name: str, variables: Mapping[str, Mapping[str, ScalarVariable]], wires: Iterable[Wire]) -> str:
    """Return the unit of `component.variable` in a system, "1" where nothing tells.

    It is the declared one, else that of the other end of a wire that does not convert, in which it is taken to be, else the
    one that its description has, as `unit_of`.
    """
    ends = [name]
    ends += [
        w.target if w.source == name else w.source for w in wires if name in (w.source, w.target) and not w.converts
    ]
    split = [end.partition(".") for end in ends]
    ends = [variables[component][name] for component, _, name in split if name in variables.get(component, {})]
    return next(filter(None, (*map(declared_unit, ends), *map(unit_of, ends[:1]))))


@dataclass(frozen=True, slots=True)
class Scale:
    """A unit by its base units' exponents in the order of BASES; SI value = factor value + offset."""

    exponents: tuple[int, ...]
    factor: float = 1.0
    offset: float = 0.0


def scale_of(description: ModelDescription, unit: str) -> Scale | None:
    """Return what the FMU says of `unit`; None where it does not define it by base units, or not sensibly."""
    definition = next((u.baseUnit for u in description.unitDefinitions if u.name == unit), None)
    if definition is None:
        return None
    factor, offset = float(definition.factor), float(definition.offset)
    if not (math.isfinite(factor) and math.isfinite(offset) and factor != 0.0):
        return None
    return Scale(tuple(int(getattr(definition, base)) for base in BASES), factor, offset)


def conversion(source: Scale, target: Scale) -> tuple[float, float] | None:
    """Return (factor, offset) from one unit to the other; None where they are of different quantities."""
    if source.exponents != target.exponents:
        return None
    return source.factor / target.factor, (source.offset - target.offset) / target.factor


def known_scale(description: ModelDescription, unit: str) -> Scale | None:
    """Return what the FMU says of `unit`, else what its name says; None where neither does."""
    scale = scale_of(description, unit)
    named = base_unit(unit) if scale is None else None
    if named is None:
        return scale
    return Scale(tuple(named.powers.get(base, 0) for base in BASES), named.factor, named.offset)


def conversion_asked(source: Scale | None, target: Scale | None) -> tuple[float, float] | None:
    """Return (factor, offset) from one unit to the other; None where they are of different quantities, or both None.

    Of one that is None the SI unit of the other is taken.
    """
    one = source or target
    return None if one is None else conversion(source or Scale(one.exponents), target or Scale(one.exponents))


def scale_text(source: Scale | None, target: Scale | None) -> str:
    """Return what to write so that a wire converts, for the end of a message; empty where the FMUs do not say."""
    converted = None if source is None or target is None else conversion(source, target)
    if converted is None:
        return ""
    factor, offset = converted
    return f"; it converts with factor = {factor!r}" + (f" and offset = {offset!r}" if offset else "")


def check_units(wire: Wire, descriptions: Mapping[str, ModelDescription]) -> None:
    """Raise UserError where both ends of a wire that does not convert declare units, and other ones, see `same_unit`.

    `descriptions`: of the FMUs by component. Of a variable that an FMU does not have nothing is said.
    """
    ends = [end.partition(".") for end in (wire.source, wire.target)]
    variables = [
        next((v for v in descriptions[owner].modelVariables if v.name == name), None) if owner in descriptions else None
        for owner, _, name in ends
    ]
    a, b = variables
    if wire.converts or a is None or b is None:
        return
    source, target = declared_unit(a), declared_unit(b)
    if source and target and not same_unit(source, target):
        hint = scale_text(scale_of(descriptions[ends[0][0]], source), scale_of(descriptions[ends[1][0]], target))
        text = f"the wire {wire.source} -> {wire.target}"
        raise UserError(f"{text} must join equal units, found {source} and {target}{hint}")
