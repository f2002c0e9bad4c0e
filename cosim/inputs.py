"""Functions of time on inputs, as a scenario names them: steps, pulses, square waves, sines, and tables from files."""

from __future__ import annotations

import csv
import io
import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

from fmpy.model_description import ScalarVariable
from pydantic import BaseModel, ConfigDict, Field

from fmu_export.reading import read_text

from .errors import UserError
from .names import PlainName
from .structure import Signal
from .typed import Finite, Positive

ROUNDING = 1e-12
"""What k step may miss a time by, relative: an edge that it misses only so is reached."""


def _reached(time: float, when: float) -> bool:
    return time >= when - ROUNDING * max(1.0, abs(when))


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Function(Protocol):
    """A function of time [s]; hashable, so that values ahead can be shared by runs."""

    def at(self, time: float) -> float:
        """Return the value at `time` [s]."""
        ...

    def whole(self) -> bool:
        """Return whether all values are whole numbers, as inputs that are no real numbers want them."""
        ...


class Sine(_Section):
    """One term amplitude * sin(frequency t + phase)."""

    amplitude: Finite = Field(description="amplitude, in the unit of the input")
    frequency: Finite = Field(description="angular frequency [rad/s]")
    phase: Finite = Field(0.0, description="phase [rad]")


class _Sines(_Section):
    """A gain times a sum of sines, 0 before a time."""

    gain: Finite = Field(1.0, description="factor of the whole sum, the paper's G [1]")
    sines: tuple[Sine, ...] = Field((), description="terms of the sum")
    start: Finite = Field(0.0, description="time before which it is 0 [s]; the sines' phases count from t = 0")

    def at(self, time: float) -> float:
        """Return the value at `time` [s]."""
        if time < self.start:
            return 0.0
        return self.gain * sum(s.amplitude * math.sin(s.frequency * time + s.phase) for s in self.sines)

    def whole(self) -> bool:
        """Return False: a sine's values are real numbers."""
        return False


class DisturbanceSection(_Sines):
    """A sum of sines times a gain on an input of the plant."""

    input: str | None = Field(
        None, description="input of the plant; none: disturbance_voltage, or its one input named *_disturbance"
    )


class StepSignal(_Section):
    """0 before a time, a value from then on."""

    kind: Literal["step"] = Field(description="step")
    input: str = Field(description="input as component.variable")
    value: Finite = Field(description="value from `time` on, in the input's unit")
    time: Finite = Field(0.0, description="when it steps [s]")
    before: Finite = Field(0.0, description="value before")

    def at(self, time: float) -> float:
        """Return the value at `time` [s]."""
        return self.value if _reached(time, self.time) else self.before

    def whole(self) -> bool:
        """Return whether both values are whole numbers."""
        return _all_whole((self.value, self.before))


class PulseSignal(_Section):
    """A value for a while, 0 before and after."""

    kind: Literal["pulse"] = Field(description="pulse")
    input: str = Field(description="input as component.variable")
    value: Finite = Field(description="value in the pulse, in the input's unit")
    width: Positive = Field(description="how long it lasts [s]")
    time: Finite = Field(0.0, description="when it begins [s]")

    def at(self, time: float) -> float:
        """Return the value at `time` [s]."""
        return self.value if _reached(time, self.time) and not _reached(time, self.time + self.width) else 0.0

    def whole(self) -> bool:
        """Return whether the value is a whole number."""
        return _all_whole((self.value,))


class SquareSignal(_Section):
    """Mean plus amplitude in the first half of each period, mean minus amplitude in the second; the mean before."""

    kind: Literal["square"] = Field(description="square")
    input: str = Field(description="input as component.variable")
    amplitude: Finite = Field(description="amplitude, in the input's unit")
    period: Positive = Field(description="period [s]")
    mean: Finite = Field(0.0, description="mean, in the input's unit")
    start: Finite = Field(0.0, description="when the first period begins [s]")

    def at(self, time: float) -> float:
        """Return the value at `time` [s]."""
        if not _reached(time, self.start):
            return self.mean
        half = math.floor(2.0 * (time - self.start) / self.period * (1.0 + ROUNDING) + ROUNDING)
        return self.mean - self.amplitude if half % 2 else self.mean + self.amplitude

    def whole(self) -> bool:
        """Return whether all values are whole numbers."""
        return _all_whole((self.mean, self.mean + self.amplitude))


class SinesSignal(_Sines):
    """A sum of sines times a gain on an input."""

    kind: Literal["sines"] = Field(description="sines")
    input: str = Field(description="input as component.variable")


class CsvSignal(_Section):
    """A table of times and values from a file; beyond its ends the first and the last value hold."""

    kind: Literal["csv"] = Field(description="csv")
    input: str = Field(description="input as component.variable")
    file: PlainName = Field(
        description="table with columns time and value, beside the scenario or in the current folder"
    )
    column: str = Field("value", description="the column of the values")
    interpolation: Literal["linear", "held"] = Field(
        "linear", description="linear between rows, or held until the next"
    )


KINDS = {"step": StepSignal, "pulse": PulseSignal, "square": SquareSignal, "sines": SinesSignal, "csv": CsvSignal}
"""The kinds of signals by their names."""

SignalSection = Annotated[
    StepSignal | PulseSignal | SquareSignal | SinesSignal | CsvSignal, Field(discriminator="kind")
]


