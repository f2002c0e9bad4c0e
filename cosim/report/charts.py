"""Plots as data for the page's script: curves by name in tables of times and values, thinned where there are many rows."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..evaluation import NO_UNIT, ErrorSignal
from ..judged_signals import error_norm, evaluation_in, given, set_point, wrapped
from ..plots import (
    COLOURS,
    LARGEST,
    UNKNOWN,
    colours,
    has_norm,
    law_of,
    mode_colours,
    mode_names,
    mode_spans,
    norm_name,
)
from ..recording import Recording
from ..unit_definitions import shown_unit, with_unit

Array = np.ndarray

MOST_VALUES = 120_000
"""Of all curves on a page together: 0.64 MB of it."""
LEAST_ROWS = 2000
"""Of a curve that is thinned: more than a screen has columns of pixels."""
MOST_SIGNALS = 100
"""Of the signals of one run besides those that it is judged by."""

DECADES = 16
"""Of a logarithmic axis, below the largest value: as many digits as a number has."""

SMALLEST = -300
"""Power of ten on a logarithmic axis."""

SINGLE = 1e-37, 1e37
"""Magnitudes of numbers that single precision holds with all its digits."""


@dataclass(frozen=True)
class Curve:
    """A column of a run's table as a curve; `held`: a row's value held since the row before."""

    run: str
    column: str
    name: str
    colour: str
    dashed: bool = False
    held: bool = False


@dataclass(frozen=True)
class Chart:
    """Curves over time on one axis."""

    title: str
    unit: str
    curves: tuple[Curve, ...]
    floor: float = 0.0
    """Of a logarithmic axis: smaller values are drawn on its lower edge; 0: the axis is linear."""
    remark: str = ""

    @property
    def label(self) -> str:
        """What stands beside the axis."""
        return with_unit(self.title, self.unit)


@dataclass(eq=False)
class Plots:
    """The plots of some runs by their names: what they are judged by, and of a single run all its signals."""

    runs: Mapping[str, Recording]
    charts: list[Chart] = field(default_factory=list)
    others: list[Chart] = field(default_factory=list)
    left_out: int = 0
    """How many signals are not among the others."""

    def __post_init__(self) -> None:
        self.columns: dict[str, dict[str, tuple[str, Array]]] = {name: {} for name in self.runs}
        self.colours = colours(self.runs)
        if len(self.runs) == 1:
            self.colours = {name: COLOURS.get(law_of(run), COLOURS["IHC"]) for name, run in self.runs.items()}

    def add_judged(self) -> None:
        """Add what is judged: errors, |e|, controls, homogeneous norm."""
        evaluation = evaluation_in(next(iter(self.runs.values())))
        for error in evaluation.errors:
            self.charts.append(self._error(error))
        groups = evaluation.error_groups if len(evaluation.errors) > 1 else {}
        for suffix, group in groups.items():
            title, unit = norm_name(evaluation, suffix)
            norms = {name: error_norm(run, evaluation, group) for name, run in self.runs.items()}
            self._add_positive(title, unit, norms)
        for control in evaluation.controls:
            curves = [
                self._curve(name, control.signal, control.unit, run[control.signal], control.name, held=True)
                for name, run in self.runs.items()
            ]
            self.charts.append(Chart(control.name, control.unit, tuple(curves)))
        if has_norm(evaluation, self.runs.values()):
            self._add_positive("‖x‖_d", NO_UNIT, {name: run[evaluation.norm or ""] for name, run in self.runs.items()})

    def add_signals(self) -> None:
        """Add all signals of the single run, those of one unit in one plot."""
        ((name, run),) = self.runs.items()
        by_unit: dict[str, list[str]] = {}
        for signal in list(run.signals)[:MOST_SIGNALS]:
            by_unit.setdefault(run.units.get(signal, NO_UNIT), []).append(signal)
        self.left_out = max(len(run.signals) - MOST_SIGNALS, 0)
        for unit, signals in by_unit.items():
            shades = colours(signals)
            kinds = len(set(shades.values()))
            curves = []
            for number, signal in enumerate(signals):
                self._column(name, signal, unit, run[signal])
                curves.append(Curve(name, signal, signal, shades[signal], dashed=number >= kinds))
            self.others.append(Chart("numbers" if unit == NO_UNIT else "signals", unit, tuple(curves)))

    def _error(self, error: ErrorSignal) -> Chart:
        curves = []
        for name, run in self.runs.items():
            values = given(run, error)
            if error.wraps:
                values = wrapped(values)
                values[1:][np.abs(np.diff(values)) > np.pi] = np.nan  # no line across the jump from pi to -pi
            curves.append(self._curve(name, error.name, error.unit, values, error.name))
            point = set_point(run, error)
            if point is not None:
                of = "set-point" if len(self.runs) == 1 else f"set-point, {name}"
                self._column(name, f"{error.name}, set-point", error.unit, point)
                curves.append(Curve(name, f"{error.name}, set-point", of, "#6b7280", dashed=True, held=True))
        return Chart(error.name, error.unit, tuple(curves))

    def _add_positive(self, title: str, unit: str, found: Mapping[str, Array]) -> None:
        """Add a plot with a logarithmic axis, unless there is nothing to show on one."""
        curves = tuple(self._curve(name, title, unit, values, title) for name, values in found.items())
        drawn = {curve.name: self.columns[curve.run][curve.column][1] for curve in curves}
        largest = max((float(values[values > 0.0].max(initial=0.0)) for values in drawn.values()), default=0.0)
        if largest > 0.0:
            floor = 10.0 ** max(math.floor(math.log10(largest)) - DECADES, SMALLEST)
            under = ", ".join(name for name, values in drawn.items() if np.any((values >= 0.0) & (values < floor)))
            remark = f"On the lower edge, where it is 0 or below {floor:.0e}: {under}." if under else ""
            self.charts.append(Chart(title, unit, curves, floor, remark))

    def _curve(self, run: str, column: str, unit: str, values: Array, name: str, *, held: bool = False) -> Curve:
        self._column(run, column, unit, values)
        return Curve(run, column, name if len(self.runs) == 1 else run, self.colours[run], held=held)

    def _column(self, run: str, name: str, unit: str, values: Array) -> None:
        drawn = np.asarray(values, dtype=float)
        self.columns[run][name] = unit, np.where(np.abs(drawn) < LARGEST, drawn, np.nan)

    def text(self, chart: Chart) -> str:
        """Return in words what a plot shows."""
        unit = f" {shown_unit(chart.unit)}".rstrip()
        axis = ", logarithmic," if chart.floor else ""
        said = [f"{chart.label}{axis} over time"]
        for curve in chart.curves:
            values = self.columns[curve.run][curve.column][1]
            values = values[np.isfinite(values)]
            if len(values):
                low, high = values.min(), values.max()
                said.append(
                    f"{curve.name}: from {values[0]:.3g} to {values[-1]:.3g}{unit}, between {low:.3g} and {high:.3g}{unit}"
                )
        return "; ".join(said)

    def modes(self) -> list[tuple[str, str]]:
        """Return name and colour of each mode of the controller that occurs."""
        found: dict[str, str] = {}
        for run in self.runs.values():
            names, shades = mode_names(run), mode_colours(run)
            found |= {names.get(m, str(m)): shades.get(m, UNKNOWN) for m, begin, end in mode_spans(run) if end > begin}
        return list(found.items())

    def data(self, files: Mapping[str, str], most: int | None = None) -> tuple[dict[str, Any], list[str]]:
        """Return what the script draws, and how each run was thinned, in words; `files` are the names of downloads.

        `most` rows of each run are drawn; None: as many as a page can have.
        """
        rows = most or max(LEAST_ROWS, MOST_VALUES // max(1, sum(map(len, self.columns.values()))))
        tables: list[dict[str, Any]] = []
        thin: dict[tuple[int, int], list[str]] = {}
        for name, run in self.runs.items():
            columns = self.columns[name]
            time, values, per = thinned(run.time, [v for _, v in columns.values()], rows)
            shades = mode_colours(run)
            tables.append(
                {
                    "file": files[name],
                    "time": packed(time, exact=True),
                    "columns": [
                        {"name": column, "unit": unit, "values": packed(of)}
                        for (column, (unit, _)), of in zip(columns.items(), values, strict=True)
                    ],
                    "modes": [
                        {"colour": shades.get(mode, UNKNOWN), "begin": begin, "end": end}
                        for mode, begin, end in mode_spans(run)
                    ],
                }
            )
            if per > 1:
                thin.setdefault((per, len(run.time)), []).append(name)
        said = []
        for (per, count), names in thin.items():
            of = f" of {', '.join(names)}" if len(self.runs) > 1 else ""
            said.append(
                f"The plots show two points for every {per} of the {count} rows{of}: the smallest and the largest value in "
                "them, so that no peak is lost. The tables (CSV) have every row."
            )
        runs, places = list(self.runs), {name: list(columns) for name, columns in self.columns.items()}
        charts = [
            {
                "label": chart.label,
                "floor": chart.floor,
                "curves": [
                    {
                        "table": runs.index(curve.run),
                        "column": places[curve.run].index(curve.column),
                        "name": curve.name,
                        "colour": curve.colour,
                        "dashed": curve.dashed,
                        "held": curve.held and not said,  # of thinned rows the two are not held
                    }
                    for curve in chart.curves
                ],
            }
            for chart in (*self.charts, *self.others)
        ]
        return {"tables": tables, "charts": charts}, said


def thinned(time: Array, columns: Sequence[Array], most: int) -> tuple[Array, list[Array], int]:
    """Return times and values of about `most` rows or fewer, and how many rows became two; 1: all are there.

    Of so many rows in a row stay the smallest and the largest value of each column, in the order in which they come, at the
    times of the first and the last row; between them is a gap, NaN, where a column has one.
    """
    rows = len(time)
    if rows <= most:
        return time, list(columns), 1
    per = math.ceil(2 * rows / most)
    begins = np.arange(0, rows, per)
    ends = np.append(begins[1:], rows) - 1
    stretches = [_Parts(values, len(begins), per) for values in columns]
    gaps = [np.any([parts.gaps[k] for parts in stretches], axis=0) for k in range(3)]
    kept = np.column_stack([gaps[0], ends >= begins, gaps[1], ends > begins, gaps[2]]).ravel()
    times = np.column_stack([time[k] for k in (begins, begins, ends, ends, ends)]).ravel()[kept]
    return times, [parts.rows()[kept] for parts in stretches], per


class _Parts:
    """A column in parts of so many rows: the smallest and the largest value of each, and where gaps are around them."""

    def __init__(self, values: Array, count: int, per: int) -> None:
        padded = np.full(count * per, np.nan)
        padded[: len(values)] = values
        parts = padded.reshape(count, per)
        missing = np.isnan(parts)
        low, high = np.where(missing, np.inf, parts).argmin(axis=1), np.where(missing, -np.inf, parts).argmax(axis=1)
        first, second = np.minimum(low, high)[:, None], np.maximum(low, high)[:, None]
        missing.ravel()[len(values) :] = False
        place = np.arange(per)
        where = (place < first, (place > first) & (place < second), place > second)
        self.gaps = [np.any(missing & inside, axis=1) for inside in where]
        self.first, self.second = (np.take_along_axis(parts, k, axis=1)[:, 0] for k in (first, second))

    def rows(self) -> Array:
        """Return gap or not, first, gap or not, second, gap or not, of each part; what is no gap repeats its neighbour."""
        beside = (self.first, self.first, self.second)
        a, b, c = (np.where(gap, np.nan, value) for gap, value in zip(self.gaps, beside, strict=True))
        return np.column_stack([a, self.first, b, self.second, c]).ravel()


def packed(values: Array, *, exact: bool = False) -> dict[str, str]:
    """Return numbers as base64, in single precision where that holds them and they need not be exact."""
    sizes = np.abs(values[np.isfinite(values) & (values != 0.0)])
    single = not exact and (not len(sizes) or (sizes.min() > SINGLE[0] and sizes.max() < SINGLE[1]))
    raw = np.asarray(values, dtype="<f4" if single else "<f8").tobytes()
    return {"type": "f4" if single else "f8", "base64": base64.b64encode(raw).decode("ascii")}
