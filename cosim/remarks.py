"""What is to be known of a run, a sentence each: before it, of its system, and after it, of its result."""

from __future__ import annotations

from pathlib import Path

from . import certified, model_match, pendulum
from .evaluation import TRUE
from .fmu_files import describe, start_values_of
from .integration import opened
from .judged_signals import at_rest, overflow
from .plant_variables import START
from .results import Result
from .scenario import Scenario
from .structure import SystemStructure
from .wiring import CONTROLLER, PLANT

LOWER = "_lower"
"""How the names of parameters end that bound a controller's commands."""


def remarks_before(system: SystemStructure, scenario: Scenario) -> list[str]:
    """Return what is to be known of a scenario's system before it runs.

    Of its controller on its plant, although they fit, see `model_match`, unless it may be of another model; of controls
    that act on nothing; of start values that no certificate covers. Raises UserError for start values that a run would
    refuse: with them nothing is to be known.
    """
    for component in system.components:
        opened(component.name, Path(component.path), component.interface).checked_start(component.start)
    said = [] if scenario.controller.other_model else model_match.remarks(system)
    said = [*said, *_loose_controls(system)]
    for component in system.components:
        if component.name == CONTROLLER:
            said += certified.remarks(start_values_of(component.path), scenario.controller.start)
    return said


def remarks_after(result: Result, system: SystemStructure) -> list[str]:
    """Return what is to be known of a run of `system`: that nothing moved, that its numbers overflow."""
    return [*rest_remarks(result, system), *overflow(result)]


def _loose_controls(system: SystemStructure) -> list[str]:
    """Return a sentence for each control of one of our controllers that is wired to nothing, though there is a plant."""
    there = {component.name: component.path for component in system.components}
    if not {CONTROLLER, PLANT} <= there.keys():
        return []
    own, wired = start_values_of(there[CONTROLLER]), {wire.source for wire in system.wires}
    controls = [
        v.name
        for v in describe(there[CONTROLLER]).modelVariables
        if v.causality == "output"
        and (f"{v.name}{LOWER}" in own or (pendulum.is_controller(own) and v.name == "voltage"))
    ]
    loose = [f"{CONTROLLER}.{name}" for name in controls if f"{CONTROLLER}.{name}" not in wired]
    return [f"the control {name} acts on nothing: no wire leads from it" for name in loose]


def rest_remarks(result: Result, system: SystemStructure) -> list[str]:
    """Return in a sentence that nothing moved in a run of `system`, and how something would; nothing where it did.

    Nothing moves where no judged signal changes and none is beside its set-point, but for rounding.
    """
    if not at_rest(result):
        return []
    plants = [component for component in system.components if component.name == PLANT]
    outputs = {name.partition(".")[2] for name in result.signals}
    starts = [
        f"{PLANT}.start.{name}"
        for plant in plants
        for name in start_values_of(plant.path)
        if name.endswith(START) and {name.removesuffix(START), name.removesuffix(START) + TRUE} & outputs
    ]
    example = f", as with --set {starts[0]}=..." if starts else ""
    return [
        f"nothing moved: all was at rest where it began; change a start value{example}, or add a signal or a disturbance"
    ]
