"""The experiments as scenarios: variants of the controller, cells of conditions, random draws; and their running.

A run is named by a `Key`. Everything that a run depends on is in its scenario, so that any of them can be written to a
file and repeated alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from filing.files import write_file
from ihc_fmu.design import Design
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.pendulum.interface import INTERFACE as CONTROLLER
from ihc_fmu.pendulum.paper_system import paper_system
from ihc_fmu.pendulum.start_values import default_design
from plant_fmu.interface import start_values as plant_start_values
from plant_fmu.parameters import PARAMETER_SETS

from ..judged_signals import angle_norm, kept_upright, wrapped
from ..metrics import evaluate, settling_time
from ..results import Result
from ..scenario import BUILT_IN, Scenario, load_scenario
from ..studies.engine import Job, Workers, run_all, run_numbers
from ..studies.journal import Journal
from . import printed
from .gains import TILT
from .variants import PAPER_U_MAX, Variant, controllers, sweep_variants

Changes = Mapping[str, Any]
Progress = Callable[[int, int], None]

REFERENCE = ("ident", printed.SAMPLE_TIME)
"""Parameter set and sample time [s] of the experiments that the figures and tables show."""

SAMPLE_TIMES = (1e-4, 1e-3, 2e-3)
GAINS = tuple(printed.LMSE)
COMPARED = ("LC", "IHC", "SMC1", "SMC2")
"""The controllers of the paper's tables; it does not say which sliding mode controller it used, so there are two."""

SETS = tuple(PARAMETER_SETS)

UNCERTAIN = ("m_p", "L_p", "J_p", "D_p", "L_r", "J_r", "D_r", "R_m", "k_m")
UNCERTAINTY = 0.1
"""Each of these parameters of the plant is drawn within 10 % of its value, independently; the controller knows nothing."""

ANGLE_SPREAD = 0.1
"""Both initial angles are drawn within this of their value [rad]."""

NOISE_STD = 5e-4
"""Standard deviation of the noise on both angles before they are counted [rad], a sixth of a count."""

SWING_UP_RANGES = {
    "swing_up_energy_gain": (8e3, 9e4),
    "swing_up_acceleration_limit": (40.0, 180.0),
    "swing_up_arm_stiffness": (10.0, 80.0),
    "swing_up_arm_damping": (2.0, 14.0),
    "swing_up_energy_offset": (0.02, 0.45),
    "swing_up_velocity_scale": (0.2, 4.0),
    "capture_angle": (0.15, 0.5),
    "capture_velocity": (3.0, 9.0),
}
"""What random swing-ups are drawn from: the swing-up's six numbers and the two that decide the capture."""

WIDE_TOLERANCE = 0.1
"""A second tolerance for settling beside the metrics' 0.02 [rad], since the paper names none."""

SIGNALS = ("plant.theta", "plant.delta", "controller.voltage", "controller.mode")


class Key(NamedTuple):
    """What a run is called: the experiment, the plant's set, sample time [s], gain G, controller, draw (0: none)."""

    experiment: str
    parameters: str
    step: float
    gain: float
    variant: str
    draw: int


@dataclass(frozen=True)
class Size:
    """How much is run: draws per cell and controller, also of those beyond the paper, which sets at which sample times, the
    swing-ups, the a_min grid.
    """

    draws: int
    beyond: bool
    sample_times: tuple[float, ...]
    other_sample_times: tuple[float, ...]
    other_gains: tuple[float, ...]
    swing_ups: int
    chattering_draws: int
    a_mins: tuple[float, ...]


FULL = Size(
    200, True, SAMPLE_TIMES, SAMPLE_TIMES, (0, 60, 200), 1500, 20, tuple(round(1.0 - 0.05 * i, 2) for i in range(15))
)
QUICK = Size(10, False, SAMPLE_TIMES, (1e-3,), (0, 200), 120, 2, (1.0, 0.9, 0.8, 0.7, 0.6, 0.5))


def draw_changes(seed: int, parameters: str, delta_0: float) -> dict[str, Any]:
    """Return the entries of draw `seed`: encoder offsets and noise, initial angles about `delta_0`, the plant's numbers.

    All uniform in their range and from one generator seeded by `seed`, so equal for every controller.
    """
    rng = np.random.default_rng([seed, 2])  # apart from the offsets, which are drawn from `seed` alone
    start: dict[str, float] = {
        "noise_std": NOISE_STD,
        "theta_0": float(rng.uniform(-ANGLE_SPREAD, ANGLE_SPREAD)),
        "delta_0": delta_0 + float(rng.uniform(-ANGLE_SPREAD, ANGLE_SPREAD)),
    }
    named = plant_start_values(parameters)
    for name in UNCERTAIN:
        start[name] = float(named[name]) * (1.0 + float(rng.uniform(-UNCERTAINTY, UNCERTAINTY)))
    return {"run.seed": seed, **{f"plant.start.{name}": value for name, value in start.items()}}


