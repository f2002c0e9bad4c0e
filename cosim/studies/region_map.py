"""What a search for regions of attraction has found: of each law the cells, the area with its bounds, the settling times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from fmu_export.errors import counted

from ..metric_meanings import MetricMeaning, squared
from ..scenario import Scenario
from ..unit_definitions import shown_unit, with_unit
from .certified_section import Certified
from .numbers import Numbers
from .ranges import Range
from .refinement import Point, Refinement

Array = np.ndarray

HELD = 0.1
"""Share of the run at its end over which |e| must be within its tolerance."""
FEWEST = 3
"""Points of the lattice along each axis of the certified ball, about, below which a region's share of it is not said."""
CERTIFIED_LAWS = ("LC", "IHC")
"""The laws that a design's certificate is about."""

Outcome = Literal["attracted", "unsettled", "lost", "failed"]
"""What comes of a start: settled; the law acts to the end, not settled; it does not act to the end, or from the first
sample where it must, or numbers overflow; an FMU ends the run with an error."""

Key = tuple[Point, int | None]
"""A run of a law: its point, and the draw's number."""


@dataclass(frozen=True)
class Axis:
    """An entry of the scenario and its range; `rest`: the design's equilibrium, else what the scenario has."""

    name: str
    entry: str
    range: Range
    unit: str
    rest: float

    @property
    def label(self) -> str:
        """The name as it was given, with the unit."""
        return with_unit(self.name, self.unit)

    def value(self, number: int, finest: int) -> float:
        """Return the value at a point of a lattice of `finest` cells."""
        return self.range.at(number / finest)


@dataclass(frozen=True)
class Judge:
    """How a run's numbers are judged: by which metrics; until when a law must have begun to act [s], None: whenever."""

    quantities: Mapping[str, MetricMeaning]
    duration: float
    latest: float | None

    def settling(self, numbers: Numbers) -> float:
        """Return the time from which all |e| stay within their tolerances [s]; NaN where one does not."""
        times = [numbers[q.name] for q in self.quantities.values() if q.role == "settling"]
        return math.nan if any(map(math.isnan, times)) else max(times)

    def outcome(self, numbers: Numbers) -> Outcome:
        """Return what came of a run."""
        if not numbers:
            return "failed"
        sums = [numbers[q.name] for q in self.quantities.values() if q.role in ("integral", "energy")]
        late = self.latest is not None and not numbers["capture_time"] <= self.latest
        if not numbers["kept"] or late or not all(map(math.isfinite, sums)):
            return "lost"
        return "attracted" if self.settling(numbers) <= (1.0 - HELD) * self.duration else "unsettled"


