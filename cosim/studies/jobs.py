"""Jobs: the runs of a study."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from fmu_export.files import FilePath

from .. import parameter_files
from ..scenario import Scenario

K = TypeVar("K", bound=Hashable)


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


def anchored(job: Job[K]) -> Job[K]:
    """Return the job with absolute paths."""
    parameters = parameter_files.file_of(job.scenario.plant.parameters, job.folder)
    if parameters is not None:
        job = replace(job, scenario=job.scenario.changed({"plant.parameters": str(parameters.absolute())}))
    return replace(job, folder=None if job.folder is None else Path(job.folder).absolute())
