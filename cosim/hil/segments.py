"""A log of measured angles and voltages, cut into short segments on a grid of its period; rows may be missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import UserError
from ..provenance import provenance
from ..results import Result

Array = np.ndarray

ANGLES = ("plant.theta_encoder", "plant.delta_encoder")
COMMANDED = "controller.voltage"
VOLTAGES = ("hil.applied_voltage", COMMANDED)
"""Where the voltage over the step that ended at a row is: the first that the log has."""

LARGEST = 1e9
"""Times [s], angles [rad] and voltages [V] of a log are smaller."""
LEAST_POINTS = 8
"""Points of a segment."""
LEAST_SEGMENTS = 4
LEAST_ROWS = 0.5
"""A segment with gaps is used where it has this share of its rows."""
LEAST_MOTION = 0.05
"""One of the angles must move by this, or there is nothing to identify [rad]."""


@dataclass(frozen=True)
class Segments:
    """S segments of n points on a grid of the log's period [s].

    angles [rad] of shape (n, 2, S), 0 where `seen`, of shape (n, S), says that the log has no row; voltage [V] of shape
    (n - 1, S), held from each point to the next; begins, of shape (S,): the segments' first points in the log.
    """

    period: float
    angles: Array
    seen: Array
    voltage: Array
    begins: Array


def cut(result: Result, segment: float, least_motion: float = LEAST_MOTION) -> Segments:
    """Return the log cut into segments of `segment` [s]; a rest at the end, and segments that are mostly gaps, are left out.

    A row after a gap has the voltage of all the time since the row before it. Raises UserError for a log that is too short,
    lacks signals, is not finite or moves by less than `least_motion` [rad].
    """
    angles, voltage = _signals(result)
    period, points = _grid(np.asarray(result.time, dtype=float))
    n = round(segment / period)
    if n < LEAST_POINTS:
        least = LEAST_POINTS * period
        raise UserError(f"a segment must have at least {LEAST_POINTS} periods, {least:g} s, found {segment:g} s")
    count = (points[-1] + 1) // n
    seen = np.isin(np.arange(count * n), points).reshape(count, n)
    used = np.mean(seen, axis=1) >= LEAST_ROWS
    if np.count_nonzero(used) < LEAST_SEGMENTS:
        raise UserError(
            f"the log must have at least {LEAST_SEGMENTS} segments of {segment:g} s without long gaps, found "
            f"{np.count_nonzero(used)}"
        )
    motion = np.max(np.ptp(angles, axis=0))
    if motion < least_motion:
        raise UserError(f"an angle must move by {least_motion:g} rad, or nothing is to be seen, found {motion:.3g} rad")
    row = np.searchsorted(points, np.arange(count * n))  # at the point, or the first after it
    at = np.where(seen[..., None], angles[row].reshape(count, n, 2), 0.0)
    held = voltage[row].reshape(count, n)
    begins = n * np.flatnonzero(used)
    return Segments(period, at[used].transpose(1, 2, 0), seen[used].T, held[used, 1:].T, begins)


def _signals(result: Result) -> tuple[Array, Array]:
    """Return the angles [rad] of shape (rows, 2) and the voltage [V] over the step that ended at each row."""
    voltage_name = next((name for name in VOLTAGES if name in result.signals), VOLTAGES[-1])
    for name in (*ANGLES, voltage_name):
        if name not in result.signals:
            raise UserError(f"the identification needs {name}; the log has {', '.join(result.signals) or 'no signals'}")
    origin = provenance(result)
    if origin.every not in (None, 1):
        raise UserError(f"the identification needs every row, found a log with every = {origin.every}")
    angles = np.column_stack([result[name] for name in ANGLES]).astype(float)
    voltage = np.asarray(result[voltage_name], dtype=float)
    for name, values in (
        ("time", result.time),
        (ANGLES[0], angles[:, 0]),
        (ANGLES[1], angles[:, 1]),
        (voltage_name, voltage),
    ):
        if not np.all(np.abs(values) < LARGEST):
            raise UserError(f"the identification needs finite numbers below {LARGEST:g}, found others in {name}")
    if voltage_name == COMMANDED and origin.order == "parallel":
        voltage = np.concatenate([voltage[:1], voltage[:-1]])  # a row then has the voltage of the next step
    return angles, voltage


def _grid(time: Array) -> tuple[float, Array]:
    """Return the period [s], the shortest step between two rows, and each row's number of periods since the first."""
    steps = np.diff(time)
    if not len(steps) or np.min(steps) <= 0.0:
        raise UserError("the log must have at least two rows, with increasing times")
    period = float(np.min(steps))
    points = np.cumsum(np.concatenate([[0], np.rint(steps / period).astype(int)]))
    if np.max(np.abs(steps / period - np.diff(points))) > 0.1:
        raise UserError(f"rows must be whole periods apart, found steps that are no multiples of {period:g} s")
    return float((time[-1] - time[0]) / points[-1]), points
