"""The type of one FMU variable: the single declaration from which XML, code and documentation are derived.

Standard library only: this module travels inside the Python FMUs.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from .errors import UserError, shown

Value = float | int | bool
Type = Literal["Real", "Integer", "Boolean", "Enumeration"]
Causality = Literal["parameter", "input", "output", "local"]
Variability = Literal["fixed", "tunable", "discrete", "continuous"]

LONGEST_NAME = 200
"""Characters in the name of a variable or of a unit, at most."""


@dataclass(frozen=True, slots=True)
class Variable:
    """One scalar variable of a unit's FMI 2.0 interface.

    `start` is None for outputs and local variables: they are calculated in initialization. `items` names the values 1, 2,
    ... of an enumeration. `dependencies` lists the inputs that an output depends on directly at a communication point,
    `initial_dependencies` the parameters and inputs that it depends on in initialization.
    `fault_on_non_finite` marks an input whose NaN or infinity the unit itself turns into a fault; every other non-finite
    value is refused.

    The name is any text on one line: FMI's flat names. So is the unit, "1" for none, in Modelica's notation where the SI
    has it (`units.py`). `slot` is the name of the compiled variable that a shown one stands
    for, where a unit's binary serves many interfaces; empty, it is the variable's own name.
    """

    name: str
    causality: Causality
    description: str
    unit: str = "1"
    type: Type = "Real"
    variability: Variability = "continuous"
    start: Value | None = None
    min: float | None = None
    max: float | None = None
    items: tuple[str, ...] = ()
    dependencies: tuple[str, ...] = ()
    initial_dependencies: tuple[str, ...] = ()
    fault_on_non_finite: bool = False
    slot: str = ""

    def __post_init__(self) -> None:
        check_name(self.name, "variable's name")
        check_name(self.unit, "unit")
        if (self.start is None) != self.calculated:
            raise ValueError(f"variable {self.name}: parameters and inputs have a start value, all others have none")
        if (self.type == "Enumeration") != bool(self.items):
            raise ValueError(f"variable {self.name}: items belong to an Enumeration, and it needs them")

    @property
    def compiled(self) -> str:
        """The name of the compiled variable that this one stands for."""
        return self.slot or self.name

    def shown_as(self, name: str, description: str | None = None, unit: str | None = None) -> Variable:
        """Return this compiled variable as one that is shown under another name, with a description and unit of its own."""
        return replace(
            self,
            name=name,
            slot=self.compiled,
            description=self.description if description is None else description,
            unit=self.unit if unit is None else unit,
        )

    @property
    def calculated(self) -> bool:
        """Whether the unit computes it: outputs and local variables."""
        return self.causality in ("output", "local")

    def check(self, value: Value | str) -> Value:
        """Return `value` as this variable's type, or raise UserError that names variable, rule and value."""
        number = self._as_number(value)
        if not math.isfinite(number):
            if self.fault_on_non_finite:
                return number
            raise UserError(f"{self.name} must be finite, found {value}")
        low, high = self.limits()
        if number < low or number > high:
            raise UserError(f"{self.name} must lie in [{low:g}, {high:g}]{self._unit_text()}, found {value}")
        return number

    def limits(self) -> tuple[float, float]:
        """Return the smallest and largest admissible value."""
        if self.type == "Enumeration":
            return 1, len(self.items)
        return (-math.inf if self.min is None else self.min), (math.inf if self.max is None else self.max)

    def _unit_text(self) -> str:
        return "" if self.unit == "1" or self.type != "Real" else f" {self.unit}"

    def _as_number(self, value: Value | str) -> Value:
        if isinstance(value, str):
            if value not in self.items:
                expected = f"one of {', '.join(self.items)}" if self.items else f"a {self.type}"
                raise UserError(f"{self.name} must be {expected}, found {value!r}")
            return self.items.index(value) + 1
        if self.type == "Boolean":
            if not isinstance(value, int | float) or value not in (0, 1):
                raise UserError(f"{self.name} must be true or false, found {value}")
            return bool(value)
        if isinstance(value, bool):
            raise UserError(f"{self.name} must be of type {self.type}, found {str(value).lower()}")
        if not isinstance(value, int | float):
            raise UserError(f"{self.name} must be a number, found {value}")
        if self.type == "Real":
            return float(value)
        if not math.isfinite(value) or value != int(value) or not -(2**31) <= value < 2**31:
            raise UserError(f"{self.name} must be an integer of 32 bits, found {value}")
        return int(value)


