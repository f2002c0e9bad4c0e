"""A system's controller and plant, to be compared: what the one was designed for, and what is asked of the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.model_description import ModelDescription

from fmu_export.errors import UserError
from fmu_export.reading import read_text
from ihc_fmu.design import DESIGN_FILE, Design
from ihc_fmu.pendulum.interface import STATES
from ihc_fmu.quantity import Quantity
from ihc_fmu.system import System as LinearSystem

from . import pendulum, pendulum_match
from .design_match import Expected
from .fmu_files import describe, start_values_of, unpacked
from .plant_as_wired import COUNTS, TRUE, Place, Question
from .structure import Component, SystemStructure, Wire
from .unit_definitions import NO_UNIT, conversion, conversion_asked, known_scale, unit_of
from .wire_factors import ComparedWire
from .wiring import CONTROLLER, PLANT

Array = np.ndarray

MOST_BYTES = 2**20
"""Size of a design file that is read of an FMU; the largest design has 60 kB."""
SMALL = 0.2
"""The span in which the fastest pole, of the model or of the linear control loop, changes the states by about this part."""
REACH = 5.0
"""How many times the room within the limits an input's size may be."""


@dataclass(frozen=True)
class ComparedPair:
    """Controller and plant of a system, and all their start values."""

    wires: Sequence[Wire]
    controller: Component
    plant: Component
    controller_values: Mapping[str, Any]
    plant_values: Mapping[str, Any]

    @classmethod
    def of(cls, system: SystemStructure) -> ComparedPair | None:
        """Return the two; None where there are not both."""
        there = {c.name: c for c in system.components}
        if not {CONTROLLER, PLANT} <= there.keys():
            return None
        both = there[CONTROLLER], there[PLANT]
        return cls(system.wires, *both, *({**start_values_of(c.path), **c.start} for c in both))

    @property
    def balances(self) -> bool:
        """Whether the controller is the pendulum's."""
        return pendulum.is_controller(self.controller_values)

    @property
    def plain(self) -> bool:
        """Whether wires between the two go by equal names and change no value."""
        return not any(w.converts or w.source.partition(".")[2] != w.target.partition(".")[2] for w in self.wires)

    @cached_property
    def expected(self) -> Expected | str | None:
        """What the controller was designed for; why that cannot be told, or None where it does not say."""
        if self.balances:
            model = pendulum_match.design_model(self.controller_values)
            gain = pendulum_match.k_lin_of(self.controller_values)
            return None if model is None else _of_the_pendulum(*map(_entries, (model.A, model.b, gain)))
        fmu = unpacked(self.controller.path)  # and held as long as it is read
        file = fmu.folder / "resources" / DESIGN_FILE
        if not file.is_file():
            return None
        try:
            return _of_a_design(file)
        except UserError as error:
            reason = str(error).removeprefix(f"{file}: ")
            return f"the design in {self.controller.path} cannot be read, so that its model is not judged: {reason}"

    @cached_property
    def question(self) -> Question | None:
        """What is asked of the plant; None where nothing is expected of it, or no wire leads from or to it."""
        expected = self.expected
        if not isinstance(expected, Expected):
            return None
        system = expected.system
        outputs = self._ports(PLANT, CONTROLLER, [q.name for q in system.outputs])
        inputs = self._ports(CONTROLLER, PLANT, [q.name for q in system.inputs])
        if not outputs or not inputs:
            return None
        plain = ([wire.unconverted for wire in some] for some in (outputs, inputs))
        return Question(
            path=self.plant.path,
            content=str(unpacked(self.plant.path).folder),
            start=tuple(sorted(self.plant.start.items())),
            outputs=outputs,
            inputs=inputs,
            places=tuple(self._places(expected, outputs, inputs).items()),
            unconverted=tuple(self._places(expected, *plain).items()),
            span=_span(system),
        )

    def _ports(self, source: str, target: str, names: Sequence[str]) -> tuple[ComparedWire, ...]:
        """Return the wires from one to the other whose variable of the controller is one of `names`."""
        compared = []
        for wire in self.wires:
            ends = {part: name for part, _, name in (wire.source.partition("."), wire.target.partition("."))}
            if (
                ends.keys() == {PLANT, CONTROLLER}
                and wire.source.startswith(f"{source}.")
                and ends[CONTROLLER] in names
            ):
                units = [self._unit(source, ends[source]), self._unit(target, ends[target])]
                asked, declared = self._asked(source, target, units), None not in units
                compared.append(ComparedWire(wire, names.index(ends[CONTROLLER]), asked, declared))
        return tuple(compared)

    def _description(self, component: str) -> ModelDescription:
        return describe((self.plant if component == PLANT else self.controller).path)

    def _unit(self, component: str, name: str) -> str | None:
        """Return the unit of a component's variable; None where nothing says it."""
        unit = next((unit_of(v) for v in self._description(component).modelVariables if v.name == name), NO_UNIT)
        return None if unit == NO_UNIT else unit

    def _asked(self, source: str, target: str, units: Sequence[str | None]) -> float | None:
        """Return the factor that the units at the ends of a wire ask for, SI units for one that is not said."""
        if units[0] == units[1]:
            return None if units[0] is None else 1.0
        pairs = zip((source, target), units, strict=True)
        scales = [None if unit is None else known_scale(self._description(name), unit) for name, unit in pairs]
        if any(unit is not None and scale is None for unit, scale in zip(units, scales, strict=True)):
            return None
        asked = conversion_asked(scales[0], scales[1])
        return None if asked is None else asked[0]

    def _places(
        self, expected: Expected, outputs: Sequence[ComparedWire], inputs: Sequence[ComparedWire]
    ) -> dict[str, Place]:
        """Return where the plant's variables are at the design's equilibrium: its states by name, else by the wires."""
        return _places(expected, self._units(expected.system), outputs, inputs)

    def _units(self, system: LinearSystem) -> dict[str, tuple[float, float] | None]:
        """Return (factor, offset) from the design's unit of a state to the plant's, None where that is another quantity."""
        units: dict[str, tuple[float, float] | None] = {}
        for quantity in system.states:
            own = self._unit(PLANT, quantity.name + TRUE) or self._unit(PLANT, quantity.name)
            units[quantity.name] = (1.0, 0.0)
            if own is not None and quantity.unit not in (NO_UNIT, own):
                a = known_scale(self._description(CONTROLLER), quantity.unit)
                b = known_scale(self._description(PLANT), own)
                units[quantity.name] = None if a is None or b is None else conversion(a, b)
        return units

    def states_in_plant(self) -> dict[str, tuple[float, float]]:
        """Return, of states of the design that the plant may have by their names, the equilibrium and a factor.

        x = factor (value - equilibrium) is the deviation in the design's unit, value and equilibrium in the plant's. The
        wire of a state that is measured decides, otherwise the units.
        """
        expected, question = self.expected, self.question
        if not isinstance(expected, Expected) or question is None:
            return {}
        system, found = expected.system, {}
        for state, value in zip(system.states, np.asarray(system.x_eq), strict=True):
            unit = self._units(system)[state.name]
            if unit is not None:
                found[state.name] = (float(unit[0] * value + unit[1]), 1.0 / unit[0])
        names = [state.name for state in system.states]
        for wire in question.outputs:
            alone = np.flatnonzero(np.asarray(system.C)[wire.number])
            if wire.factor and wire.name in names and alone.tolist() == [names.index(wire.name)]:
                scale = float(np.asarray(system.C)[wire.number, alone[0]])
                rest = (float(np.asarray(system.y_eq)[wire.number]) - wire.offset) / wire.factor
                found[wire.name] = (rest, wire.factor / scale)
        return found


