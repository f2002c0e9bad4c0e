"""Scenarios: one run's description, read from TOML with typed and checked contents, and the system that it means.

The same entries describe every system: components that are FMUs, wires, signals on inputs, what is judged and recorded.
"""

from __future__ import annotations

import filecmp
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from filing.origin import WRITTEN
from fmu_export.files import FilePath, is_file, is_folder
from fmu_export.reading import read_toml
from fmu_export.variables import did_you_mean
from ihc_fmu.sampled_unit import check_step
from plant_fmu.parameters import PARAMETER_SETS

from . import certified, parameter_files, pendulum, ssp, wiring
from .animation import BodySection, check_bodies, check_signals
from .errors import UserError
from .evaluation import ARM_SET_POINT, TRUE, EvaluateSection, Evaluation, evaluation_of, pendulum_evaluation
from .inputs import CsvSignal, DisturbanceSection, SignalSection, function_of, planned
from .integration import Interface
from .master import Engine, Order, step_count
from .names import PlainName
from .pendulum import WIRES
from .pendulum_files import PENDULUM_FMUS
from .plant_variables import START
from .results import Result
from .start_values import StartValue
from .structure import Component, Signal, SystemStructure, Wire
from .typed import Positive, checked
from .wiring import CONTROLLER, PLANT, Variables, WireSection

if TYPE_CHECKING:
    from ihc_fmu.design import Design

BUILT_IN = Path(__file__).parent / "scenarios"

LOWER = "_lower"
"""How the names of parameters end that bound a controller's commands."""

