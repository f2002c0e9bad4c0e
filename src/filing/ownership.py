"""Whose is a file that is about to be replaced? One that this project did not write stays.

Every kind of file that is written for users says by what: JSON under "format", pictures and FMUs by the software that made
them, texts in a comment. A table (CSV) has no place for that; it is known by the description (*.json, *.md) beside it, or by
its heading.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from fmu_export.archive import made_by
from fmu_export.errors import UserError

from .origin import SOFTWARE, WRITTEN

_HEAD = 1024
_INSTANCES = ("controller.", "plant.", "hil.")
_HEADINGS = (
    "law,seed,",
    "law,draw,",
    "draw,law,",
    "mu,u_max,a_min,b_max,",
    "kind,chosen,",
    "time,voltage,what",
    "experiment,parameters,step,gain,variant,draw,",
)
"""Beginnings of tables' headings besides those of results."""


def check_replaceable(*paths: Path, kind: str = "") -> None:
    """Raise UserError for the first of the files that exists and that this project did not write, or cannot be a file.

    `kind` is what JSON files among them are to be, "result" for one: a file of another kind stays too.
    """
    for path in paths:
        try:
            exists = path.exists()
            above = next((folder for folder in path.parents if folder.exists()), None)
        except OSError as error:
            raise UserError(f"{path} cannot be written: {error.strerror}") from None
        if exists and path.is_dir():
            raise UserError(f"{path} cannot be written: it is a folder")
        if above is not None and not above.is_dir():
            raise UserError(f"{path} cannot be written: {above} is a file, not a folder")
        if not exists:
            continue
        if not is_ours(path):
            raise UserError(f"{path} was not written by {SOFTWARE} and stays; choose another name or move that file")
        actual = kind_of(path.read_bytes()) if kind and path.suffix.lower() == ".json" else ""
        if actual and actual != kind:
            raise UserError(f"{path} is a {actual}, not a {kind}, and stays; choose another name or move that file")


def kind_of(content: str | bytes) -> str:
    """Return what the content of a JSON file of this project is, such as "result" or "design"; empty for other content."""
    try:
        data = json.loads(content)
    except (ValueError, RecursionError):
        return ""
    software, _, rest = str(data.get("format", "") if isinstance(data, dict) else "").partition(" ")
    return rest.rpartition(" ")[0] if software == SOFTWARE else ""


def is_ours(path: Path) -> bool:
    """Return whether the file `path` is one that this project wrote, or of a kind that it does not write for users."""
    kind = _KINDS.get(path.suffix.lower())
    return kind is None or path.stat().st_size == 0 or kind(path)


def _is_json(path: Path) -> bool:
    return bool(kind_of(path.read_bytes()))


def _is_table(path: Path) -> bool:
    described, listed = path.with_suffix(".json"), path.with_suffix(".md")
    if described.is_file() and kind_of(described.read_bytes()) in ("result", "comparison"):
        return True
    if listed.is_file() and is_ours(listed):
        return True
    with path.open("rb") as file:
        heading = file.readline().decode("utf-8", "replace").rstrip("\r\n")
    time, *names = heading.split(",")
    is_result = time == "time" and bool(names) and all(name.startswith(_INSTANCES) for name in names)
    return is_result or heading.startswith(_HEADINGS)


def _is_archive(path: Path) -> bool:
    return made_by(path, SOFTWARE)


def _says(text: str) -> Callable[[Path], bool]:
    def says(path: Path) -> bool:
        with path.open("rb") as file:
            return text.encode() in file.read(_HEAD)

    return says


def _is_parquet(path: Path) -> bool:
    """Return whether the file's metadata, which stand at its end before their length, name this project."""
    content = path.read_bytes()
    length = int.from_bytes(content[-8:-4], "little")
    return content[-4:] == b"PAR1" and SOFTWARE.encode() in content[-8 - length : -8]


_KINDS: dict[str, Callable[[Path], bool]] = {
    ".json": _is_json,
    ".csv": _is_table,
    ".parquet": _is_parquet,
    ".png": _says(f"Software\0{SOFTWARE}"),
    ".fmu": _is_archive,
    ".ssp": _is_archive,
    ".toml": _says(WRITTEN),
    ".md": _says(WRITTEN),
    ".html": _says(WRITTEN),
}
