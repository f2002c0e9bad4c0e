"""Jobs run by the workers of a Dask cluster: in portions, to the same numbers to the last bit.

Scenarios travel with the content of the files that they name, once to each worker, and workers need this package only, the
same version of it. A portion that a lost worker had begun is run by another; at the end, one that a slow worker still has.
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import shutil
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from filing.files import write_file
from fmu_export.reading import read_bytes

from .. import parameter_files
from ..errors import UserError
from ..interrupts import second_ends
from ..results import Result, versions
from ..scenario import Scenario
from ..scenario_files import files
from .jobs import Job
from .journal import code_digest
from .judging import Judging

if TYPE_CHECKING:
    from distributed import Client, Future

T = TypeVar("T")

PORTION = 1.0
"""How long a worker has with a portion of the jobs [s]."""

ANSWER = 10.0
"""How long a scheduler has to answer [s]."""

SLOW = 3.0
"""A portion counts as slow from this times the usual time on; then another worker runs it too where nothing else is left."""

_DESIGN, _PARAMETERS = "design.json", "parameters.toml"
_NAMING = (".fmu", ".design", ".parameters", ".file")
"""How entries end that name files."""


@dataclass(frozen=True)
class Parcel:
    """A scenario with the contents of the files that it names; `digest` tells it from others."""

    scenario: str
    contents: Mapping[str, bytes]
    digest: str

    def unpacked(self) -> tuple[Scenario, Path]:
        """Return the scenario and the folder of its files, which lasts as long as the process."""
        with _unpacking:
            if self.digest not in _unpacked:
                folder = Path(tempfile.mkdtemp(prefix="qube-ihc-parcel-"))
                atexit.register(shutil.rmtree, folder, ignore_errors=True)
                for name, content in self.contents.items():
                    write_file(folder / name, content)
                _unpacked[self.digest] = Scenario.model_validate_json(self.scenario), folder
            return _unpacked[self.digest]


_unpacked: dict[str, tuple[Scenario, Path]] = {}
_unpacking = threading.Lock()
_own = threading.local()


def packed(scenario: Scenario, fmus: Path, folder: Path | None) -> Parcel:
    """Return a scenario with its files' contents; raises UserError for a file that cannot be read."""
    used = files(scenario, fmus, folder)
    contents = {path.name: read_bytes(path, "FMU") for path in used.fmus.values()}
    contents |= {name: read_bytes(path, "signal") for name, path in used.tables.items()}
    parameters = parameter_files.file_of(scenario.plant.parameters, folder)
    changes = {}
    if used.design is not None:
        contents[_DESIGN] = read_bytes(used.design, "design")
        changes["controller.design"] = _DESIGN
    if parameters is not None:
        contents[_PARAMETERS] = read_bytes(parameters, "parameter")
        changes["plant.parameters"] = _PARAMETERS
    text = scenario.changed(changes).model_dump_json()
    digest = hashlib.sha256(text.encode())
    for name in sorted(contents):
        digest.update(name.encode() + b"\0" + hashlib.sha256(contents[name]).digest())
    return Parcel(text, contents, digest.hexdigest()[:32])


def identity() -> str:
    """Return what has to be the same here and on a worker for the same numbers: the code, and the libraries' versions."""
    return f"{code_digest()[:16]} {dict(versions())}"


def run_portion(
    parcel: Parcel,
    changes: Sequence[Mapping[str, Any]],
    judge: Callable[[Result], T],
    failed: Callable[[Any], T] | None,
    expected: str,
) -> list[T]:
    """Run a portion on a worker; return what `judge` makes of each run."""
    if identity() != expected:
        raise UserError(
            f"the cluster's workers must have this version of qube-ihc and its libraries, {expected}, found {identity()}"
        )
    scenario, folder = parcel.unpacked()
    judging = getattr(_own, "judging", None)
    if judging is None:
        judging = _own.judging = Judging()
    jobs = [Job(None, scenario, folder, change) for change in changes]
    return [judging(job, folder, judge, failed) for job in jobs]


