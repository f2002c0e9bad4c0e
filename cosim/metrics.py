"""Numbers that judge a run, from a result of whatever origin: simulation or device, of whatever system.

What is judged is the result's own word, see `evaluation`: errors with their set-points, controls, modes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ihc_fmu.arguments import check_kind
from ihc_fmu.arrays import QUIET

from .errors import UserError
from .evaluation import ACTING, SHARE, TOLERANCE, Evaluation
from .judged_signals import check_angles, error_norm, evaluation_in, missing_signals, takeovers
from .metric_meanings import WINDOW, ZERO, MetricMeaning, measure_of, quantities_of
from .recording import Recording

Array = np.ndarray

LEAST = 1e-300
"""Tolerance of an |e| that stays 0."""
PARTS = 6
"""Into how many parts the window is divided to look for a trend."""

SURE, MATERIAL = 2.0, 1.1
"""Ratios of RMS |e| in the window's halves: a trend on its own; too small to matter."""

TREND_T = 3.747
"""Student's t of a trend's slope that happens by chance in 2 % of stationary windows (two-sided, PARTS - 2 degrees)."""


@dataclass(frozen=True)
class Metrics:
    """What a run is judged by, as numbers with names; each is an attribute too. |e| is the norm of the errors of one group.

    ==================== ==============================================================================================
    `settling_time` [s]  from when on |e| stays within the tolerance; NaN where it does not
    `integral_e2`        integral of abs(e)^2 over the run
    `steady_rms`         RMS of |e| over the window, the last seconds
    `steady_trend` [1]   how many times it falls from the window's first half to its second; exactly 1 where it is steady,
                         NaN where that cannot be said
    `energy`             integral of the sum of u^2
    `peak`               largest |u|
    `control_variation`  total variation of the controls per second over the window, the measure of chattering; NaN where
                         the result does not have every row
    `capture_time` [s]   where the controller first brings the plant to where the law can act: when the law first acts
    `captures`           how often it took over
    ==================== ==============================================================================================

    Of the pendulum `integral_q2`, `peak_voltage` and `voltage_variation` are the names.

    Parameters
    ----------
    values
        The numbers by name.
    quantities
        What they mean: symbol, unit, role.

    Examples
    --------
    >>> import cosim
    >>> metrics = cosim.evaluate(cosim.run("fmus/arm.ssp", {"plant.start.angle_0": 0.1, "run.duration": 3.0}))
    >>> round(metrics.peak, 2), metrics.steady
    (1.37, False)
    >>> metrics.as_dict()["peak"] == metrics.peak
    True
    >>> metrics.quantities["peak"].heading
    'peak |u1|'
    """

    values: Mapping[str, float]
    quantities: Mapping[str, MetricMeaning]

    def __getattr__(self, name: str) -> float:
        try:
            return object.__getattribute__(self, "values")[name]
        except KeyError:
            raise AttributeError(f"there is no metric {name!r}") from None

    @property
    def steady(self) -> bool:
        """Whether the window is a steady state; otherwise what is said of it is partly a transient's."""
        return all(self.values[q.name] == 1.0 for q in self.quantities.values() if q.role == "trend")

    def as_dict(self) -> dict[str, float]:
        """Return the numbers by name, NaN for those that are not there.

        Returns
        -------
        dict[str, float]
            A copy of `values`.
        """
        return dict(self.values)


