"""Scenarios: one run's description, read from TOML with typed and checked contents, and the system that it means."""

from __future__ import annotations

import filecmp
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from filing.origin import WRITTEN
from fmu_export.files import is_file, is_folder
from fmu_export.reading import read_toml
from fmu_export.variables import did_you_mean
from ihc_fmu.pendulum.interface import INTERFACE as CONTROLLER
from ihc_fmu.pendulum.interface import VELOCITY_SOURCES
from plant_fmu.interface import start_values as plant_start_values
from plant_fmu.parameters import PARAMETER_SETS

from . import parameter_files
from .errors import UserError
from .master import Component, Engine, Order, Signal, System, Wire, step_count
from .names import PlainName
from .results import Result
from .typed import Finite, Positive, checked

SAMPLE_TIMES = next(v for v in CONTROLLER.variables if v.name == "sample_time").limits()
"""Bounds of the controller's sample time [s]."""

BUILT_IN = Path(__file__).parent / "scenarios"

_VOLTAGE = Wire("controller.voltage", "plant.voltage")
WIRES = {
    "encoders": (
        Wire("plant.theta_encoder", "controller.theta"),
        Wire("plant.delta_encoder", "controller.delta"),
        _VOLTAGE,
    ),
    "ideal": (
        *(Wire(f"plant.{name}", f"controller.{name}") for name in ("theta", "delta", "theta_dot", "delta_dot")),
        _VOLTAGE,
    ),
}
"""How the two units are wired, by the measurement that the controller gets."""

StartValue = bool | int | float | str


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RunSection(_Section):
    """How long and how finely."""

    step: Positive = Field(1e-3, description="communication step [s]")
    duration: Positive = Field(10.0, description="duration, a multiple of the step [s]")
    order: Order = Field(
        "controller-first", description="coupling order: controller-first (no delay) or parallel (one step)"
    )
    engine: Engine = Field(
        "auto",
        description="loop: native (C) or fmpy (Python), to the same result; auto: native unless an FMU is Python",
    )
    seed: int | None = Field(
        None,
        ge=0,
        lt=2**31,
        strict=True,
        description="draws the encoders' sub-count offsets and seeds the noise; none: the FMU's start values",
    )


class PlantSection(_Section):
    """The plant FMU."""

    fmu: PlainName = Field(
        "QubeServo2.fmu",
        description="name of a file in the folder given to the command or beside the scenario; no path",
    )
    parameters: str | None = Field(
        None,
        description="none: the FMU's own start values; or a set that replaces them, by name: "
        f"{', '.join(PARAMETER_SETS)}; or of a file *.toml, beside the scenario or in the current folder",
    )
    measurement: Literal["encoders", "ideal"] = Field(
        "encoders", description="encoders: counted angles; ideal: the true state, velocities included"
    )
    start: dict[str, StartValue] = Field(default_factory=dict, description="start values of the plant FMU by name")

    @field_validator("parameters")
    @classmethod
    def _own(cls, value: str | None) -> str | None:
        """Take the word that TOML, which has no null, says for it."""
        return None if value == "none" else value


class ControllerSection(_Section):
    """The controller FMU."""

    fmu: PlainName = Field(
        "IhcController.fmu",
        description="name of a file in the folder given to the command or beside the scenario; no path",
    )
    design: str | None = Field(
        None, description="design file beside the scenario; none: the design exported in the FMU"
    )
    other_model: bool = Field(
        False, description="true: run a controller that was designed for another model than the plant's all the same"
    )
    start: dict[str, StartValue] = Field(default_factory=dict, description="start values of the controller FMU by name")


class Sine(_Section):
    """One term amplitude * sin(frequency t + phase)."""

    amplitude: Finite = Field(description="amplitude, in the unit of the disturbed input")
    frequency: Finite = Field(description="angular frequency [rad/s]")
    phase: Finite = Field(0.0, description="phase [rad]")


