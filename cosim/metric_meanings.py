"""What the metrics of a run mean: names, symbols, units and sentences, as they follow from what the run is judged by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from .evaluation import SHARE, SWING_UP, Evaluation, pendulum_evaluation
from .unit_definitions import shown_unit

WINDOW = 3.0
"""The steady state is looked at over the last seconds of a run [s]."""
ZERO = 0.01
"""RMS |e| that counts as zero, in tolerances: what still decays there is steady. Of the pendulum a fifteenth of a count."""

Role = Literal["settling", "integral", "rms", "trend", "energy", "peak", "variation", "capture", "captures"]


@dataclass(frozen=True, slots=True)
class MetricMeaning:
    """A metric as tables, pictures and texts show it.

    `role` is what it says, `group` the numbers of the errors or controls that it is said of. `over_draws`: how it is
    averaged over draws, by its mean or its root mean square. `of_window`: it is a statement about the steady state.
    `never`: what NaN means; such a draw counts the run's duration. `zero`: what counts as zero.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    role: Role
    group: tuple[int, ...] = ()
    over_draws: Literal["mean", "rms"] = "mean"
    of_window: bool = False
    never: bool = False
    zero: float = 0.0

    @property
    def heading(self) -> str:
        """The symbol with its unit."""
        return f"{self.symbol} [{self.unit}]" if self.unit else self.symbol

    def text(self, value: float) -> str:
        """Return a value as text without its unit."""
        if math.isnan(value):
            return "never" if self.never else "–"
        if value < self.zero:
            return f"< {self.zero:g}" if self.zero > TINY else "0"
        return f"{value:.4g}"


TINY = 1e-100
"""A level below which an error that counts as zero is told as 0."""


@dataclass(frozen=True)
class _Words:
    """How a kind of system names its metrics."""

    integral: str = "integral_e2"
    peak: str = "peak"
    variation: str = "control_variation"
    norm: str = "e"


_WORDS = {"general": _Words(), "pendulum": _Words("integral_q2", "peak_voltage", "voltage_variation", "q")}


def squared(unit: str) -> str:
    """Return the square of a unit, empty where there is none."""
    shown = shown_unit(unit)
    return f"{shown}²" if shown.isalpha() else f"({shown})²" if shown else ""


@lru_cache(maxsize=64)
def quantities_of(evaluation: Evaluation) -> dict[str, MetricMeaning]:
    """Return every metric of a system by its name in files, in the order of tables."""
    words = _WORDS[evaluation.kind]
    groups = zip(evaluation.error_groups.items(), evaluation.settled, strict=True)
    errors = [_error_quantities(evaluation, words, suffix, group, within) for (suffix, group), within in groups]
    controls = [
        _control_quantities(evaluation, words, suffix, group) for suffix, group in evaluation.control_groups.items()
    ]
    meanings = [q for some in (*errors, *controls) for q in some]
    if evaluation.mode is not None and evaluation.mode.value(SWING_UP) is not None:
        meanings += [
            MetricMeaning("capture_time", "capture", "s", "the stabilizing law first acts", "capture", never=True),
            MetricMeaning("captures", "captures", "", "how often the stabilizing law took over", "captures"),
        ]
    return {q.name: q for q in meanings}


def _error_quantities(
    evaluation: Evaluation, words: _Words, suffix: str, group: tuple[int, ...], tolerance: float | None
) -> list[MetricMeaning]:
    unit = evaluation.error_unit(group)
    shown = shown_unit(unit)
    e = f"|{words.norm}|" if not suffix else f"|{words.norm} {evaluation.errors[group[0]].name}|"
    of = f" {e}" if suffix else ""
    within = f"{100 * SHARE:g} % of its largest" if tolerance is None else f"{tolerance:g} {shown}".rstrip()
    return [
        MetricMeaning(
            f"settling_time{suffix}",
            f"settling{of}",
            "s",
            f"from then on {e} ≤ {within} to the end of the run",
            "settling",
            group,
            never=True,
        ),
        MetricMeaning(
            f"{words.integral}{suffix}",
            f"∫{e}² dt",
            f"{squared(unit)} s".strip(),
            "over the run, by the trapezoidal rule",
            "integral",
            group,
        ),
        MetricMeaning(
            f"steady_rms{suffix}",
            f"steady RMS {e}",
            shown,
            f"over the last {WINDOW:g} s",
            "rms",
            group,
            over_draws="rms",
            of_window=True,
            zero=0.0 if tolerance is None else ZERO * tolerance,
        ),
        MetricMeaning(
            f"steady_trend{suffix}",
            f"steady trend{of}",
            "",
            f"RMS of {e} in the window's first half over that in its second; 1: steady",
            "trend",
            group,
        ),
    ]


def _control_quantities(
    evaluation: Evaluation, words: _Words, suffix: str, group: tuple[int, ...]
) -> list[MetricMeaning]:
    unit = evaluation.controls[group[0]].unit
    shown = shown_unit(unit)
    names = [evaluation.controls[k].name for k in group]
    pendulum = evaluation.kind == "pendulum"
    one = "V" if pendulum else names[0] if len(group) == 1 else "u"
    called = "voltage" if pendulum else one if len(group) == 1 else "controls"
    energy = f"∫{one}² dt" if len(group) == 1 else "∫Σu² dt"
    held = "voltage" if pendulum else "controls"
    peaks = [
        MetricMeaning(
            f"{words.peak}{suffix if len(group) == 1 else f'[{evaluation.controls[k].signal}]'}",
            f"peak |{'V' if pendulum else evaluation.controls[k].name}|",
            shown,
            "over the run",
            "peak",
            (k,),
        )
        for k in group
    ]
    return [
        MetricMeaning(
            f"energy{suffix}",
            energy,
            f"{squared(unit)} s".strip(),
            f"over the run, exact for the held {held}",
            "energy",
            group,
        ),
        *peaks,
        MetricMeaning(
            f"{words.variation}{suffix}",
            f"variation of {one}",
            f"{shown or '1'}/s",
            f"total variation of the {called} per second over the last {WINDOW:g} s, the measure of chattering",
            "variation",
            group,
            of_window=True,
        ),
    ]


QUANTITIES = quantities_of(pendulum_evaluation({}))
"""The pendulum's metrics by their names in files."""


def is_pendulum(quantities: Mapping[str, MetricMeaning]) -> bool:
    """Return whether these are the pendulum's metrics."""
    return quantities == QUANTITIES


def kept_words(quantities: Mapping[str, MetricMeaning]) -> str:
    """Return what a law does in the runs that count."""
    return "kept upright" if is_pendulum(quantities) else "acting to the end"


def lost_words(quantities: Mapping[str, MetricMeaning]) -> str:
    """Return what a law does in the others."""
    return "pendulum lost" if is_pendulum(quantities) else "law not acting to the end"


def measure_of(quantities: Mapping[str, MetricMeaning], role: Role) -> MetricMeaning:
    """Return the first metric of a role."""
    return next(q for q in quantities.values() if q.role == role)
