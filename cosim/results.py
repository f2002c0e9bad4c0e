"""What a run leaves: signals over time with units and metadata; written as CSV with a JSON beside it, exactly.

The JSON is written last and holds the digest of the table, and its own, so that files of different runs, cut or changed
ones are refused.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic_core import to_json

from filing.files import write_files
from fmu_export.files import FilePath, uninterrupted
from fmu_export.reading import parse_json, read_bytes, read_text
from ihc_fmu.arguments import as_names

from .errors import UserError
from .provenance import provenance
from .recording import Recording
from .room import check_memory

if TYPE_CHECKING:
    from ihc_fmu.design import Design

    from .plots import Picture

FORMAT = "qube-ihc result 2"
EARLIER_FORMATS = ("qube-ihc result 1",)

ROWS_AT_ONCE = 500
"""Rows that become text together: few enough for the processor's caches."""

BYTES_READ = 8
"""Memory that reading a table takes, for each byte of the file."""

MOST_BYTES = 8 * 2**30
"""Size of the largest table that is read [byte]."""

WHOLE = ("controller.mode", "controller.fault", "hil.steps", "hil.missed", "hil.digital")
"""Signals that hold whole numbers."""
MOST_WHOLE = 2.0**31
"""They are smaller."""

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Result(Recording):
    """What a run recorded: a recording that can be drawn, written and read.

    Parameters
    ----------
    time, signals, units, metadata, judged_by
        As of `Recording`.

    Examples
    --------
    >>> import cosim
    >>> result = cosim.run("fmus/arm.ssp", {"plant.start.angle_0": 0.1, "run.duration": 3.0})
    >>> result.units["plant.angle"], float(result["plant.angle"][0])
    ('rad', 0.1)
    >>> result.to_dataframe().shape, len(result.plot("plant.angle").axes)
    ((3001, 11), 1)
    >>> result.report("tilted.html").name
    'tilted.html'
    >>> result.save("tilted.csv")
    >>> bool((cosim.Result.load("tilted.csv").time == result.time).all())
    True
    """

    def plot(self, *names: str) -> Picture:
        """Draw the result.

        Parameters
        ----------
        *names
            Signals, a panel for each; none: the overview of what the run is judged by, or of all signals where it cannot
            be judged.

        Returns
        -------
        matplotlib.figure.Figure
            The picture; nothing is written.

        Raises
        ------
        UserError
            For a signal that is not there, or a result without rows.
        """
        from .judged_signals import can_draw, can_evaluate  # noqa: PLC0415 - heavy
        from .plots import overview, panels_of  # noqa: PLC0415

        as_names("signals", names)
        if not len(self.time) or not self.signals:
            raise UserError("a plot needs at least one row and one signal")
        if not names and can_evaluate(self) and can_draw(self):
            return overview(self)
        return panels_of({"": self}, names or tuple(self.signals))

    def __repr__(self) -> str:
        end = f" until {self.time[-1]:g} s" if len(self.time) else ""
        return f"<Result: {len(self.time)} rows{end} of {', '.join(self.signals)}>"

    def _repr_html_(self) -> str:
        """Return the metrics as a table, or without them the signals, for notebooks."""
        from ihc_fmu.html import html_table  # noqa: PLC0415

        from .judged_signals import can_evaluate  # noqa: PLC0415 - heavy
        from .metrics import evaluate, unsteady  # noqa: PLC0415 - heavy
        from .tables import metric_rows  # noqa: PLC0415

        end = f", until {self.time[-1]:g} s" if len(self.time) else ""
        caption = f"{len(self.time)} rows of {len(self.signals)} signals{end}"
        if len(self.time) < 2 or not can_evaluate(self):
            return html_table(caption, ("signal", "unit"), [(name, self.units[name]) for name in self.signals])
        metrics = evaluate(self)
        why = unsteady(metrics)
        return html_table(f"{caption}{f'; * {why}' if why else ''}", (), metric_rows(metrics))

    def report(
        self,
        path: FilePath,
        *,
        title: str = "",
        notes: Sequence[str] = (),
        design: Design | None = None,
        table: FilePath | None = None,
    ) -> Path:
        """Write a page about the run, HTML in one file: metrics, notes, plots to zoom into, what was run.

        Parameters
        ----------
        path
            The page, `*.html`.
        title
            Its title; empty: the scenario's description, or its name.
        notes
            What is to be known of the run besides what its FMUs logged.
        design
            The controller's design, whose certificate the page shows; None: no certificate.
        table
            The file that the result was saved to, to which the page has a link; None: no link.

        Returns
        -------
        pathlib.Path
            The page.

        Raises
        ------
        UserError
            Where it cannot be written, or would replace a file of somebody else.
        """
        from .report.pages import write_result  # noqa: PLC0415 - heavy

        return write_result(path, self, title, notes, design, table)

    def save(self, path: FilePath) -> None:
        """Write the table `path` (CSV) and then the JSON that describes it, with its number of rows and its SHA-256.

        Both are on the disk before they get their names, and Ctrl-C waits for that.

        Parameters
        ----------
        path
            The table, a CSV file.

        Raises
        ------
        UserError
            Where they cannot be written; an earlier result is then as it was.
        """
        path = Path(path)
        if path.suffix != ".csv":
            raise UserError(f"a result goes into a file named *.csv, found {path}")
        columns = [self.time, *self.signals.values()]
        contents = {"units": self.units, "metadata": self.metadata}
        with uninterrupted():
            table = [_names(["time", *self.signals]) + b"\n"]
            for k in range(0, len(self.time), ROWS_AT_ONCE):
                table.append(_csv([c[k : k + ROWS_AT_ONCE] for c in columns]) + b"\n")
            header = {"format": FORMAT, "rows": len(self.time), "sha256": _sha256(table), **contents}
            header["description_sha256"] = _seal(header)
            write_files({path: table, path.with_suffix(".json"): json.dumps(header, indent=1) + "\n"})

    @classmethod
    def load(cls, path: FilePath) -> Result:
        """Read a CSV and the JSON that describes it.

        Parameters
        ----------
        path
            The table, a CSV file.

        Returns
        -------
        Result
            As it was saved.

        Raises
        ------
        UserError
            Names the file and what does not fit.
        """
        path = Path(path)
        if path.is_file():
            size = BYTES_READ * path.stat().st_size
            check_memory(f"reading {path}", size, "a result with fewer rows or columns can be read")
        content = read_bytes(path, "result", MOST_BYTES)
        header = _description(path.with_suffix(".json"))
        rows = content.count(b"\n") - 1 - sum(name.count("\n") for name in header["units"])
        if rows != header["rows"]:
            raise UserError(f"{path} has {rows} rows, its description says {header['rows']}: cut, or of another run")
        if _sha256([content]) != header["sha256"]:
            raise UserError(f"{path} is not the table that its description means: changed, or of another run")
        try:
            names, *lines = csv.reader(io.StringIO(content.decode("utf-8"), newline=""))
        except (csv.Error, UnicodeDecodeError):
            raise UserError(f"{path} is not a table of numbers") from None
        wrong = next((k for k, line in enumerate(lines, 1) if len(line) != len(names)), None)
        if wrong is not None:
            raise UserError(f"{path}: row {wrong} has {len(lines[wrong - 1])} values for {len(names)} columns")
        if names[:1] != ["time"] or len(set(names)) != len(names) or not set(names[1:]) <= header["units"].keys():
            raise UserError(f"{path}: the columns must be time and signals with units, found {', '.join(names)}")
        columns = list(zip(*lines, strict=True)) or [() for _ in names]
        arrays = [_column(path, name, column) for name, column in zip(names, columns, strict=True)]
        if not (np.isfinite(arrays[0]).all() and np.all(arrays[0][1:] > arrays[0][:-1])):
            raise UserError(f"{path}: the time must grow from row to row")
        result = cls(arrays[0], dict(zip(names[1:], arrays[1:], strict=True)), header["units"], header["metadata"])
        provenance(result, f"{path.with_suffix('.json')}: metadata")
        return result


