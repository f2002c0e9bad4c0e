"""Start values of an FMU's variables: their types, and which of them may be set before the initialization."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from fmpy.model_description import ScalarVariable

from fmu_export.errors import shown

from .errors import UserError

StartValue = bool | int | float | str
StartValues = Mapping[str, StartValue]


def as_value(variable: ScalarVariable, value: StartValue) -> StartValue:
    """Return `value` in the type of `variable`; an enumeration may be given by its item's name.

    Raises UserError that names variable, rule and value.
    """
    name, kind = variable.name, variable.type
    if kind == "Enumeration":
        declared: Any = variable.declaredType
        items: dict[str, int] = {item.name: int(item.value) for item in declared.items}
        if value in items:
            return items[str(value)]
        if isinstance(value, bool) or value not in items.values():
            raise UserError(f"{name} must be one of {', '.join(items)}, found {shown(value)}")
        return int(value)
    if kind == "Boolean":
        if not isinstance(value, bool):
            raise UserError(f"{name} must be true or false, found {shown(value)}")
        return value
    if kind == "String":
        if not isinstance(value, str) or "\0" in value:
            raise UserError(f"{name} must be a text, found {shown(value)}")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UserError(f"{name} must be a number, found {shown(value)}")
    if isinstance(value, int) and value.bit_length() > 1000:
        raise UserError(f"{name} must be a number of moderate size, found {shown(value)}")
    if not math.isfinite(value):
        raise UserError(f"{name} must be finite, found {value}")
    if kind == "Integer" and (value != int(value) or not -(2**31) <= value < 2**31):
        raise UserError(f"{name} must be an integer of 32 bits, found {shown(value)}")
    low = -math.inf if variable.min is None else float(variable.min)
    high = math.inf if variable.max is None else float(variable.max)
    if not low <= value <= high:
        unit = "" if variable.unit in (None, "1") else f" {variable.unit}"
        raise UserError(f"{name} must lie in [{low:g}, {high:g}]{unit}, found {value}")
    return int(value) if kind == "Integer" else float(value)


def not_settable(variable: ScalarVariable) -> str | None:
    """Return why a variable cannot be set before the initialization; None: it can.

    Set can be parameters, inputs, and what begins with its start attribute (FMI 2.0: initial = "exact", "approx").
    """
    causality, initial = variable.causality, variable.initial
    if variable.variability == "constant":
        return "is a constant and cannot be set"
    if causality == "independent":
        return "is the independent variable, the time, and cannot be set"
    if causality == "calculatedParameter":
        return "is a parameter that the FMU calculates from others, and has no start value to set"
    if causality in ("parameter", "input") or initial in ("exact", "approx"):
        return None
    article = "an" if causality == "output" else "a"
    return (
        f'is {article} {causality} variable that the FMU calculates (initial = "{initial}"), with no start value to set'
    )
