"""Many runs: in threads, interruptible, with what is finished kept in a journal, so that a repetition goes on from there."""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

from .errors import SimulationError, UserError
from .fmu import describe
from .results import Result, versions
from .scenario import Scenario, files, run_scenario

JOURNAL_FORMAT = "qube-ihc journal 1"

K = TypeVar("K", bound=Hashable)
T = TypeVar("T")

Numbers = Mapping[str, float]
"""What is kept of a run: numbers by name, NaN where there is none."""


@dataclass(frozen=True)
class Job(Generic[K]):
    """One run of a campaign: what it is called there, its scenario and the folder of the scenario's files."""

    key: K
    scenario: Scenario
    folder: Path | None = None


def run_all(
    jobs: Sequence[Job[K]],
    fmus: Path,
    finish: Callable[[Result], T],
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    done: Callable[[Job[K], T], None] | None = None,
    failed: Callable[[SimulationError], T] | None = None,
) -> dict[K, T]:
    """Run every job in `workers` threads (None: one per core); return what `finish` makes of each result, by key.

    Native FMUs step without Python's lock, so that threads use all cores; `finish` runs in the thread of its run.
    `done` and `progress(done, total)` are called in this thread after each job. Raises what a run raises, unless `failed`
    turns the failure of an FMU into a value; on that, and on Ctrl-C, jobs that have not begun are dropped and running
    ones stopped at their next look.
    """
    stop = threading.Event()

    def look(_done: int = 0, _total: int = 0) -> None:
        if stop.is_set():
            raise KeyboardInterrupt

    def run(job: Job[K]) -> T:
        look()
        try:
            return finish(run_scenario(job.scenario, fmus, job.folder, look))
        except SimulationError as error:
            if failed is None:
                raise
            return failed(error)

    found: dict[K, T] = {}
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        futures: dict[Future[T], Job[K]] = {pool.submit(run, job): job for job in jobs}
        try:
            for future in as_completed(futures):
                job = futures[future]
                found[job.key] = future.result()
                if done is not None:
                    done(job, found[job.key])
                if progress is not None:
                    progress(len(found), len(jobs))
        except BaseException:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return {job.key: found[job.key] for job in jobs}


class Journal:
    """Finished runs' numbers in a file of JSON lines, each under a digest of all that decides them.

    A line is written whole when its run is finished; a last line cut short by a power failure is dropped. Numbers of runs
    whose scenario, start values or FMUs have changed since are not found again.
    """

    def __init__(self, path: Path, purpose: str) -> None:
        """Open or begin the journal `path`; raise UserError where the file is something else.

        `purpose` names how results became numbers; numbers of another purpose are not found.
        """
        self.path, self.purpose = path, purpose
        self.known: dict[str, dict[str, float]] = {}
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            text = ""
        lines = text.splitlines(keepends=True)
        if lines and not lines[-1].endswith("\n"):
            lines.pop()
        if lines and lines[0].strip() != JOURNAL_FORMAT:
            raise UserError(f"{path} is not a journal of the format {JOURNAL_FORMAT!r}; delete or rename it")
        for line in lines[1:]:
            digest, numbers = json.loads(line)
            self.known[digest] = {name: math.nan if value is None else value for name, value in numbers.items()}
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a", encoding="utf-8")
        self._file.truncate(len("".join(lines).encode()))
        if not lines:
            self._file.write(JOURNAL_FORMAT + "\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def digest(self, job: Job[Any], fmus: Path) -> str:
        """Return what the job's numbers are kept under: a hash of purpose, versions, scenario, FMUs and design."""
        about = hashlib.sha256(f"{self.purpose} {dict(versions())}".encode())
        about.update(job.scenario.model_dump_json().encode())
        plant, controller, design = files(job.scenario, fmus, job.folder)
        for fmu in (plant, controller):
            about.update(str(describe(fmu)[1].guid).encode())
        if design is not None:
            about.update(design.read_bytes())
        return about.hexdigest()[:32]

    def keep(self, digest: str, numbers: Numbers) -> None:
        """Append the numbers of a finished run."""
        self.known[digest] = dict(numbers)
        safe = {name: None if math.isnan(value) else value for name, value in numbers.items()}
        self._file.write(json.dumps([digest, safe]) + "\n")
        self._file.flush()


def run_numbers(
    jobs: Sequence[Job[K]],
    fmus: Path,
    evaluate: Callable[[Result], Numbers],
    journal: Journal,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[K, Numbers]:
    """Return each job's numbers, from the journal or by a run; `progress` counts both.

    A run that an FMU ends with an error has no numbers: an empty mapping, kept too. Otherwise as `run_all`.
    """
    digests = {job.key: journal.digest(job, fmus) for job in jobs}
    missing = [job for job in jobs if digests[job.key] not in journal.known]
    before = len(jobs) - len(missing)

    def report(done: int, _total: int) -> None:
        if progress is not None:
            progress(before + done, len(jobs))

    report(0, 0)
    run_all(
        missing,
        fmus,
        evaluate,
        workers,
        report,
        done=lambda job, numbers: journal.keep(digests[job.key], numbers),
        failed=lambda _error: {},
    )
    return {job.key: journal.known[digests[job.key]] for job in jobs}
