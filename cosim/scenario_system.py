"""The system that a scenario means: its FMUs found, wired, driven and started, and what its runs are judged by."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_export.files import FilePath
from ihc_fmu.sampled_unit import check_step

from . import certified, pendulum, wiring
from .animation import check_signals
from .errors import UserError
from .evaluation import ARM_SET_POINT, EvaluateSection, Evaluation, evaluation_of, pendulum_evaluation
from .fmu_files import describe, start_values_of
from .inputs import function_of, planned
from .offsets import OFFSETS, offsets, random_measurement
from .pendulum import WIRES
from .scenario import Scenario
from .scenario_files import beside_or_here, check_fmus_exist, files
from .start_values import StartValue, StartValues
from .structure import Component, Signal, SystemStructure, Wire
from .unit_definitions import check_units
from .wiring import CONTROLLER, PLANT, Variables

if TYPE_CHECKING:
    from ihc_fmu.design import Design


def build_system(
    scenario: Scenario, fmus: FilePath, folder: FilePath | None = None, controller: FilePath | None = None
) -> SystemStructure:
    """Return the system that `scenario` means, with the FMUs of the folder `fmus`, or beside the scenario in `folder`.

    `controller` is the file of a controller FMU that the user named, in the place of the scenario's. What the scenario
    does not say is as it was exported. Raises UserError for files that do not exist or say what cannot
    be, designs that fail their certificate, a controller that was designed for another model than the plant's, and a
    sample time of one of our controllers that does not fit the run's step.
    """
    system = Plan(scenario, fmus, folder, controller).system()
    _check_sample_time(system, scenario.run.step)
    return system


def evaluation(scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> Evaluation | None:
    """Return what the scenario's runs are judged by; None where that is the pendulum's.

    Raises UserError for signals that the FMUs do not have.
    """
    return Plan(scenario, fmus, folder).evaluation()


def system_and_evaluation(
    scenario: Scenario, fmus: FilePath, folder: FilePath | None = None
) -> tuple[SystemStructure, Evaluation | None]:
    """Return the system that `scenario` means and what its runs are judged by, read once; raises as each alone."""
    plan = Plan(scenario, fmus, folder)
    judged = plan.evaluation()
    return plan.system(), judged


class Plan:
    """A scenario with its files found and its FMUs' variables read; raises as `build_system`."""

    def __init__(
        self, scenario: Scenario, fmus: FilePath, folder: FilePath | None = None, controller: FilePath | None = None
    ) -> None:
        self.scenario, self.folder = scenario, folder
        self.files = files(scenario, fmus, folder)
        self.paths = dict(self.files.fmus)
        if controller is not None:
            self.paths[CONTROLLER] = Path(controller)
        if not self.paths:
            raise UserError("a scenario needs at least one component")
        check_fmus_exist(self.paths)
        self.own = {name: start_values_of(path) for name, path in self.paths.items()}
        self.swings = PLANT in self.own and pendulum.is_plant(self.own[PLANT])
        self.balances = CONTROLLER in self.own and pendulum.is_controller(self.own[CONTROLLER])
        self._refuse_what_is_the_pendulums()

    @cached_property
    def variables(self) -> dict[str, Variables]:
        """The FMUs' variables by component and name."""
        return {name: {v.name: v for v in describe(path).modelVariables} for name, path in self.paths.items()}

    @property
    def measurement(self) -> str:
        """What the pendulum's controller gets."""
        return self.scenario.plant.measurement or "encoders"

    def _refuse_what_is_the_pendulums(self) -> None:
        """Raise UserError for entries that mean nothing to the FMUs that there are."""
        plant, controller = self.scenario.plant, self.scenario.controller
        for entry, value, ours, unit in (
            ("plant.parameters", plant.parameters, self.swings, "QubeServo2"),
            ("plant.measurement", plant.measurement, self.swings, "QubeServo2"),
            ("controller.design", controller.design, self.balances, "IhcController"),
        ):
            if value is not None and not ours:
                fmu = self.scenario.parts.get(entry.partition(".")[0])
                there = "there is none" if fmu is None else f"{fmu.fmu} is another FMU"
                raise UserError(
                    f"{entry} is for the FMU {unit}, and {there}; its values go under start, found {value!r}"
                )
        if plant.measurement is not None and self.scenario.wires is not None:
            raise UserError(
                "plant.measurement says how the pendulum is wired, and the wires are listed: give one of both"
            )
        seed, own = self.scenario.run.seed, {**self.own.get(PLANT, {}), **plant.start}
        if seed is not None and not offsets(own) and "noise_seed" not in own:
            raise UserError(
                f"run.seed draws the plant's offsets (*{OFFSETS[0]}, *{OFFSETS[1]}) and seeds its noise (noise_seed), which "
                f"this plant has not, found {seed}"
            )

    def system(self) -> SystemStructure:
        """Return the system."""
        wires = self.wires()
        started = {
            name: self.start(name, self.scenario.parts[name].start, self.scenario.run.seed) for name in self.paths
        }
        signals = self.signals()
        check_signals(self.scenario.animation, self._signals_recorded(signals))
        if CONTROLLER in self.paths and wires not in WIRES.values():
            self._check_fed(wires, signals, started[CONTROLLER])
        names = self._sequence(wires)
        parts = self.scenario.parts
        components = tuple(Component(n, self.paths[n], started[n], parts[n].interface) for n in names)
        system = SystemStructure(components=components, wires=wires, signals=signals)
        if not self.scenario.controller.other_model:
            _check_model(system)
        return system

    def _signals_recorded(self, signals: Sequence[Signal]) -> Sequence[str]:
        """Return the names of all signals that the run records."""
        if self.scenario.record.outputs is not None:
            return self.scenario.record.outputs
        given = [f"{name}.{output}" for name, known in self.variables.items() for output in wiring.outputs(known)]
        return [*given, *(signal.target for signal in signals if signal.recorded)]

    def wires(self) -> tuple[Wire, ...]:
        """Return the wires."""
        if self.scenario.wires is not None:
            listed = tuple(section.wire() for section in self.scenario.wires)
            wiring.check_ends(listed, self.variables)
            return listed
        if not {CONTROLLER, PLANT} <= self.paths.keys():
            return ()
        if self.swings and self.balances:
            return WIRES[self.measurement]
        given = wiring.outputs(self.variables[PLANT])
        measured = pendulum.measured(given, self.measurement) if self.swings else {name: name for name in given}
        return tuple(wiring.by_names(self.variables[CONTROLLER], self.variables[PLANT], measured))

    def signals(self) -> list[Signal]:
        """Return what acts on inputs from outside."""
        signals = []
        disturbance = self.scenario.disturbance
        if disturbance.sines and disturbance.gain:
            target = f"{PLANT}.{disturbance.input or self._disturbed()}"
            signals.append(planned(target, disturbance, self._variable(target)))
        for section in self.scenario.signals:
            function = function_of(section, self.files.tables)
            signals.append(planned(section.input, function, self._variable(section.input), recorded=True))
        return signals

    def _disturbed(self) -> str:
        """Return the input that a disturbance acts on where the scenario does not say."""
        inputs = wiring.inputs(self.variables[PLANT]) if PLANT in self.paths else []
        if self.swings:
            return "disturbance_voltage"
        disturbances = [name for name in inputs if name.endswith("_disturbance")]
        if len(disturbances) != 1:
            raise UserError(
                f"disturbance.input must say which input of the plant, one of {', '.join(disturbances or inputs)}"
            )
        return disturbances[0]

    def _variable(self, name: str) -> Any:
        component, _, variable = name.partition(".")
        return self.variables.get(component, {}).get(variable)

    def start(self, name: str, own_start: StartValues, seed: int | None) -> dict[str, StartValue]:
        """Return the start values of a component: `own_start`, as a scenario says them, and what follows from it.

        `seed` draws what is left to chance of the plant; None: nothing.
        """
        if name == CONTROLLER and self.balances:
            ideal = self.measurement if self.swings and self.scenario.wires is None else ""
            step = self.scenario.run.step
            return pendulum.controller_start(self.own[name], own_start, step, self.files.design, ideal)
        if name == PLANT:
            drawn = {} if seed is None else random_measurement({**self.own[name], **own_start}, seed)
            return {**self._parameters, **drawn, **own_start}
        return dict(own_start)

    @cached_property
    def _parameters(self) -> dict[str, StartValue]:
        """The start values of the plant's parameter set."""
        return pendulum.plant_start(self.scenario.plant.parameters, self.folder)

    def _check_fed(self, wires: Sequence[Wire], signals: Sequence[Signal], start: Mapping[str, StartValue]) -> None:
        targets = [*(w.target for w in wires), *(s.target for s in signals)]
        fed = {target.removeprefix(f"{CONTROLLER}.") for target in targets} | start.keys()
        if self.balances:
            fed |= {*pendulum.RATES}  # read only where velocity_source says so
        wiring.check_fed(self.variables[CONTROLLER], fed, listed=self.scenario.wires is not None)

    def _sequence(self, wires: Sequence[Wire]) -> Sequence[str]:
        listed, names = self.scenario.run.sequence, list(self.paths)
        if listed is None:
            return wiring.sequence(names, wires)
        if sorted(listed) != sorted(names):
            raise UserError(
                f"run.sequence must name each component once: {', '.join(names)}, found {', '.join(listed)}"
            )
        return listed

    def evaluation(self) -> Evaluation | None:
        """Return what the runs are judged by; None where that is the pendulum's."""
        section = self.scenario.evaluate
        usual = set(self.wires()) in (set(wires) for wires in WIRES.values())
        if self.swings and self.balances and usual and section == EvaluateSection():  # type: ignore[call-arg]
            arm = self._arm_set_point()
            return None if arm == 0.0 else pendulum_evaluation(self._recorded(), arm)
        angles = [f"{PLANT}.{name}" for name in pendulum.ANGLES] if self.swings else []
        start = {name: {**own, **self.scenario.parts[name].start} for name, own in self.own.items()}
        return evaluation_of(section, self.variables, start, self.wires(), self.signals(), angles)

    def _arm_set_point(self) -> str | float:
        """Return where the pendulum's arm is to be held: the input's name where that has a signal, or a number [rad]."""
        name = f"{CONTROLLER}.{ARM_SET_POINT}"
        if any(signal.target == name for signal in self.signals()):
            return name
        return float({**self.own[CONTROLLER], **self.scenario.controller.start}.get(ARM_SET_POINT, 0.0))

    def _recorded(self) -> Sequence[str]:
        """Return the plant's outputs that are recorded."""
        if self.scenario.record.outputs is not None:
            return self.scenario.record.outputs
        return [f"{PLANT}.{name}" for name in wiring.outputs(self.variables[PLANT])]