NONE = "none"
"""What TOML, which has no null, says for nothing."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RunSection(_Section):
    """How long and how finely."""

    step: Positive = Field(1e-3, description="communication step [s]")
    duration: Positive = Field(10.0, description="duration, a multiple of the step [s]")
    order: Order = Field(
        "controller-first", description="coupling order: controller-first (no delay) or parallel (one step)"
    )
    sequence: tuple[str, ...] | None = Field(
        None, description="components in the order of stepping; none: the controller, then along the wires"
    )
    engine: Engine = Field(
        "auto",
        description="loop: native (C) or fmpy (Python), to the same result; auto: native unless an FMU is Python or for "
        "model exchange",
    )
    seed: int | None = Field(
        None,
        ge=0,
        lt=2**31,
        strict=True,
        description="draws the encoders' sub-count offsets and seeds the noise; none: the plant FMU's start values",
    )


_FMU = "name of a file in the folder given to the command or beside the scenario; no path; none: there is no such component"


_INTERFACE = (
    "CoSimulation: by the FMU's own steps; ModelExchange: integrated by SciPy; none: CoSimulation where the FMU has it"
)


class PlantSection(_Section):
    """The plant FMU."""

    fmu: PlainName = Field(PENDULUM_FMUS[0], description=_FMU)
    interface: Interface | None = Field(None, description=_INTERFACE)
    parameters: str | None = Field(
        None,
        description="of the pendulum; none: the FMU's own start values; or a set that replaces them, by name: "
        f"{', '.join(PARAMETER_SETS)}; or of a file *.toml, beside the scenario or in the current folder",
    )
    measurement: Literal["encoders", "ideal"] | None = Field(
        None,
        description="of the pendulum; encoders, or none: counted angles; ideal: the true state, velocities included",
    )
    start: dict[str, StartValue] = Field(default_factory=dict, description="start values of the plant FMU by name")

    @field_validator("parameters")
    @classmethod
    def _own(cls, value: str | None) -> str | None:
        return None if value == NONE else value


class ControllerSection(_Section):
    """The controller FMU."""

    fmu: PlainName = Field(PENDULUM_FMUS[1], description=_FMU)
    interface: Interface | None = Field(None, description=_INTERFACE)
    design: str | None = Field(
        None, description="of the pendulum: design file beside the scenario; none: the design exported in the FMU"
    )
    other_model: bool = Field(
        False, description="true: run a controller that was designed for another model than the plant's all the same"
    )
    start: dict[str, StartValue] = Field(default_factory=dict, description="start values of the controller FMU by name")


class ComponentSection(_Section):
    """A further FMU."""

    fmu: PlainName = Field(
        description="name of a file in the folder given to the command or beside the scenario; no path"
    )
    interface: Interface | None = Field(None, description=_INTERFACE)
    start: dict[str, StartValue] = Field(default_factory=dict, description="start values of the FMU by name")


class RecordSection(_Section):
    """What is kept."""

    outputs: tuple[str, ...] | None = Field(
        None, description="outputs, and inputs with a signal, as component.variable; none: all"
    )
    every: int = Field(
        1, ge=1, strict=True, description="keep every n-th communication point, and the first and the last"
    )


class Scenario(_Section):
    """One run's description; every section and every entry has a default.

    Parameters
    ----------
    name
        The file's.
    description
        What happens, in words: the title of pictures.
    wires
        The connections; None: by equal names of plant and controller.
    run, plant, controller, components, disturbance, signals, animation, evaluate, record
        The sections of the file, see the reference of scenarios.
    """

    name: PlainName = "scenario"
    description: str = ""
    wires: tuple[WireSection, ...] | None = None
    run: RunSection = RunSection()  # type: ignore[call-arg]
    plant: PlantSection = PlantSection()  # type: ignore[call-arg]
    controller: ControllerSection = ControllerSection()  # type: ignore[call-arg]
    components: dict[str, ComponentSection] = {}
    disturbance: DisturbanceSection = DisturbanceSection()  # type: ignore[call-arg]
    signals: tuple[SignalSection, ...] = ()
    animation: tuple[BodySection, ...] = ()
    evaluate: EvaluateSection = EvaluateSection()  # type: ignore[call-arg]
    record: RecordSection = RecordSection()  # type: ignore[call-arg]

    @field_validator("animation")
    @classmethod
    def _bodies(cls, value: tuple[BodySection, ...]) -> tuple[BodySection, ...]:
        check_bodies(value)
        return value

    @field_validator("components")
    @classmethod
    def _further(cls, value: dict[str, ComponentSection]) -> dict[str, ComponentSection]:
        for name in value:
            if not (name.isascii() and name.isidentifier()) or name in (CONTROLLER, PLANT):
                raise ValueError(
                    f"must have names of letters, digits and underscores other than controller and plant, found {name!r}"
                )
        return value

    @property
    def parts(self) -> dict[str, PlantSection | ControllerSection | ComponentSection]:
        """The sections of the components that there are, by their names."""
        both = {CONTROLLER: self.controller, PLANT: self.plant}
        return {name: part for name, part in both.items() if part.fmu != NONE} | self.components

    def changed(self, changes: Mapping[str, Any]) -> Scenario:
        """Return the scenario with entries replaced.

        Parameters
        ----------
        changes
            Values by `section.entry` or `section.start.variable`; entries of lists are named by their numbers from 0 on.

        Returns
        -------
        Scenario
            Checked as one of a file.

        Raises
        ------
        UserError
            For a name that does not exist or a value outside its rule.
        """
        data = self.model_dump(mode="json")
        for path, value in changes.items():
            *parents, last = _parted(path)
            place: Any = data
            for parent in parents:
                place = _inside(place, parent, path)
            _inside(place, last, path, new=True)
            place[int(last) if isinstance(place, list) else last] = value
        return _validated(data, self.name)

    def to_toml(self) -> str:
        """Return the scenario as the text of a TOML file; `load_scenario` reads back the same but for the file's name.

        Returns
        -------
        str
            The text.
        """
        import tomli_w  # noqa: PLC0415

        return f"# {WRITTEN}\n" + tomli_w.dumps(self.model_dump(mode="json", exclude_none=True, exclude={"name"}))


def _parted(path: str) -> list[str]:
    """Return the parts of an entry's name; behind `start` stands a variable, whose name may have dots in it."""
    parts = path.split(".")
    begin = 3 if parts[0] == "components" else 2
    if len(parts) > begin and parts[begin - 1] == "start":
        return [*parts[:begin], ".".join(parts[begin:])]
    return parts


