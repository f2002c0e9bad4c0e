"""What `region` and `tune --pareto` have left of a scenario, read again; a file is not trusted to be what they wrote."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, Field

from fmu_export.errors import UserError, shown

from ..studies.pareto_front import DOMINATED, FRONT, LC, LOST, RETUNED, RULE
from ..studies.refinement import Point, Refinement
from ..studies.region_files import FORMAT
from ..typed import Finite, checked

Array = np.ndarray

MOST_BYTES = 64 * 2**20
"""Of a file that is read."""
MOST_CELLS = 2048
"""Along each axis of a map."""
MOST_POINTS = 5000
"""Of a front."""
USUAL = 1e-50, 1e50
"""Sizes of numbers that are drawn."""
NEAR = 1e-6
"""How far a start may lie from its point of the lattice, in finest cells."""
SEARCHED = " in the search"
"""How the heading of an objective's first column ends."""


class AxisFile(BaseModel):
    """An axis of a region: its name, the entry of the scenario, its ends, its unit."""

    name: str
    entry: str
    low: Finite
    high: Finite
    unit: str


class _Cells(BaseModel):
    coarse: Annotated[int, Field(ge=2, le=MOST_CELLS, strict=True)]
    finest: Annotated[int, Field(ge=2, le=MOST_CELLS, strict=True)]


class _Certified(BaseModel):
    Q: list[list[Finite]] | None = None
    centre: list[Finite] = []


class _RegionFile(BaseModel):
    format: str
    axes: Annotated[list[AxisFile], Field(min_length=1, max_length=2)]
    cells: _Cells
    supervisor_opened: bool
    scenario: dict[str, Any]
    laws: Annotated[dict[str, Any], Field(min_length=1)]
    certified: _Certified


@dataclass(frozen=True)
class ReadRegion:
    """A region of attraction.

    `settling` of each law: one axis, starts and settling times [s] (2, n), NaN where not attracted; two, the times at the
    middle of each finest cell, (finest, finest). `ball`: points on the border of the certified ball (n, axes), None without.
    """

    axes: Sequence[AxisFile]
    settling: Mapping[str, Array]
    ball: Array | None
    opened: bool
    scenario: Mapping[str, Any]


@dataclass(frozen=True)
class ReadPoint:
    """A point of a front: what it is, its values by name, its objectives."""

    kind: str
    chosen: bool
    values: Mapping[str, float]
    objectives: Sequence[float]


@dataclass(frozen=True)
class ReadFront:
    """A front: the names of its objectives and of what is tuned, its points."""

    objectives: Sequence[str]
    names: Sequence[str]
    points: Sequence[ReadPoint]


def read_region(folder: Path) -> ReadRegion | None:
    """Return the region in a folder, None where there is none; UserError for files that `region` did not write so."""
    path = folder / "region.json"
    if not path.exists():
        return None
    try:
        data = json.loads(_text(path))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path} is no JSON: {error}") from None
    file = checked(_RegionFile, data, path)
    if file.format != FORMAT:
        raise UserError(f"{path}: format must be {FORMAT}, found {shown(file.format)}")
    for axis in file.axes:
        if not (axis.low < axis.high and _usual(axis.low) and _usual(axis.high)):
            raise UserError(f"{path}: the axis {shown(axis.name)} must go up, found {axis.low:g} to {axis.high:g}")
    runs = _runs(folder / "region.csv", file)
    settling = {law: _settling(folder / "region.csv", law, runs[law], file) for law in file.laws}
    return ReadRegion(file.axes, settling, _ball(file.certified, path), file.supervisor_opened, file.scenario)


def _runs(path: Path, file: _RegionFile) -> dict[str, dict[Point, list[float]]]:
    """Return the settling times of each law's points, a number for each draw, NaN where not attracted."""
    rows = _rows(path, ["law", "draw", *(axis.name for axis in file.axes), "outcome", "settled"])
    found: dict[str, dict[Point, list[float]]] = {law: {} for law in file.laws}
    for number, row in enumerate(rows, 2):
        if row["law"] not in found:
            raise UserError(f"{path}, line {number}: the law must be one of region.json's, found {shown(row['law'])}")
        point = tuple(_place(axis, _number(path, number, row, axis.name), file.cells.finest) for axis in file.axes)
        if None in point:
            raise UserError(f"{path}, line {number}: the start is no point of the map that region.json tells of")
        attracted = row["outcome"] == "attracted"
        time = _number(path, number, row, "settled") if attracted else math.nan
        found[row["law"]].setdefault(point, []).append(time)  # type: ignore[arg-type]
    return found


def _place(axis: AxisFile, value: float, finest: int) -> int | None:
    """Return the point of the lattice at a value; None where there is none."""
    place = (value - axis.low) / (axis.high - axis.low) * finest
    if not -NEAR <= place <= finest + NEAR or abs(place - round(place)) > NEAR:
        return None
    return round(place)


