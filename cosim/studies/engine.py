"""Many runs: in threads, interruptible, with what is finished kept in a journal, so that a repetition goes on from there."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

from fmu_export.files import FilePath

from ..results import Result, SimulationError
from ..scenario_run import run_scenario
from .cluster import Cluster
from .jobs import Job, K, anchored
from .journal import Journal
from .judging import Judging, finished
from .numbers import Numbers, numbers
from .threads import Look, execute

T = TypeVar("T")

Workers = int | Cluster | None
"""Where jobs are run: in so many threads of this process, None: one per core; or on a cluster."""

LEASE = 0.2
"""How long the runs last that a process reserves at a time in a shared journal [s], and that it keeps together."""


def run_all(
    jobs: Sequence[Job[K]],
    fmus: FilePath,
    finish: Callable[[Result], T],
    workers: Workers = None,
    progress: Callable[[int, int], None] | None = None,
    done: Callable[[Job[K], T], None] | None = None,
    failed: Callable[[SimulationError], T] | None = None,
) -> dict[K, T]:
    """Run every job in `workers` threads (None: one per core); return what `finish` makes of each result, by key.

    Native FMUs step without Python's lock, so that threads use all cores; `finish` runs in the thread of its run. `done`
    and `progress(done, total)` are called in this thread after each job. Whole results are large: a cluster is not asked
    for them. Raises what a run raises, unless `failed` turns the failure of an FMU into a value; on that, and on Ctrl-C,
    jobs that have not begun are dropped and running ones stopped at their next look. Raises ValueError where two jobs have
    the same key.
    """
    place = Path(fmus).absolute()  # FMPy changes the folder of the whole process while it loads a library

    def run(job: Job[K], look: Look) -> T:
        return finished(lambda: run_scenario(job.whole, place, job.folder, look), finish, failed)

    results, ended = _collected(jobs, progress, done)
    threads = None if isinstance(workers, Cluster) else workers
    execute(iter(anchored(jobs)), lambda: run, threads, ended)
    return {job.key: results[job.key] for job in jobs}


def judge_all(
    jobs: Sequence[Job[K]],
    fmus: FilePath,
    judge: Callable[[Result], T],
    workers: Workers = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[K, T]:
    """Return what `judge` makes of each job's result, which has what the metrics need, see `Prepared`; as `run_all`."""
    results, ended = _collected(jobs, progress)
    _judge(iter(anchored(jobs)), Path(fmus).absolute(), judge, None, workers, ended)
    return {job.key: results[job.key] for job in jobs}


def _judge(
    jobs: Iterator[Job[K]],
    fmus: Path,
    judge: Callable[[Result], T],
    failed: Callable[[SimulationError], T] | None,
    workers: Workers,
    ended: Callable[[Job[K], T], None],
) -> None:
    """Run and judge jobs in threads, or on a cluster."""
    if isinstance(workers, Cluster):
        workers.execute(jobs, fmus, judge, failed, ended)
    else:
        execute(jobs, lambda: _InThread(fmus, judge, failed), workers, ended)


class _InThread(Generic[T]):
    """What a thread runs its jobs with."""

    def __init__(self, fmus: Path, judge: Callable[[Result], T], failed: Callable[[SimulationError], T] | None) -> None:
        self.fmus, self.judge, self.failed = fmus, judge, failed
        self.judging = Judging()

    def __call__(self, job: Job[Any], look: Look) -> T:
        return self.judging(job, self.fmus, self.judge, self.failed, look)

    def close(self) -> None:
        self.judging.close()


def _collected(
    jobs: Sequence[Job[K]],
    progress: Callable[[int, int], None] | None,
    done: Callable[[Job[K], T], None] | None = None,
) -> tuple[dict[K, T], Callable[[Job[K], T], None]]:
    """Return the values by key and what puts a job's value there; raise ValueError where two jobs have the same key."""
    _check_keys(jobs)
    results: dict[K, T] = {}

    def ended(job: Job[K], value: T) -> None:
        results[job.key] = value
        if done is not None:
            done(job, value)
        if progress is not None:
            progress(len(results), len(jobs))

    return results, ended


