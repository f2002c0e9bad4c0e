"""What of a scenario can be set on a page, found in its FMUs: sliders with their ranges, choices, in groups."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from fmpy.model_description import ScalarVariable

from fmu_export.errors import UserError, shown
from fmu_export.files import FilePath

from .. import wiring
from ..fmu import Instance
from ..fmu_files import describe, start_values_of
from ..plant_variables import state_pairs
from ..scenario import Scenario
from ..scenario_files import files
from ..scenario_system import build_system, controller_design
from ..start_values import StartValue, not_settable
from ..structure import SystemStructure
from ..studies.ranges import Range
from ..studies.tunables import (
    A_MIN,
    ALPHA,
    B_MAX,
    GAINS,
    MU,
    MUS,
    NOISES,
    RATES,
    SCALES,
    SPREAD,
    U_MAX,
    Tunable,
    TunedController,
    around,
)
from ..unit_definitions import NO_UNIT, unit_of, with_unit
from ..wiring import CONTROLLER, PLANT

HUGE = 1e100
"""From here on a number stands for none, as the limit of an input that has no limit, and has no slider."""

STEPS = 200
"""Of a slider, about."""

RANGES = {"a_min": A_MIN, "b_max": B_MAX}
"""Of the law's own parameters, where their values lie in them."""
FIRST = ("a_min", "b_max", MU)
"""What comes first on the page, in this order."""
REST = ("law", "enabled")
"""Parameters of a controller that are not set: the laws stand side by side, and a controller that is off is none."""
ESTIMATOR = (
    "velocity_source",
    "velocity_filter_cutoff",
    "observer_acceleration_noise",
    "kalman_count_weight",
    "compensate_disturbance",
)
"""Parameters of a controller that are its estimator's."""
EXTENT = {"rad": 0.5, "rad/s": 5.0, "m": 0.5, "m/s": 2.0}
"""To where an initial state can be moved at least, by its unit; others to 1."""


@dataclass(frozen=True)
class Slider:
    """A number: the entry of the scenario, its name, unit and meaning, the value in force, the slider's range and step.

    `logarithmic`: it is moved by the logarithm, in steps of its own.
    """

    entry: str
    name: str
    unit: str
    meaning: str
    value: float
    low: float
    high: float
    step: float
    whole: bool = False
    logarithmic: bool = False

    @property
    def label(self) -> str:
        """The name with its unit."""
        return with_unit(self.name, self.unit)

    def taken(self, value: Any) -> float | int:
        """Return a value as the scenario has it: without what binary fractions add to it; UserError for no finite number."""
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < HUGE:
            raise UserError(f"{self.name} must be a finite number, found {shown(value)}")
        return round(value) if self.whole else float(f"{value:.12g}")


@dataclass(frozen=True)
class Choice:
    """One of several values, by their names."""

    entry: str
    name: str
    meaning: str
    value: Any
    items: Mapping[Any, str]

    def taken(self, value: Any) -> Any:
        """Return a value; UserError for one that is none of the items."""
        if not isinstance(value, bool | int | str) or value not in self.items:
            raise UserError(f"{self.name} must be one of {', '.join(self.items.values())}, found {shown(value)}")
        return value


Adjustable = Slider | Choice


@dataclass(frozen=True)
class Group:
    """What belongs together; `folded` at first."""

    title: str
    members: list[Adjustable] = field(default_factory=list)
    folded: bool = False


def decided(name: str) -> str:
    """Return the entry, on the page and none of a scenario, of a number that decides several start values, such as mu."""
    return f"{CONTROLLER}.{name}"


