"""What can be said from draws: means and changes with their intervals, and how they are written."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ihc_fmu.arrays import QUIET

from ..metric_meanings import MetricMeaning

Array = np.ndarray

CONFIDENCE = 0.95


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


@dataclass(frozen=True)
class Share:
    """In how many of `draws` pairs the one law was the better one; `low`, `high`: Wilson's interval."""

    wins: int
    draws: int

    @property
    def value(self) -> float:
        """The share; NaN without draws."""
        return self.wins / self.draws if self.draws else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval of the share (Wilson's score interval); (0, 1) without draws."""
        if not self.draws:
            return 0.0, 1.0
        from scipy.stats import binomtest  # noqa: PLC0415 - heavy

        interval = binomtest(self.wins, self.draws).proportion_ci(CONFIDENCE, method="wilson")
        return float(interval.low), float(interval.high)

    @property
    def decided(self) -> int:
        """The sign of the share less one half where the interval excludes one half, otherwise 0."""
        low, high = self.interval
        return int(low > 0.5) - int(high < 0.5)

    def __str__(self) -> str:
        if not self.draws:
            return "no draw decides"
        low, high = self.interval
        return f"{self.wins} of {self.draws} ({100 * low:.0f} to {100 * high:.0f} %)"


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


def change_of(values: Array, base: Array, q: MetricMeaning) -> MeanEstimate:
    """Return the change of a metric's mean over `base`, from the same draws; NaN where both errors at rest count as zero."""
    if q.over_draws != "rms":
        return change(values, base)
    if len(values) and all(math.sqrt(np.mean(of**2)) < q.zero for of in (values, base)):
        return MeanEstimate(math.nan)
    return rms_change(values, base)


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
    shown = shown if any(digit in shown for digit in "123456789") else "0"
    return f"{shown} ± {factor * half:.{digits}f}{unit} {VERDICTS[estimate.decided]}"


LEAST_INTERVAL = 5e-4
"""Half width of a change's interval, in percent or of a factor, below which none is shown: draws that are all alike."""
VERDICTS = {1: "worse", 0: "open", -1: "better"}
"""What the sign of a decided change means."""