@dataclass(frozen=True, eq=False)
class TimeTable:
    """Values over growing times [s]; one object per file and column, so that it hashes by what it is."""

    times: tuple[float, ...]
    values: tuple[float, ...]
    held: bool

    def at(self, time: float) -> float:
        """Return the value at `time` [s]."""
        after = bisect_right(self.times, time)
        if after in (0, len(self.times)):
            return self.values[max(0, after - 1)]
        low, high = self.values[after - 1], self.values[after]
        if self.held:
            return low
        begin, end = self.times[after - 1], self.times[after]
        return low + (high - low) * ((time - begin) / (end - begin))

    def whole(self) -> bool:
        """Return whether all values are whole numbers and held."""
        return self.held and _all_whole(self.values)


def load_table(path: Path, column: str, *, held: bool) -> TimeTable:
    """Return the table of a CSV file with a column `time` that grows from row to row, and the column of the values.

    Raises UserError for a file that is missing, too large or something else.
    """
    try:
        status = path.stat()
    except OSError:
        read_text(path, "signal")  # says what is wrong
        raise
    return _loaded(path.absolute(), path, column, held, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=16)
def _loaded(_place: Path, path: Path, column: str, held: bool, _time: int, _size: int) -> TimeTable:
    def choose(names: Sequence[str]) -> Sequence[str]:
        if "time" not in names or column not in names:
            raise UserError(f"{path} must have the columns time and {column}, found {', '.join(names) or 'nothing'}")
        return [column]

    columns = read_columns(path, choose, "signal")
    return TimeTable(columns["time"], columns[column], held)


def read_columns(
    path: Path, choose: Callable[[Sequence[str]], Sequence[str]], kind: str
) -> dict[str, tuple[float, ...]]:
    """Return the column `time` of a table (CSV), which grows from row to row, and those that `choose` picks of its names.

    `kind` is what the file is called where it cannot be read. Raises UserError for anything else, and what `choose`
    raises, who looks for the `time` too.
    """
    rows = csv.reader(io.StringIO(read_text(path, kind), newline=""))
    try:
        names = [name.strip() for name in next(rows, [])]
        wanted = ("time", *choose(names))
        twice = next((name for name in wanted if names.count(name) > 1), None)
        if twice is not None:
            raise UserError(f"{path} must have the column {twice} once, found {', '.join(names)}")
        places = [names.index(name) for name in wanted]
        lines = [_numbers(path, row, places, line) for line, row in enumerate(rows, 2) if row]
    except csv.Error as error:
        raise UserError(f"{path} is not a table: {error}") from None
    if not lines:
        raise UserError(f"{path} must have at least one row below its heading")
    columns = dict(zip(wanted, zip(*lines, strict=True), strict=True))
    times = columns["time"]
    late = next((k for k in range(1, len(times)) if not times[k] > times[k - 1]), None)
    if late is not None:
        raise UserError(
            f"{path}: the time must grow from row to row, found {times[late]:g} after {times[late - 1]:g} s"
        )
    return columns


def _numbers(path: Path, row: Sequence[str], places: Sequence[int], line: int) -> tuple[float, ...]:
    try:
        values = tuple(float(row[place]) for place in places)
    except (ValueError, IndexError):
        raise UserError(
            f"{path}: line {line} must have a number in each column, found {', '.join(row)[:60]!r}"
        ) from None
    if not all(map(math.isfinite, values)):
        text = " and ".join(f"{value}" for value in values)
        raise UserError(f"{path}: line {line} must have finite numbers, found {text}")
    return values


def _all_whole(values: Sequence[float]) -> bool:
    return all(value == math.floor(value) and abs(value) < 2**31 for value in values)


@dataclass(frozen=True)
class PlannedSignal(Signal):
    """A section's function as a signal: values ahead are computed once for all runs with the same function and step."""

    section: Function

    def ahead(self, start_time: float, step: float, first: int, count: int) -> Sequence[float]:
        """Return the values at start_time + k step for `count` steps from `first` on."""
        return _ahead(self.section, start_time, step, first, count)  # type: ignore[arg-type] # frozen, so hashable


@lru_cache(maxsize=256)
def _ahead(section: Function, start_time: float, step: float, first: int, count: int) -> tuple[float, ...]:
    return tuple(section.at(start_time + k * step) for k in range(first, first + count))


@dataclass(frozen=True)
class WholeSignal(PlannedSignal):
    """The same on an input that takes whole numbers, or true and false."""

    def ahead(self, start_time: float, step: float, first: int, count: int) -> Sequence[float]:
        """Return the values as whole numbers."""
        return [int(value) for value in super().ahead(start_time, step, first, count)]


def planned(target: str, function: Function, variable: ScalarVariable | None, *, recorded: bool = False) -> Signal:
    """Return the signal of a function on the input `target`, whose variable says what values it takes.

    Raises UserError for an input of whole numbers, or true and false, whose signal has others.
    """
    if variable is None or variable.type in ("Real", "String"):  # the coupling refuses what is no input, and a String
        return PlannedSignal(target, function.at, function, recorded=recorded)
    if not function.whole():
        raise UserError(f"the signal on {target} must have whole numbers, since that is of type {variable.type}")

    def whole(time: float) -> float:
        return int(function.at(time))

    return WholeSignal(target, whole, function, recorded=recorded)


def function_of(section: Any, find: Mapping[str, Path]) -> Function:
    """Return the function of a signal's section; `find` gives the paths of its files by their names."""
    if isinstance(section, CsvSignal):
        return load_table(find[section.file], section.column, held=section.interpolation == "held")
    return section