def no_numbers(_error: SimulationError) -> Numbers:
    """Return what is kept of a run that an FMU ends with an error."""
    return {}


def run_numbers(
    jobs: Sequence[Job[K]],
    fmus: FilePath,
    journal: Journal,
    evaluate: Callable[[Result], Numbers] = numbers,
    workers: Workers = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[K, Numbers]:
    """Return each job's numbers, from the journal or by a run; `progress` counts both.

    `evaluate` makes them of a result that has what the metrics need, see `Prepared`. A run that an FMU ends with an error
    has no numbers: an empty mapping, kept too. Several processes may share the journal: each runs what no other has begun,
    then what is left. Otherwise as `run_all`.
    """
    _check_keys(jobs)
    place, jobs = Path(fmus).absolute(), anchored(jobs)
    digest = journal.digests(place)
    digests = {job.key: digest(job) for job in jobs}
    known = journal.found(digests.values())
    results: dict[K, Numbers] = {job.key: known[digests[job.key]] for job in jobs if digests[job.key] in known}
    keeper = _Keeper(journal)
    twins: dict[str, list[Job[K]]] = {}
    for job in jobs:  # those that come to the same run, which is made once
        twins.setdefault(digests[job.key], []).append(job)

    def report() -> None:
        if progress is not None:
            progress(len(results), len(jobs))

    def ended(job: Job[K], values: Numbers) -> None:
        for twin in twins[digests[job.key]]:
            results[twin.key] = dict(values)
        keeper.keep(digests[job.key], values)
        report()

    report()
    for claims in (True, False):  # what others have begun may never end
        todo = [some[0] for some in twins.values() if some[0].key not in results]
        queue = _Lease(todo, digests, journal, claims=claims)
        try:
            _judge(queue, place, evaluate, no_numbers, workers, ended)
        finally:
            keeper.flush()
        for job, values in queue.elsewhere:
            results |= {twin.key: values for twin in twins[digests[job.key]]}
            report()
    return {job.key: results[job.key] for job in jobs}


def _check_keys(jobs: Sequence[Job[K]]) -> None:
    if len({job.key for job in jobs}) < len(jobs):
        raise ValueError("two jobs of a study have the same key")


class _Keeper:
    """Keeps numbers in a journal, those of LEASE together."""

    def __init__(self, journal: Journal) -> None:
        self.journal, self.kept, self.since = journal, [], time.monotonic()

    def keep(self, digest: str, values: Numbers) -> None:
        self.kept.append((digest, values))
        if time.monotonic() - self.since > LEASE:
            self.flush()

    def flush(self) -> None:
        if self.kept:
            self.journal.keep(self.kept)
        self.kept, self.since = [], time.monotonic()


class _Lease(Iterator[Job[K]]):
    """Jobs to run, reserved in a shared journal some at a time; `elsewhere`: what other processes have done meanwhile."""

    def __init__(self, jobs: Sequence[Job[K]], digests: Mapping[K, str], journal: Journal, *, claims: bool) -> None:
        self.left, self.digests, self.journal, self.claims = list(reversed(jobs)), digests, journal, claims
        self.elsewhere: list[tuple[Job[K], Numbers]] = []
        self.ready: list[Job[K]] = []
        self.size, self.since = 1, time.monotonic()

    def __next__(self) -> Job[K]:
        while not self.ready:
            if not self.left:
                raise StopIteration
            self._reserve()
        return self.ready.pop()

    def _reserve(self) -> None:
        now = time.monotonic()
        self.size = min(2 * self.size, 256) if now - self.since < LEASE else max(1, self.size // 2)
        self.since = now
        some = [self.left.pop() for _ in range(min(self.size, len(self.left)))]
        digests = {self.digests[job.key]: job for job in some}
        known = self.journal.found(digests)
        self.elsewhere += [(digests[digest], values) for digest, values in known.items()]
        rest = [digest for digest in digests if digest not in known]
        ours = self.journal.claim(rest) if self.claims else set(rest)
        self.ready = [digests[digest] for digest in reversed(rest) if digest in ours]