class SimulationError(RuntimeError):
    """A run failed on the way.

    Parameters
    ----------
    message
        What failed.
    result
        Everything recorded until then.
    time
        When [s].
    instance
        Which FMU.

    Examples
    --------
    >>> import cosim
    >>> plant = cosim.Component("plant", "fmus/arm_linear_plant.fmu", {"angle_0": 1e300})
    >>> try:
    ...     cosim.simulate(cosim.SystemStructure([plant]), step=0.1, duration=100.0)
    ... except cosim.SimulationError as error:
    ...     print(f"{error.instance} at {error.time:.1f} s, {len(error.result.time)} rows")
    plant at 9.1 s, 92 rows
    """

    def __init__(self, message: str, result: Result, time: float, instance: str) -> None:
        super().__init__(message)
        self.result, self.time, self.instance = result, time, instance


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a run.

    Parameters
    ----------
    result
        Everything recorded until then.

    Examples
    --------
    >>> import cosim
    >>> plant = cosim.Component("plant", "fmus/arm_linear_plant.fmu")
    >>> def press(done, steps):
    ...     raise KeyboardInterrupt
    >>> try:
    ...     cosim.simulate(cosim.SystemStructure([plant]), 1e-3, 1.0, engine="fmpy", progress=press)
    ... except cosim.Interrupted as interrupted:
    ...     print(f"{interrupted.result.time[-1]:.3f} s")
    0.256 s
    """

    def __init__(self, result: Result) -> None:
        super().__init__("interrupted")
        self.result = result


def _description(path: Path) -> dict[str, Any]:
    """Return the description of a table, checked against its own digest; raise UserError for another file."""
    header = parse_json(read_text(path, "result"), path, finite=False)
    version = header.get("format") if isinstance(header, dict) else None
    if version in EARLIER_FORMATS:
        raise UserError(f"{path} is of an earlier version, which kept no digest of the table; make the result again")
    if version != FORMAT:
        raise UserError(f"{path} is not the description of a result, whose format is {FORMAT!r}")
    digest = header.pop("description_sha256", None)
    if digest != _seal(header):
        raise UserError(f"{path} was changed: it does not fit its own digest")
    units = header.get("units")
    if not isinstance(units, dict) or not all(isinstance(unit, str) for unit in units.values()):
        raise UserError(f"{path}: units must be texts by the signals' names")
    if not isinstance(header.get("metadata"), dict) or not {"rows", "sha256"} <= header.keys():
        raise UserError(f"{path} is not the description of a result: rows, sha256 and metadata belong to it")
    return header


def _seal(header: Mapping[str, Any]) -> str:
    """Return the digest of a description without its own."""
    return _sha256([json.dumps(header).encode()])


def _sha256(pieces: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    return digest.hexdigest()


def _names(names: Sequence[str]) -> bytes:
    """Return the first row; names of FMUs may have commas, quotes and line breaks in them."""
    return ",".join('"' + n.replace('"', '""') + '"' if set(n) & set(',"\r\n') else n for n in names).encode()


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
        values = np.array(texts, dtype=np.float64)
    except (ValueError, OverflowError):
        wrong = next((text for text in texts if not _is_number(text)), "a whole number beyond 64 bits")
        raise UserError(f"{path}: column {name} must hold numbers, found {wrong!r}") from None
    broken = np.flatnonzero(~(np.abs(values) < MOST_WHOLE) | (values != np.rint(values)))
    if name in WHOLE and len(broken):
        row = int(broken[0])
        raise UserError(f"{path}: column {name} must hold whole numbers, found {texts[row]} in row {row + 1}")
    return values


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
