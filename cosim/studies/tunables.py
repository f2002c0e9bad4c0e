"""What of a controller is tuned freely: its numbers with their ranges, and what in a scenario a choice of them changes.

Some are start values of the controller FMU. Others decide several of them: mu, the scale of P and the gain by a design, the
noises of the pendulum's Kalman filter by its gain. Those have the same names, `controller.NAME`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from fmu_export.errors import UserError
from fmu_export.files import FilePath
from fmu_export.variables import Value, did_you_mean
from ihc_fmu.design import Design
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.pendulum.interface import VELOCITY_SOURCES, kalman_gains, vector
from ihc_fmu.pendulum.kalman import KalmanOptions, linearize, noises_of
from ihc_fmu.pendulum.nominal_model import nominal_model
from ihc_fmu.pendulum.start_values import kalman_values

from ..certified import certified_names
from ..fmu_files import describe, start_values_of
from ..pendulum import is_controller
from ..scenario import Scenario
from ..scenario_files import files
from ..scenario_system import build_system
from ..start_values import StartValue
from ..unit_definitions import NO_UNIT, unit_of, with_unit
from ..wiring import CONTROLLER
from .ranges import Range, range_of
from .tuning import design_start

MU, U_MAX, ALPHA = "mu", "u_max", "alpha"
"""Minus the degree of homogeneity; the scale of P: the largest |(K - K_0) x| of the first input on the unit ball; the rate
of decay that the matrix inequality asks for."""
NOISE_UNITS = {"voltage_noise": "V2.s", "disturbance_noise": "V2/s", "bias_noise": "rad2/s"}
"""Of the pendulum's Kalman filter, as in `KalmanOptions`."""
NOISES = tuple(NOISE_UNITS)

A_MIN, B_MAX = Range(0.05, 1.0), Range(1.0, 5.0)
MUS = Range(0.5, 1.0)
SCALES = (1 / 3, 10.0)
"""Of u_max, times the design's."""
COUNT_WEIGHT = "kalman_count_weight"
"""Of a Kalman filter: of what of an innovation is within half a count."""
WEIGHTS = Range(0.4, 1.0)
SPREAD = (1 / 100, 100.0)
"""Of the noises, times the present ones."""
GAINS = (0.5, 2.0)
"""Of the entries of K, times the design's."""
RATES = (1 / 4, 4.0)
"""Of alpha, times the design's."""
DECADE = 10.0
DIGITS = 4
"""Significant digits of a number that is tried: more would be read by nobody."""


@dataclass(frozen=True)
class Tunable:
    """A number of the controller that is tuned: its name behind `controller.`, its range, its unit.

    Positive ranges over more than a decade are searched by the logarithm.
    """

    name: str
    range: Range
    unit: str = NO_UNIT

    @property
    def logarithmic(self) -> bool:
        """Whether the logarithm is what is searched evenly."""
        return self.range.low > 0.0 and self.range.high > DECADE * self.range.low

    @property
    def heading(self) -> str:
        """The name with its unit."""
        return with_unit(self.name, self.unit)

    def at(self, share: float) -> float:
        """Return the value at a share in [0, 1] of the range, to DIGITS digits."""
        low, high = self.range.low, self.range.high
        value = low * (high / low) ** share if self.logarithmic else self.range.at(share)
        return min(max(float(f"{value:.{DIGITS}g}"), low), high)

    def share(self, value: float) -> float:
        """Return the share at which a value lies, that of the nearer end for one outside the range."""
        low, high = self.range.low, self.range.high
        value = min(max(value, low), high)
        return math.log(value / low) / math.log(high / low) if self.logarithmic else (value - low) / (high - low)


@dataclass(frozen=True)
class Setting:
    """What a choice of numbers makes of the controller: changes of the scenario, the design where it decides one.

    `plain` are the changes that the design's file does not bring.
    """

    changes: Mapping[str, Value]
    plain: Mapping[str, Value]
    design: Design | None