def controller_of(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> TunedController | None:
    """Return the scenario's controller, whose design and filter can be set; None where there is none.

    Raises as `build_system`.
    """
    if CONTROLLER not in files(scenario, fmus, folder).fmus:
        return None
    design, uncovered = controller_design(build_system(scenario, fmus, folder), scenario, folder)
    return TunedController(scenario, fmus, folder, None if uncovered else design)


def groups_of(
    scenario: Scenario, fmus: FilePath, folder: FilePath | None, controller: TunedController | None, peak: float
) -> list[Group]:
    """Return what can be set in a scenario, in the order of the page; groups without members are left out.

    `controller` is the scenario's, see `controller_of`; `peak` is the largest control of a run, which a disturbance is held
    against. Raises as `build_system`.
    """
    system = build_system(scenario, fmus, folder)
    paths = {component.name: component.path for component in system.components}
    values = {c.name: {**start_values_of(c.path), **c.start} for c in system.components}
    of_controller = list(_parameters(CONTROLLER, system, values))
    law, gain = (
        Group("controller", _design_sliders(controller)),
        Group("gain K, rate alpha", _gain_sliders(controller), folded=True),
    )
    estimator, further = Group("estimator", _noise_sliders(controller)), Group("controller, further", folded=True)
    for variable, member in of_controller:
        name = variable.name
        told = name in scenario.controller.start
        if name in REST or not (told or name in ESTIMATOR or variable.variability == "tunable"):
            continue
        place = estimator if name in ESTIMATOR else law if told or name in RANGES else further
        place.members.append(member)
    law.members.sort(key=lambda m: FIRST.index(m.name) if m.name in FIRST else len(FIRST))
    initial, plant = Group("initial state"), Group("plant, further", folded=True)
    states = _initial(paths)
    for variable, member in _parameters(PLANT, system, values, states):
        told = variable.name in states or variable.name in scenario.plant.start
        (initial if told else plant).members.append(member)
    groups = [law, estimator, initial, _disturbance(scenario, system, peak), _signals(scenario), _run(scenario)]
    return [group for group in (*groups, gain, further, plant) if group.members]


def with_disturbance(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> Scenario:
    """Return the scenario with a disturbance that can be turned up: its own, else a sine of gain 0 on an input.

    The input is the scenario's, else the first one of the plant that nothing feeds; as it stands where there is none.
    """
    free = _free_inputs(build_system(scenario, fmus, folder))
    if scenario.disturbance.sines or not free:
        return scenario
    target = scenario.disturbance.input or next((n for n in free if "disturbance" in n), free[0])
    sine = {"amplitude": 1.0, "frequency": 3.0}
    return scenario.changed({"disturbance.sines": [sine], "disturbance.gain": 0.0, "disturbance.input": target})


def _free_inputs(system: SystemStructure) -> list[str]:
    """Return the plant's real inputs that no wire and no signal feeds."""
    fed = {wire.target for wire in system.wires} | {signal.target for signal in system.signals}
    paths = {component.name: component.path for component in system.components}
    if PLANT not in paths:
        return []
    known = {v.name: v for v in describe(paths[PLANT]).modelVariables}
    return [n for n in wiring.inputs(known) if known[n].type == "Real" and f"{PLANT}.{n}" not in fed]


def _parameters(
    component: str, system: SystemStructure, values: Mapping[str, Mapping[str, Any]], states: tuple[str, ...] = ()
) -> Iterator[tuple[ScalarVariable, Adjustable]]:
    """Yield the parameters of a component, and how they are set; texts are left out."""
    path = next((c.path for c in system.components if c.name == component), None)
    for variable in () if path is None else describe(path).modelVariables:
        if (variable.causality != "parameter" and variable.name not in states) or not_settable(variable) is not None:
            continue
        value = values[component].get(variable.name)
        if value is not None:
            member = _member(f"{component}.start.{variable.name}", variable, value, variable.name in states)
            if member is not None:
                yield variable, member


def _member(entry: str, variable: ScalarVariable, value: StartValue, initial: bool) -> Adjustable | None:
    name, meaning = variable.name, variable.description or ""
    if variable.type == "Boolean":
        return Choice(entry, name, meaning, value, {True: "yes", False: "no"})
    if variable.type == "Enumeration":
        items = {int(item.value): item.name for item in variable.declaredType.items}  # type: ignore[union-attr]
        return Choice(entry, name, meaning, items.get(value, value), {n: n for n in items.values()})  # type: ignore[call-overload]
    if variable.type not in ("Real", "Integer") or not isinstance(value, int | float) or not abs(value) < HUGE:
        return None
    low = -math.inf if variable.min is None else float(variable.min)
    high = math.inf if variable.max is None else float(variable.max)
    unit, whole = unit_of(variable), variable.type == "Integer"
    extent = EXTENT.get(unit, 1.0) if initial else 0.0
    return slider(entry, name, unit, meaning, value, (low, high), extent=extent, whole=whole)


def slider(
    entry: str,
    name: str,
    unit: str,
    meaning: str,
    value: float,
    limits: tuple[float, float] = (-math.inf, math.inf),
    *,
    extent: float = 0.0,
    span: tuple[float, float] | None = None,
    whole: bool = False,
) -> Slider:
    """Return a slider about a value, within its limits.

    Its range is `span`; else, with an extent, as far to both sides; else the law's own, the limits where they are near, or
    from 0 to twice the value. It always has the value in it.
    """
    low, high = limits
    if span is not None:
        begin, end = span
    elif extent:
        end = max(extent, 2.0 * abs(value))
        end = min(end, math.pi) if unit == "rad" and abs(value) <= math.pi else end
        begin = -end
    elif name in RANGES:
        begin, end = RANGES[name].low, RANGES[name].high
    elif high - low <= 100.0 * abs(value):
        begin, end = low, high
    else:
        begin, end = sorted((0.0, 2.0 * value)) if value else (max(low, -1.0), 1.0)
    begin, end = max(min(begin, value), low), min(max(end, value), high)
    step = step_of(end - begin, whole)
    begin, end = step * math.ceil(begin / step - 1e-9), step * math.floor(end / step + 1e-9)
    return Slider(entry, name, unit, meaning, value, float(f"{begin:.9g}"), float(f"{end:.9g}"), step, whole)


def step_of(width: float, whole: bool = False) -> float:
    """Return 1, 2 or 5 times a power of ten, of which about STEPS make up a width."""
    if width <= 0.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(width / STEPS))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= width / STEPS * (1.0 - 1e-9))
    return max(1.0, round(step)) if whole else float(f"{step:.3g}")


