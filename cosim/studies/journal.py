"""The journal of finished runs: numbers under a digest of all that decides them, so that a repetition goes on from there."""

from __future__ import annotations

import hashlib
import json
import math
import secrets
import sqlite3
import threading
from collections.abc import Iterator
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
from ..fmu_files import describe
from ..results import versions
from ..scenario_files import files
from .jobs import Job
from .numbers import Numbers

APPLICATION, VERSION = 0x51554245, 2
"""What tells a journal from another SQLite file: "QUBE", and the version of its format."""

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

    def found(self, digest: str) -> dict[str, float] | None:
        """Return the numbers kept under `digest`; raises UserError where they do not fit their checksum."""
        if self._file is None:
            return None
        with self._opened() as file:
            row = file.execute("SELECT digest, numbers, checksum FROM runs WHERE digest = ?", (digest,)).fetchone()
        return None if row is None else self._numbers(*row)

    def claim(self, digest: str) -> bool:
        """Say that this process now runs `digest`; return False where another process has said so before.

        The other may have been killed since, so that a claim only means: this run can wait until all others are done.
        """
        with self._opened() as file:
            file.execute("INSERT OR IGNORE INTO claims VALUES (?, ?)", (digest, self._owner))
            (owner,) = file.execute("SELECT owner FROM claims WHERE digest = ?", (digest,)).fetchone()
        return owner == self._owner

    def keep(self, digest: str, numbers: Numbers) -> None:
        """Keep the numbers of a finished run."""
        text = json.dumps({name: None if math.isnan(value) else value for name, value in numbers.items()})
        with self._opened() as file:
            file.execute("INSERT OR REPLACE INTO runs VALUES (?, ?, ?)", (digest, text, _checksum(digest, text)))
            file.execute("DELETE FROM claims WHERE digest = ?", (digest,))

    def digest(self, job: Job[Any], fmus: FilePath) -> str:
        """Return what the job's numbers are kept under: a hash of purpose, code, versions, scenario, FMUs and files."""
        digest = hashlib.sha256(f"{self.purpose} {code_digest()} {dict(versions())} {_scipy()}".encode())
        digest.update(job.whole.model_dump_json().encode())
        used = files(job.whole, fmus, job.folder)
        for fmu in used.fmus.values():
            digest.update(str(describe(fmu).guid).encode())
        parameters = parameter_files.file_of(job.whole.plant.parameters, job.folder)
        others = [("design", used.design), ("parameter", parameters), *(("signal", t) for t in used.tables.values())]
        for what, file in others:
            digest.update(b"" if file is None else hashlib.sha256(read_bytes(file, what)).digest())
        return digest.hexdigest()[:32]

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """Give the open file as one transaction; what SQLite has to say becomes a UserError that names the file."""
        try:
            with self._lock:
                if self._file is None:
                    self._file = self._connected()
                with self._file:
                    yield self._file
        except (sqlite3.DatabaseError, OSError) as error:
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