class TunedController:
    """The controller of a scenario: what of it can be tuned, and what a choice of that changes."""

    def __init__(self, scenario: Scenario, fmus: FilePath, folder: FilePath | None, design: Design | None) -> None:
        """Read the scenario's controller FMU; `design` is the controller's, None: there is none that is known."""
        path = files(scenario, fmus, folder).fmus[CONTROLLER]
        self.variables = {v.name: v for v in describe(path).modelVariables}
        self.own = _own_values(scenario, fmus, folder)
        self.pendulum = is_controller(self.own)
        changed = {*certified_names(self.own)} & scenario.controller.start.keys()
        self.design = None if changed else design
        self.redesigned = design is not None and not (changed or design.integral or design.psi or design.d_max)

    @property
    def filtered(self) -> bool:
        """Whether the pendulum's Kalman filter estimates the state."""
        kalman = ("kalman", VELOCITY_SOURCES.index("kalman") + 1)
        return self.pendulum and self.own["velocity_source"] in kalman

    @property
    def gains(self) -> tuple[str, ...]:
        """The names of the entries of K."""
        if self.design is None:
            return ()
        if self.pendulum:
            return vector("k_lin")
        m, n = self.design.K.shape
        return tuple(f"K_{i}_{j}" for i in range(1, m + 1) for j in range(1, n + 1))

    @cached_property
    def start(self) -> dict[str, float]:
        """The present value of all that can be tuned."""
        values = {name: float(self.own[name]) for name in self._plain if name in self.own}
        if self.redesigned and self.design is not None:
            values |= {MU: self.design.mu, U_MAX: float(self.design.u_max[0]), ALPHA: self.design.alpha}
            values |= dict(zip(self.gains, self.design.K.ravel().tolist(), strict=True))
        if self.filtered and self.noises is not None:
            values |= {name: getattr(self.noises, name) for name in NOISES}
        return values

    @cached_property
    def noises(self) -> KalmanOptions | None:
        """The noises that the pendulum's Kalman filter is for; None: there is no such filter, or its gain is for none."""
        if not self.pendulum:
            return None
        M = np.array([float(self.own[name]) for name in kalman_gains()]).reshape(-1, 2)
        try:
            return noises_of(
                M, *linearize(nominal_model(self._nominal(self.own))), float(self.own["kalman_sample_time"])
            )
        except UserError:  # no filter for this nominal model
            return None

    @cached_property
    def _plain(self) -> list[str]:
        """The names of the start values that are numbers of the controller's own, not of its design or filter."""
        decided = {*certified_names(self.own), *(design_start(self.design) if self.pendulum and self.design else ())}
        return [
            v.name
            for v in self.variables.values()
            if (v.causality, v.type) == ("parameter", "Real")
            and v.name not in decided
            and not v.name.startswith("kalman_M")
            and v.name not in ("sample_time", "kalman_sample_time")
        ]

    def tunables(self, over: Mapping[str, Range], gain: bool = False) -> list[Tunable]:
        """Return what is tuned: the numbers in `over`, empty: the usual ones; with `gain`, the entries of K and alpha too.

        Raises UserError for a number that cannot be tuned, or not in its range.
        """
        free = {**self.gain_ranges(), ALPHA: around(self.start[ALPHA], RATES)} if gain else {}
        ranges = {**(over or self.usual()), **{name: limits for name, limits in free.items() if name not in over}}
        return [self._tunable(name, limits) for name, limits in ranges.items()]

    def of_linear(self) -> list[Tunable]:
        """Return what is tuned of the law LC: its K, and the pendulum's Kalman filter where that is used.

        Raises UserError where the gain is not known.
        """
        ranges = self.gain_ranges()
        ranges |= self._filter_ranges()
        return [self._tunable(name, limits) for name, limits in ranges.items()]

    def linear_setting(self, values: Mapping[str, float]) -> Setting:
        """Return what these values change for the law LC, which needs no design."""
        plain: dict[str, Value] = {name: value for name, value in values.items() if name in {*self.gains, COUNT_WEIGHT}}
        if any(name in values for name in NOISES):
            plain |= self._kalman({**self.start, **values})
        changes = {**self.linear(), **_entries(plain)}
        return Setting(changes, changes, None)

    def usual(self) -> dict[str, Range]:
        """Return the ranges of what is tuned unless other numbers are named."""
        ranges = {"a_min": A_MIN, "b_max": B_MAX}
        if self.redesigned and self.design is not None:
            ranges[U_MAX] = around(self.start[U_MAX], SCALES)
            if self.pendulum:
                ranges[MU] = MUS
        return ranges | self._filter_ranges()

    def _filter_ranges(self) -> dict[str, Range]:
        noises = {name: around(self.start[name], SPREAD) for name in NOISES if name in self.start}
        weighs = COUNT_WEIGHT in self.start and (self.filtered or not self.pendulum)
        return {**noises, COUNT_WEIGHT: WEIGHTS} if weighs else noises

    def gain_ranges(self) -> dict[str, Range]:
        """Return the ranges of the gain's entries; raise UserError where they cannot be tuned."""
        if not self.redesigned:
            raise UserError("tuning K needs a controller whose design is known, without integral action, psi and d_max")
        return {name: around(self.start[name], GAINS) for name in self.gains if self.start[name] != 0.0}

    def _tunable(self, name: str, limits: Range) -> Tunable:
        """Return what is tuned by its name; raise UserError for one that cannot be, or not within these limits."""
        if name not in self.start:
            raise UserError(
                f"controller.{name} cannot be tuned{did_you_mean(name, self.start)}; what can: {', '.join(self.start)}"
            )
        low, high = (float(end) for end in self._ends(name))
        positive = name in (MU, U_MAX, ALPHA, *NOISES)
        if not low <= limits.low < limits.high <= high or (positive and limits.low <= 0.0):
            raise UserError(
                f"controller.{name} must lie in {'(' if positive else '['}{low:g}, {high:g}], "
                f"found {limits.low:g}..{limits.high:g}"
            )
        return Tunable(name, limits, self.unit(name))

    def _ends(self, name: str) -> tuple[str | float, str | float]:
        """Return the least and the largest value that the controller takes."""
        variable = self.variables.get(name)
        if variable is None:
            return 0.0, math.inf
        low, high = variable.min, variable.max
        return -math.inf if low is None else low, math.inf if high is None else high

    def unit(self, name: str) -> str:
        """Return the unit of a number; "1" where it has none."""
        if name in NOISE_UNITS:
            return NOISE_UNITS[name]
        if name == ALPHA:
            return "1/s"
        if name == U_MAX and self.design is not None:
            return self.design.system.inputs[0].unit
        variable = self.variables.get(name)
        return NO_UNIT if variable is None else unit_of(variable)

    def setting(self, values: Mapping[str, float]) -> Setting:
        """Return what these values change; raises UserError where they cannot be, or no design is proven for them."""
        now = {**self.start, **values}
        if now.get("a_min", 0.0) > now.get("b_max", math.inf):
            raise UserError(f"a_min must not exceed b_max, found {now['a_min']} and {now['b_max']}")
        plain = {name: value for name, value in values.items() if name in self._plain}
        for name in NOISES:
            if name in values and not 0.0 < values[name] < math.inf:
                raise UserError(f"{name} must be positive and finite, found {values[name]:g}")
        if any(name in values for name in NOISES):
            plain |= self._kalman(now)
        design = self._design(values)
        return Setting(_entries({**self._design_start(design, now), **plain}), _entries(plain), design)

    def linear(self) -> dict[str, Value | str]:
        """Return the changes that make the controller the LC that its design was made from."""
        return {**_entries(self._design_start(self.design, self.start)), f"{CONTROLLER}.start.law": "LC"}

    def _design(self, values: Mapping[str, float]) -> Design | None:
        d = self.design
        if d is None or not self.redesigned:
            return d
        K = np.array([values.get(name, k) for name, k in zip(self.gains, d.K.ravel(), strict=True)]).reshape(d.K.shape)
        mu, u_max, alpha = values.get(MU, d.mu), values.get(U_MAX, float(d.u_max[0])), values.get(ALPHA, d.alpha)
        same = (mu, alpha) == (d.mu, d.alpha) and (d.K == K).all()
        solved = d if same else _solved(d, mu, alpha, tuple(K.ravel().tolist()))
        bounds = d.u_max * (u_max / d.u_max[0])
        return solved if (solved.u_max == bounds).all() else solved.scaled_to(u_max=bounds.tolist())

    def _design_start(self, design: Design | None, now: Mapping[str, float]) -> dict[str, Value]:
        """Return the start values that a design decides: of the pendulum all, of another what it changes."""
        if design is None or (design is self.design and not self.pendulum):
            return {}
        if not self.pendulum:
            n, m = design.n, design.system.m
            values: dict[str, Value] = {MU: design.mu}
            values |= {f"P_{i + 1}_{j + 1}": float(design.P[i, j]) for i in range(n) for j in range(i, n)}
            return values | {f"K_{i + 1}_{j + 1}": float(design.K[i, j]) for i in range(m) for j in range(n)}
        return design_start(design, now["voltage_limit"])

    def _kalman(self, values: Mapping[str, float]) -> dict[str, Value]:
        known = {**self.own, **values}
        options = replace(KalmanOptions(), **{name: values[name] for name in NOISES if name in values})
        return kalman_values(self._nominal(known), float(known["sample_time"]), options)

    @staticmethod
    def _nominal(values: Mapping[str, StartValue]) -> dict[str, Value]:
        return {name: float(value) for name, value in values.items() if name.startswith("nominal_")}