@dataclass(frozen=True, slots=True)
class Interface:
    """The whole interface of a unit: its name, its text, its variables in the order of their value references.

    `step_size` [s] is the step that suits it by default, unless `step_parameter` names the parameter that tells it.
    """

    name: str
    description: str
    variables: tuple[Variable, ...]
    step_size: float
    stop_time: float
    variable_step: bool
    step_parameter: str | None = None
    by_name: dict[str, Variable] = field(init=False, compare=False)

    def __post_init__(self) -> None:
        by_name = {v.name: v for v in self.variables}
        if len(by_name) != len(self.variables):
            counts = Counter(v.name for v in self.variables)
            twice = next(name for name, count in counts.items() if count > 1)
            raise UserError(f"{self.name}: variable names must be unique, found {shown(twice)} more than once")
        if self.step_parameter is not None and self.step_parameter not in by_name:
            raise ValueError(f"{self.name}: there is no variable {self.step_parameter} to tell the step")
        object.__setattr__(self, "by_name", by_name)

    def of(self, causality: Causality) -> tuple[Variable, ...]:
        """Return the variables of one causality, in interface order."""
        return tuple(v for v in self.variables if v.causality == causality)

    @property
    def calculated(self) -> tuple[Variable, ...]:
        """The outputs and local variables, in interface order: what a unit's `outputs()` returns."""
        return tuple(v for v in self.variables if v.calculated)

    def default_step(self, start: Mapping[str, Value]) -> float:
        """Return the step [s] that suits the unit with these start values."""
        return self.step_size if self.step_parameter is None else float(start[self.step_parameter])

    def exposing(self, names: Collection[str]) -> Interface:
        """Return the interface with the outputs `names` only; the others become local variables, which tools leave alone.

        Raises UserError for a name that is no output.
        """
        outputs = {v.name for v in self.of("output")}
        for name in names:
            if name not in outputs:
                raise UserError(f"{self.name} has no output named {name!r}{did_you_mean(name, outputs)}")
        return replace(
            self,
            variables=tuple(
                replace(v, causality="local") if v.causality == "output" and v.name not in names else v
                for v in self.variables
            ),
        )

    def showing(self, variables: Iterable[Variable], **fields: Any) -> Interface:
        """Return the interface that shows only `variables`, made by `Variable.shown_as`, and has other `fields`.

        Their dependencies, names of this compiled interface, become those shown; what is not shown never changes, and
        nothing depends on it.
        """
        kept = tuple(variables)
        names = {v.compiled: v.name for v in kept}

        def translated(dependencies: Iterable[str]) -> tuple[str, ...]:
            return tuple(names[name] for name in dependencies if name in names)

        return replace(
            self,
            variables=tuple(
                replace(
                    v,
                    dependencies=translated(v.dependencies),
                    initial_dependencies=translated(v.initial_dependencies),
                )
                for v in kept
            ),
            **fields,
        )

    def start_values(self, changes: Mapping[str, Value | str] | None = None) -> dict[str, Value]:
        """Return every parameter's and input's start value with `changes` applied and checked.

        Raises ValueError for an unknown name, an output, or a value outside its rule.
        """
        values = {v.name: v.start for v in self.variables if v.start is not None}
        for name, value in (changes or {}).items():
            if name not in values:
                raise UserError(f"{self.name} has no parameter or input named {name!r}{did_you_mean(name, values)}")
            values[name] = self.by_name[name].check(value)
            if not math.isfinite(values[name]):
                raise UserError(f"the start value of {name} must be finite, found {value}")
        return values


def check_name(name: str, what: str) -> None:
    """Raise UserError for what cannot name anything in an FMU: it must be printable, on one line and not too long."""
    if not 0 < len(name) <= LONGEST_NAME:
        raise UserError(f"a {what} must have 1 to {LONGEST_NAME} characters, found {len(name)}: {shown(name)}")
    if not name.isprintable() or name != name.strip():
        raise UserError(f"a {what} must be printable characters without a space at either end, found {shown(name)}")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return '; did you mean ...?' for the nearest known names, or nothing."""
    from difflib import get_close_matches  # noqa: PLC0415 - only on the way to an error

    close = get_close_matches(name, list(known), n=3)
    return f"; did you mean {' or '.join(close)}?" if close else ""
