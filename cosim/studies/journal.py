"""The journal of finished runs: numbers under a digest of all that decides them, so that a repetition goes on from there."""

from __future__ import annotations

import hashlib
import json
import math
import secrets
import sqlite3
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Self

import cosim
import fmu_export
import ihc_fmu
import plant_fmu
from fmu_export.files import FilePath
from fmu_export.reading import first_bytes, read_bytes

from .. import parameter_files
from ..errors import UserError
from ..prepared import start_value
from ..results import versions
from ..scenario import Scenario
from ..scenario_files import files
from .jobs import Job
from .numbers import Numbers

APPLICATION, VERSION = 0x51554245, 2
"""What tells a journal from another SQLite file: "QUBE", and the version of its format."""

AT_ONCE = 500
"""Digests in one question to the file."""

SQLITE_HEAD = b"SQLite format 3\0"
EARLIER_JOURNAL = b"qube-ihc journal"

PATIENCE = 60.0
"""How long a process waits for another one that writes to the journal [s]."""


class Journal:
    """Finished runs' numbers in an SQLite file, each under a digest of all that decides them, with a checksum.

    Numbers are in the file when `keep` returns, and several processes may use one file at a time: each finds what the
    others have kept. Numbers of runs whose scenario, design, parameter file or FMUs, or the code that turns them into
    numbers, have changed since are not found again. The file is made with the first numbers.
    """

    def __init__(self, path: Path, purpose: str) -> None:
        """Open the journal `path` where it exists; raise UserError where the file is something else or damaged.

        `purpose` names how results became numbers; numbers of another purpose are not found.
        """
        self.path, self.purpose = path, purpose
        self._place = path.absolute()  # FMPy changes the folder of the whole process while it loads a library
        self._owner = secrets.token_hex(8)
        self._lock = threading.Lock()  # `found` is called in the threads of the runs
        self._file: sqlite3.Connection | None = None
        head = first_bytes(path, "journal", len(SQLITE_HEAD)) if path.exists() else b""
        if head.startswith(EARLIER_JOURNAL):
            raise UserError(f"{path} is a journal of an earlier version, in lines of JSON; delete or rename it")
        if head not in (b"", SQLITE_HEAD):
            raise UserError(f"{path} is not a journal of finished runs; delete or rename it")
        if head:
            with self._opened():
                pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    @property
    def known(self) -> dict[str, dict[str, float]]:
        """All numbers by digest; raises as `found`."""
        if self._file is None:
            return {}
        with self._opened() as file:
            rows = file.execute("SELECT digest, numbers, checksum FROM runs ORDER BY rowid").fetchall()
        return {row[0]: self._numbers(*row) for row in rows}

    def found(self, digests: Iterable[str]) -> dict[str, dict[str, float]]:
        """Return the numbers that are kept under `digests`; raises UserError where one does not fit its checksum."""
        if self._file is None:
            return {}
        wanted = list(digests)
        rows = []
        with self._opened() as file:
            for first in range(0, len(wanted), AT_ONCE):
                some = wanted[first : first + AT_ONCE]
                marks = ",".join("?" * len(some))
                rows += file.execute(f"SELECT digest, numbers, checksum FROM runs WHERE digest IN ({marks})", some)
        return {row[0]: self._numbers(*row) for row in rows}

    def claim(self, digests: Sequence[str]) -> set[str]:
        """Say that this process now runs `digests`; return those of which another process has not said so before.

        The other may have been killed since, so that a claim only means: this run can wait until all others are done.
        """
        with self._opened() as file:
            file.executemany("INSERT OR IGNORE INTO claims VALUES (?, ?)", [(d, self._owner) for d in digests])
            owners = [file.execute("SELECT owner FROM claims WHERE digest = ?", (d,)).fetchone()[0] for d in digests]
        return {digest for digest, owner in zip(digests, owners, strict=True) if owner == self._owner}

    def keep(self, runs: Iterable[tuple[str, Numbers]]) -> None:
        """Keep the numbers of finished runs, by their digests."""
        rows = []
        for digest, numbers in runs:
            text = json.dumps({name: None if math.isnan(value) else value for name, value in numbers.items()})
            rows.append((digest, text, _checksum(digest, text)))
        with self._opened() as file:
            file.executemany("INSERT OR REPLACE INTO runs VALUES (?, ?, ?)", rows)
            file.executemany("DELETE FROM claims WHERE digest = ?", [row[:1] for row in rows])

    def digests(self, fmus: FilePath) -> Callable[[Job[Any]], str]:
        """Return what returns, of a job, what its numbers are kept under.

        It is a hash of purpose, code, versions, scenario, changes, and of the contents of FMUs and files; what jobs share
        is read once.
        """
        common = f"{self.purpose} {code_digest()} {dict(versions())} {_scipy()}"
        scenarios: dict[tuple[int, str, str], tuple[Scenario, str]] = {}
        contents: dict[Path, bytes] = {}

        def content(what: str, file: Path | None) -> bytes:
            if file is None:
                return b""
            if file not in contents:
                contents[file] = hashlib.sha256(read_bytes(file, what)).digest()
            return contents[file]

        def of_scenario(job: Job[Any], changes: Mapping[str, Any]) -> str:
            scenario = job.scenario.changed(changes) if changes else job.scenario
            digest = hashlib.sha256(f"{common} {scenario.model_dump_json()}".encode())
            used = files(scenario, fmus, job.folder)
            for fmu in used.fmus.values():
                digest.update(content("FMU", fmu))
            parameters = parameter_files.file_of(scenario.plant.parameters, job.folder)
            for what, file in (
                ("design", used.design),
                ("parameter", parameters),
                *(("signal", table) for table in used.tables.values()),
            ):
                digest.update(content(what, file))
            return digest.hexdigest()

        def of_job(job: Job[Any]) -> str:
            start = {entry: value for entry, value in job.changes.items() if start_value(entry)[1]}
            others = {entry: value for entry, value in job.changes.items() if entry not in start}
            key = id(job.scenario), str(job.folder), json.dumps(others, sort_keys=True, default=str)
            if key not in scenarios:
                scenarios[key] = job.scenario, of_scenario(job, others)  # the scenario is kept, and so is its id
            text = json.dumps(start, sort_keys=True)
            return hashlib.sha256(f"{scenarios[key][1]} {text}".encode()).hexdigest()[:32]

        return of_job

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """Give the open file as one transaction; what SQLite has to say becomes a UserError that names the file."""
        try:
            with self._lock:
                if self._file is None:
                    self._file = self._connected()
                with self._file:
                    yield self._file
        except OSError as error:
            raise UserError(f"the journal {self.path} cannot be written: {error.strerror}") from None
        except sqlite3.DatabaseError as error:
            raise UserError(f"the journal {self.path} is damaged or cannot be used: {error}") from None

    def _connected(self) -> sqlite3.Connection:
        self._place.parent.mkdir(parents=True, exist_ok=True)
        file = sqlite3.connect(self._place, timeout=PATIENCE, check_same_thread=False)
        try:
            with file:
                file.execute("BEGIN IMMEDIATE")
                if not file.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                    file.execute("CREATE TABLE runs (digest TEXT PRIMARY KEY, numbers TEXT, checksum TEXT)")
                    file.execute("CREATE TABLE claims (digest TEXT PRIMARY KEY, owner TEXT)")
                    file.execute(f"PRAGMA application_id = {APPLICATION}")
                    file.execute(f"PRAGMA user_version = {VERSION}")
                (kind,) = file.execute("PRAGMA application_id").fetchone()
                (version,) = file.execute("PRAGMA user_version").fetchone()
                if (kind, version) != (APPLICATION, VERSION):
                    raise UserError(f"{self.path} is not a journal of finished runs; delete or rename it")
            with suppress(sqlite3.OperationalError):  # another process has it open; otherwise a write costs no wait
                file.execute("PRAGMA journal_mode = WAL")
            file.execute("PRAGMA synchronous = NORMAL")
        except BaseException:
            file.close()
            raise
        return file

    def _numbers(self, digest: str, text: str, checksum: str) -> dict[str, float]:
        if _checksum(digest, text) != checksum:
            raise UserError(
                f"the journal {self.path} is damaged: numbers do not fit their checksum; delete or rename it"
            )
        return {name: math.nan if value is None else float(value) for name, value in json.loads(text).items()}


def _checksum(digest: str, text: str) -> str:
    return hashlib.sha256(f"{digest} {text}".encode()).hexdigest()[:16]


def code_files() -> list[Path]:
    """Return the sources that turn a scenario and its FMUs into numbers: this project's Python, and the loop in C.

    The FMUs' own code counts by their GUIDs.
    """
    packages = [Path(package.__path__[0]) for package in (cosim, fmu_export, ihc_fmu, plant_fmu)]
    loop = Path(cosim.__path__[0]) / "native"
    return [
        file for folder, ending in [(p, "*.py") for p in packages] + [(loop, "*.[ch]")] for file in folder.rglob(ending)
    ]


@cache
def code_digest() -> str:
    """Return the digest of `code_files`."""
    digest = hashlib.sha256()
    for text in sorted(file.read_bytes() for file in code_files()):
        digest.update(hashlib.sha256(text).digest())
    return digest.hexdigest()


@cache
def _scipy() -> str:
    from importlib.metadata import version  # noqa: PLC0415

    return version("scipy")  # solves for the Kalman filter's gain
