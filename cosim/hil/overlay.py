"""A run re-simulated from where its log begins, to lay simulation over hardware."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from plant_fmu.interface import start_values as plant_start_values
from plant_fmu.parameters import ParameterSet, QubeParameters

from ..errors import UserError
from ..fmu_files import start_values_of
from ..master import simulate
from ..parameter_files import named_set
from ..pendulum import WIRES
from ..provenance import provenance
from ..results import Result
from ..structure import Component, Signal, SystemStructure
from .identify import Beginning, beginning
from .replay import driven_inputs, driven_values
from .scaling import RESOLUTION

CHANCE = (
    "theta_0",
    "delta_0",
    "theta_dot_0",
    "delta_dot_0",
    "theta_encoder_offset",
    "delta_encoder_offset",
    "noise_std",
)
"""Start values of the plant that are found in the log, or that no other run has: the first state, offsets, noise."""


@dataclass(frozen=True)
class Overlay:
    """The log from `begin` on and its simulation, both from time 0; what the log showed of its beginning."""

    measured: Result
    simulated: Result
    beginning: Beginning


def own_start(result: Result) -> dict[str, Any]:
    """Return the plant's start values that a run's scenario says, but for its own first state, offsets and noise."""
    plant = result.metadata.get("scenario", {}).get("plant", {})
    named = plant.get("parameters")
    start = {} if named is None else dict(plant_start_values(named_set(named)))
    return start | {name: value for name, value in plant.get("start", {}).items() if name not in CHANCE}


def resimulate(
    result: Result,
    fmus: tuple[Path, Path],
    parameters: str | None = None,
    begin: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> Overlay:
    """Return the log from `begin` [s] on and its simulation with the plant's `parameters`.

    None: with what the run's scenario says, and what it does not say as the plant FMU was exported. `fmus` are the plant's
    and the controller's; the controller has the log's start values, and the log's values on inputs that signals drove. The
    first state, and where in its count the pendulum's encoder was zeroed, are those that fit the log best with this plant,
    see `identify.beginning`; where the arm's was zeroed is in its first angle, since nothing depends on that but the
    measurement. Raises UserError for a log without start values, or too short.
    """
    origin = provenance(result)
    start, step = origin.start_values.get("controller"), origin.step
    if start is None or step is None:
        raise UserError("the log does not say with which start values it was made")
    rows = np.flatnonzero(result.time >= begin - 1e-9)
    if rows.size < LEAST_ROWS:
        raise UserError(f"the log must have {LEAST_ROWS} rows from {begin:g} s on, it ends at {_end(result):g} s")
    measured = Result(
        result.time[rows] - result.time[rows[0]],
        {name: signal[rows] for name, signal in result.signals.items()},
        result.units,
        result.metadata,
    )
    plant = own_start(result) if parameters is None else dict(plant_start_values(named_set(parameters)))
    first = beginning(measured, _set_of({**start_values_of(fmus[0]), **plant}, parameters or "of the run"))
    names = ("theta_0", "delta_0", "theta_dot_0", "delta_dot_0")
    plant |= dict(zip(names, first.state, strict=True))
    plant |= {
        "theta_encoder_offset": 0.5,
        "delta_encoder_offset": float(np.clip(0.5 + first.bias / RESOLUTION, 0.0, 1.0)),
    }
    components = Component("controller", fmus[1], start), Component("plant", fmus[0], plant)
    signals = [_logged(measured, name, step) for name in driven_inputs(origin)]
    duration = round(float(measured.time[-1]) / step) * step
    metadata = {"overlay": {"parameters": parameters, "bias": first.bias}, **_judged(result)}
    system = SystemStructure(components, WIRES["encoders"], signals)
    simulated = simulate(system, step, duration, metadata=metadata, progress=progress)
    return Overlay(measured, simulated, first)


def _logged(measured: Result, name: str, step: float) -> Signal:
    """Return the values that a driven input of the controller had, as a signal; they hold where rows are missing."""
    numbers = np.rint(measured.time / step)
    rows = np.searchsorted(numbers, np.arange(numbers[-1] + 1), side="right") - 1
    values = driven_values(measured, name)[rows].tolist()
    return Signal(f"controller.{name}", lambda time: values[round(time / step)], recorded=True)


def _judged(result: Result) -> dict[str, Any]:
    """Return what the result says that it is judged by, for the metadata of its simulation."""
    return {name: entry for name, entry in result.metadata.items() if name == "evaluation"}


LEAST_ROWS = 45
"""Rows from the beginning on: enough for the fit of the beginning."""


def _set_of(values: Mapping[str, Any], name: str) -> ParameterSet:
    numbers = {f.name: float(values[f.name]) for f in fields(QubeParameters) if f.name in values}
    if len(numbers) < len(fields(QubeParameters)) or "back_emf" not in values:
        raise UserError("the overlay needs the plant FMU of this project: another does not say its parameters")
    return ParameterSet(name, QubeParameters(**numbers), "start values", "overlay", bool(values["back_emf"]))


def as_seen(simulated: Result, measured: Result) -> Result:
    """Return the simulation with the signals that the log has too: the encoders' angles and not the true ones."""
    shared = {name: signal for name, signal in simulated.signals.items() if name in measured.signals}
    return Result(simulated.time, shared, {name: simulated.units[name] for name in shared}, simulated.metadata)


def alike(results: Mapping[str, Result]) -> dict[str, Result]:
    """Return the results with what all can be judged by: where one has no true angles, none has."""
    true = {"plant.theta", "plant.delta"}
    if all(true <= result.signals.keys() for result in results.values()):
        return dict(results)

    def seen(result: Result) -> Result:
        kept = {
            n: signal for n, signal in result.signals.items() if n not in true or f"{n}_encoder" not in result.signals
        }
        return Result(result.time, kept, {n: result.units[n] for n in kept}, result.metadata)

    return {name: seen(result) for name, result in results.items()}


def _end(result: Result) -> float:
    return float(result.time[-1]) if len(result.time) else 0.0
