"""Draws of what a measurement leaves open, the same for every controller, and what can be said from them.

The encoders' sub-count offsets decide the steady state so strongly that a few random ones rank controllers by luck. They
are taken from a Sobol set, which covers the unit cube evenly with any number of points, best with a power of two.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ihc_fmu.arrays import QUIET

from .scenario import Scenario
from .start_values import StartValue, StartValues

Array = np.ndarray

SEED = 1
"""Seed of the scrambling of the Sobol set."""

CONFIDENCE = 0.95

OFFSETS = ("_encoder_offset", "_resolution_offset")
"""How the names of parameters end that say where inside a count a sensor was zeroed, in counts.

A sensor `y` whose parameter `y_resolution` is 0 does not count, so that its offset means nothing.
"""


@dataclass(frozen=True, slots=True)
class Chance:
    """What of a plant is drawn: its encoder offsets by their names, and whether it has noise with a seed."""

    offsets: tuple[str, ...] = ("theta_encoder_offset", "delta_encoder_offset")
    noise: bool = True

    def __bool__(self) -> bool:
        return bool(self.offsets) or self.noise


PENDULUM = Chance()


def random_measurement(own: StartValues, seed: int) -> dict[str, StartValue]:
    """Return encoder offsets drawn uniformly inside a count, and the noise's seed, for a seed of the run.

    `own` are all start values of the plant; nothing is drawn of one that has neither.
    """
    names = offsets(own)
    values = np.random.default_rng(seed).random(len(names))
    drawn_values: dict[str, StartValue] = {name: float(value) for name, value in zip(names, values, strict=True)}
    return drawn_values | ({"noise_seed": seed} if "noise_seed" in own else {})


def offsets(own: StartValues) -> list[str]:
    """Return the names of the offsets of a plant's sensors that count, in the order of its variables."""
    return [name for name in own if name.endswith(OFFSETS) and own.get(name.removesuffix("_offset")) != 0.0]


def chance_of(own: StartValues) -> Chance:
    """Return what is drawn of a plant FMU with these start values; false where nothing is."""
    return Chance(tuple(offsets(own)), "noise_seed" in own)


@lru_cache(maxsize=8)
def encoder_offsets(count: int, encoders: int = 2) -> tuple[tuple[float, ...], ...]:
    """Return the first `count` points of a scrambled Sobol sequence in the unit cube: an offset for each encoder.

    More points begin with the same ones.
    """
    from scipy.stats import qmc  # noqa: PLC0415 - heavy

    generator = np.random.default_rng(SEED)
    sobol = qmc.Sobol(encoders, scramble=True, seed=generator)  # type: ignore[call-arg] # `rng` from SciPy 1.15 on, which takes both
    points = sobol.random_base2(math.ceil(math.log2(count)))
    return tuple(tuple(map(float, point)) for point in points[:count])


def drawn(scenario: Scenario, draw: int, chance: Chance = PENDULUM) -> Scenario:
    """Return the scenario of a draw, counted from 1: its encoder offsets, its seed of the noise.

    What the scenario itself sets of these stays.
    """
    size = 1 << (draw - 1).bit_length()  # so that one set serves many draws
    point = encoder_offsets(size, len(chance.offsets))[draw - 1] if chance.offsets else ()
    values: dict[str, StartValue] = dict(zip(chance.offsets, point, strict=True))
    if chance.noise:
        values["noise_seed"] = draw
    changes = {f"plant.start.{name}": value for name, value in values.items() if name not in scenario.plant.start}
    return scenario.changed({**changes, "run.seed": None})


@dataclass(frozen=True, slots=True)
class MeanEstimate:
    """A mean over draws and the half width of its 95 % confidence interval (Student); NaN for a single draw.

    The points of a Sobol set are more even than independent ones, for which the interval is right: it is on the safe side.
    """

    value: float
    half_width: float = math.nan

    @property
    def decided(self) -> int:
        """The sign of the value where the interval excludes 0, otherwise 0."""
        return int(math.copysign(1, self.value)) if abs(self.value) > self.half_width else 0


