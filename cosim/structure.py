"""The structure of a system: which FMUs, what is wired to what, what acts from outside."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fmu_export.files import FilePath

from .fmu import Value
from .integration import Interface


@dataclass(frozen=True)
class Component:
    """An FMU in a system: its name there, its file, and the start values that differ from the file's.

    `interface`: how it is run, see `integration.opened`.
    """

    name: str
    path: Path
    start: Mapping[str, Value | str]
    interface: Interface | None

    def __init__(
        self,
        name: str,
        path: FilePath,
        start: Mapping[str, Value | str] | None = None,
        interface: Interface | None = None,
    ) -> None:
        for entry, value in (("name", name), ("path", Path(path)), ("start", start or {}), ("interface", interface)):
            object.__setattr__(self, entry, value)


@dataclass(frozen=True)
class Wire:
    """A connection from an output to an input, each as `instance.variable`: target = factor source + offset.

    A factor other than 1 or an offset other than 0 is the user's word on the units, which then may differ.
    """

    source: str
    target: str
    factor: float = 1.0
    offset: float = 0.0

    @property
    def converts(self) -> bool:
        """Whether the value changes on its way."""
        return self.factor != 1.0 or self.offset != 0.0


@dataclass(frozen=True)
class Signal:
    """A function of time [s] on an input `instance.variable`, evaluated at the start of each step and held.

    With `recorded` the input is recorded as outputs are: a row has the value of the step that ended there.
    """

    target: str
    function: Callable[[float], float]
    recorded: bool = field(default=False, kw_only=True)

    def ahead(self, start_time: float, step: float, first: int, count: int) -> Sequence[float]:
        """Return the values at start_time + k step for `count` steps from `first` on."""
        return [self.function(start_time + k * step) for k in range(first, first + count)]


@dataclass(frozen=True)
class System:
    """Components in their order of stepping, the wires between them, and signals from outside."""

    components: Sequence[Component]
    wires: Sequence[Wire] = ()
    signals: Sequence[Signal] = ()