class DisturbanceSection(_Section):
    """A sum of sines times a gain on an input of the plant."""

    input: Literal["disturbance_voltage", "pendulum_torque"] = Field(
        "disturbance_voltage", description="input of the plant [V or N.m]"
    )
    gain: Finite = Field(1.0, description="factor of the whole sum, the paper's G [1]")
    sines: tuple[Sine, ...] = Field((), description="terms of the sum")
    start: Finite = Field(
        0.0, description="time before which the disturbance is 0 [s]; the sines' phases count from t = 0"
    )

    def value(self, time: float) -> float:
        """Return the disturbance at `time` [s]."""
        if time < self.start:
            return 0.0
        return self.gain * sum(s.amplitude * math.sin(s.frequency * time + s.phase) for s in self.sines)


@dataclass(frozen=True)
class DisturbanceSignal(Signal):
    """A disturbance as a signal: values ahead are computed once for all runs with the same disturbance and step."""

    section: DisturbanceSection

    def ahead(self, start_time: float, step: float, first: int, count: int) -> Sequence[float]:
        """Return the values at start_time + k step for `count` steps from `first` on."""
        return _ahead(self.section, start_time, step, first, count)  # type: ignore[arg-type] # frozen, so hashable


@lru_cache(maxsize=256)
def _ahead(section: DisturbanceSection, start_time: float, step: float, first: int, count: int) -> tuple[float, ...]:
    return tuple(section.value(start_time + k * step) for k in range(first, first + count))


class RecordSection(_Section):
    """What is kept."""

    outputs: tuple[str, ...] | None = Field(None, description="outputs as instance.variable; none: all")
    every: int = Field(
        1, ge=1, strict=True, description="keep every n-th communication point, and the first and the last"
    )


class Scenario(_Section):
    """One run's description. `name` is the file's; every section and every entry has a default."""

    name: PlainName = "scenario"
    description: str = ""
    run: RunSection = RunSection()  # type: ignore[call-arg]
    plant: PlantSection = PlantSection()  # type: ignore[call-arg]
    controller: ControllerSection = ControllerSection()  # type: ignore[call-arg]
    disturbance: DisturbanceSection = DisturbanceSection()  # type: ignore[call-arg]
    record: RecordSection = RecordSection()  # type: ignore[call-arg]

    def changed(self, changes: Mapping[str, Any]) -> Scenario:
        """Return the scenario with entries replaced, each named `section.entry` or `section.start.variable`.

        Raises UserError for a name that does not exist or a value outside its rule.
        """
        data = self.model_dump()
        for path, value in changes.items():
            *parents, last = path.split(".")
            place: Any = data
            for parent in parents:
                if not isinstance(place, dict) or parent not in place:
                    raise UserError(f"the scenario has no entry {path!r}{did_you_mean(parent, place)}")
                place = place[parent]
            if not isinstance(place, dict):
                raise UserError(f"the scenario has no entry {path!r}")
            place[last] = value
        return _validated(data, self.name)

    def to_toml(self) -> str:
        """Return the scenario as the text of a TOML file; `load_scenario` reads back the same but for the file's name."""
        import tomli_w  # noqa: PLC0415

        return f"# {WRITTEN}\n" + tomli_w.dumps(self.model_dump(mode="json", exclude_none=True, exclude={"name"}))


def built_in_names() -> list[str]:
    """Return the names of the scenarios that come with the project."""
    return sorted(file.stem for file in BUILT_IN.glob("*.toml"))


def load_scenario(name: str) -> tuple[Scenario, Path]:
    """Return (scenario, its folder) from a TOML file, or a built-in one by its name.

    Raises UserError that names the file, the entry, the rule and the value.
    """
    path = Path(name)
    if not path.suffix and not is_file(path):  # a folder `paper` does not hide the scenario `paper`
        if name in built_in_names():
            path = BUILT_IN / f"{name}.toml"
        elif not is_folder(path):
            raise UserError(f"no scenario file or built-in scenario {name!r}; built in: {', '.join(built_in_names())}")
    data = read_toml(path, "scenario")
    return _validated({"name": path.stem, **data}, str(path)), path.parent