def _design_sliders(controller: TunedController | None) -> list[Adjustable]:
    """Return mu and the scale of P, where the design is known and can be solved anew."""
    if controller is None or not controller.redesigned:
        return []
    largest = "largest |(K - K_0) x| of the first input on the unit ball"
    scale = _tuned(controller, U_MAX, around(controller.start[U_MAX], SCALES), largest)
    return [
        _tuned(controller, MU, MUS, "minus the degree of homogeneity; the design is solved anew"),
        replace(scale, name="scale of P"),
    ]


def _gain_sliders(controller: TunedController | None) -> list[Adjustable]:
    """Return the entries of K and the rate of decay, where a design can be solved for others."""
    if controller is None or not controller.redesigned:
        return []
    meaning = "entry of the LC's gain; the design is solved anew"
    values = {name: controller.start[name] for name in controller.gains}
    rate = _tuned(
        controller, ALPHA, around(controller.start[ALPHA], RATES), "rate of decay that the design is to prove"
    )
    return [
        *(_tuned(controller, n, around(v, GAINS) if v else Range(-1.0, 1.0), meaning) for n, v in values.items()),
        rate,
    ]


def _noise_sliders(controller: TunedController | None) -> list[Adjustable]:
    """Return the noises of the pendulum's Kalman filter, also where it is not used at first."""
    if controller is None or controller.noises is None:
        return []
    meaning = "noise that the Kalman filter assumes; its gain is computed anew"
    values = {name: getattr(controller.noises, name) for name in NOISES}
    return [_tuned(controller, name, around(value, SPREAD), meaning, value) for name, value in values.items()]


def _tuned(controller: TunedController, name: str, limits: Range, meaning: str, value: float | None = None) -> Slider:
    """Return the slider of a number that decides start values; `value` where the scenario does not use it at first."""
    value = controller.start[name] if value is None else value
    span = min(limits.low, value), max(limits.high, value)
    made = slider(decided(name), name, controller.unit(name), meaning, float(f"{value:.6g}"), span=span)
    if not Tunable(name, limits).logarithmic:
        return made
    return replace(made, low=span[0], high=span[1], logarithmic=True)


def _initial(paths: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the parameters of the plant that set its states at the start."""
    if PLANT not in paths:
        return ()
    try:
        return tuple(start for _, start in state_pairs(Instance(PLANT, paths[PLANT]), ()))
    except UserError:  # another tool's FMU need not say what its states are
        return ()


def _disturbance(scenario: Scenario, system: SystemStructure, peak: float) -> Group:
    group, section = Group("disturbance"), scenario.disturbance
    if not section.sines:
        return group
    size = sum(abs(sine.amplitude) for sine in section.sines)
    most = max(2.0 * abs(section.gain), peak / size if size else 0.0) or 1.0
    span = (0.0, float(f"{most:.2g}"))
    meaning = "factor of the sum of sines, whose amplitudes are in the unit of the input"
    group.members.append(slider("disturbance.gain", "gain", NO_UNIT, meaning, section.gain, span=span))
    if len(section.sines) == 1:
        frequency, entry = section.sines[0].frequency, "disturbance.sines.0.frequency"
        meaning = "angular frequency of the sine"
        span = (0.0, max(20.0, 2.0 * frequency))
        group.members.append(slider(entry, "frequency", "rad/s", meaning, frequency, span=span))
    if section.input is not None:
        names = dict.fromkeys([section.input, *_free_inputs(system)])
        items = {name: name for name in names}
        group.members.append(Choice("disturbance.input", "input", "input of the plant", section.input, items))
    return group


def _signals(scenario: Scenario) -> Group:
    """Return the numbers of the signals on inputs: set-points for one."""
    group = Group("signals")
    for k, section in enumerate(scenario.signals):
        for name in ("value", "amplitude", "period", "gain"):
            value = getattr(section, name, None)
            if isinstance(value, int | float):
                extent = 0.0 if name == "period" else 1.0
                meaning = f"{section.kind} on {section.input}"
                label = f"{section.input.partition('.')[2]} {name}"
                group.members.append(
                    slider(f"signals.{k}.{name}", label, NO_UNIT, meaning, float(value), extent=extent)
                )
    return group


def _run(scenario: Scenario) -> Group:
    group, run = Group("run"), scenario.run
    span = (1.0, max(2.0, 2.0 * run.duration))
    whole = run.duration >= 1.0 and run.duration.is_integer()
    group.members.append(slider("run.duration", "duration", "s", "of the run", run.duration, span=span, whole=whole))
    if run.seed is not None:
        meaning = "draws the encoders' offsets and the noise"
        group.members.append(slider("run.seed", "seed", NO_UNIT, meaning, run.seed, span=(0, 100), whole=True))
    return group
