"""The files of this project: written whole or not at all, and only in place of its own.

A file that this project did not write stays, and so does a JSON file of another kind than the new one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from fmu_export import files
from fmu_export.files import Content

from .ownership import check_replaceable, kind_of


def write_file(path: Path, content: Content) -> None:
    """Write `content` to `path`; raises UserError where it cannot be written or must stay."""
    files.write_file(path, content, _check)


def write_files(contents: Mapping[Path, Content]) -> None:
    """Write files of one folder that belong together, as `fmu_export.files.write_files` does; raises as `write_file`."""
    files.write_files(contents, _check)


@contextmanager
def staging(folder: Path, last: str | None = None) -> Iterator[Path]:
    """Give a hidden folder for files that belong together, as `fmu_export.files.staging` does; raises as `write_file`."""
    with files.staging(folder, _check, last) as place:
        yield place


def _check(path: Path, content: str | bytes | None) -> None:
    check_replaceable(path, kind="" if content is None else kind_of(content))
