"""The simulation of a scenario laid over what was measured, of whatever system: by the names of its signals."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_export.files import FilePath

from .coupling import Coupling
from .errors import UserError
from .evaluation import Evaluation, pendulum_evaluation
from .fmu_files import describe
from .inputs import read_columns
from .judged_signals import evaluation_in, missing_signals, wrapped
from .provenance import provenance
from .results import Result
from .scenario import Scenario
from .scenario_files import check_fmus_exist, files
from .scenario_run import run_scenario
from .scenario_system import build_system
from .typed import checked

LEAST_ROWS = 2
"""Rows that can be compared."""


@dataclass(frozen=True)
class Laid:
    """What was measured and its simulation, both from the scenario's time 0; the table's columns that no signal is."""

    measured: Result
    simulated: Result
    left_out: tuple[str, ...] = ()

    @property
    def seen(self) -> Result:
        """The simulation with the signals that were measured, judged as what was measured."""
        kept = {name: signal for name, signal in self.simulated.signals.items() if name in self.measured.signals}
        metadata = {**self.simulated.metadata, "evaluation": self.measured.metadata["evaluation"]}
        return Result(self.simulated.time, kept, {name: self.simulated.units[name] for name in kept}, metadata)


def lay(
    path: FilePath,
    scenario: Scenario,
    fmus: FilePath,
    folder: FilePath | None = None,
    begin: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> Laid:
    """Return what `path` holds from `begin` [s] on, the scenario's time 0, and the scenario's simulation of that length.

    `path` is a result, or a table (CSV) with a column `time` [s] and columns named as the scenario's signals,
    `component.variable`, in the FMUs' units. Raises UserError for a file without such signals, or in other units.
    """
    path, system = Path(path), build_system(scenario, fmus, folder)
    coupling = Coupling(system)
    known = coupling.checked_outputs(scenario.record.outputs)
    whole, left_out = _loaded(path, known)
    rows = np.flatnonzero(whole.time >= begin - 1e-9)
    if rows.size < LEAST_ROWS:
        raise UserError(f"{path} must have {LEAST_ROWS} rows from {begin:g} s on, found {rows.size}")
    step, time = scenario.run.step, whole.time[rows] - begin
    for name in known:
        if whole.units.get(name, coupling.unit(name)) != coupling.unit(name):
            raise UserError(f"{name} is in {whole.units[name]} in {path}, and in {coupling.unit(name)} in the scenario")
    duration = max(1, math.ceil(time[-1] / step - 1e-6)) * step
    simulated = run_scenario(scenario.changed({"run.duration": duration}), fmus, folder, progress)
    signals = {name: whole[name][rows] for name in known if name in whole.signals}
    evaluation = _judged_by(simulated, signals)
    metadata = {**whole.metadata, "evaluation": evaluation.model_dump(mode="json")}
    measured = Result(time, signals, {name: coupling.unit(name) for name in signals}, metadata)
    return Laid(measured, simulated, left_out)


def _loaded(path: Path, known: Sequence[str]) -> tuple[Result, tuple[str, ...]]:
    """Return a result, or a table as one, and the table's columns besides the `known` signals."""
    if path.with_suffix(".json").is_file():
        result = Result.load(path)
        _check_any(path, result.signals, known)
        return result, ()
    left_out: list[str] = []

    def choose(names: Sequence[str]) -> list[str]:
        if "time" not in names:
            raise UserError(f"{path} must have a column time, found {', '.join(names) or 'nothing'}")
        _check_any(path, names, known)
        left_out.extend(name for name in names if name not in known and name != "time")
        return [name for name in known if name in names]

    columns = {name: np.array(values) for name, values in read_columns(path, choose, "measured").items()}
    return Result(columns.pop("time"), columns, {}, {}), tuple(left_out)


def _check_any(path: Path, names: Collection[str], known: Sequence[str]) -> None:
    if not set(known) & set(names):
        some = ", ".join(known[:6]) + (", ..." if len(known) > 6 else "")
        raise UserError(
            f"{path} must have columns named as the scenario's signals, {some}; found {', '.join(names) or 'nothing'}"
        )


def _judged_by(simulated: Result, measured: Collection[str]) -> Evaluation:
    """Return what both can be judged by: of what the simulation is judged by that which was measured."""
    evaluation = pendulum_evaluation(measured)
    if "evaluation" in simulated.metadata:
        evaluation = evaluation_in(simulated)
    if evaluation.kind == "pendulum" and not missing_signals(measured, evaluation):
        return evaluation.model_copy(update={"norm": evaluation.norm if evaluation.norm in measured else None})
    kept = [k for k, e in enumerate(evaluation.errors) if {e.signal, e.set_point or e.signal} <= set(measured)]
    return Evaluation(
        errors=tuple(evaluation.errors[k] for k in kept),
        controls=tuple(control for control in evaluation.controls if control.signal in measured),
        scales=None if evaluation.scales is None else tuple(evaluation.scales[k] for k in kept),
        tolerance=evaluation.tolerance,
        mode=evaluation.mode if evaluation.mode is not None and evaluation.mode.signal in measured else None,
        norm=evaluation.norm if evaluation.norm in measured else None,
    )


def differences(
    measured: Result, simulated: Result, names: Iterable[str], angles: Collection[str] = ()
) -> dict[str, float]:
    """Return the RMS differences of signals over the measured rows, in their units.

    Between its own rows the simulation is a line. `angles` [rad] are signals of which whole turns do not count.
    """
    common = measured.time <= simulated.time[-1] + 1e-9
    differences = {}
    for name in names:
        difference = np.interp(measured.time[common], simulated.time, simulated[name]) - measured[name][common]
        if name in angles:
            difference = wrapped(difference)
        differences[name] = float(np.sqrt(np.mean(difference**2)))
    return differences


def compared(laid: Laid) -> dict[str, float]:
    """Return the RMS differences of all real numbers that were measured."""
    angles = [error.signal for error in evaluation_in(laid.measured).errors if error.wraps]
    real = [name for name in laid.measured.signals if laid.simulated[name].dtype == np.float64]
    return differences(laid.measured, laid.simulated, real, angles)


def scenario_in(result: Result, source: object) -> Scenario:
    """Return the scenario of a run; raise UserError, which begins with `source`, for a result that does not keep one."""
    kept = result.metadata.get("scenario")
    if kept is None:
        raise UserError(f"{source} does not say with which scenario it was made; --scenario names one")
    return checked(Scenario, kept, f"{source}: scenario")


def other_files(result: Result, scenario: Scenario, fmus: Path, folder: Path) -> list[str]:
    """Return the names of the FMUs that are not the files that the run was made with, by their GUIDs."""
    used = provenance(result).fmus
    paths = files(scenario, fmus, folder).fmus
    check_fmus_exist(paths)
    return [path.name for name, path in paths.items() if name in used and describe(path).guid != used[name].guid]