def _settling(path: Path, law: str, runs: Mapping[Point, list[float]], file: _RegionFile) -> Array:
    """Return what `ReadRegion` has of a law; the cells are divided again as they were."""
    cells, axes = file.cells, file.axes
    times = {point: float(np.mean(some)) for point, some in runs.items()}
    if len(times) < (cells.coarse + 1) ** len(axes):
        raise UserError(f"{path} lacks runs of {law} that region.json tells of")
    try:
        refinement = Refinement(len(axes), cells.coarse, cells.finest)
    except UserError as error:
        raise UserError(f"{path.with_name('region.json')}: {error}") from None
    while wanted := refinement.wanted:
        if not times.keys() >= {*wanted}:
            raise UserError(f"{path} lacks runs of {law} that region.json tells of")
        refinement.tell({point: not math.isnan(times[point]) for point in wanted})
    if len(axes) == 2:
        return refinement.interpolated(times)
    starts = sorted(refinement.known)
    low, high = axes[0].low, axes[0].high
    return np.array([[low + point[0] / cells.finest * (high - low), times[point]] for point in starts]).T


def _ball(certified: _Certified, path: Path) -> Array | None:
    if certified.Q is None:
        return None
    size = len(certified.centre)
    Q = np.array(certified.Q) if {len(row) for row in certified.Q} == {size} else np.empty(0)
    rule = f"{path}: certified.Q must be symmetric and positive definite, as large as certified.centre"
    if (
        Q.shape != (size, size)
        or not all(_usual(v) for v in (*Q.ravel(), *certified.centre))
        or not np.allclose(Q, Q.T)
    ):
        raise UserError(rule)
    try:
        back = np.linalg.inv(np.linalg.cholesky(Q)).T
    except np.linalg.LinAlgError:
        raise UserError(rule) from None
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    around = np.column_stack((np.cos(turn), np.sin(turn))) if size == 2 else np.array([[-1.0], [1.0]])
    return np.array(certified.centre) + around @ back.T


def read_front(folder: Path) -> ReadFront | None:
    """Return the front in a folder, None where there is none; UserError for a file that `tune --pareto` did not write so."""
    path = folder / "front.csv"
    if not path.exists():
        return None
    rows = _rows(path, ["kind", "chosen", "kept", "draws"])
    headings = list(rows[0]) if rows else []
    objectives = [name.removesuffix(SEARCHED) for name in headings if name.endswith(SEARCHED)]
    if len(objectives) < 2 or not {*objectives} <= {*headings}:
        raise UserError(f"{path} must have a row for each point, and two objectives or more")
    if len(rows) > MOST_POINTS:
        raise UserError(f"{path} must have up to {MOST_POINTS} points, found {len(rows)}")
    names = headings[2 : headings.index(objectives[0] + SEARCHED)]
    kinds = (LC, RULE, FRONT, RETUNED, DOMINATED, LOST)
    points = []
    for number, row in enumerate(rows, 2):
        if row["kind"] not in kinds:
            raise UserError(
                f"{path}, line {number}: kind must be one of {', '.join(kinds)}, found {shown(row['kind'])}"
            )
        values = {name: _number(path, number, row, name) for name in names if row[name]}
        judged = [_number(path, number, row, name, finite=row["kind"] != LOST) for name in objectives]
        points.append(ReadPoint(row["kind"], row["chosen"] == "1", values, judged))
    return ReadFront(objectives, names, points)


def _text(path: Path) -> str:
    """Return a file's text; UserError where it cannot be read."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise UserError(f"{path} must have up to {MOST_BYTES // 2**20} MB")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UserError(f"{path} is no text in UTF-8") from None


def _rows(path: Path, needed: Sequence[str]) -> list[dict[str, str]]:
    """Return the rows of a CSV file by its headings, of which these are needed; UserError where it is none."""
    try:
        reader = csv.reader(io.StringIO(_text(path)), strict=True)
        headings, *rows = list(reader) or [[]]
    except csv.Error as error:
        raise UserError(f"{path} is no CSV: {error}") from None
    missing = next((name for name in needed if name not in headings), None)
    if missing is not None:
        raise UserError(f"{path} has no column {shown(missing)}")
    for number, row in enumerate(rows, 2):
        if len(row) != len(headings):
            raise UserError(f"{path}, line {number}: it must have {len(headings)} cells, found {len(row)}")
    return [dict(zip(headings, row, strict=True)) for row in rows]


def _number(path: Path, line: int, row: Mapping[str, str], name: str, *, finite: bool = True) -> float:
    """Return a cell's number; UserError where it is none, or, where it must be finite, none of a usual size."""
    try:
        value = float(row[name])
    except ValueError:
        raise UserError(f"{path}, line {line}: {name} must be a number, found {shown(row[name])}") from None
    if finite and not _usual(value):
        low, high = USUAL
        raise UserError(
            f"{path}, line {line}: {name} must be 0 or of a size from {low:g} to {high:g}, found {shown(row[name])}"
        )
    return value


def _usual(value: float) -> bool:
    """Return whether a number can be drawn: it is 0, or of a usual size."""
    return value == 0.0 or USUAL[0] <= abs(value) <= USUAL[1]
