"""Many runs: in threads, interruptible, with what is finished kept in a journal, so that a repetition goes on from there."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import TypeVar

from fmu_export.files import FilePath

from ..interrupts import second_ends
from ..results import Result, SimulationError
from ..scenario_run import run_scenario
from .jobs import Job, K, anchored
from .journal import Journal
from .numbers import Numbers, numbers

T = TypeVar("T")


def run_all(
    jobs: Sequence[Job[K]],
    fmus: FilePath,
    finish: Callable[[Result], T],
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    done: Callable[[Job[K], T], None] | None = None,
    failed: Callable[[SimulationError], T] | None = None,
    skip: Callable[[Job[K]], tuple[bool, T]] | None = None,
) -> dict[K, T]:
    """Run every job in `workers` threads (None: one per core); return what `finish` makes of each result, by key.

    Native FMUs step without Python's lock, so that threads use all cores; `finish` runs in the thread of its run.
    `skip` is asked there before a run begins, and returns whether to leave it out and the value in its place. `done` and
    `progress(done, total)` are called in this thread after each job. Raises what a run raises, unless `failed` turns the
    failure of an FMU into a value; on that, and on Ctrl-C, jobs that have not begun are dropped and running
    ones stopped at their next look. Raises ValueError where two jobs have the same key.
    """
    if len({job.key for job in jobs}) < len(jobs):
        raise ValueError("two jobs of a study have the same key")
    fmus = Path(fmus).absolute()  # FMPy changes the folder of the whole process while it loads a library
    jobs = [anchored(job) for job in jobs]
    stop = threading.Event()

    def look(_done: int = 0, _total: int = 0) -> None:
        if stop.is_set():
            raise KeyboardInterrupt

    def run(job: Job[K]) -> T:
        look()
        if skip is not None:
            left_out, value = skip(job)
            if left_out:
                return value
        try:
            return finish(run_scenario(job.whole, fmus, job.folder, look))
        except SimulationError as error:
            if failed is None:
                raise
            return failed(error)

    results: dict[K, T] = {}
    with second_ends(), ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        try:
            futures: dict[Future[T], Job[K]] = {pool.submit(run, job): job for job in jobs}
            for future in as_completed(futures):
                job = futures[future]
                results[job.key] = future.result()
                if done is not None:
                    done(job, results[job.key])
                if progress is not None:
                    progress(len(results), len(jobs))
        except BaseException:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return {job.key: results[job.key] for job in jobs}


def run_numbers(
    jobs: Sequence[Job[K]],
    fmus: FilePath,
    journal: Journal,
    evaluate: Callable[[Result], Numbers] = numbers,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[K, Numbers]:
    """Return each job's numbers, from the journal or by a run; `progress` counts both.

    A run that an FMU ends with an error has no numbers: an empty mapping, kept too. Otherwise as `run_all`.
    """
    digests = {job.key: journal.digest(job, fmus) for job in jobs}
    known = {job.key: journal.found(digests[job.key]) for job in jobs}
    kept = {key: values for key, values in known.items() if values is not None}
    todo = [job for job in jobs if job.key not in kept]

    def report() -> None:
        if progress is not None:
            progress(len(kept), len(jobs))

    def done(job: Job[K], values: Numbers | None) -> None:
        if values is not None:
            if journal.found(digests[job.key]) is None:
                journal.keep(digests[job.key], values)
            kept[job.key] = dict(values)
            report()

    def first(job: Job[K]) -> tuple[bool, Numbers | None]:
        """Skip what another process has done, and what it has begun."""
        values = journal.found(digests[job.key])
        return (True, values) if values is not None or not journal.claim(digests[job.key]) else (False, None)

    def again(job: Job[K]) -> tuple[bool, Numbers | None]:
        """Skip what another process has done meanwhile; whoever began the rest may be gone."""
        values = journal.found(digests[job.key])
        return values is not None, values

    report()
    for skip in (first, again):
        todo = [job for job in todo if job.key not in kept]
        run_all(todo, fmus, evaluate, workers, done=done, failed=lambda _error: {}, skip=skip)
    return {job.key: kept[job.key] for job in jobs}
