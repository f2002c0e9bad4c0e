"""What makes numbers of jobs, in one thread: the scenarios that it has prepared."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from ..prepared import Prepared
from ..results import Result, SimulationError
from ..rig import Progress
from .jobs import Job

T = TypeVar("T")

MOST_PREPARED = 8
"""Scenarios that are kept prepared."""


class Judging:
    """Runs jobs one after the other and judges them; not for several threads at a time."""

    def __init__(self) -> None:
        self.prepared: dict[tuple[int, str, str], Prepared] = {}

    def __call__(
        self,
        job: Job[Any],
        fmus: Path,
        judge: Callable[[Result], T],
        failed: Callable[[SimulationError], T] | None = None,
        look: Progress | None = None,
    ) -> T:
        """Return what `judge` makes of a run, or `failed`, where given, of an FMU's failure."""
        key = id(job.scenario), str(job.folder), str(fmus)
        ready = self.prepared.pop(key, None)
        if ready is None:
            if len(self.prepared) >= MOST_PREPARED:
                self.prepared.pop(next(iter(self.prepared))).close()
            ready = Prepared(job.scenario, fmus, job.folder)
        self.prepared[key] = ready
        return finished(lambda: ready.run(job.changes, look), judge, failed)

    def close(self) -> None:
        """Give all up that is prepared."""
        for ready in self.prepared.values():
            ready.close()
        self.prepared.clear()


def finished(
    run: Callable[[], Result], finish: Callable[[Result], T], failed: Callable[[SimulationError], T] | None
) -> T:
    """Return what `finish` makes of a run's result, or `failed`, where given, of an FMU's failure."""
    try:
        return finish(run())
    except SimulationError as error:
        if failed is None:
            raise
        return failed(error)
