"""Where controller and plant meet: is the model that the controller was designed for the plant's?

The pendulum's controller says its model by start values, that of any other design by DESIGN_FILE among its FMU's resources,
which is read as any design file is; a controller without is not judged. The plant's model is known for the pendulum, and of
any other FMU that shows its states found by differences (`plant_as_wired`). Between the pendulum's two units start values
decide (`pendulum_match`); another plant of its controller is seen in the coordinates of its two angles and their rates; all
others are compared by what goes from commands to measurements (`design_match`). Nothing is said of a plant that hides its
states; of one that shows them and cannot be evaluated, why.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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

from . import design_match, pendulum, pendulum_match
from .design_match import SAME, Expected
from .fmu_files import describe, start_values_of, unpacked
from .pendulum_match import Model
from .plant_as_wired import COUNTS, TRUE, ComparedWire, Found, Place, Question, found, judged
from .structure import Component, SystemStructure, Wire
from .unit_definitions import NO_UNIT, conversion, conversion_asked, known_scale, unit_of
from .unit_slips import SCALE_TOLERANCE
from .wire_factors import Wired
from .wiring import CONTROLLER, PLANT

Array = np.ndarray

MOST_BYTES = 2**20
"""Size of a design file that is read of an FMU; the largest design has 60 kB."""
SMALL = 0.2
"""The span in which the fastest pole, of the model or of the linear control loop, changes the states by about this part."""
REACH = 5.0
"""How many times the room within the limits an input's size may be."""


def misfit(system: SystemStructure) -> str | None:
    """Return how the model that a system's controller was designed for differs from its plant's; None where it fits.

    None too where there are not both, or one of them does not say.
    """
    pair = _Pair.of(system)
    if pair is None:
        return None
    if pair.balances and pendulum.is_plant(pair.plant_values):
        return pendulum_match.misfit(pair.controller_values, pair.plant_values)
    expected, question = pair.expected, pair.question
    if not isinstance(expected, Expected) or question is None:
        return None
    if pair.balances:
        design, plant = pendulum_match.design_model(pair.controller_values), _in_angles(judged(question))
        return None if design is None or plant is None else pendulum_match.misfit_of(design, plant)
    return _misfit(expected, question, pair.plain)


def remarks(system: SystemStructure) -> list[str]:
    """Return what is to be known of a system's controller on its plant, although they fit."""
    pair = _Pair.of(system)
    if pair is None:
        return []
    if pair.balances and pendulum.is_plant(pair.plant_values):
        return pendulum_match.remarks(pair.controller_values, pair.plant_values)
    return [pair.expected] if isinstance(pair.expected, str) else _remarks(pair, pair.expected)


def _remarks(pair: _Pair, expected: Expected | None) -> list[str]:
    question = pair.question
    if expected is None or question is None:
        return []
    plant = judged(question)
    if isinstance(plant, str):
        return [_not_compared(plant)]
    if pair.balances:
        design, real = pendulum_match.design_model(pair.controller_values), _in_angles(plant)
        gain = pendulum_match.k_lin_of(pair.controller_values)
        if real is None:
            return [_not_compared("the two angles and their rates are not its states")]
        return [] if design is None else pendulum_match.remarks_of(design, real, gain)
    fits = design_match.fits(expected, plant.seen)
    if not fits:  # and not refused, see _misfit
        unknown = "where its states belong that do not have the design's names is not known"
        silent = "nothing that is measured answers to its commands there"
        return [_not_compared(silent if fits is None else unknown), *_resting(question)]
    return [*design_match.remarks(expected, plant.seen), *_cancelled(question), *_resting(question)]


def _not_compared(reason: str) -> str:
    return f"the controller's model could not be compared with the plant's, because {reason}"