@dataclass(eq=False)
class _Portion(Generic[T]):
    """Jobs that travel together."""

    jobs: list[Job[Any]]
    changes: list[Mapping[str, Any]]
    parcel: Future
    since: float = field(default_factory=time.monotonic)
    futures: list[Future] = field(default_factory=list)
    done: bool = False
    again: bool = False


def _checked_address(address: str) -> str:
    """Return the address with its protocol; raise UserError for a text that is none."""
    protocol, separator, rest = address.rpartition("://")
    host, colon, port = rest.rpartition(":")
    if (separator and protocol not in ("tcp", "tls", "ws", "wss", "ucx")) or not (host and colon and port.isdigit()):
        raise UserError(f"--cluster takes the address of a scheduler, such as tcp://10.0.0.5:8786, found {address!r}")
    return f"{protocol or 'tcp'}://{rest}"


class Cluster:
    """A cluster's scheduler, at an address such as `tcp://10.0.0.5:8786`."""

    def __init__(self, address: str) -> None:
        """Connect; raise UserError where Dask is not installed, or nobody answers."""
        try:
            from distributed import Client  # noqa: PLC0415 - optional, and heavy
        except ImportError:
            raise UserError('--cluster needs Dask, which is not installed: pip install "qube-ihc[cluster]"') from None
        self.address = _checked_address(address)
        for name in ("distributed.client", "distributed.comm", "distributed.core", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what is to be said is said here
        try:
            self.client: Client = Client(self.address, timeout=ANSWER, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise UserError(
                f"no Dask scheduler answers at {address!r} within {ANSWER:g} s: {str(error).splitlines()[0][:200]}"
            ) from None

    def execute(
        self,
        jobs: Iterator[Job[Any]],
        fmus: Path,
        judge: Callable[[Result], T],
        failed: Callable[[Any], T] | None,
        ended: Callable[[Job[Any], T], None],
    ) -> None:
        """Run jobs on the workers; call `ended(job, value)` here for each.

        Raises what a run raises, UserError where the scheduler is lost, after `ended` for all that has come back.
        """
        with second_ends():
            _Dispatch(self, jobs, fmus, judge, failed, ended).run()

    def close(self) -> None:
        """End the connection."""
        with suppress(Exception):  # of a scheduler that is gone
            self.client.close(timeout=2)


class _Dispatch(Generic[T]):
    """What is under way of the jobs."""

    def __init__(
        self,
        cluster: Cluster,
        jobs: Iterator[Job[Any]],
        fmus: Path,
        judge: Callable[[Result], T],
        failed: Callable[[Any], T] | None,
        ended: Callable[[Job[Any], T], None],
    ) -> None:
        self.cluster, self.client, self.jobs, self.fmus = cluster, cluster.client, jobs, fmus
        self.judge, self.failed, self.ended = judge, failed, ended
        self.expected = identity()
        self.back: SimpleQueue[tuple[_Portion[T], Future]] = SimpleQueue()
        self.parcels: dict[tuple[int, str, str], tuple[Scenario, Future]] = {}
        self.out: set[_Portion[T]] = set()
        self.next: Job[Any] | None = None
        self.size, self.times = 1, []
        self.exhausted = False

    def run(self) -> None:
        """Hand out portions until all is done."""
        try:
            self._hand_out()
            while self.out:
                try:
                    portion, future = self.back.get(timeout=0.5)
                except Empty:
                    self._check_alive()
                else:
                    self._receive(portion, future)
                self._hand_out()
        except (OSError, TimeoutError):
            raise self._lost() from None
        finally:
            while True:  # what came back while the rest was stopped
                try:
                    portion, future = self.back.get_nowait()
                except Empty:
                    break
                if future.status == "finished" and not portion.done:
                    self._take(portion, future)
            futures = [future for portion in self.out for future in portion.futures]
            if futures and self.client.status == "running":
                with suppress(Exception):
                    self.client.cancel(futures, force=True)

    def _threads(self) -> int:
        threads: dict[str, int] = self.client.nthreads()  # type: ignore[assignment] - a coroutine in asynchronous clients
        return max(1, sum(threads.values()))

    def _hand_out(self) -> None:
        """Send portions until every thread of the cluster has one, and a second one to begin with at once."""
        if self.client.status != "running":
            self._check_alive()
        wanted = 2 * self._threads()
        while not self.exhausted and len(self.out) < wanted:
            portion = self._portion()
            if portion is None:
                self.exhausted = True
                break
            self._send(portion)
        if self.exhausted:
            self._send_slow_ones_again()

    def _portion(self) -> _Portion[T] | None:
        """Return the next jobs that share a parcel."""
        some: list[Job[Any]] = []
        changes: list[Mapping[str, Any]] = []
        parcel = None
        while len(some) < self.size:
            job = self.next if self.next is not None else next(self.jobs, None)
            self.next = None
            if job is None:
                break
            own, rest = self._parcel(job)
            if parcel is not None and own is not parcel:
                self.next = job
                break
            parcel = own
            some.append(job)
            changes.append(rest)
        return None if parcel is None else _Portion(some, changes, parcel)

    def _parcel(self, job: Job[Any]) -> tuple[Future, Mapping[str, Any]]:
        """Return the parcel of a job's scenario, and what is still to be changed in it."""
        naming = {entry: value for entry, value in job.changes.items() if entry.endswith(_NAMING)}
        key = id(job.scenario), str(job.folder), repr(sorted(naming.items()))
        if key not in self.parcels:
            scenario = job.scenario.changed(naming) if naming else job.scenario
            parcel = packed(scenario, self.fmus, None if job.folder is None else Path(job.folder))
            future = self.client.submit(_same, parcel, key=f"qube-ihc-parcel-{parcel.digest}-{time.time_ns()}")
            self.parcels[key] = job.scenario, future  # a task with its content: a worker that loses it is no loss
        rest = {entry: value for entry, value in job.changes.items() if entry not in naming}
        return self.parcels[key][1], rest

    def _send(self, portion: _Portion[T], priority: int = 0) -> None:
        future = self.client.submit(
            run_portion,
            portion.parcel,
            portion.changes,
            self.judge,
            self.failed,
            self.expected,
            pure=False,
            priority=priority,
        )
        portion.futures.append(future)
        self.out.add(portion)
        future.add_done_callback(lambda done: self.back.put((portion, done)))

    def _receive(self, portion: _Portion[T], future: Future) -> None:
        if portion.done:
            return
        if future.status == "finished":
            self._take(portion, future)
        elif future.status == "error":
            error = future.exception()
            assert error is not None
            raise (
                error
                if isinstance(error, UserError)
                else RuntimeError(f"a worker of the cluster failed: {type(error).__name__}: {error}")
            )
        else:
            self._check_alive()
            portion.futures.remove(future)
            self._send(portion)

    def _take(self, portion: _Portion[T], future: Future) -> None:
        """Take what a portion has come to, whoever was first."""
        values = future.result()
        portion.done = True
        self.out.discard(portion)
        for other in portion.futures:
            if other is not future:
                with suppress(Exception):
                    other.cancel()
        seconds = time.monotonic() - portion.since
        self.times.append(seconds)
        for job, value in zip(portion.jobs, values, strict=True):
            self.ended(job, value)
        per_job = statistics.median(self.times[-20:]) / max(1, len(portion.jobs))
        self.size = max(1, min(2 * self.size, round(PORTION / max(per_job, 1e-6)), 1000))

    def _send_slow_ones_again(self) -> None:
        usual = max(PORTION, statistics.median(self.times[-20:])) if self.times else PORTION
        for portion in list(self.out):
            if not portion.again and time.monotonic() - portion.since > SLOW * 2 * usual:
                portion.again = True
                self._send(portion, priority=1)

    def _check_alive(self) -> None:
        """Raise an error where the scheduler does not answer any more."""
        if self.client.status != "running":
            raise self._lost()
        self.client.sync(self.client.scheduler.identity, callback_timeout=ANSWER)  # type: ignore[union-attr]

    def _lost(self) -> UserError:
        return UserError(
            f"the Dask scheduler at {self.cluster.address} is gone; what has come back is kept, and the same command goes on"
        )


def _same(parcel: Parcel) -> Parcel:
    return parcel