def _validated(data: dict[str, Any], source: str) -> Scenario:
    scenario = checked(Scenario, data, source)
    try:
        step_count(scenario.run.step, scenario.run.duration)
        if scenario.plant.parameters is not None:
            parameter_files.check_name(scenario.plant.parameters, "plant.parameters")
    except UserError as error:
        raise UserError(f"{source}: {error}") from None
    return scenario


def build_system(scenario: Scenario, fmus: Path, folder: Path | None = None, controller: Path | None = None) -> System:
    """Return the system that `scenario` means, with the FMUs of the folder `fmus`, or beside the scenario in `folder`.

    `controller` is the file of a controller FMU that the user named, in the place of the scenario's. What the scenario
    does not say is as it was exported. Raises UserError for files that do not exist or say what cannot
    be, designs that fail their certificate, and a controller that was designed for another model than the plant's.
    """
    plant_start: dict[str, StartValue] = {}
    if scenario.plant.parameters is not None:
        plant_start |= plant_start_values(parameter_files.chosen(scenario.plant.parameters, folder))
    if scenario.run.seed is not None:
        plant_start |= random_measurement(scenario.run.seed)
    plant_fmu, controller_fmu, design = files(scenario, fmus, folder)
    controller_fmu = controller or controller_fmu
    components = (
        Component("controller", controller_fmu, _controller_start(scenario, controller_fmu, design)),
        Component("plant", plant_fmu, plant_start | scenario.plant.start),
    )
    if not scenario.controller.other_model:
        _check_model(components)
    signals = []
    if scenario.disturbance.sines and scenario.disturbance.gain:
        section = scenario.disturbance
        signals.append(DisturbanceSignal(f"plant.{section.input}", section.value, section))
    return System(
        components=components,
        wires=WIRES[scenario.plant.measurement],
        signals=signals,
    )


def _controller_start(scenario: Scenario, fmu: Path, design: Path | None) -> dict[str, StartValue]:
    """Return the controller's start values that the scenario decides, and those that follow from them."""
    own = _own_values(fmu)
    start: dict[str, StartValue] = {}
    if own.get("sample_time") == CONTROLLER.step_size:  # not chosen at export
        step, (low, high) = scenario.run.step, SAMPLE_TIMES
        if not low <= step <= high and "sample_time" not in scenario.controller.start:
            raise UserError(
                f"run.step, as the controller's sample time, must lie in [{low:g}, {high:g}] s, found {step:g} s"
            )
        start["sample_time"] = step
    if design is not None:
        limit = scenario.controller.start.get("voltage_limit", own.get("voltage_limit"))
        start |= _design_values(design, limit)
    if scenario.plant.measurement == "ideal":
        start["velocity_source"] = "inputs"
    start |= scenario.controller.start
    source = start.get("velocity_source", own.get("velocity_source"))
    if source in ("kalman", VELOCITY_SOURCES.index("kalman") + 1):
        start = _kalman_values(own, start) | start
    return start


def _check_model(components: Sequence[Component]) -> None:
    """Raise UserError where the controller was designed for another model than the plant's, see `model_match`."""
    from .model_match import misfit  # noqa: PLC0415

    problem = misfit(*_all_values(components))
    if problem is not None:
        raise UserError(f"{problem}; controller.other_model = true runs it all the same")


def _all_values(components: Sequence[Component]) -> list[dict[str, StartValue]]:
    return [{**_own_values(c.path), **c.start} for c in components]


def remarks(system: System) -> list[str]:
    """Return what is to be known of a system's controller on its plant, although they fit, see `model_match`."""
    from .model_match import remarks as found  # noqa: PLC0415

    return found(*_all_values(system.components))


