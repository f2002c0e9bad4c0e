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
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ihc_fmu.pendulum.interface import STATES

from . import design_match, pendulum, pendulum_match
from .compared_pair import ComparedPair
from .design_match import SAME, Expected
from .pendulum_match import Model
from .plant_as_wired import Question, WiredPlant, judged, plant_at
from .structure import SystemStructure
from .unit_slips import SCALE_TOLERANCE
from .wire_factors import ComparedWire

Array = np.ndarray


def misfit(system: SystemStructure) -> str | None:
    """Return how the model that a system's controller was designed for differs from its plant's; None where it fits.

    None too where there are not both, or one of them does not say.
    """
    pair = ComparedPair.of(system)
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
    pair = ComparedPair.of(system)
    if pair is None:
        return []
    if pair.balances and pendulum.is_plant(pair.plant_values):
        return pendulum_match.remarks(pair.controller_values, pair.plant_values)
    return [pair.expected] if isinstance(pair.expected, str) else _remarks(pair, pair.expected)


def _remarks(pair: ComparedPair, expected: Expected | None) -> list[str]:
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
    there = plant_at(question)
    if isinstance(there, str):
        return [f"the plant cannot be evaluated at the design's equilibrium, as it is wired: {there}"]
    if there.moving is None:
        return []
    return [f"the plant does not rest at the design's equilibrium: {there.moving} there"]


@lru_cache(maxsize=64)
def _misfit(expected: Expected, question: Question, plain: bool) -> str | None:
    plant = judged(question)
    if not isinstance(plant, WiredPlant) or design_match.fits(expected, plant.seen) is not False:
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


def _explained(expected: Expected, question: Question, plant: WiredPlant) -> str | None:
    """Return what would make the design fit; by differences as wide as before the wires too, should one spoil them."""
    plain = plant_at(replace(question, places=question.unconverted))
    for there in (plant, plain):
        if not isinstance(there, WiredPlant):
            continue
        said = design_match.explained(expected, there.seen, _wires(expected, question))
        if said is not None:
            return said
    return None


def _scaled(expected: Expected, question: Question) -> str | None:
    """Return which units or factors alone would make the design fit where the plant starts, if it rests there."""
    there = plant_at(replace(question, places=()))
    if (
        not isinstance(there, WiredPlant)
        or there.moving is not None
        or design_match.fits(expected, there.seen) is not False
    ):
        return None
    return design_match.explained(expected, there.seen, _wires(expected, question), only_sizes=True)


def _wires(expected: Expected, question: Question) -> dict[str, list[ComparedWire]]:
    """Return the wires between the two by the controller's quantities."""
    wires: dict[str, list[ComparedWire]] = {}
    for some, quantities in (
        (question.outputs, expected.system.outputs),
        (question.inputs, expected.system.inputs),
    ):
        for wire in some:
            wires.setdefault(quantities[wire.number].name, []).append(wire)
    return wires


def _elsewhere(expected: Expected, question: Question, plant: WiredPlant) -> str | None:
    """Return where else the design fits the plant, if it is where the plant starts."""
    there = plant_at(replace(question, places=()))
    if not isinstance(there, WiredPlant) or not design_match.fits(expected, there.seen):
        return None
    moved = [name for name, value in plant.values.items() if not np.isclose(there.values[name], value, 1e-6, 1e-9)]
    places = [
        ", ".join(f"{name} = {values[name]:.4g}" for name in moved[:3]) for values in (there.values, plant.values)
    ]
    return f"it is linearized about another equilibrium: it fits at {places[0]}, not at {places[1]}" if moved else None


def _in_angles(plant: WiredPlant | str) -> Model | None:
    """Return a plant's model in its first two outputs and their rates, as the pendulum's; None where they are no states."""
    if not isinstance(plant, WiredPlant):
        return None
    seen = plant.seen
    if len(seen.A) != len(STATES) or not {0, 1} <= set(seen.rows) or seen.columns != (0,):
        return None
    angles = [seen.rows.index(0), seen.rows.index(1)]
    C, D, b = seen.C[angles], seen.D[angles], seen.B[:, 0]
    T = np.vstack((C, C @ seen.A))
    direct = np.abs(D).max() + np.abs(C @ b).max() > 1e-6 * np.abs(T @ b).max()
    if direct or not np.linalg.cond(T) < 1e9:
        return None
    return Model(T @ np.linalg.solve(T.T, seen.A.T).T, T @ b)