@QUIET
def trend(time: Array, e: Array, window: float = WINDOW, zero: float = ZERO * TOLERANCE) -> float:
    """Return how many times RMS |e| falls from the first half of the last `window` [s] to the second; 1 where it is steady.

    A window is steady unless the ratio of the two is
    - at least SURE, or at most its inverse: no stationary |e| that this loop shows does that; or
    - at least MATERIAL, or at most its inverse, and the logarithms of the mean squares of PARTS equal parts have a slope
      of that sign with Student's t above TREND_T: a trend against what scatters about it (an exponential has no scatter).
    zero^2 is added to each mean square, so that what decays below that counts as zero. NaN where the run
    is shorter than the window, has less than two rows for each part, or a |e| that is not finite or has no finite
    square.
    """
    late = e[first_of_window(time, window) :]
    if time[-1] - time[0] < window * (1.0 - 1e-9) or len(late) < 2 * PARTS or not np.all(np.isfinite(late)):
        return math.nan
    size, larger = divmod(len(late), PARTS)  # the first ones have a row more, as of np.array_split
    squares, end = late**2, larger * (size + 1)
    blocks = squares[:end].reshape(larger, size + 1), squares[end:].reshape(PARTS - larger, size)
    parts = np.concatenate([np.mean(block, axis=1) for block in blocks]) + np.float64(zero) ** 2
    if not np.isfinite(np.sum(parts)):
        return math.nan
    first, second = np.sum(parts[: PARTS // 2]), np.sum(parts[PARTS // 2 :])
    ratio = 1.0 if first == second else math.sqrt(float(first / second))  # 0 and infinity where one of them is 0

    def beyond(bound: float) -> bool:
        return ratio >= bound or ratio * bound <= 1.0

    if not beyond(MATERIAL):
        return 1.0
    x, y = np.arange(PARTS) - (PARTS - 1) / 2, np.log(parts)
    slope = float(x @ y / (x @ x))
    scatter = float(np.sum((y - np.mean(y) - slope * x) ** 2)) / (PARTS - 2)
    significant = slope * slope * float(x @ x) > TREND_T**2 * scatter and (slope < 0.0) == (ratio > 1.0)
    return ratio if significant or beyond(SURE) else 1.0


def first_of_window(time: Array, window: float) -> int:
    """Return the first row of the last `window` [s]."""
    return int(np.argmax(time >= time[-1] - window))


def unsteady(metrics: Metrics) -> str:
    """Return in a sentence why the window is no steady state; empty where it is one."""
    if metrics.steady:
        return ""
    trends = {q.symbol: metrics.values[q.name] for q in metrics.quantities.values() if q.role == "trend"}
    symbol, ratio = next((symbol, value) for symbol, value in trends.items() if value != 1.0)
    if math.isnan(ratio):
        return f"no steady state can be told: the run is shorter than {WINDOW:g} s, or has too few rows there"
    times = ratio if ratio > 1.0 else 1.0 / ratio
    e = symbol.removeprefix("steady trend").strip() or measure_of(metrics.quantities, "rms").symbol.split()[-1]
    return (
        f"no steady state: over the last {WINDOW:g} s RMS {e} {'falls' if ratio > 1.0 else 'grows'} {times:.3g} times "
        "from half to half; a longer run would tell"
    )


def settling_time(time: Array, q: Array, tolerance: float) -> float:
    """Return the time from which |q| <= tolerance to the end of the run [s]; NaN where the last row exceeds it."""
    outside = np.flatnonzero(~(q <= tolerance))
    if not outside.size:
        return float(time[0])
    return float(time[outside[-1] + 1]) if outside[-1] + 1 < len(time) else math.nan


def variation_rate(time: Array, signal: Array) -> float:
    """Return the total variation of a sampled signal per second, sum |s_k - s_{k-1}| / (t_n - t_1); NaN for one row."""
    return float(np.sum(np.abs(np.diff(signal))) / (time[-1] - time[0])) if len(time) > 1 else math.nan


def has_every_row(result: Recording) -> bool:
    """Return whether rows are a communication step apart, as far as the result says how long a step is."""
    step = result.metadata.get("step")
    return not isinstance(step, int | float) or float(result.time[-1] - result.time[0]) < 1.5 * step * (
        len(result.time) - 1
    )


def evaluate(result: Recording, tolerance: float | None = None, steady: float = WINDOW) -> Metrics:
    """Judge a result by its errors and controls.

    Integrals are sums over the steps: |e|^2 by the trapezoidal rule, u^2 exactly, since the control of a row was held
    over the step that ended there.

    Parameters
    ----------
    result
        A run or a measurement; its metadata say what is judged (`evaluation`).
    tolerance
        Within which |e| is settled, in its unit; None: the result's own, else 2 % of the largest |e|.
    steady
        Length of the window at the end [s].

    Returns
    -------
    Metrics
        The numbers and what they mean.

    Raises
    ------
    UserError
        For a result without the signals, or with fewer than two rows.

    Examples
    --------
    >>> import cosim
    >>> result = cosim.run("fmus/arm.ssp", {"plant.start.angle_0": 0.1, "run.duration": 3.0})
    >>> metrics = cosim.evaluate(result)
    >>> print(f"{metrics.values['settling_time[plant.angle]']:.2f} s")
    1.48 s
    """
    check_kind("result", result, Recording, "a Result")
    if len(result.time) < 2:
        raise UserError(f"metrics need at least two rows, found {len(result.time)}")
    evaluation = evaluation_in(result)
    _check(result, evaluation)
    return _judged(result, with_tolerances(result, evaluation), tolerance, steady)


def evaluate_alike(results: Mapping[str, Recording]) -> dict[str, Metrics]:
    """Return the metrics of results that are held against each other: a tolerance that none names is the widest of all.

    Raises UserError as `evaluate`, and for results that are judged by different signals.
    """
    evaluations = {name: evaluation_in(result) for name, result in results.items()}
    for name, evaluation in evaluations.items():
        _check(results[name], evaluation)
    whole = {name: with_tolerances(results[name], evaluation) for name, evaluation in evaluations.items()}
    if len({len(evaluation.settled) for evaluation in whole.values()}) == 1:
        widest = tuple(
            max(column) for column in zip(*(evaluation.settled for evaluation in whole.values()), strict=True)
        )
        for name, evaluation in evaluations.items():
            if None in evaluation.settled:
                whole[name] = evaluation.model_copy(update={"tolerances": widest})
    judged = {name: _judged(results[name], evaluation) for name, evaluation in whole.items()}
    quantities = next(iter(judged.values())).quantities
    other = next((name for name, m in judged.items() if m.quantities != quantities), None)
    if other is not None:
        raise UserError(f"results side by side must be judged by the same signals, and {other} is judged by others")
    return judged


def _check(result: Recording, evaluation: Evaluation) -> None:
    """Raise UserError where a result lacks what it is judged by."""
    missing = missing_signals(result.signals, evaluation)
    if evaluation.kind == "pendulum":
        check_angles(result, evaluation)  # says which pairs of angles would do
    if missing:
        raise UserError(f"the result has no signal {missing[0]!r}; it has {', '.join(result.signals)}")


@QUIET
def _judged(
    result: Recording, evaluation: Evaluation, tolerance: float | None = None, steady: float = WINDOW
) -> Metrics:
    judge = _Judge(result, evaluation, tolerance, steady)
    quantities = quantities_of(evaluation)
    return Metrics({name: judge.number(q) for name, q in quantities.items()}, quantities)


def with_tolerances(result: Recording, evaluation: Evaluation) -> Evaluation:
    """Return what a result is judged by with tolerances: SHARE of each group's largest |e| in it, where there are none."""
    if None not in evaluation.settled:
        return evaluation
    norms = [error_norm(result, evaluation, group) for group in evaluation.error_groups.values()]
    largest = [float(np.max(e, where=np.isfinite(e), initial=0.0)) for e in norms]
    return evaluation.model_copy(update={"tolerances": tuple(max(float(f"{SHARE * e:.2g}"), LEAST) for e in largest)})


class _Judge:
    """A result with its errors' norms and controls at hand."""

    def __init__(self, result: Recording, evaluation: Evaluation, tolerance: float | None, steady: float) -> None:
        self.time, self.steady = result.time, steady
        self.own = dict(zip(evaluation.error_groups.values(), map(float, evaluation.settled), strict=True))  # type: ignore[arg-type]
        self.settled = self.own if tolerance is None else dict.fromkeys(self.own, tolerance)
        self.late = slice(first_of_window(self.time, steady), None)
        self.norms = {group: error_norm(result, evaluation, group) for group in evaluation.error_groups.values()}
        self.controls = [np.asarray(result[control.signal]) for control in evaluation.controls]
        self.every_row = has_every_row(result)
        acts = None if evaluation.mode is None else evaluation.mode.value(ACTING)
        self.captures = np.zeros(0, int)
        if evaluation.mode is not None and acts is not None:
            self.captures = takeovers(result[evaluation.mode.signal], acts)

    def number(self, q: MetricMeaning) -> float:
        """Return the value of a metric."""
        if q.role == "capture":
            return float(self.time[self.captures[0]]) if self.captures.size else math.nan
        if q.role == "captures":
            return int(self.captures.size)
        if q.role in ("energy", "peak", "variation"):
            return self._of_controls(q)
        return self._of_errors(q, self.norms[q.group])

    def _of_errors(self, q: MetricMeaning, e: Array) -> float:
        if q.role == "settling":
            return settling_time(self.time, e, self.settled[q.group])
        if q.role == "integral":
            return float(np.trapezoid(e**2, self.time))
        if q.role == "rms":
            return float(np.sqrt(np.mean(e[self.late] ** 2)))
        return trend(self.time, e, self.steady, ZERO * self.own[q.group])

    def _of_controls(self, q: MetricMeaning) -> float:
        some = [self.controls[k] for k in q.group]
        if q.role == "peak":
            return max(float(np.max(np.abs(u))) for u in some)
        if q.role == "energy":
            return sum(float(np.sum(u[1:] ** 2 * np.diff(self.time))) for u in some)
        if not self.every_row:
            return math.nan
        return sum(variation_rate(self.time[self.late], u[self.late]) for u in some)
