"""A study's folder: files that reach it together, described by a JSON file with what they say and their digests."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from filing.files import staging, write_file
from fmu_export.errors import UserError
from fmu_export.files import FilePath
from fmu_export.reading import read_json

from .estimates import MeanEstimate


def save_described(
    folder: FilePath, contents: str, summary: Mapping[str, Any], write: Callable[[Path], object]
) -> list[Path]:
    """Write what `write` puts into a folder that it is given, and `contents`, JSON with the summary; return the files.

    `contents` has under `files` the SHA-256 of each of the others. They reach `folder` together, and what an earlier one
    has left there and this one does not replace is removed. Raises UserError where they cannot be written.
    """
    folder = Path(folder)
    earlier = _files_of(folder / contents)
    with staging(folder, last=contents) as place:
        write(place)
        files = {path.name: _sha256(path) for path in sorted(place.iterdir())}
        write_file(place / contents, json.dumps({**summary, "files": files}, indent=1) + "\n")
    for name in earlier.keys() - files.keys():
        if _sha256(folder / name) == earlier[name]:
            (folder / name).unlink()
    return [folder / name for name in (*files, contents)]


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _files_of(path: Path) -> dict[str, str]:
    """Return the digests by plain names that an earlier description holds; none where there is no such thing."""
    try:
        files = read_json(path, path.stem)["files"]
        return {str(name): str(digest) for name, digest in files.items() if Path(name).name == name}
    except (UserError, LookupError, TypeError, AttributeError):  # not there, or another's: nothing of it is ours
        return {}


def csv_row(*cells: object) -> str:
    """Return a line of a table; names of FMUs may have commas, quotes and line breaks in them."""
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(cells)
    return text.getvalue()


def pair(estimate: MeanEstimate) -> list[float | None]:
    """Return an estimate's value and the half width of its interval, safe for JSON."""
    return [None if math.isnan(v) else v for v in (estimate.value, estimate.half_width)]