def _inside(place: Any, name: str, path: str, *, new: bool = False) -> Any:
    """Return the entry `name` of a table or list; with `new` a table need not have it yet."""
    if isinstance(place, dict):
        if name in place or new:
            return place.get(name)
        raise UserError(f"the scenario has no entry {path!r}{did_you_mean(name, place)}")
    if isinstance(place, list) and name.isdigit() and int(name) < len(place):
        return place[int(name)]
    raise UserError(f"the scenario has no entry {path!r}")


def built_in_names() -> list[str]:
    """Return the names of the scenarios that come with the project."""
    return sorted(file.stem for file in BUILT_IN.glob("*.toml"))


def load_scenario(name: FilePath) -> tuple[Scenario, Path]:
    """Load a scenario.

    Parameters
    ----------
    name
        A TOML file, an SSP file, or the name of a built-in scenario.

    Returns
    -------
    tuple[Scenario, pathlib.Path]
        The scenario and its folder; that of an SSP file is where its FMUs were unpacked.

    Raises
    ------
    UserError
        Names the file, the entry, the rule and the value.
    """
    name, path = os.fspath(name), Path(name)
    if path.suffix == ssp.SUFFIX:
        data, folder = ssp.read(path)
        return _validated({"name": path.stem, **data}, str(path)), folder
    if not path.suffix and not is_file(path):  # a folder `paper` does not hide the scenario `paper`
        if name in built_in_names():
            path = BUILT_IN / f"{name}.toml"
        elif not is_folder(path):
            raise UserError(f"no scenario file or built-in scenario {name!r}; built in: {', '.join(built_in_names())}")
    data = read_toml(path, "scenario")
    return _validated({"name": path.stem, **data}, str(path)), path.parent


def load_located(name: str, fmus: Path) -> tuple[Scenario, Path, Path]:
    """Return (scenario, its folder, the folder of its FMUs): `fmus`, unless it is an SSP file, which has its own."""
    chosen, folder = load_scenario(name)
    return chosen, folder, folder if Path(name).suffix == ssp.SUFFIX else fmus


def _validated(data: dict[str, Any], source: str) -> Scenario:
    scenario = checked(Scenario, data, source)
    try:
        step_count(scenario.run.step, scenario.run.duration)
        if scenario.plant.parameters is not None:
            parameter_files.check_name(scenario.plant.parameters, "plant.parameters")
    except UserError as error:
        raise UserError(f"{source}: {error}") from None
    return scenario


@dataclass(frozen=True)
class Files:
    """The paths of a scenario's files: FMUs by component, the controller's design, tables of signals by their names."""

    fmus: dict[str, Path]
    design: Path | None
    tables: dict[str, Path]


