"""Numbers that judge a run, from a result of whatever origin: simulation or device."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from typing import Literal

import numpy as np

from .errors import UserError
from .results import Result

Array = np.ndarray

STABILIZING = 3
"""Value of the controller's output `mode` while the stabilizing law acts."""


TOLERANCE = 0.02
"""|q| within which the pendulum counts as settled [rad]."""

WINDOW = 3.0
"""The steady state is looked at over the last seconds of a run [s]."""

PARTS = 6
"""Into how many parts the window is divided to look for a trend."""

SURE, MATERIAL = 2.0, 1.1
"""Ratios of RMS |q| in the window's halves: a trend on its own; too small to matter."""

TREND_T = 3.747
"""Student's t of a trend's slope that happens by chance in 2 % of stationary windows (two-sided, PARTS - 2 degrees)."""

ZERO = 0.01 * TOLERANCE
"""RMS |q| that counts as zero: what still decays there is steady [rad]. A fifteenth of a count of the encoders."""


@dataclass(frozen=True)
class Metrics:
    """What the comparison shows. |q| = hypot(theta, delta), delta wrapped to (-pi, pi]; QUANTITIES has symbols and units.

    settling_time [s]: |q| stays within the tolerance from then on; NaN where it does not. integral_q2 [rad^2 s]: integral
    of |q|^2 over the run. steady_rms [rad]: RMS of |q| over the window, the last seconds. steady_trend [1]: how many times
    it falls from the window's first half to its second; exactly 1 where it is steady (`trend`), NaN where that cannot be
    said. energy [V^2 s]: integral of V^2. peak_voltage [V]. voltage_variation [V/s]: total variation of V per second over
    the window, the measure of chattering; NaN where the result does not have every row. capture_time [s]: the stabilizing
    law first acts; NaN where it never does. captures: how often it took over.
    """

    settling_time: float
    integral_q2: float
    steady_rms: float
    steady_trend: float
    energy: float
    peak_voltage: float
    voltage_variation: float
    capture_time: float
    captures: int

    @property
    def steady(self) -> bool:
        """Whether the window is a steady state; otherwise steady_rms and voltage_variation are partly a transient's."""
        return self.steady_trend == 1.0

    def as_dict(self) -> dict[str, float]:
        """Return the numbers by name; NaN as None's JSON-safe stand-in is left to the caller."""
        return asdict(self)


NAMES = tuple(f.name for f in fields(Metrics))