def _cancelled(question: Question) -> list[str]:
    """Return that wires turn all signs, or scale all numbers besides their units, and that this cancels; else nothing."""
    there, back = (
        [port.factor / (port.asked or 1.0) for port in ports] for ports in (question.outputs, question.inputs)
    )
    if max(there) < 0.0 and max(back) < 0.0:
        return [
            "the wires turn the signs of all measurements and of all commands: that answers as without, but the controller "
            "holds the plant at the mirrored equilibrium, and its set-points and limits are mirrored too"
        ]
    sizes = np.abs([*there, *(1.0 / factor for factor in back if factor)])
    declared = all(port.declared and port.asked and port.factor for port in (*question.outputs, *question.inputs))
    if not declared or np.ptp(np.log(sizes)) > SAME or abs(math.log(sizes[0])) <= math.log(SCALE_TOLERANCE):
        return []
    return [
        f"the wires multiply all measurements by {sizes[0]:.4g} and all commands by {1.0 / sizes[0]:.4g} besides their "
        "units: that answers as without, but the controller weighs and limits other numbers than it was designed for"
    ]


def _resting(question: Question) -> list[str]:
    """Return that a plant does not rest at the design's equilibrium as it is wired, where it does not."""
    there = found(question)
    if isinstance(there, str):
        return [f"the plant cannot be evaluated at the design's equilibrium, as it is wired: {there}"]
    if there.moving is None:
        return []
    return [f"the plant does not rest at the design's equilibrium: {there.moving} there"]


@lru_cache(maxsize=64)
def _misfit(expected: Expected, question: Question, plain: bool) -> str | None:
    plant = judged(question)
    if not isinstance(plant, Found) or design_match.fits(expected, plant.seen) is not False:
        return None
    wired = "" if plain else ", as it is wired"
    model = f"the controller was designed for another model than the plant's{wired}"
    if not plant.placed and plant.moving is not None:  # where its other states belong is not known
        said = _scaled(expected, question)
        return None if said is None else f"{model}: {said}"
    said = _explained(expected, question, plant) or _elsewhere(expected, question, plant)
    if said is not None:
        return f"{model}: {said}"
    unlike = design_match.unlike(expected, plant.seen)
    return f"the controller was designed for another system than this plant{wired}: {unlike}"


def _explained(expected: Expected, question: Question, plant: Found) -> str | None:
    """Return what would make the design fit; by differences as wide as before the wires too, should one spoil them."""
    plain = found(replace(question, places=question.unconverted))
    for there in (plant, plain):
        if not isinstance(there, Found):
            continue
        said = design_match.explained(expected, there.seen, _wires(expected, question))
        if said is not None:
            return said
    return None


def _scaled(expected: Expected, question: Question) -> str | None:
    """Return which units or factors alone would make the design fit where the plant starts, if it rests there."""
    there = found(replace(question, places=()))
    if not isinstance(there, Found) or there.moving is not None or design_match.fits(expected, there.seen) is not False:
        return None
    return design_match.explained(expected, there.seen, _wires(expected, question), only_sizes=True)


def _wires(expected: Expected, question: Question) -> dict[str, list[Wired]]:
    """Return the wires between the two by the controller's quantities."""
    wires: dict[str, list[Wired]] = {}
    for ports, quantities, measures in (
        (question.outputs, expected.system.outputs, True),
        (question.inputs, expected.system.inputs, False),
    ):
        for port in ports:
            name = quantities[port.number].name
            ends = f"{PLANT}.{port.name}", f"{CONTROLLER}.{name}"
            source, target = ends if measures else ends[::-1]
            wire = Wired(source, target, port.factor, measures, port.asked, port.declared)
            wires.setdefault(name, []).append(wire)
    return wires


def _elsewhere(expected: Expected, question: Question, plant: Found) -> str | None:
    """Return where else the design fits the plant, if it is where the plant starts."""
    there = found(replace(question, places=()))
    if not isinstance(there, Found) or not design_match.fits(expected, there.seen):
        return None
    moved = [name for name, value in plant.values.items() if not np.isclose(there.values[name], value, 1e-6, 1e-9)]
    places = [
        ", ".join(f"{name} = {values[name]:.4g}" for name in moved[:3]) for values in (there.values, plant.values)
    ]
    return f"it is linearized about another equilibrium: it fits at {places[0]}, not at {places[1]}" if moved else None


