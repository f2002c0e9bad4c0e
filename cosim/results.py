"""What a run leaves: signals over time with units and metadata; written as CSV with a JSON beside it, exactly."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import to_json

from fmu_export.files import write_file

from .errors import UserError

FORMAT = "qube-ihc result 1"

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
        blocks = [",".join(["time", *self.signals]).encode()]
        columns = [self.time, *self.signals.values()]
        blocks += [_csv([c[k : k + ROWS_AT_ONCE] for c in columns]) for k in range(0, len(self.time), ROWS_AT_ONCE)]
        write_file(path, b"\n".join(blocks) + b"\n")

    @classmethod
    def load(cls, path: Path) -> Result:
        """Read a CSV and the JSON beside it; raise UserError that names the file and what is wrong with it."""
        if not path.exists():
            raise UserError(f"result file {path} does not exist")
        try:
            header = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
            with path.open(newline="", encoding="utf-8") as file:
                rows = csv.reader(file)
                names = next(rows)
                columns = list(zip(*rows, strict=True)) or [() for _ in names]
        except FileNotFoundError as error:
            raise UserError(f"result file {error.filename} does not exist") from None
        except (json.JSONDecodeError, ValueError, StopIteration, UnicodeDecodeError) as error:
            raise UserError(f"{path}: not a result: {str(error) or 'the file is empty'}") from None
        right = isinstance(header, dict) and header.get("format") == FORMAT and {"units", "metadata"} <= header.keys()
        if not right or names[:1] != ["time"] or len(names) != len(columns) or len(set(names)) != len(names):
            raise UserError(f"{path}: not a result of the format {FORMAT!r}")
        arrays = [_column(path, name, column) for name, column in zip(names, columns, strict=True)]
        return cls(arrays[0], dict(zip(names[1:], arrays[1:], strict=True)), header["units"], header["metadata"])


def _csv(columns: Sequence[Array]) -> bytes:
    """Return rows of numbers in their shortest exact form: JSON's lists of lists without the brackets.

    Pydantic's writer of JSON is several times faster than `repr`.
    """
    rows = list(zip(*[c.tolist() for c in columns], strict=True))
    return to_json(rows, inf_nan_mode="constants")[2:-2].replace(b"],[", b"\n")


def _column(path: Path, name: str, texts: tuple[str, ...]) -> Array:
    try:
        if name != "time" and texts and all(text.lstrip("-").isdigit() for text in texts):
            return np.array(texts, dtype=np.int64)
        return np.array(texts, dtype=np.float64)
    except (ValueError, OverflowError) as error:
        raise UserError(f"{path}: column {name}: {error}") from None


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of what computes a result."""
    import platform  # noqa: PLC0415
    from importlib.metadata import version  # noqa: PLC0415

    packages = ("qube-ihc", "fmpy", "pythonfmu", "numpy")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}