@dataclass(frozen=True, slots=True)
class Quantity:
    """A metric as tables, pictures and texts show it.

    `over_draws`: how it is averaged over draws, by its mean or its root mean square. `of_window`: it is a statement about
    the steady state. `never`: what NaN means; such a draw counts the run's duration in a mean.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    over_draws: Literal["mean", "rms"] = "mean"
    of_window: bool = False
    never: bool = False

    @property
    def heading(self) -> str:
        """The symbol with its unit."""
        return f"{self.symbol} [{self.unit}]" if self.unit else self.symbol

    def text(self, value: float) -> str:
        """Return a value as text without its unit."""
        if math.isnan(value):
            return "never" if self.never else "–"
        if self.name == "steady_rms" and value < ZERO:
            return f"< {ZERO:g}"
        return f"{value:.4g}"


QUANTITIES = {
    q.name: q
    for q in (
        Quantity(
            "settling_time", "settling", "s", f"from then on |q| ≤ {TOLERANCE:g} rad to the end of the run", never=True
        ),
        Quantity("integral_q2", "∫|q|² dt", "rad² s", "over the run, by the trapezoidal rule"),
        Quantity(
            "steady_rms", "steady RMS |q|", "rad", f"over the last {WINDOW:g} s", over_draws="rms", of_window=True
        ),
        Quantity(
            "steady_trend",
            "steady trend",
            "",
            "RMS of |q| in the window's first half over that in its second; 1: steady",
        ),
        Quantity("energy", "∫V² dt", "V² s", "over the run, exact for the held voltage"),
        Quantity("peak_voltage", "peak |V|", "V", "over the run"),
        Quantity(
            "voltage_variation",
            "variation of V",
            "V/s",
            f"total variation of the voltage per second over the last {WINDOW:g} s, the measure of chattering",
            of_window=True,
        ),
        Quantity("capture_time", "capture", "s", "the stabilizing law first acts", never=True),
        Quantity("captures", "captures", "", "how often the stabilizing law took over"),
    )
}
"""Every metric by its name in files: the one table of symbols and units."""


def trend(time: Array, q: Array, window: float = WINDOW) -> float:
    """Return how many times RMS |q| falls from the first half of the last `window` [s] to the second; 1 where it is steady.

    A window is steady unless the ratio of the two is
    - at least SURE, or at most its inverse: no stationary |q| that this loop shows does that; or
    - at least MATERIAL, or at most its inverse, and the logarithms of the mean squares of PARTS equal parts have a slope
      of that sign with Student's t above TREND_T: a trend against what scatters about it (an exponential has no scatter).
    ZERO^2 is added to each mean square, so that what decays below that counts as zero. NaN where the run
    is shorter than the window, has less than two rows for each part, or a |q| that is not finite.
    """
    late = q[time >= time[-1] - window]
    if time[-1] - time[0] < window * (1.0 - 1e-9) or len(late) < 2 * PARTS or not np.all(np.isfinite(late)):
        return math.nan
    parts = np.array([np.mean(part**2) for part in np.array_split(late, PARTS)]) + ZERO**2
    ratio = math.sqrt(float(np.sum(parts[: PARTS // 2]) / np.sum(parts[PARTS // 2 :])))
    if max(ratio, 1.0 / ratio) < MATERIAL:
        return 1.0
    x, y = np.arange(PARTS) - (PARTS - 1) / 2, np.log(parts)
    slope = float(x @ y / (x @ x))
    scatter = float(np.sum((y - np.mean(y) - slope * x) ** 2)) / (PARTS - 2)
    significant = slope * slope * float(x @ x) > TREND_T**2 * scatter and (slope < 0.0) == (ratio > 1.0)
    return ratio if significant or max(ratio, 1.0 / ratio) >= SURE else 1.0


def unsteady(metrics: Metrics) -> str:
    """Return in a sentence why the window is no steady state; empty where it is one."""
    if metrics.steady:
        return ""
    if math.isnan(metrics.steady_trend):
        return f"no steady state can be told: the run is shorter than {WINDOW:g} s, or has too few rows there"
    falls = metrics.steady_trend > 1.0
    times = metrics.steady_trend if falls else 1.0 / metrics.steady_trend
    return (
        f"no steady state: over the last {WINDOW:g} s RMS |q| {'falls' if falls else 'grows'} {times:.3g} times "
        "from half to half; a longer run would tell"
    )


def wrapped(angle: Array) -> Array:
    """Return angles [rad] wrapped to (-pi, pi]."""
    return -((math.pi - angle) % (2.0 * math.pi) - math.pi)


def missing_signals(known: Iterable[str]) -> list[str]:
    """Return which signals the metrics need besides the `known` ones."""
    there = set(known)
    missing = [name for name in ("controller.voltage", "controller.mode") if name not in there]
    pairs = [[f"plant.{a}{suffix}" for a in ("theta", "delta")] for suffix in ("_encoder", "")]
    return missing + min(([name for name in pair if name not in there] for pair in pairs), key=len)


def can_evaluate(result: Result) -> bool:
    """Return whether `result` has the signals that the metrics need."""
    if missing_signals(result.signals):
        return False
    mode = result["controller.mode"]
    return bool(np.all(np.isfinite(mode)) and np.array_equal(mode, np.rint(mode)))  # another's may be anything


def angle_norm(result: Result) -> Array:
    """Return |q| [rad] at each row: of the true angles where the result has them, of the measured ones otherwise."""
    for suffix in ("", "_encoder"):
        names = [f"plant.{angle}{suffix}" for angle in ("theta", "delta")]
        if all(name in result.signals for name in names):
            return np.hypot(result[names[0]], wrapped(result[names[1]]))
    raise UserError("the result has neither plant.theta and plant.delta nor the encoders' angles")


def settling_time(time: Array, q: Array, tolerance: float) -> float:
    """Return the time from which |q| <= tolerance to the end of the run [s]; NaN where the last row exceeds it."""
    outside = np.flatnonzero(q > tolerance)
    if not outside.size:
        return float(time[0])
    return float(time[outside[-1] + 1]) if outside[-1] + 1 < len(time) else math.nan


def takeovers(mode: Array) -> Array:
    """Return the rows at which the stabilizing law takes over, from the controller's output `mode`."""
    stabilizing = mode == STABILIZING
    return np.flatnonzero(stabilizing & ~np.concatenate([[False], stabilizing[:-1]]))


def kept_upright(result: Result) -> bool:
    """Return whether the stabilizing law took over once and acts at the end."""
    mode = result["controller.mode"]
    return takeovers(mode).size == 1 and bool(mode[-1] == STABILIZING)


def variation_rate(time: Array, signal: Array) -> float:
    """Return the total variation of a sampled signal per second, sum |s_k - s_{k-1}| / (t_n - t_1); NaN for one row."""
    return float(np.sum(np.abs(np.diff(signal))) / (time[-1] - time[0])) if len(time) > 1 else math.nan


def has_every_row(result: Result) -> bool:
    """Return whether rows are a communication step apart, as far as the result says how long a step is."""
    step = result.metadata.get("step")
    return not isinstance(step, int | float) or float(np.median(np.diff(result.time))) < 1.5 * step


def evaluate(result: Result, tolerance: float = TOLERANCE, steady: float = WINDOW) -> Metrics:
    """Return the metrics of `result`; `tolerance` [rad] defines settling, `steady` [s] the window at the end.

    Integrals are sums over the steps: |q|^2 by the trapezoidal rule, V^2 exactly, since the voltage of a row was held
    over the step that ended there. Raises UserError for a result without the signals or with fewer than two rows.
    """
    time = result.time
    if len(time) < 2:
        raise UserError(f"metrics need at least two rows, found {len(time)}")
    q, voltage, mode = angle_norm(result), result["controller.voltage"], result["controller.mode"]
    captures = takeovers(mode)
    late = time >= time[-1] - steady
    return Metrics(
        settling_time=settling_time(time, q, tolerance),
        integral_q2=float(np.trapezoid(q**2, time)),
        steady_rms=float(np.sqrt(np.mean(q[late] ** 2))),
        steady_trend=trend(time, q, steady),
        energy=float(np.sum(voltage[1:] ** 2 * np.diff(time))),
        peak_voltage=float(np.max(np.abs(voltage))),
        voltage_variation=variation_rate(time[late], voltage[late]) if has_every_row(result) else math.nan,
        capture_time=float(time[captures[0]]) if captures.size else math.nan,
        captures=int(captures.size),
    )
