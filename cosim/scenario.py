"""Scenarios: one run's description, read from TOML with typed and checked contents.

The same entries describe every system: components that are FMUs, wires, signals on inputs, what is judged and recorded.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from filing.origin import WRITTEN
from fmu_export.files import FilePath, is_file, is_folder
from fmu_export.reading import read_toml
from fmu_export.variables import did_you_mean
from plant_fmu.parameters import PARAMETER_SETS

from . import parameter_files, ssp
from .animation import Bodies
from .errors import UserError
from .evaluation import EvaluateSection
from .inputs import DisturbanceSection, SignalSection
from .integration import Interface
from .master import step_count
from .names import PlainName
from .pendulum_files import PENDULUM_FMUS
from .rig import Engine, Order
from .start_values import StartValue
from .typed import Positive, checked
from .wiring import CONTROLLER, PLANT, WireSection

BUILT_IN = Path(__file__).parent / "scenarios"

NONE = "none"
"""What TOML, which has no null, says for nothing."""

GAIN = "disturbance.gain"


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

    Examples
    --------
    >>> import cosim
    >>> scenario = cosim.Scenario(plant={"fmu": "arm_linear_plant.fmu"}, controller={"fmu": "arm_controller.fmu"})
    >>> longer = scenario.changed({"run.duration": 2.0, "plant.start.angle_0": 0.1})
    >>> "duration = 2.0" in longer.to_toml()
    True
    >>> float(cosim.run(longer, fmus="fmus").time[-1])
    2.0
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
    animation: Bodies = ()
    evaluate: EvaluateSection = EvaluateSection()  # type: ignore[call-arg]
    record: RecordSection = RecordSection()  # type: ignore[call-arg]

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

    def entry(self, name: str) -> str:
        """Return the entry that a name means: that of a start value also without `start`, as in `plant.delta_0`.

        An entry of a component's own section, such as `plant.fmu`, goes before a variable of that name. Whether there is
        such a thing is not asked.

        Parameters
        ----------
        name
            `section.entry`, `component.start.variable` or `component.variable`.

        Returns
        -------
        str
            The entry, such as `plant.start.delta_0` or `components.load.start.mass`.

        Examples
        --------
        >>> import cosim
        >>> scenario, _ = cosim.load_scenario("tilt")
        >>> scenario.entry("plant.delta_0"), scenario.entry("plant.fmu")
        ('plant.start.delta_0', 'plant.fmu')
        """
        return _entry(name, self.components)

    def changed(self, changes: Mapping[str, Any]) -> Scenario:
        """Return the scenario with entries replaced.

        Parameters
        ----------
        changes
            Values by `section.entry` or `component.variable`, see `entry`; entries of lists are named by their numbers from
            0 on.

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
            *parents, last = _parted(_entry(path, data["components"]))
            place: Any = data
            for parent in parents:
                place = _inside(place, parent, path)
            _inside(place, last, path, new=True)
            place[int(last) if isinstance(place, list) else last] = value
        made = _validated(data, self.name)
        if GAIN in changes and made.disturbance.gain and not made.disturbance.sines:
            raise UserError(f"{GAIN} has no effect in a scenario whose disturbance has no sines, found {changes[GAIN]}")
        return made

    def to_toml(self) -> str:
        """Return the scenario as the text of a TOML file; `load_scenario` reads back the same but for the file's name.

        Returns
        -------
        str
            The text.
        """
        import tomli_w  # noqa: PLC0415

        return f"# {WRITTEN}\n" + tomli_w.dumps(self.model_dump(mode="json", exclude_none=True, exclude={"name"}))


def _entry(name: str, components: Mapping[str, Any]) -> str:
    """Return the entry that a name means, see `Scenario.entry`."""
    section, _, rest = name.removeprefix("components.").partition(".")
    kind = {PLANT: PlantSection, CONTROLLER: ControllerSection}.get(section)
    if kind is None and section in components:
        kind, section = ComponentSection, f"components.{section}"
    if kind is None or not rest:
        return name
    own = rest.partition(".")[0] in kind.model_fields
    return f"{section}.{rest}" if own else f"{section}.start.{rest}"


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

    Examples
    --------
    >>> import cosim
    >>> scenario, folder = cosim.load_scenario("fmus/arm.ssp")
    >>> scenario.name, scenario.run.duration
    ('arm', 10.0)
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
    scenario, folder = load_scenario(name)
    return scenario, folder, folder if Path(name).suffix == ssp.SUFFIX else fmus


def _validated(data: dict[str, Any], source: str) -> Scenario:
    scenario = checked(Scenario, data, source)
    try:
        step_count(scenario.run.step, scenario.run.duration)
        if scenario.plant.parameters is not None:
            parameter_files.check_name(scenario.plant.parameters, "plant.parameters")
    except UserError as error:
        raise UserError(f"{source}: {error}") from None
    return scenario