@dataclass(frozen=True)
class LawRegion:
    """What was found of a law: the cells, and each run's numbers by its point and draw.

    `volume`: of the whole range, in the product of the axes' units. `draws`: their numbers, None for the scenario as it is.
    """

    law: str
    cells: Refinement
    runs: Mapping[Key, Numbers]
    draws: Sequence[int | None]
    volume: float
    judge: Judge

    @cached_property
    def outcomes(self) -> dict[Key, Outcome]:
        """What came of each run."""
        return {key: self.judge.outcome(numbers) for key, numbers in self.runs.items()}

    def count(self, outcome: Outcome) -> int:
        """Return how many runs ended so."""
        return sum(one == outcome for one in self.outcomes.values())

    def share(self, point: Point) -> float:
        """Return the share of draws in which a point is attracted."""
        return sum(self.outcomes[point, draw] == "attracted" for draw in self.draws) / len(self.draws)

    @property
    def bounds(self) -> tuple[float, float]:
        """The volume of the cells with all corners attracted, and of those with any."""
        inner, outer = self.cells.bounds
        return self.volume * inner, self.volume * outer

    @property
    def area(self) -> float:
        """The estimate between the bounds, a cell on the boundary counted by its attracted corners; of a line its length."""
        return self.volume * self.cells.share

    @property
    def error(self) -> float:
        """How far the farther of the bounds lies from `area`."""
        inner, outer = self.bounds
        return max(self.area - inner, outer - self.area)

    @cached_property
    def settling(self) -> dict[Point, float]:
        """The time from which all |e| stay within their tolerances [s], the mean over the draws, of attracted points."""
        times = {
            point: [self.judge.settling(self.runs[point, draw]) for draw in self.draws]
            for point, attracted in self.cells.known.items()
            if attracted
        }
        return {point: sum(some) / len(some) for point, some in times.items()}

    @property
    def settling_map(self) -> Array:
        """The settling time [s] at the middle of each finest cell, (finest,) * axes; NaN but inside the region."""
        return self.cells.interpolated(self.settling)

    def interval(self, rest: int) -> tuple[tuple[int, int | None], tuple[int, int | None]] | None:
        """Return the ends of the attracted interval around a point of a line: the last that is, the next that is not.

        None for the latter where the range ends first; None where the point itself is not attracted.
        """
        attracted = self.cells.grid()
        if not attracted[rest]:
            return None
        beyond = np.flatnonzero(~attracted)
        low, high = beyond[beyond < rest], beyond[beyond > rest]
        return (
            (int(low[-1]) + 1, int(low[-1])) if low.size else (0, None),
            (int(high[0]) - 1, int(high[0])) if high.size else (self.cells.finest, None),
        )

    @property
    def parts(self) -> int:
        """Number of parts that do not touch, on the lattice of the finest cells."""
        from scipy.ndimage import label  # noqa: PLC0415 - heavy

        _, count = label(self.cells.grid())  # type: ignore[misc] # for an output of its own
        return int(count)

    @property
    def open_sides(self) -> list[tuple[int, int]]:
        """The sides of the range at which points are attracted: the axis, and 0 or `finest`."""
        attracted = [point for point, yes in self.cells.known.items() if yes]
        ends = [(axis, end) for axis in range(self.cells.axes) for end in (0, self.cells.finest)]
        return [(axis, end) for axis, end in ends if any(point[axis] == end for point in attracted)]


@dataclass(frozen=True)
class Line:
    """The attracted interval of a law around the rest, in the axis' unit.

    `low`, `high`: its ends, each the last start that is attracted and the next that is not, which is None where the range
    ends first.
    """

    rest: float
    low: tuple[float, float | None]
    high: tuple[float, float | None]

    @property
    def radius(self) -> tuple[float, float | None]:
        """The distance from the rest within which both sides are attracted, and at which one is not."""
        (inner, beyond), (other, other_beyond) = self.high, self.low
        sides = [(inner - self.rest, beyond), (self.rest - other, other_beyond)]
        distance, end = min(sides, key=lambda side: side[0])
        return distance, None if end is None else abs(end - self.rest)


