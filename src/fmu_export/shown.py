"""What an FMU shows of a unit's compiled variables: some of them, in any order, under other names and with other units.

One binary, or one slave class, then serves every design. What is not shown still has its value: its start value in the
compiled table, or another one that the export gives.

Standard library only: this module travels inside the Python FMUs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

from .errors import UserError
from .variables import Interface, Value, Variable


@dataclass(frozen=True)
class Showing:
    """The `interface` that an FMU of the compiled `table` shows.

    Each of its variables has a slot in the table: the same type, causality (outputs and local variables are one),
    variability, limits and treatment of values that are not finite. Raises ValueError where one has not.
    """

    table: Interface
    interface: Interface

    def __post_init__(self) -> None:
        slots: dict[str, str] = {}
        for variable in self.interface.variables:
            if variable.compiled in slots:
                raise ValueError(
                    f"{slots[variable.compiled]} and {variable.name} have the same slot {variable.compiled}"
                )
            slots[variable.compiled] = variable.name
            compiled = self.table.by_name.get(variable.compiled)
            if compiled is None:
                raise ValueError(
                    f"{self.table.name} has no variable {variable.compiled} for {variable.name} to stand for"
                )
            if _nature(variable) != _nature(compiled):
                raise ValueError(
                    f"{variable.name} must have the type, causality, variability and limits of its slot "
                    f"{compiled.name}: {_nature(compiled)}, found {_nature(variable)}"
                )

    @cached_property
    def names(self) -> dict[str, str]:
        """The shown names by those of the compiled variables."""
        return {v.compiled: v.name for v in self.interface.variables}

    @cached_property
    def references(self) -> list[int]:
        """The value references of the shown variables: their slots' positions in the table."""
        position = {v.name: i for i, v in enumerate(self.table.variables)}
        return [position[v.compiled] for v in self.interface.variables]

    def compiled_values(self, start: Mapping[str, Value], hidden: Mapping[str, Value | str]) -> dict[str, Value]:
        """Return the start values of the whole table: those shown, `hidden` ones by compiled names, the table's own.

        Raises UserError for a value that the table does not admit or a hidden one that is shown or does not exist.
        """
        twice = next((name for name in hidden if name in self.names), None)
        if twice is not None:
            raise UserError(f"{twice} must be hidden or shown, found it as {self.names[twice]} and hidden")
        slots = {v.name: v.compiled for v in self.interface.variables}
        return self.table.start_values({**hidden, **{slots[name]: value for name, value in start.items()}})

    def admitted(
        self,
        twin: Callable[[Mapping[str, Value]], object],
        start: Mapping[str, Value],
        hidden: Mapping[str, Value | str],
    ) -> dict[str, Value]:
        """Return `compiled_values`; raise UserError, in shown names, also for those that the unit `twin` refuses."""
        values = self.compiled_values(start, hidden)
        try:
            twin(values)
        except UserError as error:
            raise UserError(self.sentence(str(error))) from None
        return values

    def sentence(self, text: str) -> str:
        """Return a message of the unit, which speaks of compiled variables, with the shown names."""
        return re.sub(r"[A-Za-z_]\w*", lambda match: self.names.get(match[0], match[0]), text)


def _nature(variable: Variable) -> tuple[object, ...]:
    """Return what a shown variable and its slot have in common."""
    causality = "output" if variable.calculated else variable.causality
    variability = variable.variability if variable.causality == "parameter" else ""
    return variable.type, causality, variability, *variable.limits(), variable.fault_on_non_finite
