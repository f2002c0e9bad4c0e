"""The comparison of the three laws in a scenario, over draws of the encoders' offsets."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_export.files import write_file

from .campaign import Job, run_all
from .master import Coupling, step_count
from .metrics import NAMES, Metrics, evaluate
from .results import Result
from .room import check_rows
from .scenario import Scenario, build_system

LAWS = ("LC", "SMC", "IHC")


@dataclass(frozen=True)
class Draw:
    """One run of a comparison: its law, its seed (None: the FMU's own offsets), its numbers."""

    law: str
    seed: int | None
    metrics: Metrics


@dataclass(frozen=True)
class Comparison:
    """All draws of a scenario, and each law's full result of a typical draw, for the pictures.

    The typical draw is the one whose steady-state RMS is the median for the first law: the draw is the same for all laws,
    and chosen by the law that the others are compared with.
    """

    scenario: Scenario
    draws: tuple[Draw, ...]
    results: dict[str, Result]

    def median(self, law: str, name: str) -> float:
        """Return the median over the draws; a draw that never settles or captures counts as infinitely late.

        NaN where the median draw is such a one.
        """
        values = [getattr(d.metrics, name) for d in self.draws if d.law == law]
        median = float(np.median([math.inf if math.isnan(v) else v for v in values]))
        return median if math.isfinite(median) else math.nan

    def save(self, folder: Path) -> None:
        """Write each law's result, all draws as comparison.csv and the medians as comparison.json to `folder`."""
        for law, result in self.results.items():
            result.save(folder / f"{law}.csv")
        lines = [",".join(["law", "seed", *NAMES])]
        for d in self.draws:
            seed = "" if d.seed is None else str(d.seed)
            lines.append(",".join([d.law, seed, *(repr(getattr(d.metrics, n)) for n in NAMES)]))
        write_file(folder / "comparison.csv", "\n".join(lines) + "\n")
        laws = list(self.results)
        medians = {law: {n: _json_number(self.median(law, n)) for n in NAMES} for law in laws}
        about = {
            "scenario": self.scenario.model_dump(mode="json"),
            "draws": len(self.draws) // len(laws),
            "median": medians,
        }
        write_file(folder / "comparison.json", json.dumps(about, indent=1) + "\n")


def _json_number(value: float) -> float | None:
    return None if math.isnan(value) else value


@dataclass(frozen=True)
class Study:
    """A scenario, the folder of its file, and the seeds to run it with; no seeds: once, as it stands."""

    scenario: Scenario
    folder: Path
    seeds: Sequence[int] = ()


def compare(
    studies: Sequence[Study],
    fmus: Path,
    laws: Sequence[str] = LAWS,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Comparison]:
    """Run every law in every study with every seed, in `workers` threads (None: one per core).

    All laws of a study see the same encoder offsets and noise. `progress(done, total)` counts runs. Raises what a run
    raises; on that, and on Ctrl-C, runs that have not begun are dropped and running ones stopped.
    """
    for study in studies:  # says what cannot work before anything runs
        coupling = Coupling(build_system(study.scenario, fmus, study.folder))
        run, record = study.scenario.run, study.scenario.record
        columns = len(coupling.checked_outputs(record.outputs))
        runs = len(laws) * len(study.seeds or [None])
        check_rows(step_count(run.step, run.duration) // record.every + 2, columns, record.every, runs)
    jobs = [
        Job((s, law, seed), study.scenario.changed(_changes(law, seed)), study.folder)
        for s, study in enumerate(studies)
        for seed in study.seeds or [None]
        for law in laws
    ]
    found = run_all(jobs, fmus, lambda result: (evaluate(result), result), workers, progress)
    comparisons = []
    for s, study in enumerate(studies):
        draws = tuple(Draw(law, seed, found[s, law, seed][0]) for law in laws for seed in study.seeds or [None])
        ranked = sorted((d for d in draws if d.law == laws[0]), key=lambda d: d.metrics.steady_rms)
        typical = ranked[len(ranked) // 2].seed
        comparisons.append(Comparison(study.scenario, draws, {law: found[s, law, typical][1] for law in laws}))
    return comparisons


def _changes(law: str, seed: int | None) -> dict[str, str | int]:
    return {"controller.start.law": law} | ({} if seed is None else {"run.seed": seed})
