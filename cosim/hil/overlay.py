"""A run re-simulated from where its log begins, to lay simulation over hardware."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from plant_fmu.interface import start_values as plant_start_values

from ..errors import UserError
from ..master import Component, System, simulate
from ..metrics import wrapped
from ..parameter_files import chosen
from ..provenance import provenance
from ..results import Result
from ..scenario import WIRES
from .replay import MEASURED

FIT_TIME = 0.05
"""Stretch of the log [s] from which the velocities at its start are found."""
FIT_DEGREE = 3


def start_state(result: Result, begin: float) -> dict[str, float]:
    """Return the plant's start values at time `begin` [s] of a log: angles and velocities of a cubic through FIT_TIME.

    The middle of a count is taken for the angle that was counted down to it.
    """
    late = (result.time >= begin - 1e-9) & (result.time <= begin + FIT_TIME)
    if np.count_nonzero(late) <= FIT_DEGREE:
        raise UserError(f"the log must have at least {FIT_TIME:g} s from {begin:g} s on, it ends at {_end(result):g} s")
    time = result.time[late] - begin
    state = {}
    for name in MEASURED:
        rate, angle = np.polyfit(time, result[name][late], FIT_DEGREE)[-2:]
        short = name.removeprefix("plant.").removesuffix("_encoder")
        state[f"{short}_0"], state[f"{short}_dot_0"] = float(angle), float(rate)
    return state


def resimulate(
    result: Result,
    fmus: tuple[Path, Path],
    parameters: str,
    begin: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Result, Result]:
    """Return (the log from `begin` [s] on, its simulation with the plant's `parameters`), both from time 0.

    `fmus` are the plant's and the controller's; the controller has the log's start values. The encoders are zeroed in the
    middle of a count, since nobody knows where inside one the device's were. Raises UserError for a log without start
    values.
    """
    about = provenance(result)
    start, step = about.start_values.get("controller"), about.step
    if start is None or step is None:
        raise UserError("the log does not say with which start values it was made")
    rows = np.flatnonzero(result.time >= begin - 1e-9)
    if rows.size < 2:
        raise UserError(f"the log must go on after {begin:g} s, it ends at {_end(result):g} s")
    measured = Result(
        result.time[rows] - result.time[rows[0]],
        {name: signal[rows] for name, signal in result.signals.items()},
        result.units,
        result.metadata,
    )
    plant = {
        **plant_start_values(chosen(parameters)),
        **start_state(result, float(result.time[rows[0]])),
        "theta_encoder_offset": 0.5,
        "delta_encoder_offset": 0.5,
    }
    system = System((Component("controller", fmus[1], start), Component("plant", fmus[0], plant)), WIRES["encoders"])
    duration = round(float(measured.time[-1]) / step) * step
    return measured, simulate(
        system, step, duration, metadata={"overlay": {"parameters": parameters}}, progress=progress
    )


def as_seen(simulated: Result, measured: Result) -> Result:
    """Return the simulation with the signals that the log has too: the encoders' angles and not the true ones."""
    shared = {name: signal for name, signal in simulated.signals.items() if name in measured.signals}
    return Result(simulated.time, shared, {name: simulated.units[name] for name in shared}, simulated.metadata)


def _end(result: Result) -> float:
    return float(result.time[-1]) if len(result.time) else 0.0


def differences(measured: Result, simulated: Result) -> dict[str, float]:
    """Return the RMS difference of the measured angles [rad] and of the voltage [V] over the common rows."""
    rows = np.searchsorted(simulated.time, measured.time - 1e-9)
    rows = rows[rows < len(simulated.time)]
    found = {}
    for name in (*MEASURED, "controller.voltage"):
        difference = simulated[name][rows] - measured[name][: len(rows)]
        if name == "plant.delta_encoder":
            difference = wrapped(difference)
        found[name] = float(np.sqrt(np.mean(difference**2)))
    return found