def swing_up_changes(seed: int) -> dict[str, float]:
    """Return the entries of a random swing-up: its six numbers and the two that decide the capture, log-uniform."""
    rng = np.random.default_rng([seed, 3])
    draws = {
        name: math.exp(rng.uniform(math.log(low), math.log(high))) for name, (low, high) in SWING_UP_RANGES.items()
    }
    return {f"controller.start.{name}": float(value) for name, value in draws.items()}


def thinned(result: Result) -> Result:
    """Return the rows of a result that are at least 1 ms apart."""
    every = max(1, round(1e-3 / (result.time[1] - result.time[0])))
    return replace(result, time=result.time[::every], signals={n: s[::every] for n, s in result.signals.items()})


def numbers(result: Result) -> dict[str, float]:
    """Return the metrics of a run and what the paper's sentences need.

    window_rms, window_theta, window_delta [rad]: RMS of |q| and height of each angle's oscillation in the insets' window.
    arm_peak [rad]: largest |theta| after the capture. energy_after_capture [V^2 s]. settling_wide [s]: settling to
    0.1 rad. kept: 1 where the law took over once and acts at the end.
    """
    time = result.time
    window = (time >= printed.WINDOW[0]) & (time <= printed.WINDOW[1])
    theta, delta = result["plant.theta"][window], wrapped(result["plant.delta"][window])
    values = {name: float(value) for name, value in evaluate(result).as_dict().items()}
    values["window_rms"] = float(np.sqrt(np.mean(theta**2 + delta**2)))
    values["window_theta"] = float(np.ptp(theta))
    values["window_delta"] = float(np.ptp(delta))
    after = time >= values["capture_time"]  # nowhere where it is NaN
    values["arm_peak"] = float(np.max(np.abs(result["plant.theta"][after]), initial=0.0))
    held = np.diff(time, prepend=time[0])  # a row's voltage was held over the step that ended there
    values["energy_after_capture"] = float(np.sum((result["controller.voltage"] ** 2 * held)[after]))
    values["settling_wide"] = settling_time(time, angle_norm(result), WIDE_TOLERANCE)
    values["kept"] = float(kept_upright(result))
    return values


PURPOSE = "section V: numbers 1"
"""Named in the journal; to be changed with `numbers`."""


