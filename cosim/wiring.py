"""The wires of a scenario: listed by the user, or by equal names between controller and plant; and the order of stepping."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from fmpy.model_description import ScalarVariable
from pydantic import BaseModel, ConfigDict, Field, model_validator

from fmu_export.variables import did_you_mean

from .errors import UserError
from .fmu import RECORDED
from .structure import Wire
from .typed import Finite

CONTROLLER, PLANT = "controller", "plant"
"""The conventional components."""

SET_POINT = "_setpoint"
"""How the names of inputs end that are set-points: 0 unless they are given."""

Variables = Mapping[str, ScalarVariable]

_SHORT = re.compile(r"\s*(?P<source>.+?)\s*->\s*(?P<target>.+?)\s*(?:\*\s*(?P<factor>\S+)\s*)?", re.DOTALL)


class WireSection(BaseModel):
    """A wire: target = factor source + offset. In short: "component.output -> component.input * factor".

    A name with -> or * in it needs the long form.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    source: str = Field(description="output as component.variable")
    target: str = Field(description="input as component.variable")
    factor: Finite = Field(1.0, description="by which the value is multiplied, where the units differ")
    offset: Finite = Field(0.0, description="what is added then, in the unit of the input")

    @model_validator(mode="before")
    @classmethod
    def _short(cls, value: Any) -> Any:
        """Take the short form."""
        if not isinstance(value, str):
            return value
        match = _SHORT.fullmatch(value)
        if match is None:
            raise ValueError(f"must be 'component.output -> component.input', found {value[:80]!r}")
        ends = {"source": match["source"], "target": match["target"]}
        return ends if match["factor"] is None else {**ends, "factor": _factor(match["factor"])}

    def wire(self) -> Wire:
        """Return it as the master takes it."""
        return Wire(self.source, self.target, self.factor, self.offset)


def _factor(text: str) -> float:
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not math.isfinite(factor):
        raise ValueError(f"must have a finite number behind *, found {text[:80]!r}")
    return factor


def inputs(variables: Variables) -> list[str]:
    """Return the names of the inputs that can be wired."""
    return [v.name for v in variables.values() if v.causality == "input" and v.type in RECORDED]


def outputs(variables: Variables) -> list[str]:
    """Return the names of the outputs that can be wired."""
    return [v.name for v in variables.values() if v.causality == "output" and v.type in RECORDED]


def by_names(controller: Variables, plant: Variables, measured: Mapping[str, str]) -> list[Wire]:
    """Return a wire for every input of one of the two that an output of the other has the name of.

    `measured` are the plant's outputs by the names that they have for the controller. Raises UserError where nothing acts
    on the plant.
    """
    there = [Wire(f"{PLANT}.{measured[x]}", f"{CONTROLLER}.{x}") for x in inputs(controller) if x in measured]
    given = set(outputs(controller))
    back = [Wire(f"{CONTROLLER}.{u}", f"{PLANT}.{u}") for u in inputs(plant) if u in given]
    if not back:
        raise UserError(
            f"no output of the controller has the name of an input of the plant; list the wires, as "
            f'wires = ["controller.{(outputs(controller) or ["OUTPUT"])[0]} -> plant.{(inputs(plant) or ["INPUT"])[0]}"]'
        )
    return [*there, *back]


def check_ends(wires: Sequence[Wire], variables: Mapping[str, Variables]) -> None:
    """Raise UserError for a wire that does not lead from an output to an input; `variables` are by component."""
    for wire in wires:
        for name, causality, verb in ((wire.source, "output", "begins"), (wire.target, "input", "ends")):
            component, _, variable = name.partition(".")
            said = f"the wire {wire.source} -> {wire.target} {verb} at {name}, which is no"
            if component not in variables:
                raise UserError(f"{said} component's variable{did_you_mean(component, variables)}")
            fitting = [v.name for v in variables[component].values() if v.causality == causality]
            if variable not in fitting:
                raise UserError(f"{said} {causality}{did_you_mean(variable, fitting)}")


def check_fed(controller: Variables, fed: Collection[str], *, listed: bool) -> None:
    """Raise UserError for an input of the controller that nothing feeds; set-points may be left at their start values.

    `fed` are the names of those that have a wire, a signal or a start value of the scenario.
    """
    for name in inputs(controller):
        if name not in fed and not name.endswith(SET_POINT):
            why = "none of the wires ends there" if listed else "no output of the plant has its name"
            raise UserError(
                f"the input {CONTROLLER}.{name} gets nothing: {why}; wire it, give it a signal, or a value under "
                f"{CONTROLLER}.start"
            )


def sequence(names: Sequence[str], wires: Sequence[Wire]) -> list[str]:
    """Return the components in the order of stepping: the controller, then each after those that it is fed by.

    What the controller itself is fed by steps after it. Of several that could be next the first in `names` is.
    """
    feeds = {(w.source.partition(".")[0], w.target.partition(".")[0]) for w in wires}
    done = [name for name in names if name == CONTROLLER] or list(names[:1])
    while len(done) < len(names):
        left = [name for name in names if name not in done]
        waits = {name: [a for a, b in feeds if b == name and a in left and a != name] for name in left}
        reached = [name for name in left if any((a, name) in feeds for a in done)]
        done.append(next((n for n in left if not waits[n]), (reached or left)[0]))
    return done
