"""The files that a scenario names, and where they are: FMUs, the controller's design, tables of signals."""

from __future__ import annotations

import filecmp
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fmu_export.files import FilePath, is_file

from . import parameter_files
from .errors import UserError
from .fmu_files import check_exists
from .inputs import CsvSignal
from .scenario import Scenario


@dataclass(frozen=True)
class Files:
    """The paths of a scenario's files: FMUs by component, the controller's design, tables of signals by their names."""

    fmus: dict[str, Path]
    design: Path | None
    tables: dict[str, Path]


def files(scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> Files:
    """Return the paths of the files that a scenario names.

    An FMU is beside the scenario or in the folder `fmus`; raises UserError where both have it and they differ.
    """

    def find(file: str) -> Path:
        beside, there = Path(folder or "") / file, Path(fmus) / file
        if folder is None or not is_file(beside):
            return there
        if is_file(there) and not filecmp.cmp(beside, there, shallow=False):
            raise UserError(
                f"{beside} and {there} are different FMUs; --fmus {folder} takes the one beside the scenario, or remove one"
            )
        return beside

    design = scenario.controller.design
    tables = [section.file for section in scenario.signals if isinstance(section, CsvSignal)]
    return Files(
        {name: find(part.fmu) for name, part in scenario.parts.items()},
        None if design is None else beside_or_here(design, folder),
        {file: beside_or_here(file, folder) for file in tables},
    )


def check_fmus_exist(fmus: Mapping[str, Path]) -> None:
    """Raise UserError for an FMU of a scenario, by its component, that is not there."""
    for path in fmus.values():
        check_exists(path, "--fmus names the folder of the scenario's FMUs")


def beside_or_here(file: str, folder: FilePath | None) -> Path:
    """Return the path of a file that a scenario names: beside it if it is there, else in the current folder."""
    beside = Path(folder or "") / file
    return beside if is_file(beside) else Path(file)


def portable(scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> tuple[Scenario, dict[str, Path]]:
    """Return a scenario for another folder, and by their names there the files that it then needs beside it.

    They are the FMUs that lie beside the scenario, or not in the folder `fmus`, tables of signals, the controller's design,
    the parameter file.
    """
    used, parameters = files(scenario, fmus, folder), parameter_files.file_of(scenario.plant.parameters, folder)
    stays = Path(fmus).absolute()
    if folder is not None and Path(folder).absolute() == stays:
        stays = None  # of an SSP file, or what lies beside the scenario
    beside = {path.name: path for path in used.fmus.values() if path.parent.absolute() != stays} | used.tables
    named = {"controller.design": used.design, "plant.parameters": parameters}
    moved = {entry: path for entry, path in named.items() if path is not None}
    beside |= {path.name: path for path in moved.values()}
    return scenario.changed({entry: path.name for entry, path in moved.items()}), beside
