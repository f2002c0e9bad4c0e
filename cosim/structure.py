"""The structure of a system: which FMUs, what is wired to what, what acts from outside."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fmu_export.files import FilePath

from .integration import Interface
from .start_values import StartValue


@dataclass(frozen=True)
class Component:
    """An FMU in a system.

    Parameters
    ----------
    name
        Its name there, of letters, digits and underscores.
    path
        The FMU.
    start
        Start values that differ from the file's, by name.
    interface
        "CoSimulation": by the FMU's own steps; "ModelExchange": integrated by SciPy; None: CoSimulation where the FMU has
        it.

    Examples
    --------
    >>> import cosim
    >>> plant = cosim.Component("plant", "fmus/arm_linear_plant.fmu", {"angle_0": 0.1})
    >>> plant.path.name, plant.start
    ('arm_linear_plant.fmu', {'angle_0': 0.1})
    """

    name: str
    path: Path
    start: Mapping[str, StartValue]
    interface: Interface | None

    def __init__(
        self,
        name: str,
        path: FilePath,
        start: Mapping[str, StartValue] | None = None,
        interface: Interface | None = None,
    ) -> None:
        for entry, value in (("name", name), ("path", Path(path)), ("start", start or {}), ("interface", interface)):
            object.__setattr__(self, entry, value)


@dataclass(frozen=True)
class Wire:
    """A connection from an output to an input: target = factor source + offset.

    A factor other than 1 or an offset other than 0 is the user's word on the units, which then may differ.

    Parameters
    ----------
    source
        An output as `instance.variable`.
    target
        An input.
    factor
        By which the value is multiplied.
    offset
        What is added then, in the unit of the target.

    Examples
    --------
    >>> import cosim
    >>> cosim.Wire("plant.angle", "controller.angle").converts
    False
    >>> cosim.Wire("plant.millimetres", "controller.position", factor=1e-3).converts
    True
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
    """A function of time on an input, evaluated at the start of each step and held.

    Parameters
    ----------
    target
        The input as `instance.variable`.
    function
        Of the time [s].
    recorded
        Whether the input is recorded as outputs are: a row has the value of the step that ended there.

    Examples
    --------
    >>> import cosim
    >>> push = cosim.Signal("plant.u1", lambda time: 2.0 if time >= 1.0 else 0.0)
    >>> push.ahead(start_time=0.0, step=0.5, first=0, count=4)
    [0.0, 0.0, 2.0, 2.0]
    """

    target: str
    function: Callable[[float], float]
    recorded: bool = field(default=False, kw_only=True)

    def ahead(self, start_time: float, step: float, first: int, count: int) -> Sequence[float]:
        """Return the values of coming steps.

        Parameters
        ----------
        start_time
            Of the run [s].
        step
            Communication step [s].
        first
            Number of the first step.
        count
            Number of steps.

        Returns
        -------
        Sequence[float]
            At start_time + k step, k = first, ..., first + count - 1.
        """
        return [self.function(start_time + k * step) for k in range(first, first + count)]


@dataclass(frozen=True)
class SystemStructure:
    """A system of FMUs.

    Parameters
    ----------
    components
        The FMUs in their order of stepping.
    wires
        The connections between them.
    signals
        What acts on free inputs from outside.

    Examples
    --------
    >>> import cosim
    >>> plant = cosim.Component("plant", "fmus/arm_linear_plant.fmu")
    >>> controller = cosim.Component("controller", "fmus/arm_controller.fmu")
    >>> names = ["angle", "rate"]
    >>> wires = [cosim.Wire(f"plant.{name}", f"controller.{name}") for name in names]
    >>> wires.append(cosim.Wire("controller.u1", "plant.u1"))
    >>> system = cosim.SystemStructure([controller, plant], wires)
    >>> [component.name for component in system.components]
    ['controller', 'plant']
    """

    components: Sequence[Component]
    wires: Sequence[Wire] = ()
    signals: Sequence[Signal] = ()