Place = tuple[Scenario, FilePath, FilePath | None]
"""A scenario, the folder of its FMUs, and its own."""


def controller_over(other: Place, base: Place) -> dict[str, Value | str]:
    """Return the changes of `base` that give its controller the parameters that it has in `other`, all but its law.

    Raises UserError where their controllers are not of one kind.
    """
    theirs, own = _own_values(*other), _own_values(*base)
    if theirs.keys() != own.keys() or (not is_controller(own) and theirs["sample_time"] != own["sample_time"]):
        raise UserError(
            f"--reference takes ENTRY=VALUE, or a scenario with the same kind of controller, found {other[0].name}"
        )
    path = files(*base).fmus[CONTROLLER]
    able = {v.name for v in describe(path).modelVariables if v.causality == "parameter"} - {"law", "sample_time"}
    return {
        f"{CONTROLLER}.start.{name}": value for name, value in theirs.items() if name in able and value != own[name]
    }


def _own_values(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> dict[str, StartValue]:
    """Return the start values of a scenario's controller: its FMU's, and what the scenario and its design give."""
    path = files(scenario, fmus, folder).fmus[CONTROLLER]
    components = build_system(scenario, fmus, folder).components
    return start_values_of(path) | dict(next(c.start for c in components if c.name == CONTROLLER))


def around(value: float, factors: tuple[float, float]) -> Range:
    """Return the range between two multiples of a value, to three digits."""
    return Range(*sorted(float(f"{factor * value:.3g}") for factor in factors))


@lru_cache(maxsize=256)  # a matrix inequality
def _solved(design: Design, mu: float, alpha: float, K: tuple[float, ...]) -> Design:
    system = design.system.changed(K=np.reshape(K, design.K.shape))
    return inverse_design(system, Options(mu=mu, alpha=alpha, u_max=design.u_max.tolist()))


def _entries(values: Mapping[str, Value]) -> dict[str, Value]:
    return {f"{CONTROLLER}.start.{name}": value for name, value in values.items()}


def ranges_over(texts: Sequence[str]) -> dict[str, Range]:
    """Return the ranges by names of `controller.NAME=LOW..HIGH`; UserError for another text and a name given twice."""
    ranges: dict[str, Range] = {}
    for text in texts:
        entry, equals, limits = text.partition("=")
        component, _, name = entry.strip().partition(".")
        if not equals or component != CONTROLLER or not name:
            raise UserError(f"--over takes controller.NAME=LOW..HIGH, found {text!r}")
        if name in ranges:
            raise UserError(f"--over names {entry.strip()} twice")
        ranges[name] = range_of(limits.strip(), f"--over {entry.strip()}")
    return ranges