@QUIET
def mean(values: Array) -> MeanEstimate:
    """Return the mean of `values`; NaN without any."""
    return MeanEstimate(float(np.mean(values)), _half_width(values)) if len(values) else MeanEstimate(math.nan)


def root_mean_square(values: Array) -> MeanEstimate:
    """Return the root mean square of `values`, its interval by the delta method from that of the mean square."""
    square = mean(np.asarray(values) ** 2)
    root = math.sqrt(square.value)
    return MeanEstimate(root, square.half_width / (2.0 * root) if root else square.half_width)


@QUIET
def change(values: Array, base: Array) -> MeanEstimate:
    """Return mean(values) / mean(base) - 1 of pairs from the same draws, its interval by the delta method.

    The pairs' differences decide the interval, so that what a draw does to both controllers cancels. NaN where the base's
    mean is 0 or there is no pair.
    """
    below = float(np.mean(base)) if len(base) else 0.0
    if below == 0.0:
        return MeanEstimate(math.nan)
    ratio = float(np.mean(values)) / below
    return MeanEstimate(ratio - 1.0, _half_width(values - ratio * base) / abs(below))


def rms_change(values: Array, base: Array) -> MeanEstimate:
    """Return RMS(values) / RMS(base) - 1 of pairs from the same draws, as `change`."""
    squares = change(values**2, base**2)
    ratio = math.sqrt(1.0 + squares.value)
    return MeanEstimate(ratio - 1.0, squares.half_width / (2.0 * ratio) if ratio else squares.half_width)


def _half_width(values: Array) -> float:
    from scipy.stats import t  # noqa: PLC0415 - heavy

    count = len(values)
    if count < 2:
        return math.nan
    return float(t.ppf(0.5 + CONFIDENCE / 2, count - 1) * np.std(values, ddof=1) / math.sqrt(count))


def estimate_text(estimate: MeanEstimate, text: Callable[[float], str]) -> str:
    """Return a mean and the half width of its interval, with the digits that the interval leaves."""
    value, half = estimate.value, estimate.half_width
    if math.isnan(value) or math.isnan(half) or half <= 1e-9 * abs(value) or text(value).startswith("<"):
        return text(value)
    digits = decimals(half)
    return f"{value:.{digits}f} ± {half:.{digits}f}"


def decimals(half_width: float) -> int:
    """Return the decimals that show the half width of an interval to one digit, to two where the first would be a 1."""
    power = math.floor(math.log10(half_width))
    return max(0, -power + (half_width < 1.95 * 10.0**power))


def change_text(estimate: MeanEstimate) -> str:
    """Return a change in percent, or a factor from 10 on; its interval; and whether it is decided, smaller being better."""
    value, half = estimate.value, estimate.half_width
    if math.isnan(value):
        return "–"
    if abs(value) < 1e-12 and not half > 1e-12:
        return "equal"
    factor, unit = (1.0, "") if value > 9.0 else (100.0, " %")
    shown = f"× {1.0 + value:.3g}" if value > 9.0 else f"{100.0 * value:+.3g}"
    if math.isnan(half):
        return shown + unit
    if factor * half < LEAST_INTERVAL:
        return f"{shown}{unit} {VERDICTS[estimate.decided]}"
    digits = min(3, decimals(factor * half))
    shown = f"× {1.0 + value:.{digits}f}" if value > 9.0 else f"{100.0 * value:+.{digits}f}"
    return f"{shown} ± {factor * half:.{digits}f}{unit} {VERDICTS[estimate.decided]}"


LEAST_INTERVAL = 5e-4
"""Half width of a change's interval, in percent or of a factor, below which none is shown: draws that are all alike."""
VERDICTS = {1: "worse", 0: "open", -1: "better"}
"""What the sign of a decided change means."""
