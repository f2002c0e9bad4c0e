"""FMUs as files: checked, unpacked once while they are in use, described; and what is loaded of them, with its end.

An unpacked FMU lasts as long as an instance of it, or as it is among the KEPT last ones that were asked for. Then its folder
is removed. Its libraries are unloaded where this project has made them; those of other tools stay loaded, since not all of
them survive being unloaded, and what PythonFMU has made stays as it is, for Python has its modules from there.
"""

from __future__ import annotations

import os
import threading
import zipfile
from collections import OrderedDict
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn
from weakref import finalize
from xml.parsers import expat

import fmpy
import fmpy.fmi2
from fmpy.model_description import ModelDescription

from filing.origin import SOFTWARE
from fmu_export.errors import shown
from fmu_export.files import FilePath

from .archives import UnpackedArchive
from .errors import UserError
from .pendulum_files import PENDULUM_FMUS
from .python_wrapper import finalize_at_exit
from .start_values import StartValue

KEPT = 16
"""Unpacked FMUs that are kept though no instance needs them: as many as a comparison of several systems has."""

LOADING = threading.RLock()
"""FMPy changes the process's folder while it loads a library."""

_kept: OrderedDict[tuple[str, int, int], UnpackedFmu] = OrderedDict()
"""The last ones, by path, time and size of the file."""

_python: set[UnpackedFmu] = set()
"""Those that Python has modules of."""


class UnpackedFmu:
    """An FMU unpacked into a folder, with its description and its loaded libraries.

    Raises UserError for a file that is not an FMU, or not an FMU of FMI 2.0.
    """

    def __init__(self, path: Path) -> None:
        if not zipfile.is_zipfile(path):
            raise UserError(f"{path} is not an FMU: it is not a zip file")
        self._archive = UnpackedArchive(path)
        try:
            self.description = _description(path, self.folder)
            _check_folder(self.folder, self.description)
        except BaseException:
            self._archive.remove()
            raise
        self._idle: dict[tuple[type, str], list[Any]] = {}
        if (self.description.generationTool or "").startswith(f"{SOFTWARE} "):
            finalize(self, _unload, self._idle).atexit = False

    @property
    def folder(self) -> Path:
        """Where it is unpacked."""
        return self._archive.folder

    @cached_property
    def start_values(self) -> dict[str, StartValue]:
        """The start values of its numbers and truth values by name, in their types."""
        types = {"Real": float, "Boolean": lambda text: str(text).lower() in ("true", "1"), "String": None}
        return {
            v.name: convert(v.start)
            for v in self.description.modelVariables
            if v.start is not None and (convert := types.get(v.type, int)) is not None
        }

    def library(self, kind: type[fmpy.fmi2._FMU2], identifier: str, instance: str) -> Any:
        """Return FMPy's object of a library for one instance: one that was given back, as loading costs more than a run."""
        idle = self._idle.setdefault((kind, identifier), [])
        try:
            loaded = idle.pop()
        except IndexError:
            guid, folder = self.description.guid, str(self.folder)
            loaded = kind(guid=guid, unzipDirectory=folder, modelIdentifier=identifier, instanceName=instance)
            if finalize_at_exit(loaded.dll):
                _python.add(self)
        loaded.instanceName = instance
        return loaded

    def give_back(self, loaded: Any) -> None:
        """Take back a library whose instance has been freed."""
        self._idle[type(loaded), loaded.modelIdentifier].append(loaded)


def _unload(idle: dict[tuple[type, str], list[Any]]) -> None:
    for libraries in idle.values():
        for loaded in libraries:
            loaded.freeLibrary()


def check_exists(path: FilePath, advice: str = "") -> os.stat_result:
    """Return the status of an FMU's file; raise UserError, with `advice`, where there is none or it cannot be read."""
    path = Path(path)
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        made = "`qube-ihc export` makes the project's FMUs" if path.name in PENDULUM_FMUS else ""
        hints = ", ".join(filter(None, (made, advice)))
        raise UserError(f"FMU {path} does not exist{'; ' if hints else ''}{hints}") from None
    except OSError as error:
        raise UserError(f"FMU {path} cannot be read: {error.strerror}") from None


def unpacked(path: FilePath) -> UnpackedFmu:
    """Return an FMU unpacked, the same for the same file content while it is in use or was so lately.

    It is unpacked again where its folder is gone, as where temporary files are tidied under a process that lasts. Raises
    UserError for a file that is missing, not an FMU, or not an FMU of FMI 2.0.
    """
    path = Path(path)
    with LOADING:
        status = check_exists(path)
        key = (str(path.resolve()), status.st_mtime_ns, status.st_size)
        fmu = _kept.pop(key, None)
        if fmu is None or not (fmu.folder / "modelDescription.xml").is_file():
            fmu = UnpackedFmu(path)
        _kept[key] = fmu
        surplus = [_kept.popitem(last=False) for _ in range(len(_kept) - KEPT)]
    surplus.clear()
    return fmu


def describe(path: FilePath) -> ModelDescription:
    """Return an FMU's description; raises as `unpacked`."""
    return unpacked(path).description


def start_values_of(path: FilePath) -> dict[str, StartValue]:
    """Return the start values of an FMU's numbers and truth values by name, in their types; raises as `unpacked`."""
    return dict(unpacked(path).start_values)


def _check_folder(folder: Path, description: ModelDescription) -> None:
    """Raise UserError for a folder that PythonFMU's wrapper cannot read."""
    python = description.coSimulation is not None and description.coSimulation.needsExecutionTool
    if python and "%" in folder.as_uri().replace("%20", ""):
        raise UserError(f"the temporary folder (TMPDIR) must be named in plain letters for Python FMUs, found {folder}")


def _description(path: Path, folder: Path) -> ModelDescription:
    """Return the description in `folder`; raise UserError for one that is not that of an FMI 2.0 FMU."""
    file = folder / "modelDescription.xml"
    if not file.is_file():
        raise UserError(f"{path} is not a valid FMU: it has no modelDescription.xml")
    try:
        _refuse_entities(path, file.read_bytes())
        description = fmpy.read_model_description(str(folder))
    except UserError:
        raise
    except Exception as error:  # FMPy raises bare exceptions of many kinds
        raise UserError(f"{path} is not a valid FMU: {_first_line(error)}") from None
    kinds = [kind for kind in (description.coSimulation, description.modelExchange) if kind is not None]
    if description.fmiVersion != "2.0" or not kinds:
        raise UserError(f"{path} must be an FMI 2.0 FMU, found FMI {description.fmiVersion}")
    for identifier in (kind.modelIdentifier or "" for kind in kinds):
        if not (identifier.isascii() and identifier.isidentifier()):  # a file's name: a path would load another library
            raise UserError(f"{path} must have a C identifier as modelIdentifier, found {shown(identifier)}")
    return description


def _refuse_entities(path: Path, xml: bytes) -> None:
    """Raise UserError for XML with a document type: its entities can read other files, and grow without end."""

    def refuse(*_: object) -> NoReturn:
        raise UserError(f"{path} is not a valid FMU: a model description has no document type")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(xml, True)


def _first_line(error: Exception) -> str:
    """Return the first line of an error's text, and where that announces a list its first item too."""
    first, *others = str(error).splitlines() or [type(error).__name__]
    return f"{first} {others[0].lstrip('- ')}" if first.endswith(":") and others else first