@dataclass(frozen=True)
class Region:
    """The regions of several laws over the same axes, and the section of the certified ball.

    Parameters
    ----------
    scenario
        As it was given.
    axes
        One or two.
    laws
        What was found, by law, in the order in which they were named.
    certified
        The ball's section, or why there is none.
    opened
        Whether the pendulum's supervisor was opened, so that the laws act from the first sample on.
    """

    scenario: Scenario
    axes: tuple[Axis, ...]
    laws: Mapping[str, LawRegion]
    certified: Certified
    opened: bool

    @property
    def _any(self) -> LawRegion:
        return next(iter(self.laws.values()))

    @property
    def draws(self) -> int:
        """Number of draws; 0: the scenario as it stands."""
        return len(self._any.draws) if self._any.draws[0] is not None else 0

    @property
    def unit(self) -> str:
        """The unit of an area, or of a length."""
        units = [shown_unit(axis.unit) for axis in self.axes]
        if len(set(units)) < len(units):
            return squared(self.axes[0].unit) or "1"
        return " · ".join(f"({unit})" if "/" in unit and len(units) > 1 else unit or "1" for unit in units)

    def at(self, point: Point) -> tuple[float, ...]:
        """Return the values of the axes at a point of the lattice."""
        finest = self._any.cells.finest
        return tuple(axis.value(number, finest) for axis, number in zip(self.axes, point, strict=True))

    def line(self, law: str) -> Line | None:
        """Return the attracted interval around the rest, of one axis; None where the rest is beside it or the range."""
        axis, cells = self.axes[0], self.laws[law].cells
        number = round((axis.rest - axis.range.low) / axis.range.width * cells.finest)
        ends = self.laws[law].interval(number) if 0 <= number <= cells.finest else None
        if ends is None:
            return None
        low, high = (
            (axis.value(inner, cells.finest), None if beyond is None else axis.value(beyond, cells.finest))
            for inner, beyond in ends
        )
        return Line(axis.rest, low, high)

    def change(self, law: str, base: str) -> tuple[float, float, float]:
        """Return by which part a law's area lies above another's, and the least and most that the bounds of both allow.

        NaN where the other's inner bound is 0.
        """
        found, other = self.laws[law], self.laws[base]
        (inner, outer), (base_inner, base_outer) = found.bounds, other.bounds
        if not base_inner:
            return math.nan, math.nan, math.nan
        return found.area / other.area - 1.0, inner / base_outer - 1.0, outer / base_inner - 1.0

    def table(self) -> tuple[str, list[str], list[list[str]]]:
        """Return title, headings and a row for each law, as text."""
        drawn = f", in each of {self.draws} draws" if self.draws else ""
        over = " and ".join(axis.name for axis in self.axes)
        title = f"{self.scenario.name}: attracted over {over}{drawn}"
        if len(self.axes) == 1:
            unit = shown_unit(self.axes[0].unit)
            heads = ["", *(f"{what} [{unit}]" if unit else what for what in ("down to", "up to", "radius")), "runs"]
            return title, heads, [[law, *self._ends(law), str(len(self.laws[law].runs))] for law in self.laws]
        heads = ["", f"area [{self.unit}]", f"over {self._any.law} (bounds)", "runs (of the full grid)"]
        kept = [0, 1, 2, 3] if len(self.laws) > 1 else [0, 1, 3]
        rows = [self._row(law) for law in self.laws]
        return title, [heads[i] for i in kept], [[row[i] for i in kept] for row in rows]

    def _ends(self, law: str) -> list[str]:
        line = self.line(law)
        if line is None:
            return ["–"] * 3
        digits = _decimals(self.axes[0].range.width / self._any.cells.finest)
        pairs = (line.low, line.high, line.radius)
        return [
            f"{inner:.{digits}f}{' or beyond' if beyond is None else f' (not {beyond:.{digits}f})'}"
            for inner, beyond in pairs
        ]

    def _row(self, law: str) -> list[str]:
        found = self.laws[law]
        full = (found.cells.finest + 1) ** found.cells.axes * len(found.draws)
        value, *ends = (100.0 * change for change in self.change(law, self._any.law))
        change = "–" if math.isnan(value) else f"{value:+.2g} % ({ends[0]:+.2g} to {ends[1]:+.2g})"
        runs = f"{len(found.runs)} ({100.0 * len(found.runs) / full:.2g} %)"
        return [law, with_error(found.area, found.error), "" if law == self._any.law else change, runs]

    def remarks(self) -> list[str]:
        """Return what has to be known to read the map, a sentence each."""
        said = [self._resolved()]
        if self.opened:
            said.append(
                "the pendulum's supervisor is open: each law acts from the first sample on, without swing-up, and a fallen "
                "pendulum is lost; --supervisor leaves it as the scenario has it"
            )
        for law, found in self.laws.items():
            sides = [
                f"{self.axes[axis].name} = {self.axes[axis].value(end, found.cells.finest):g}"
                for axis, end in found.open_sides
            ]
            if sides:
                said.append(f"{law}: the region goes on beyond {', '.join(sides)}")
            if found.parts > 1:
                said.append(f"{law}: the region is in {found.parts} parts that do not touch")
            if found.cells.bounds[0] == 0.0 and found.count("attracted"):
                said.append(
                    f"{law}: no cell lies wholly within the region; --coarse and --resolution of more cells show it"
                )
            if found.count("unsettled"):
                said.append(
                    f"{law}: in {found.count('unsettled')} of {len(found.runs)} runs it acts to the end and has not settled "
                    f"by the last {100 * HELD:g} %: astray, or too slow for run.duration and evaluate.tolerance"
                )
            if found.count("failed"):
                said.append(f"{law}: {found.count('failed')} runs were ended by an FMU's error, and are not attracted")
        return [*said, *self._certified()]

    def _resolved(self) -> str:
        cells = self._any.cells
        sizes = [" × ".join(_sized(axis, n) for axis in self.axes) for n in (cells.coarse, cells.finest)]
        return (
            f"the boundary is resolved to {sizes[1]}; a hole or an island smaller than a coarse cell, {sizes[0]}, can be "
            "missed"
        )

    def _certified(self) -> list[str]:
        section = self.certified.section
        if section is None:
            return [f"no certified ball is drawn: {self.certified.why_not}"]
        extent = ", ".join(
            f"{axis.name} {_around(c, e)} {shown_unit(axis.unit)}".rstrip()
            for axis, c, e in zip(self.axes, section.centre, section.extent, strict=True)
        )
        limits = (
            f"within it the law may need more of {', '.join(section.reaches)} than the limits leave"
            if section.reaches
            else "within it no command reaches its limit"
        )
        return [
            f"certified ball: {extent} (the unit ball of the design's model, with the state known, in continuous time and "
            f"without limits); {limits}",
            *(self._share(law) for law in CERTIFIED_LAWS if law in self.laws),
        ]

    def _share(self, law: str) -> str:
        """Return in words how much of the certified ball a law's region holds."""
        share, points = self.held(law), self._within(law).sum()
        if math.isnan(share):
            return (
                f"{law}: only {counted(int(points), 'point')} of the map in the certified ball, too few to say how much of "
                "it the region holds; a finer --resolution or narrower ranges have more"
            )
        held = "all" if share == 1.0 else f"{100.0 * share:.3g} %"
        return f"{law}: the region holds {held} of the certified ball, by {points} points in it"

    def held(self, law: str) -> float:
        """Return the share of the certified ball, within the range, that a law's region holds, by points of the lattice.

        NaN without a ball, or where too few points lie in it.
        """
        inside = self._within(law)
        return float(np.mean(self.laws[law].cells.grid()[inside])) if inside.sum() >= FEWEST**inside.ndim else math.nan

    def _within(self, law: str) -> Array:
        """Return which points of the lattice lie in the certified ball."""
        section, cells = self.certified.section, self.laws[law].cells
        if section is None:
            return np.zeros(cells.grid().shape, dtype=bool)
        values = [axis.range.low + np.arange(cells.finest + 1) / cells.finest * axis.range.width for axis in self.axes]
        return section.has(np.stack(np.meshgrid(*values, indexing="ij"), axis=-1))


def _sized(axis: Axis, cells: int) -> str:
    return f"{axis.range.width / cells:.3g} {shown_unit(axis.unit)}".rstrip()


def _around(centre: float, extent: float) -> str:
    return f"±{extent:.3g}" if abs(centre) < 1e-9 * extent else f"{centre:.3g} ± {extent:.3g}"


def _decimals(size: float) -> int:
    """Return the decimals that show a step of this size to two digits."""
    return max(0, 1 - math.floor(math.log10(size)))


def with_error(value: float, error: float) -> str:
    """Return value ± error, with the decimals that the error leaves."""
    if error <= 0.0:
        return f"{value:.4g}"
    digits = _decimals(error)
    return f"{value:.{digits}f} ± {error:.{digits}f}"