def _in_angles(found: Found | str) -> Model | None:
    """Return a plant's model in its first two outputs and their rates, as the pendulum's; None where they are no states."""
    if not isinstance(found, Found):
        return None
    seen = found.seen
    if len(seen.A) != len(STATES) or not {0, 1} <= set(seen.rows) or seen.columns != (0,):
        return None
    angles = [seen.rows.index(0), seen.rows.index(1)]
    C, D, b = seen.C[angles], seen.D[angles], seen.B[:, 0]
    T = np.vstack((C, C @ seen.A))
    direct = np.abs(D).max() + np.abs(C @ b).max() > 1e-6 * np.abs(T @ b).max()
    if direct or not np.linalg.cond(T) < 1e9:
        return None
    return Model(T @ np.linalg.solve(T.T, seen.A.T).T, T @ b)


@dataclass(frozen=True)
class _Pair:
    """Controller and plant of a system, and all their start values."""

    wires: Sequence[Wire]
    controller: Component
    plant: Component
    controller_values: Mapping[str, Any]
    plant_values: Mapping[str, Any]

    @classmethod
    def of(cls, system: SystemStructure) -> _Pair | None:
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
        return Question(
            path=self.plant.path,
            content=str(unpacked(self.plant.path).folder),
            start=tuple(sorted(self.plant.start.items())),
            outputs=outputs,
            inputs=inputs,
            places=tuple(self._places(expected, outputs, inputs).items()),
            unconverted=tuple(self._places(expected, *map(_unconverted, (outputs, inputs))).items()),
            span=_span(system),
        )

    def _ports(self, source: str, target: str, names: Sequence[str]) -> tuple[ComparedWire, ...]:
        """Return the wires from one to the other whose variable of the controller is one of `names`."""
        found = []
        for wire in self.wires:
            ends = {part: name for part, _, name in (wire.source.partition("."), wire.target.partition("."))}
            if (
                ends.keys() == {PLANT, CONTROLLER}
                and wire.source.startswith(f"{source}.")
                and ends[CONTROLLER] in names
            ):
                units = [self._unit(source, ends[source]), self._unit(target, ends[target])]
                found.append(
                    ComparedWire(
                        ends[PLANT],
                        names.index(ends[CONTROLLER]),
                        wire.factor,
                        wire.offset,
                        asked=self._asked(source, target, units),
                        declared=None not in units,
                    )
                )
        return tuple(found)

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
        units: dict[str, tuple[float, float] | None] = {}
        for quantity in expected.system.states:
            own = self._unit(PLANT, quantity.name + TRUE) or self._unit(PLANT, quantity.name)
            units[quantity.name] = (1.0, 0.0)
            if own is not None and quantity.unit not in (NO_UNIT, own):
                a = known_scale(self._description(CONTROLLER), quantity.unit)
                b = known_scale(self._description(PLANT), own)
                units[quantity.name] = None if a is None or b is None else conversion(a, b)
        return _places(expected, units, outputs, inputs)


def _unconverted(ports: Sequence[ComparedWire]) -> tuple[ComparedWire, ...]:
    return tuple(replace(port, factor=1.0, offset=0.0) for port in ports)


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
    found = {}
    for q, value, *sizes in zip(system.states, np.asarray(system.x_eq), expected.extent, least, strict=True):
        unit = units[q.name]
        if unit is not None:
            factor, offset = unit
            found[q.name] = Place(float(factor * value + offset), *(abs(factor) * float(size) for size in sizes))
    for port in outputs:
        if port.factor and (port.name not in found or port.factor != 1.0 or port.offset):
            i, size = port.number, abs(port.factor)
            value = (float(np.asarray(system.y_eq)[i]) - port.offset) / port.factor
            extent = float(np.abs(C[i]) @ expected.extent)
            found[port.name] = Place(value, extent / size, COUNTS * float(resolutions[i]) / size)
    for port in inputs:
        value = port.factor * float(np.asarray(system.u_eq)[port.number]) + port.offset
        found[port.name] = Place(value, abs(port.factor) * float(expected.u_size[port.number]))
    return found
