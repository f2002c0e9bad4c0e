"""The variables of a plant's FMU that take part in a linear model: found by name, with units, sizes and limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from fmpy.model_description import ScalarVariable

from fmu_export.errors import shown
from fmu_export.variables import did_you_mean
from ihc_fmu.quantity import Quantity

from .errors import UserError
from .fmu import Instance
from .start_values import StartValue
from .unit_definitions import unit_of

MOST_VARIABLES = 256
"""States, inputs or outputs of a model, at most."""
START = "_0"
"""The parameter that sets the output S at the start is S_0 where nothing else is said."""


class HiddenStatesError(UserError):
    """An FMU is for co-simulation only and does not say what its states are."""


def state_pairs(instance: Instance, states: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return (output, what sets it at the start) of each state of a co-simulation FMU."""
    real = [v for v in instance.variables.values() if v.type == "Real"]
    readable = [v.name for v in real if v.causality in ("output", "local")]
    own = [v.name for v in real if v.name in readable and v.initial == "exact" and v.variability != "constant"]
    settable = [*(v.name for v in real if v.causality == "parameter"), *own]

    def setter(name: str) -> str:
        return name if name in own and name + START not in settable else name + START

    if not states:
        pairs = [(name, setter(name)) for name in readable if setter(name) in settable]
        if pairs:
            return _bounded(pairs, "states")
        raise HiddenStatesError(
            f"{instance.path} is for co-simulation only and does not say what its states are: name each with --state "
            f"OUTPUT=PARAMETER, the real output that shows it and the parameter that sets it at the start"
        )
    pairs = []
    for text in states:
        name, _, parameter = text.partition("=")
        pairs.append((name, parameter or setter(name)))
        for part, known, what in ((name, readable, "real output"), (pairs[-1][1], settable, "real parameter")):
            index_of(part, known, what)
    for side, what in ((0, "state"), (1, "parameter")):
        _check_once([pair[side] for pair in pairs], what)
    return _bounded(pairs, "states")


def real_inputs(instance: Instance, names: tuple[str, ...]) -> tuple[ScalarVariable, ...]:
    """Return the named inputs, or the only one; raise UserError for others."""
    known = [v.name for v in instance.variables.values() if v.type == "Real" and v.causality == "input"]
    if not names and len(known) != 1:
        raise UserError(f"name the inputs with --input: {instance.path} has {', '.join(known) or 'no real input'}")
    return _chosen(instance, names or known, known, "real input")


def real_outputs(
    instance: Instance, names: tuple[str, ...], states: Sequence[ScalarVariable]
) -> tuple[ScalarVariable, ...]:
    """Return the named outputs, or the states where all are outputs; raise UserError for others."""
    known = [v.name for v in instance.variables.values() if v.type == "Real" and v.causality == "output"]
    if names:
        return _chosen(instance, names, known, "real output")
    hidden = [v.name for v in states if v.name not in known]
    if hidden:
        raise UserError(
            f"name what is measured with --output: the state {hidden[0]} is no output of {instance.path}, which has "
            f"{', '.join(known) or 'none'}"
        )
    return tuple(_bounded(states, "outputs"))


def _chosen(instance: Instance, names: Sequence[str], known: Sequence[str], what: str) -> tuple[ScalarVariable, ...]:
    for name in names:
        index_of(name, known, what)
    _check_once(names, what)
    return tuple(instance.variables[name] for name in _bounded(names, f"{what}s"))


def _bounded(variables: Sequence[Any], what: str) -> list[Any]:
    if len(variables) > MOST_VARIABLES:
        raise UserError(f"a model must have at most {MOST_VARIABLES} {what}, found {len(variables)}")
    return list(variables)


def _check_once(names: Sequence[str], what: str) -> None:
    for name in names:
        if list(names).count(name) > 1:
            raise UserError(f"each {what} must be named once, found {shown(name)} twice")


def index_of(name: str, known: Sequence[str], what: str) -> int:
    """Return where `name` is among the known ones; raise UserError, which calls it `what`, where it is not."""
    if name not in known:
        raise UserError(f"the FMU has no {what} {shown(name)}{did_you_mean(name, known)}")
    return list(known).index(name)


def quantities(variables: Sequence[ScalarVariable]) -> tuple[Quantity, ...]:
    """Return names and units; raise UserError for a name that a system file cannot hold."""
    named = tuple(Quantity(v.name, unit_of(v)) for v in variables)
    for quantity in named:
        if Quantity.parse(str(quantity)) != quantity:
            raise UserError(f"a system file cannot hold the name {shown(quantity.name)} in {shown(quantity.unit)}")
    return named


def _attribute(variable: ScalarVariable, name: str) -> Any:
    own = getattr(variable, name, None)
    return own if own is not None else getattr(variable.declaredType, name, None)


def nominal_of(variable: ScalarVariable) -> float:
    """Return the size of a variable that its nominal attribute says; 1 without."""
    value = _number(_attribute(variable, "nominal"))
    return abs(value) if value is not None and value != 0.0 else 1.0


def bound_of(variable: ScalarVariable, name: str, none: float) -> float:
    """Return the attribute "min" or "max"; `none` where there is none."""
    value = _number(_attribute(variable, name))
    return none if value is None or abs(value) >= 1e300 else value


def start_of(variable: ScalarVariable) -> StartValue:
    """Return the start value of a real variable; 0 without."""
    return _number(variable.start) or 0.0


def _number(text: object) -> float | None:
    try:
        value = float(str(text))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def finite_number(name: str, value: float) -> float:
    """Return the value; raise UserError, which names it, where it is not finite."""
    if not math.isfinite(value):
        raise UserError(f"{name} must be finite, found {value}")
    return float(value)