def files(scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> Files:
    """Return the paths of the files that a scenario names.

    An FMU is beside the scenario or in the folder `fmus`; raises UserError where both have it and they differ.
    """

    def find(file: str) -> Path:
        beside, there = Path(folder or "") / file, Path(fmus) / file
        if folder is None or not is_file(beside):
            return there
        if is_file(there) and not filecmp.cmp(beside, there, shallow=False):
            raise UserError(
                f"{beside} and {there} are different FMUs; --fmus {folder} takes the one beside the scenario, or remove one"
            )
        return beside

    design = scenario.controller.design
    tables = [section.file for section in scenario.signals if isinstance(section, CsvSignal)]
    return Files(
        {name: find(part.fmu) for name, part in scenario.parts.items()},
        None if design is None else _beside_or_here(design, folder),
        {file: _beside_or_here(file, folder) for file in tables},
    )


def check_found(fmus: Mapping[str, Path]) -> None:
    """Raise UserError for an FMU of a scenario, by its component, that is not there."""
    from .fmu_files import check_exists  # noqa: PLC0415

    for path in fmus.values():
        check_exists(path, "--fmus names the folder of the scenario's FMUs")


def _beside_or_here(file: str, folder: FilePath | None) -> Path:
    """Return the path of a file that a scenario names: beside it if it is there, else in the current folder."""
    beside = Path(folder or "") / file
    return beside if is_file(beside) else Path(file)


def build_system(
    scenario: Scenario, fmus: FilePath, folder: FilePath | None = None, controller: FilePath | None = None
) -> SystemStructure:
    """Return the system that `scenario` means, with the FMUs of the folder `fmus`, or beside the scenario in `folder`.

    `controller` is the file of a controller FMU that the user named, in the place of the scenario's. What the scenario
    does not say is as it was exported. Raises UserError for files that do not exist or say what cannot
    be, designs that fail their certificate, a controller that was designed for another model than the plant's, and a
    sample time of one of our controllers that does not fit the run's step.
    """
    system = _Plan(scenario, fmus, folder, controller).system()
    _check_sample_time(system, scenario.run.step)
    return system


def evaluation(scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> Evaluation | None:
    """Return what the scenario's runs are judged by; None where that is the pendulum's.

    Raises UserError for signals that the FMUs do not have.
    """
    return _Plan(scenario, fmus, folder).evaluation()


class _Plan:
    """A scenario with its files found and its FMUs' variables read."""

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
        check_found(self.paths)
        self.own = {name: _own_values(path) for name, path in self.paths.items()}
        self.swings = PLANT in self.own and pendulum.is_plant(self.own[PLANT])
        self.balances = CONTROLLER in self.own and pendulum.is_controller(self.own[CONTROLLER])
        self._refuse_what_is_the_pendulums()

    @cached_property
    def variables(self) -> dict[str, Variables]:
        """The FMUs' variables by component and name."""
        from .fmu_files import describe  # noqa: PLC0415

        return {name: {v.name: v for v in describe(path).modelVariables} for name, path in self.paths.items()}

    @property
    def measurement(self) -> str:
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
                found = "there is none" if fmu is None else f"{fmu.fmu} is another FMU"
                raise UserError(
                    f"{entry} is for the FMU {unit}, and {found}; its values go under start, found {value!r}"
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
        wires = self.wires()
        started = {name: self._start(name) for name in self.paths}
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
        found = []
        disturbance = self.scenario.disturbance
        if disturbance.sines and disturbance.gain:
            target = f"{PLANT}.{disturbance.input or self._disturbed()}"
            found.append(planned(target, disturbance, self._variable(target)))
        for section in self.scenario.signals:
            function = function_of(section, self.files.tables)
            found.append(planned(section.input, function, self._variable(section.input), recorded=True))
        return found

    def _disturbed(self) -> str:
        """Return the input that a disturbance acts on where the scenario does not say."""
        inputs = wiring.inputs(self.variables[PLANT]) if PLANT in self.paths else []
        if self.swings:
            return "disturbance_voltage"
        found = [name for name in inputs if name.endswith("_disturbance")]
        if len(found) != 1:
            raise UserError(f"disturbance.input must say which input of the plant, one of {', '.join(found or inputs)}")
        return found[0]

    def _variable(self, name: str) -> Any:
        component, _, variable = name.partition(".")
        return self.variables.get(component, {}).get(variable)

    def _start(self, name: str) -> dict[str, StartValue]:
        chosen = self.scenario.parts[name].start
        if name == CONTROLLER and self.balances:
            ideal = self.measurement if self.swings and self.scenario.wires is None else ""
            step = self.scenario.run.step
            return pendulum.controller_start(self.own[name], chosen, step, self.files.design, ideal)
        if name == PLANT:
            seed = self.scenario.run.seed
            drawn = {} if seed is None else random_measurement({**self.own[name], **chosen}, seed)
            return pendulum.plant_start(self.scenario.plant.parameters, self.folder) | drawn | chosen
        return dict(chosen)

    def _check_fed(self, wires: Sequence[Wire], signals: Sequence[Signal], start: Mapping[str, StartValue]) -> None:
        targets = [*(w.target for w in wires), *(s.target for s in signals)]
        fed = {target.removeprefix(f"{CONTROLLER}.") for target in targets} | start.keys()
        if self.balances:
            fed |= {*pendulum.RATES}  # read only where velocity_source says so
        wiring.check_fed(self.variables[CONTROLLER], fed, listed=self.scenario.wires is not None)

    def _sequence(self, wires: Sequence[Wire]) -> Sequence[str]:
        chosen, names = self.scenario.run.sequence, list(self.paths)
        if chosen is None:
            return wiring.sequence(names, wires)
        if sorted(chosen) != sorted(names):
            raise UserError(
                f"run.sequence must name each component once: {', '.join(names)}, found {', '.join(chosen)}"
            )
        return chosen

    def evaluation(self) -> Evaluation | None:
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


OFFSETS = ("_encoder_offset", "_resolution_offset")
"""How the names of parameters end that say where inside a count a sensor was zeroed, in counts.

A sensor `y` whose parameter `y_resolution` is 0 does not count, so that its offset means nothing.
"""


def random_measurement(own: Mapping[str, StartValue], seed: int) -> dict[str, StartValue]:
    """Return encoder offsets drawn uniformly inside a count, and the noise's seed, for a seed of the run.

    `own` are all start values of the plant; nothing is drawn of one that has neither.
    """
    import numpy as np  # noqa: PLC0415

    names = offsets(own)
    values = np.random.default_rng(seed).random(len(names))
    found: dict[str, StartValue] = {name: float(value) for name, value in zip(names, values, strict=True)}
    return found | ({"noise_seed": seed} if "noise_seed" in own else {})


def offsets(own: Mapping[str, StartValue]) -> list[str]:
    """Return the names of the offsets of a plant's sensors that count, in the order of its variables."""
    return [name for name in own if name.endswith(OFFSETS) and own.get(name.removesuffix("_offset")) != 0.0]


def plant_values(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> Mapping[str, StartValue]:
    """Return all start values of the plant: the FMU's own and the scenario's; none where there is no plant."""
    path = files(scenario, fmus, folder).fmus.get(PLANT)
    return {} if path is None else {**_own_values(path), **scenario.plant.start}


def controller_values(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> Mapping[str, StartValue]:
    """Return the start values of the controller FMU's own; none where there is no controller."""
    path = files(scenario, fmus, folder).fmus.get(CONTROLLER)
    return {} if path is None else _own_values(path)


def _check_model(system: SystemStructure) -> None:
    """Raise UserError where the controller was designed for another model than the plant's, see `model_match`.

    Before that where a wire joins other units.
    """
    from .fmu_files import describe  # noqa: PLC0415
    from .model_match import misfit  # noqa: PLC0415 - heavy
    from .unit_definitions import check_units  # noqa: PLC0415

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
            own = _own_values(component.path)
            time = component.start.get("sample_time", own.get("sample_time"))
            if certified.certified_names(own) and isinstance(time, int | float) and 0.0 < time < math.inf:
                try:
                    check_step(time, step)
                except UserError as error:
                    raise UserError(f"run.step does not fit the controller: {error}") from None


def _loose_controls(system: SystemStructure) -> list[str]:
    """Return a sentence for each control of one of our controllers that is wired to nothing, though there is a plant."""
    from .fmu_files import describe  # noqa: PLC0415

    there = {component.name: component.path for component in system.components}
    if not {CONTROLLER, PLANT} <= there.keys():
        return []
    own, wired = _own_values(there[CONTROLLER]), {wire.source for wire in system.wires}
    controls = [
        v.name
        for v in describe(there[CONTROLLER]).modelVariables
        if v.causality == "output"
        and (f"{v.name}{LOWER}" in own or (pendulum.is_controller(own) and v.name == "voltage"))
    ]
    loose = [f"{CONTROLLER}.{name}" for name in controls if f"{CONTROLLER}.{name}" not in wired]
    return [f"the control {name} acts on nothing: no wire leads from it" for name in loose]


def remarks(system: SystemStructure, scenario: Scenario) -> list[str]:
    """Return what is to be known of a scenario's system before it runs, a sentence each.

    Of its controller on its plant, although they fit, see `model_match`, unless it may be of another model; of controls
    that act on nothing; of start values that no certificate covers.
    """
    from .model_match import remarks as found  # noqa: PLC0415 - heavy

    said = [] if scenario.controller.other_model else found(system)
    said = [*said, *_loose_controls(system)]
    for component in system.components:
        if component.name == CONTROLLER:
            said += certified.remarks(_own_values(component.path), scenario.controller.start)
    return said


def controller_design(
    system: SystemStructure, scenario: Scenario, folder: FilePath | None = None
) -> tuple[Design | None, list[str]]:
    """Return the design of a scenario's controller, and what its certificate does not cover, as `certified.design_of`."""
    for component in system.components:
        if component.name == CONTROLLER:
            file = scenario.controller.design
            return certified.design_of(component, None if file is None else _beside_or_here(file, folder))
    return None, []


def with_tolerances(scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> Scenario:
    """Return the scenario with the tolerances of settling that it does not name: those of a run of it as it stands.

    So runs that are compared are held against the same ones. Raises as `run_scenario`.
    """
    from .metrics import with_tolerances as judged_by  # noqa: PLC0415

    judged = evaluation(scenario, fmus, folder)
    if judged is None or None not in judged.settled:
        return scenario
    found = judged_by(run_scenario(scenario, fmus, folder), judged).settled
    return scenario.changed({"evaluate.tolerances": found})


def rest_remarks(result: Result, system: SystemStructure) -> list[str]:
    """Return in a sentence that nothing moved in a run of `system`, and how something would; nothing where it did.

    Nothing moves where no judged signal changes and none is beside its set-point, but for rounding.
    """
    from .metrics import at_rest  # noqa: PLC0415

    if not at_rest(result):
        return []
    plants = [component for component in system.components if component.name == PLANT]
    outputs = {name.partition(".")[2] for name in result.signals}
    starts = [
        f"{PLANT}.start.{name}"
        for plant in plants
        for name in _own_values(plant.path)
        if name.endswith(START) and {name.removesuffix(START), name.removesuffix(START) + TRUE} & outputs
    ]
    example = f", as with --set {starts[0]}=..." if starts else ""
    return [
        f"nothing moved: all was at rest where it began; change a start value{example}, or add a signal or a disturbance"
    ]


def run_scenario(
    scenario: Scenario,
    fmus: FilePath,
    folder: FilePath | None = None,
    progress: Callable[[int, int], None] | None = None,
    target: FilePath | None = None,
) -> Result:
    """Run `scenario` and return its result, whose metadata holds it; raises as `simulate`.

    `target` is the folder that the result will be written to, which must have room for it.
    """
    from .master import simulate  # noqa: PLC0415

    run, plan = scenario.run, _Plan(scenario, fmus, folder)
    judged = plan.evaluation()
    return simulate(
        plan.system(),
        run.step,
        run.duration,
        run.order,
        engine=run.engine,
        record=scenario.record.outputs,
        every=scenario.record.every,
        metadata={
            "scenario": scenario.model_dump(mode="json"),
            **({} if judged is None else {"evaluation": judged.model_dump(mode="json")}),
        },
        progress=progress,
        folder=target,
    )


def _own_values(fmu: Path) -> Mapping[str, StartValue]:
    """Return the start values with which an FMU was exported, by name and in their types."""
    from .fmu_files import start_values_of  # noqa: PLC0415

    return start_values_of(fmu)