def files(scenario: Scenario, fmus: Path, folder: Path | None = None) -> tuple[Path, Path, Path | None]:
    """Return the paths of the plant FMU, the controller FMU and, where the scenario has one, the design.

    An FMU is beside the scenario or in the folder `fmus`; raises UserError where both have it and they differ.
    """

    def find(file: str) -> Path:
        beside, there = (folder or Path()) / file, fmus / file
        if folder is None or not is_file(beside):
            return there
        if is_file(there) and not filecmp.cmp(beside, there, shallow=False):
            raise UserError(
                f"{beside} and {there} are different FMUs; --fmus {folder} takes the one beside the scenario, or remove one"
            )
        return beside

    design = scenario.controller.design
    return (
        find(scenario.plant.fmu),
        find(scenario.controller.fmu),
        None if design is None else _beside_or_here(design, folder),
    )


def _beside_or_here(file: str, folder: Path | None) -> Path:
    """Return the path of a file that a scenario names: beside it if it is there, else in the current folder."""
    beside = (folder or Path()) / file
    return beside if is_file(beside) else Path(file)


def random_measurement(seed: int) -> dict[str, StartValue]:
    """Return encoder offsets drawn uniformly inside a count, and the noise's seed, for a seed of the run."""
    import numpy as np  # noqa: PLC0415

    theta, delta = np.random.default_rng(seed).random(2)
    return {"theta_encoder_offset": float(theta), "delta_encoder_offset": float(delta), "noise_seed": seed}


def run_scenario(
    scenario: Scenario,
    fmus: Path,
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    target: Path | None = None,
) -> Result:
    """Run `scenario` and return its result, whose metadata holds it; raises as `simulate`.

    `target` is the folder that the result will be written to, which must have room for it.
    """
    from .master import simulate  # noqa: PLC0415

    run = scenario.run
    return simulate(
        build_system(scenario, fmus, folder),
        run.step,
        run.duration,
        run.order,
        engine=run.engine,
        record=scenario.record.outputs,
        every=scenario.record.every,
        metadata={"scenario": scenario.model_dump(mode="json")},
        progress=progress,
        folder=target,
    )


def _design_values(path: Path, voltage_limit: StartValue | None) -> dict[str, StartValue]:
    try:
        status = path.stat()
    except FileNotFoundError:
        raise UserError(f"design file {path} does not exist") from None
    except OSError as error:
        raise UserError(f"design file {path} cannot be read: {error.strerror}") from None
    return _values_of(path, voltage_limit, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=16)  # a design's proof takes longer than a run
def _values_of(path: Path, voltage_limit: StartValue | None, _time: int, _size: int) -> dict[str, StartValue]:
    from ihc_fmu.design import Design  # noqa: PLC0415 - heavy
    from ihc_fmu.pendulum.start_values import design_values  # noqa: PLC0415

    design = Design.load(path)
    return dict(design_values(design) if voltage_limit is None else design_values(design, None, float(voltage_limit)))


def _own_values(fmu: Path) -> Mapping[str, StartValue]:
    """Return the start values with which an FMU was exported, by name and in their types."""
    from .fmu import start_values_of  # noqa: PLC0415

    return start_values_of(fmu)


def _kalman_values(own: Mapping[str, StartValue], start: Mapping[str, StartValue]) -> dict[str, StartValue]:
    """Return the Kalman filter's gain for sample time and nominal model; nothing where the FMU's own is for them."""
    values = {**own, **start}
    nominal = {name: float(value) for name, value in values.items() if name.startswith("nominal_")}
    time = float(values["sample_time"])
    if own.get("kalman_sample_time") == time and nominal.items() <= own.items():
        return {}
    return _kalman_gain(tuple(nominal.items()), time)


@lru_cache(maxsize=16)  # a Riccati equation
def _kalman_gain(nominal: tuple[tuple[str, float], ...], sample_time: float) -> dict[str, StartValue]:
    from ihc_fmu.pendulum.start_values import kalman_values  # noqa: PLC0415 - heavy

    return dict(kalman_values(dict(nominal), sample_time))
