"""What a run leaves: signals over time with units and metadata; written as CSV with a JSON beside it, exactly."""

from __future__ import annotations

import csv
import io
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, StrictStr
from pydantic_core import to_json

from fmu_export.errors import shown
from fmu_export.files import write_file
from fmu_export.reading import parse_json, read_text

from .errors import UserError
from .room import check_memory
from .typed import checked

FORMAT = "qube-ihc result 1"

BYTES_READ = 8
"""Memory that reading a table takes, for each byte of the file."""

ROWS_AT_ONCE = 500
"""Rows that become text together: few enough for the processor's caches."""

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Result:
    """Signals at communication points.

    time [s] of shape (rows,); signals by name `instance.variable`, each of shape (rows,), float64 or int64; units by
    the same names; metadata as JSON types. A row holds every output at its time; with the order controller-first the
    voltage of a row is the one that was applied over the step that ended there, with parallel the one of the next step.
    """

    time: Array
    signals: dict[str, Array]
    units: dict[str, str]
    metadata: dict[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        try:
            return self.signals[name]
        except KeyError:
            raise UserError(f"the result has no signal {name!r}; it has {', '.join(self.signals)}") from None

    def save(self, path: Path) -> None:
        """Write `path` (CSV) and the JSON beside it, under temporary names first, so that neither is ever half there."""
        if path.suffix != ".csv":
            raise UserError(f"a result goes into a file named *.csv, found {path}")
        header = {"format": FORMAT, "units": self.units, "metadata": self.metadata}
        write_file(path.with_suffix(".json"), json.dumps(header, indent=1) + "\n")
        blocks = [_names(["time", *self.signals])]
        columns = [self.time, *self.signals.values()]
        blocks += [_csv([c[k : k + ROWS_AT_ONCE] for c in columns]) for k in range(0, len(self.time), ROWS_AT_ONCE)]
        write_file(path, b"\n".join(blocks) + b"\n")

    @classmethod
    def load(cls, path: Path) -> Result:
        """Read a CSV and the JSON beside it; raise UserError that names the file and what is wrong with it."""
        if not path.exists():
            raise UserError(f"result file {path} does not exist")
        try:
            described = path.with_suffix(".json")
            header = checked(_Header, parse_json(read_text(described, "result"), described), described)
            names, columns = _table(path)
        except csv.Error as error:
            raise UserError(f"{path}: not a result: {error}") from None
        if names[:1] != ["time"] or len(set(names)) != len(names) or not set(names[1:]) <= header.units.keys():
            raise UserError(f"{path}: not a result of the format {FORMAT!r}")
        arrays = [_column(path, name, column) for name, column in zip(names, columns, strict=True)]
        result = cls(arrays[0], dict(zip(names[1:], arrays[1:], strict=True)), header.units, header.metadata)
        from .provenance import provenance  # noqa: PLC0415 - it needs this module

        provenance(result)
        return result


class _Header(BaseModel):
    """The JSON beside the table."""

    model_config = ConfigDict(extra="ignore", frozen=True)
    format: Literal["qube-ihc result 1"]
    units: dict[StrictStr, StrictStr]
    metadata: dict[str, Any]


def _table(path: Path) -> tuple[list[str], list[tuple[str, ...]]]:
    """Return (names, columns of texts) of a CSV file; raise UserError for rows of another length than the first."""
    check_memory(f"reading {path}", path.stat().st_size * BYTES_READ, "a result with fewer rows or columns can be read")
    rows = list(csv.reader(io.StringIO(read_text(path, "result", sys.maxsize), newline=""), strict=True))
    if not rows or not rows[0]:
        raise UserError(f"{path}: not a result: the file is empty")
    for number, row in enumerate(rows, start=1):
        if len(row) != len(rows[0]):
            raise UserError(
                f"{path}: row {number} must have {len(rows[0])} entries, found {len(row)}"
                + ("; the file ends there, it was cut" if number == len(rows) else "")
            )
    return rows[0], list(zip(*rows[1:], strict=True)) or [() for _ in rows[0]]


def _csv(columns: Sequence[Array]) -> bytes:
    """Return rows of numbers in their shortest exact form: JSON's lists of lists without the brackets.

    Pydantic's writer of JSON is several times faster than `repr`.
    """
    rows = list(zip(*[c.tolist() for c in columns], strict=True))
    return to_json(rows, inf_nan_mode="constants")[2:-2].replace(b"],[", b"\n")


def _names(names: Sequence[str]) -> bytes:
    """Return the first row; names of FMUs may have commas, quotes and line breaks in them."""
    return ",".join('"' + n.replace('"', '""') + '"' if set(n) & set(',"\r\n') else n for n in names).encode()


def _column(path: Path, name: str, texts: tuple[str, ...]) -> Array:
    try:
        if name != "time" and texts and all(text.lstrip("-").isdigit() for text in texts):
            return np.array(texts, dtype=np.int64)
        return np.array(texts, dtype=np.float64)
    except (ValueError, OverflowError):
        wrong = next((text for text in texts if not _is_number(text)), max(texts, key=len))
        raise UserError(f"{path}: column {shown(name)} must hold numbers, found {shown(wrong)}") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of what computes a result."""
    import platform  # noqa: PLC0415
    from importlib.metadata import version  # noqa: PLC0415

    packages = ("qube-ihc", "fmpy", "pythonfmu", "numpy")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}