@dataclass(frozen=True)
class Study:
    """All experiments of section V: `folder` holds the scenarios' files (designs) and results, `fmus` the exported FMUs."""

    folder: Path
    fmus: Path
    size: Size
    workers: Workers = None

    @property
    def scenarios(self) -> Path:
        """Folder of the scenario and design files."""
        return self.folder / "scenarios"

    @cached_property
    def designs(self) -> dict[str, Design]:
        """The designs that variants name, by file name: the paper's numbers at 10 V, and the project's default."""
        paper = Options(mu=printed.MU, alpha=printed.ALPHA, u_max=PAPER_U_MAX)
        return {
            "paper.json": inverse_design(paper_system(), paper),
            "default.json": default_design(),
        }

    @cached_property
    def base(self) -> Scenario:
        """The built-in scenario `paper`, recording what the numbers need."""
        return load_scenario(str(BUILT_IN / "paper.toml"))[0].changed({"record.outputs": SIGNALS})

    @cached_property
    def variants(self) -> dict[str, Variant]:
        """Every controller by name."""
        return {variant.name: variant for variant in controllers()}

    @cached_property
    def sweep(self) -> dict[str, Variant]:
        """The IHC at each a_min in each measurement chain, by name."""
        return {variant.name: variant for variant in sweep_variants(self.size.a_mins)}

    def prepare(self) -> None:
        """Write the design files that scenarios name."""
        for name, design in self.designs.items():
            design.save(self.scenarios / name)

    def scenario(self, key: Key) -> Scenario:
        """Return the scenario of a run: the base, the conditions of its cell, its controller, its draw."""
        return self.base.changed(self.changes(key))

    def changes(self, key: Key) -> dict[str, Any]:
        """Return what a run changes in the base."""
        changes: dict[str, Any] = {
            "name": scenario_name(key),
            "run.step": key.step,
            "plant.parameters": key.parameters,
            "disturbance.gain": float(key.gain),
            **(self.variants | self.sweep)[key.variant].changes,
            **EXPERIMENTS[key.experiment],
        }
        delta_0 = changes.get("plant.start.delta_0", math.pi)
        if key.experiment == "swing-ups":
            changes |= swing_up_changes(key.draw)
        elif key.experiment == "chattering":
            changes["run.seed"] = key.draw
        elif key.draw:
            changes |= draw_changes(key.draw, key.parameters, delta_0)
        return changes

    def save_scenario(self, key: Key, folder: Path | None = None) -> Path:
        """Write the scenario of a run as TOML below `folder`, None: the study's own, and return its path."""
        scenario = self.scenario(key)
        path = (folder or self.folder) / self.scenarios.name / f"{scenario.name}.toml"
        write_file(path, scenario.to_toml())
        return path

    def job(self, key: Key, **changes: Any) -> Job[Key]:
        """Return the run `key` as a job, with further `changes` to its scenario."""
        return Job(key, self.base, self.scenarios, self.changes(key) | changes)

    def keys(self) -> dict[str, list[Key]]:
        """Return the names of all runs that only leave numbers, by experiment."""
        keys: dict[str, list[Key]] = {name: [] for name in EXPERIMENTS}
        own = REFERENCE[0]
        draws = range(1, self.size.draws + 1)
        keys["reference"] = _keys("reference", *REFERENCE, GAINS, tuple(self.variants), (0,))
        for step in self.size.sample_times:
            names = tuple(self.variants) if self.size.beyond and step == REFERENCE[1] else COMPARED
            keys["swing-up"] += _keys("swing-up", own, step, GAINS, names, draws)
        for parameters in sorted(SETS, key=lambda name: name != own):
            for step in self.size.other_sample_times:
                keys["shipped"] += _keys("shipped", parameters, step, self.size.other_gains, COMPARED, draws)
                keys["tilt"] += _keys("tilt", parameters, step, (0,), COMPARED, draws)
        keys["onset"] = _keys("onset", own, 1e-3, GAINS[2:], COMPARED, draws)
        chattering = range(1, self.size.chattering_draws + 1)
        for step in self.size.sample_times:
            keys["chattering"] += _keys("chattering", own, step, (0,), tuple(self.sweep), chattering)
        keys["swing-ups"] = _keys("swing-ups", own, 1e-3, (0,), COMPARED[:2], range(1, self.size.swing_ups + 1))
        return keys

    def pictures(self, keys: Sequence[Key]) -> dict[Key, Result]:
        """Return the results of runs themselves, thinned to rows of 1 ms."""
        return run_all([self.job(key) for key in keys], self.fmus, thinned, self.workers)

    def run(
        self, keys: Sequence[Key], journal: Journal, progress: Progress | None = None
    ) -> dict[Key, dict[str, float]]:
        """Return the numbers of each run, from the journal where it has them."""
        jobs = [self.job(key) for key in keys]
        return {k: dict(v) for k, v in run_numbers(jobs, self.fmus, journal, numbers, self.workers, progress).items()}


SHIPPED_SWING_UP = {f"controller.start.{name}": CONTROLLER.start_values()[name] for name in SWING_UP_RANGES}
"""The controller FMU's own swing-up, which captures after about 1.05 s."""

EXPERIMENTS: dict[str, Changes] = {
    "reference": {},
    "swing-up": {},
    "shipped": {"disturbance.start": 1.1, **SHIPPED_SWING_UP},
    "tilt": {"plant.start.delta_0": TILT, "disturbance.start": 0.0},
    "onset": {"disturbance.start": 0.0},
    "chattering": {"plant.start.delta_0": TILT, "disturbance.start": 0.0},
    "swing-ups": {},
}
"""What each experiment changes in the base: nothing (without and with draws), the shipped swing-up, balance alone from a
tilt, the disturbance from the first moment, the tilt again for each a_min, other swing-ups."""


def scenario_name(key: Key) -> str:
    """Return a file name for the scenario of a run."""
    gain = f"_G{key.gain:g}" if key.gain else ""
    draw = f"_draw{key.draw}" if key.draw else ""
    variant = key.variant.replace(", ", "-").replace(" ", "-").replace("a_min-", "a_min")
    return f"{key.experiment}_{variant}_{key.parameters}_{key.step * 1e3:g}ms{gain}{draw}"


def _keys(
    experiment: str, parameters: str, step: float, gains: Sequence[float], names: Sequence[str], draws: Sequence[int]
) -> list[Key]:
    return [Key(experiment, parameters, step, gain, name, draw) for gain in gains for draw in draws for name in names]
