"""Numbers that judge a run, from a result of whatever origin: simulation or device."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields

import numpy as np

from .errors import UserError
from .results import Result

Array = np.ndarray

STABILIZING = 3
"""Value of the controller's output `mode` while the stabilizing law acts."""


@dataclass(frozen=True)
class Metrics:
    """What the comparison shows. |q| = hypot(theta, delta), delta wrapped to (-pi, pi].

    settling_time [s]: |q| stays within the tolerance from then on; NaN where it does not. integral_q2 [rad^2 s]: integral
    of |q|^2 over the run. steady_rms [rad]: RMS of |q| over the last seconds. energy [V^2 s]: integral of V^2.
    peak_voltage [V]. voltage_variation [V/s]: total variation of V per second over the last seconds, the measure of
    chattering; for a result with every row. capture_time [s]: the stabilizing law first acts; NaN where it never does.
    captures: how often it took over.
    """

    settling_time: float
    integral_q2: float
    steady_rms: float
    energy: float
    peak_voltage: float
    voltage_variation: float
    capture_time: float
    captures: int

    def as_dict(self) -> dict[str, float]:
        """Return the numbers by name; NaN as None's JSON-safe stand-in is left to the caller."""
        return asdict(self)


NAMES = tuple(f.name for f in fields(Metrics))


def wrapped(angle: Array) -> Array:
    """Return angles [rad] wrapped to (-pi, pi]."""
    return -((math.pi - angle) % (2.0 * math.pi) - math.pi)


def can_evaluate(result: Result) -> bool:
    """Return whether `result` has the signals that the metrics need."""
    angles = ({f"plant.{a}{suffix}" for a in ("theta", "delta")} for suffix in ("", "_encoder"))
    known = result.signals.keys()
    return {"controller.voltage", "controller.mode"} <= known and any(pair <= known for pair in angles)


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


def evaluate(result: Result, tolerance: float = 0.02, steady: float = 3.0) -> Metrics:
    """Return the metrics of `result`; `tolerance` [rad] defines settling, `steady` [s] the steady state at the end.

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
        energy=float(np.sum(voltage[1:] ** 2 * np.diff(time))),
        peak_voltage=float(np.max(np.abs(voltage))),
        voltage_variation=variation_rate(time[late], voltage[late]),
        capture_time=float(time[captures[0]]) if captures.size else math.nan,
        captures=int(captures.size),
    )
