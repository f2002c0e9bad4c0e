"""Many runs: in threads, interruptible, with what is finished kept in a journal, so that a repetition goes on from there."""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, Generic, Self, TypeVar

from . import parameter_files
from .errors import SimulationError, UserError
from .fmu import describe
from .interrupts import second_ends
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
    ones stopped at their next look. Raises ValueError where two jobs have the same key.
    """
    if len({job.key for job in jobs}) < len(jobs):
        raise ValueError("two jobs of a campaign have the same key")
    fmus = fmus.absolute()  # FMPy changes the folder of the whole process while it loads a library
    jobs = [_anchored(job) for job in jobs]
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
    with second_ends(), ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        try:
            futures: dict[Future[T], Job[K]] = {pool.submit(run, job): job for job in jobs}
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


def _anchored(job: Job[K]) -> Job[K]:
    """Return the job with absolute paths."""
    parameters = parameter_files.file_of(job.scenario.plant.parameters, job.folder)
    if parameters is not None:
        job = replace(job, scenario=job.scenario.changed({"plant.parameters": str(parameters.absolute())}))
    return replace(job, folder=None if job.folder is None else job.folder.absolute())


class Journal:
    """Finished runs' numbers in a file of JSON lines, each under a digest of all that decides them.

    A line is written when its run is finished; a last line that was cut short is dropped. Numbers of runs whose scenario,
    design, parameter file or FMUs have changed since are not found again. The file is made with the first line.
    """

    def __init__(self, path: Path, purpose: str) -> None:
        """Read the journal `path` where it exists; raise UserError where the file is something else.

        `purpose` names how results became numbers; numbers of another purpose are not found.
        """
        self.path, self.purpose = path, purpose
        self._place = path.absolute()  # FMPy changes the folder of the whole process while it loads a library
        self.known: dict[str, dict[str, float]] = {}
        self._file: IO[bytes] | None = None
        try:
            lines = path.read_bytes().splitlines(keepends=True)
        except FileNotFoundError:
            lines = []
        head = lines[0].rstrip(b"\r\n") if lines else b""
        begun = lines in ([], [head]) and JOURNAL_FORMAT.encode().startswith(head)
        if head != JOURNAL_FORMAT.encode() and not begun:
            raise UserError(f"{path} is not a journal of the format {JOURNAL_FORMAT!r}; delete or rename it")
        if lines and not lines[-1].endswith(b"\n"):
            lines.pop()
        for number, line in enumerate(lines[1:], start=2):
            self.known.update([self._read(line, number)])
        self._whole = sum(map(len, lines))

    def _read(self, line: bytes, number: int) -> tuple[str, dict[str, float]]:
        try:
            digest, numbers = json.loads(line)
            return str(digest), {str(n): math.nan if v is None else _as_float(v) for n, v in numbers.items()}
        except (ValueError, TypeError, AttributeError):
            raise UserError(
                f"{self.path}: line {number} is not [digest, numbers]; delete the line or the file"
            ) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def digest(self, job: Job[Any], fmus: Path) -> str:
        """Return what the job's numbers are kept under: a hash of purpose, versions, scenario, FMUs and files."""
        about = hashlib.sha256(f"{self.purpose} {dict(versions())}".encode())
        about.update(job.scenario.model_dump_json().encode())
        plant, controller, design = files(job.scenario, fmus, job.folder)
        for fmu in (plant, controller):
            about.update(str(describe(fmu)[1].guid).encode())
        parameters = parameter_files.file_of(job.scenario.plant.parameters, job.folder)
        for what, file in (("design", design), ("parameter", parameters)):
            try:
                about.update(b"" if file is None else file.read_bytes())
            except FileNotFoundError:
                raise UserError(f"{what} file {file} does not exist") from None
        return about.hexdigest()[:32]

    def keep(self, digest: str, numbers: Numbers) -> None:
        """Append the numbers of a finished run."""
        self.known[digest] = dict(numbers)
        safe = {name: None if math.isnan(value) else value for name, value in numbers.items()}
        file = self._opened()
        file.write(json.dumps([digest, safe]).encode() + b"\n")
        file.flush()

    def _opened(self) -> IO[bytes]:
        if self._file is None:
            self._place.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._place.open("ab")
            self._file.truncate(self._whole)
            if not self._whole:
                self._file.write(JOURNAL_FORMAT.encode() + b"\n")
        return self._file


def _as_float(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError
    return float(value)


def counted(numbers: Numbers, name: str) -> float:
    """Return a number by which draws are compared: infinite where it is NaN or missing, or the pendulum fell."""
    value = numbers.get(name, math.nan) if numbers.get("kept") else math.nan
    return math.inf if math.isnan(value) else value


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
