"""A plant's FMU as its controller sees it: coarsely linearized where the controller is to hold it, behind its wires.

This is for a question that each run asks, so it takes one pair of differences for each state and input and is given up
after LONGEST. What comes of it is a model to compare with, not to design with: `linearize` is for that.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from fmu_export.errors import UserError
from fmu_export.units import per_second

from .derivatives import FIRST, EvaluationError
from .design_match import Seen
from .fmu import FmuError
from .fmu_files import describe, start_values_of
from .interrupts import deferred_interrupt
from .linear_plants import CoarseModel, Plant
from .linearize import open_plant
from .plant_variables import START, HiddenStatesError, unit_of
from .start_values import StartValue
from .wire_factors import ComparedWire

Array = np.ndarray

LONGEST = 2.0
"""What the question may take [s]."""
PART = 0.1
"""How far from the equilibrium differences go, as a part of how far the state or the input is to go."""
COUNTS = 20.0
"""How many counts of a sensor they go at least."""
TRUE, RESOLUTION = "_true", "_resolution"
"""How names in linear plants end: a state that an output has the name of, and a parameter, the step of a sensor; 0: none."""


@dataclass(frozen=True)
class Place:
    """Where a variable of the plant is, how far it goes from there, and how far at least for sensors to tell."""

    value: float
    extent: float
    least: float = 0.0


@dataclass(frozen=True)
class Question:
    """What is asked of a plant. `places`: of states and inputs by name; states without one stay at their start values.

    `unconverted`: these as if the wires changed no number, should one of them be mistaken.
    `content`: what tells this file from a later one of the same path. `start`: start values of the plant. `span` [s]: in
    which the controller's model changes by a small part.
    """

    path: Path
    content: str
    start: tuple[tuple[str, StartValue], ...]
    outputs: tuple[ComparedWire, ...]
    inputs: tuple[ComparedWire, ...]
    places: tuple[tuple[str, Place], ...]
    unconverted: tuple[tuple[str, Place], ...]
    span: float


@dataclass(frozen=True, eq=False)
class WiredPlant:
    """The plant as it is seen, and where: the values of its states and inputs.

    `moving`: what does not rest there, in words, None where all does. `placed`: whether all states had their places.
    """

    seen: Seen
    values: Mapping[str, float]
    moving: str | None
    placed: bool


def judged(question: Question) -> WiredPlant | str:
    """Return the plant where its controller is to hold it, else why it cannot be evaluated.

    A wire's mistaken factor moves the equilibrium besides. Where the plant does not rest at the one behind the wires, but at
    the same numbers before them, the latter is taken; so where it cannot be evaluated at the former.
    """
    wired = plant_at(question)
    if question.places == question.unconverted or (isinstance(wired, WiredPlant) and wired.moving is None):
        return wired
    plain = plant_at(replace(question, places=question.unconverted))
    if not isinstance(plain, WiredPlant):
        return wired
    return plain if not isinstance(wired, WiredPlant) or (plain.moving is None and _apart(plain, wired)) else wired


def _apart(a: WiredPlant, b: WiredPlant) -> bool:
    return not all(np.isclose(a.values[name], value, 1e-6, 1e-9) for name, value in b.values.items())


@lru_cache(maxsize=64)  # a study's runs have few plants
def plant_at(question: Question) -> WiredPlant | str:
    """Return the plant at the question's places, else why it cannot be evaluated there."""
    try:
        plant = open_plant(
            question.path,
            tuple(port.name for port in question.inputs),
            tuple(dict.fromkeys(port.name for port in question.outputs)),
            (),
            dict(question.start) | _exact(question.path),
            None,
        )
    except HiddenStatesError:
        return f"{question.path.name} is for co-simulation only and does not show its states"
    except (UserError, FmuError, EvaluationError) as error:
        return str(error)
    try:
        with closing(plant), deferred_interrupt() as plant.interrupt, np.errstate(all="ignore"):
            plant.deadline = time.monotonic() + LONGEST
            return _plant_at(plant, question)
    except (UserError, FmuError, EvaluationError, np.linalg.LinAlgError) as error:
        return str(error)


def _exact(path: Path) -> dict[str, StartValue]:
    """Return the start values that let a linear plant's sensors measure exactly."""
    outputs = {v.name for v in describe(path).modelVariables if v.causality == "output"}
    own = start_values_of(path)
    return {name: 0.0 for name in own if name.endswith(RESOLUTION) and name.removesuffix(RESOLUTION) in outputs}


def _plant_at(plant: Plant, question: Question) -> WiredPlant | str:
    places = dict(question.places)
    states = [places.get(v.name, places.get(v.name.removesuffix(TRUE))) for v in plant.states]
    own = {name.removesuffix(TRUE) for name in plant.names[: plant.n]}
    if places:  # not where the run begins, but where the controller is to hold it
        plant.start = {name: value for name, value in plant.start.items() if name.removesuffix(START) not in own}
    z = plant.begin()
    wanted = [*states, *(places.get(v.name) for v in plant.inputs)]
    z = np.array([value if place is None else place.value for value, place in zip(z, wanted, strict=True)])
    widths = np.array([_width(size, place) for size, place in zip(plant.sizes(z), wanted, strict=True)])
    model = plant.coarse(z, widths, question.span)
    plant.look()
    if not all(np.isfinite(M).all() for M in (model.A, model.B, model.C, model.D, model.rates)):
        return "its derivatives are not finite"
    seen = _seen(plant, model, question)
    if seen is None:
        return "its sensors count too coarsely for differences"
    values = dict(zip(plant.names, z.tolist(), strict=True))
    return WiredPlant(seen, values, _moving(plant, model, widths), None not in states)


def _width(size: float, place: Place | None) -> float:
    if place is None:
        return FIRST * size
    return max(min(FIRST * size, PART * place.extent), min(place.least, place.extent))


def _seen(plant: Plant, model: CoarseModel, question: Question) -> Seen | None:
    """Return the matrices between the controller's numbers, without outputs that are not smooth; None where none is."""
    names = [v.name for v in plant.outputs]
    told = [port for port in question.outputs if model.smooth[names.index(port.name)] and port.factor]
    ports = sorted(told, key=lambda port: port.number)
    if not ports:
        return None
    rows, factors = [names.index(port.name) for port in ports], np.array([port.factor for port in ports])
    columns = sorted({port.number for port in question.inputs})
    onto = np.zeros((plant.m, len(columns)))
    for j, port in enumerate(question.inputs):
        onto[j, columns.index(port.number)] = port.factor
    C, D = model.C[rows] * factors[:, None], model.D[rows] * factors[:, None] @ onto
    return Seen(model.A, model.B @ onto, C, D, tuple(port.number for port in ports), tuple(columns))


def _moving(plant: Plant, model: CoarseModel, widths: Array) -> str | None:
    """Return which state moves most where it should be at rest, against what differences of this width do to it."""
    allowed = np.abs(np.hstack((model.A, model.B))) @ widths
    fast = np.abs(model.rates) > allowed + 1e-9 * widths[: plant.n]
    if not fast.any():
        return None
    i = int(np.argmax(np.where(fast, np.abs(model.rates) / np.maximum(allowed, 1e-300), 0.0)))
    return f"{plant.names[i]}' is {model.rates[i]:.3g} {per_second(unit_of(plant.states[i]))}"
