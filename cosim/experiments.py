"""Named studies over many runs: the comparison of the three laws, in parallel over processes."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .master import Coupling
from .metrics import NAMES, Metrics, evaluate
from .results import Result, write_beside
from .scenario import Scenario, build_system, run_scenario

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
        write_beside(folder / "comparison.csv", "\n".join(lines) + "\n")
        laws = list(self.results)
        medians = {law: {n: _json_number(self.median(law, n)) for n in NAMES} for law in laws}
        about = {
            "scenario": self.scenario.model_dump(mode="json"),
            "draws": len(self.draws) // len(laws),
            "median": medians,
        }
        write_beside(folder / "comparison.json", json.dumps(about, indent=1) + "\n")


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
    """Run every law in every study with every seed, in `workers` processes (None: one per core).

    All laws of a study see the same encoder offsets and noise. `progress(done, total)` counts runs. Raises what a run
    raises; on that, and on Ctrl-C, runs that have not begun are dropped and the workers ended.
    """
    jobs = [(s, law, seed) for s in range(len(studies)) for seed in studies[s].seeds or [None] for law in laws]
    found: dict[tuple[int, str, int | None], tuple[Metrics, Result]] = {}
    for study in studies:  # says what cannot work before any process is started
        Coupling(build_system(study.scenario, fmus, study.folder))
    workers = min(workers or os.cpu_count() or 1, len(jobs))
    context = multiprocessing.get_context("spawn")  # a forked FMU host would share threads and locks
    others = multiprocessing.active_children()
    pool = ProcessPoolExecutor(workers, mp_context=context)
    try:
        with _interrupt_ignored():  # by the workers, who inherit this; the parent decides
            futures = {pool.submit(_run, studies[s], fmus, law, seed): (s, law, seed) for s, law, seed in jobs}
        for done, future in enumerate(as_completed(futures), start=1):
            found[futures[future]] = future.result()
            if progress is not None:
                progress(done, len(jobs))
    except BaseException:
        for process in multiprocessing.active_children():
            if process not in others:
                process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    comparisons = []
    for s, study in enumerate(studies):
        draws = tuple(Draw(law, seed, found[s, law, seed][0]) for law in laws for seed in study.seeds or [None])
        ranked = sorted((d for d in draws if d.law == laws[0]), key=lambda d: d.metrics.steady_rms)
        typical = ranked[len(ranked) // 2].seed
        comparisons.append(Comparison(study.scenario, draws, {law: found[s, law, typical][1] for law in laws}))
    return comparisons


@contextmanager
def _interrupt_ignored() -> Iterator[None]:
    """Ignore Ctrl-C for as long as it takes to start processes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    earlier = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, earlier)


def _run(study: Study, fmus: Path, law: str, seed: int | None) -> tuple[Metrics, Result]:
    changes = {"controller.start.law": law} | ({} if seed is None else {"run.seed": seed})
    result = run_scenario(study.scenario.changed(changes), fmus, study.folder)
    return evaluate(result), result