def plant_values(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> Mapping[str, StartValue]:
    """Return all start values of the plant: the FMU's own and the scenario's; none where there is no plant."""
    path = files(scenario, fmus, folder).fmus.get(PLANT)
    return {} if path is None else {**start_values_of(path), **scenario.plant.start}


def controller_values(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> Mapping[str, StartValue]:
    """Return the start values of the controller FMU's own; none where there is no controller."""
    path = files(scenario, fmus, folder).fmus.get(CONTROLLER)
    return {} if path is None else start_values_of(path)


def controller_design(
    system: SystemStructure, scenario: Scenario, folder: FilePath | None = None
) -> tuple[Design | None, list[str]]:
    """Return the design of a scenario's controller, and what its certificate does not cover, as `certified.design_of`."""
    for component in system.components:
        if component.name == CONTROLLER:
            file = scenario.controller.design
            return certified.design_of(component, None if file is None else beside_or_here(file, folder))
    return None, []


def _check_model(system: SystemStructure) -> None:
    """Raise UserError where the controller was designed for another model than the plant's, see `model_match`.

    Before that where a wire joins other units.
    """
    from .model_match import misfit  # noqa: PLC0415 - heavy

    descriptions = {component.name: describe(component.path) for component in system.components}
    for wire in system.wires:
        check_units(wire, descriptions)
    problem = misfit(system)
    if problem is not None:
        raise UserError(f"{problem}; controller.other_model = true runs it all the same")


def _check_sample_time(system: SystemStructure, step: float) -> None:
    """Raise UserError where one of our controllers cannot sample in communication steps of `step` [s]."""
    for component in system.components:
        if component.name == CONTROLLER:
            own = start_values_of(component.path)
            time = component.start.get("sample_time", own.get("sample_time"))
            if certified.certified_names(own) and isinstance(time, int | float) and 0.0 < time < math.inf:
                try:
                    check_step(time, step)
                except UserError as error:
                    raise UserError(f"run.step does not fit the controller: {error}") from None
