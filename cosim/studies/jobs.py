"""Jobs: the runs of a study."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from fmu_export.files import FilePath

from .. import parameter_files
from ..scenario import Scenario

K = TypeVar("K", bound=Hashable)

_PARAMETERS = "plant.parameters"


@dataclass(frozen=True)
class Job(Generic[K]):
    """One run of a study: what it is called there, its scenario, the folder of the scenario's files, what is changed in it.

    Jobs that differ in `changes` only, entries as `Scenario.changed` takes them, share what their scenario costs to prepare.
    """

    key: K
    scenario: Scenario
    folder: FilePath | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def whole(self) -> Scenario:
        """The scenario with its changes."""
        return self.scenario.changed(self.changes) if self.changes else self.scenario


def anchored(jobs: Sequence[Job[K]]) -> list[Job[K]]:
    """Return the jobs with absolute paths; those that share a scenario still do."""
    scenarios: dict[tuple[int, str], Scenario] = {}

    def absolute(name: str | None, folder: FilePath | None) -> str | None:
        path = parameter_files.file_of(name, folder)
        return name if path is None else str(path.absolute())

    anchored_jobs = []
    for job in jobs:
        key = id(job.scenario), str(job.folder)
        if key not in scenarios:
            named = job.scenario.plant.parameters
            path = absolute(named, job.folder)
            scenarios[key] = job.scenario if path == named else job.scenario.changed({_PARAMETERS: path})
        changes = job.changes
        if _PARAMETERS in changes:
            changes = {**changes, _PARAMETERS: absolute(changes[_PARAMETERS], job.folder)}
        folder = None if job.folder is None else Path(job.folder).absolute()
        anchored_jobs.append(Job(job.key, scenarios[key], folder, changes))
    return anchored_jobs
