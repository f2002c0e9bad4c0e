"""Sweeps: what is varied in a scenario drawn many times, the laws side by side on the same draws, and what that says."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fmu_export.files import FilePath
from ihc_fmu.arguments import check_among

from ..metric_meanings import MetricMeaning
from ..scenario import Scenario, load_located
from .comparison import UNSTEADY
from .engine import Workers, run_numbers
from .estimates import MeanEstimate, Share, change_of, mean, root_mean_square
from .jobs import Job
from .journal import Journal
from .numbers import PURPOSE, Numbers
from .sampling import Sampling
from .sensitivity import KEPT, Sensitivity, sensitivity
from .sweep_plan import SweepPlan, plan_sweep

Array = np.ndarray

CHUNK = 4096
"""Draws whose runs are in memory at a time."""
QUANTILES = (0.05, 0.5, 0.95)
"""Which are stated."""

Progress = Callable[[int, int], None]


def run_sweep(plan: SweepPlan, journal: Journal, workers: Workers = None, progress: Progress | None = None) -> Sweep:
    """Run a plan in `workers` threads (None: one per core), or on a cluster; finished runs come from and go to `journal`.

    `progress(done, total)` counts runs. Raises as `engine.run_numbers`.
    """
    numbers: dict[str, dict[str, Array]] = {law: {} for law in plan.laws}
    total = plan.count * len(plan.laws)
    for first in range(1, plan.count + 1, CHUNK):
        numbered = range(first, min(first + CHUNK, plan.count + 1))
        before = (first - 1) * len(plan.laws)
        jobs = [
            Job((draw, law), plan.scenario, plan.folder, plan.changes(draw, law))
            for draw in numbered
            for law in plan.laws
        ]

        def report(done: int, _total: int, before: int = before) -> None:
            if progress is not None:
                progress(before + done, total)

        for (draw, law), values in run_numbers(jobs, plan.fmus, journal, workers=workers, progress=report).items():
            _store(numbers[law], draw - 1, plan.count, values)
    return Sweep(plan, numbers)


def _store(columns: dict[str, Array], row: int, count: int, values: Numbers) -> None:
    for name, value in values.items():
        if name not in columns:
            columns[name] = np.full(count, math.nan)
        columns[name][row] = value


def sweep(
    scenario: FilePath | Scenario,
    vary: Mapping[str, str | Sequence[Any]],
    *,
    laws: Sequence[str] | None = None,
    changes: Mapping[str, Any] | None = None,
    draws: int | None = None,
    sampling: Sampling | None = None,
    seed: int = 1,
    fmus: FilePath = "fmus",
    journal: FilePath | None = None,
    workers: Workers = None,
    progress: Progress | None = None,
) -> Sweep:
    """Draw a scenario's entries many times and run it with each law on the same draws.

    Parameters
    ----------
    scenario
        A scenario's file (`*.toml`), an SSP file, the name of a built-in scenario, or a `Scenario`.
    vary
        By names of entries what they are drawn from: texts as `normal(0.024,5%)`, or lists of values.
    laws
        Values of the controller's `law`; None: those of this project that it has.
    changes
        Entries that differ in all runs, as in `cosim.run`.
    draws
        How many; None: 256, of a grid 1 for each combination.
    sampling
        "sobol", "latin" or "grid"; None: a grid where only lists are varied, otherwise a Sobol set.
    seed
        Of the draws.
    fmus
        Folder of the FMUs, where they are not beside the scenario.
    journal
        File that finished runs are kept in, so that a repetition goes on from there; None: they are not kept.
    workers
        Threads, or a cluster; None: a thread per core.
    progress
        Is called with the runs that are done and all of them.

    Returns
    -------
    Sweep
        What was drawn, the numbers of all runs, and what they say.

    Raises
    ------
    UserError
        For entries, distributions or laws that cannot be, and a scenario that cannot be run or judged.
    KeyboardInterrupt
        On Ctrl-C; finished runs are in the journal.

    Examples
    --------
    >>> from cosim.studies.sweep import sweep
    >>> tolerance = {"evaluate.tolerance": 0.002}
    >>> swept = sweep("fmus/arm.ssp", {"plant.angle_0": "0.05..0.2"}, laws=["LC", "IHC"], changes=tolerance, draws=8)
    >>> swept.better("IHC", "settling_time[plant.angle]").wins
    8
    """
    if isinstance(scenario, Scenario):
        located, folder, place = scenario, Path(), Path(fmus)
    else:
        located, folder, place = load_located(os.fspath(scenario), Path(fmus))
    located = located.changed(changes or {})
    plan = plan_sweep(located, vary, place, folder, laws, draws, sampling, seed)
    with tempfile.TemporaryDirectory() as nowhere, Journal(Path(journal or f"{nowhere}/runs"), PURPOSE) as kept:
        return run_sweep(plan, kept, workers, progress)


@dataclass(frozen=True, eq=False)
class Sweep:
    """The numbers of all runs of a plan: by law and name an array with a number for each draw, NaN where there is none."""

    plan: SweepPlan
    numbers: Mapping[str, Mapping[str, Array]]

    def __repr__(self) -> str:
        return f"<Sweep: {self.plan.scenario.name}, {', '.join(self.plan.laws)}, draws: {self.plan.count}>"

    @property
    def quantities(self) -> Mapping[str, MetricMeaning]:
        """The system's metrics by name."""
        return self.plan.quantities

    @property
    def shown(self) -> list[str]:
        """The names of the metrics that are stated."""
        return [name for name, q in self.quantities.items() if q.role not in ("trend", "captures")]

    @property
    def measure(self) -> str:
        """The metric that ranks draws unless another is named: the integral of the squared error."""
        return next(name for name, q in self.quantities.items() if q.role == "integral")

    def column(self, law: str, name: str) -> Array:
        """Return a number of all draws, NaN where a run has none; raises UserError for another law."""
        check_among("law", law, self.plan.laws)
        found = self.numbers[law].get(name)
        return np.full(self.plan.count, math.nan) if found is None else found

    def kept(self, law: str) -> Array:
        """Return in which draws the law took over once and acted to the end, and no FMU ended the run."""
        return self.column(law, "kept") == 1.0

    @property
    def counts(self) -> bool:
        """Whether there is a draw that counts for any law."""
        return any(self.kept(law).any() for law in self.plan.laws)

    def failed(self, law: str) -> Array:
        """Return in which draws an FMU ended the run with an error."""
        return np.isnan(self.column(law, "kept"))

    def counted(self, law: str, name: str) -> Array:
        """Return a metric of the draws that count, in which the law acted to the end: a draw that never settles counts
        the run's duration. Shape: all draws, NaN in those that do not count.
        """
        check_among("metric", name, self.quantities)
        values = self.column(law, name)
        if self.quantities[name].never:
            values = np.where(np.isnan(values), self.column(law, "duration"), values)
        return np.where(self.kept(law), values, math.nan)

    def ranked(self, law: str, name: str) -> Array:
        """Return a metric by which draws are compared: infinite where the law lost the plant, never settled, or has none."""
        check_among("metric", name, self.quantities)
        values = np.where(self.kept(law), self.column(law, name), math.nan)
        return np.where(np.isnan(values), math.inf, values)

    def value(self, law: str, name: str) -> MeanEstimate:
        """Return a metric's mean over the draws that count (of steady_rms the root mean square), with its interval."""
        values = _there(self.counted(law, name))
        return root_mean_square(values) if self.quantities[name].over_draws == "rms" else mean(values)

    def quantiles(self, law: str, name: str) -> tuple[float, ...]:
        """Return the QUANTILES of a metric over the draws that count; NaN without any."""
        values = _there(self.counted(law, name))
        return tuple(np.quantile(values, QUANTILES).tolist()) if values.size else (math.nan,) * len(QUANTILES)

    def change(self, law: str, name: str) -> MeanEstimate:
        """Return by which part the metric's mean lies above that of the first law, over the draws that both count."""
        pairs = np.stack([self.counted(law, name), self.counted(self.plan.laws[0], name)])
        values, base = pairs[:, ~np.isnan(pairs).any(axis=0)]
        return change_of(values, base, self.quantities[name])

    def better(self, law: str, name: str) -> Share:
        """Return in how many draws the metric is smaller than with the first law; one that loses the plant is worse."""
        return Share(int(np.sum(self._order(law, name) < 0)), self.plan.count)

    def equal(self, law: str, name: str) -> int:
        """Return in how many draws it is equal, both never settle or both lose the plant."""
        return int(np.sum(self._order(law, name) == 0))

    def _order(self, law: str, name: str) -> Array:
        one, other = self.ranked(law, name), self.ranked(self.plan.laws[0], name)
        return np.where(one < other, -1, np.where(one > other, 1, 0))

    def worst(self, law: str, name: str, most: int) -> list[int]:
        """Return the draws, counted from 1, that are worst for a law by a metric: those lost first, then the largest."""
        return (np.argsort(-self.ranked(law, name), kind="stable")[:most] + 1).tolist()

    def scenario(self, law: str, draw: int) -> Scenario:
        """Return the scenario of a draw, counted from 1, and a law, which run alone gives the same numbers."""
        check_among("law", law, self.plan.laws)
        return self.plan.scenario.changed(self.plan.changes(draw, law))

    @cached_property
    def sensitivities(self) -> dict[str, dict[str, Sensitivity]]:
        """By law and metric, and KEPT, what decides it; those of which there is something to say."""
        plan = self.plan
        inputs = {name: (plan.drawn[path], bool(plan.listed(path))) for path, name in plan.names.items()}
        found: dict[str, dict[str, Sensitivity]] = {}
        for law in plan.laws:
            outputs = {name: self.counted(law, name) for name in self.shown}
            outputs[KEPT] = self.kept(law).astype(float)
            said = {name: sensitivity(inputs, values) for name, values in outputs.items()}
            found[law] = {name: one for name, one in said.items() if one is not None}
        return found

    def steady(self, law: str) -> bool:
        """Return whether the end is a steady state, in at least three quarters of the draws that count."""
        steady = self.column(law, "steady")[self.kept(law)]
        return bool(np.sum(steady != 1.0) <= UNSTEADY * steady.size)

    def never(self, law: str, name: str) -> int:
        """Return in how many of the draws that count there is no such thing as the metric: a time of settling, for one."""
        return int(np.sum(np.isnan(self.column(law, name)[self.kept(law)])))


def _there(values: Array) -> Array:
    return values[~np.isnan(values)]