def _entries(numbers: Array) -> tuple[float, ...]:
    return tuple(numbers.ravel().tolist())


@lru_cache(maxsize=16)
def _of_a_design(file: Path) -> Expected:
    """Return what a design file says; raises as the file's loader."""
    design = Design.from_json(read_text(file, "design", MOST_BYTES))
    system = design.system
    sizes = np.where(design.u_max > 0.0, design.u_max, np.where(np.isfinite(system.room), system.room, 1.0))
    return Expected(system, design.extent, np.minimum(sizes, REACH * system.room))


@lru_cache(maxsize=16)
def _of_the_pendulum(A: tuple[float, ...], b: tuple[float, ...], k_lin: tuple[float, ...]) -> Expected | None:
    n = len(STATES)
    try:
        names = {"states": tuple(map(Quantity, STATES)), "inputs": (Quantity("voltage", "V"),)}
        system = LinearSystem(A=np.reshape(A, (n, n)), B=np.array(b), K=np.array(k_lin), **names)
    except UserError:
        return None
    return Expected(system, np.ones(n), np.ones(1))


def _span(system: LinearSystem) -> float:
    closed = system.A + system.B @ np.asarray(system.K)
    return SMALL / float(max(np.abs(np.linalg.eigvals(M)).max() for M in (system.A, closed)))


def _places(
    expected: Expected,
    units: Mapping[str, tuple[float, float] | None],
    outputs: Sequence[ComparedWire],
    inputs: Sequence[ComparedWire],
) -> dict[str, Place]:
    """Return where the plant's variables are at the design's equilibrium: its states by name, else by the wires.

    `units`: (factor, offset) from the design's unit of a state to the plant's, None where that is another quantity.
    """
    system = expected.system
    C, resolutions = np.asarray(system.C), np.asarray(system.resolutions)
    largest = np.abs(C) == np.abs(C).max(axis=1, keepdims=True)
    least = COUNTS * np.where(largest, resolutions[:, None] / np.where(largest, np.abs(C), 1.0), 0.0).max(axis=0)
    places = {}
    for q, value, *sizes in zip(system.states, np.asarray(system.x_eq), expected.extent, least, strict=True):
        unit = units[q.name]
        if unit is not None:
            factor, offset = unit
            places[q.name] = Place(float(factor * value + offset), *(abs(factor) * float(size) for size in sizes))
    for port in outputs:
        if port.factor and (port.name not in places or port.factor != 1.0 or port.offset):
            i, size = port.number, abs(port.factor)
            value = (float(np.asarray(system.y_eq)[i]) - port.offset) / port.factor
            extent = float(np.abs(C[i]) @ expected.extent)
            places[port.name] = Place(value, extent / size, COUNTS * float(resolutions[i]) / size)
    for port in inputs:
        value = port.factor * float(np.asarray(system.u_eq)[port.number]) + port.offset
        places[port.name] = Place(value, abs(port.factor) * float(expected.u_size[port.number]))
    return places
