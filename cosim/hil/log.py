"""The log of a run: rows packed into a file mapped to memory, so that a killed process loses none; then a Result.

The file begins with a magic number, the length of a JSON header (the columns, what the run is) and that header; rows of a
fixed size follow. A row ends with its number, from 1 on, and the CRC-32 of all before; a row without them was not finished.
The header has a CRC-32 too. While a process has the file open it holds a lock on it. (NumPy's own format, `open_memmap`, has
no place for what the run is and no checksums, and packs a row in three times the time.)
"""

from __future__ import annotations

import json
import mmap
import os
import struct
import sys
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, StrictStr

from fmu_export.reading import decoded, parse_json

from ..errors import UserError
from ..provenance import Provenance
from ..results import Result
from ..room import check_disk, check_memory
from ..typed import checked
from .scaling import RESOLUTION, delta_of, theta_of

MAGIC = b"QUBEROW2"
_HEAD = struct.Struct("<8sQ")
_CRC = struct.Struct("<I")

TIMING = ("tick", "due", "woke", "latency", "step_time", "steps", "arm", "pendulum", "digital")
"""Whole-number columns of a row: the device's tick; when its sample was due and when it was read [ns], from the sample to
the command and within the controller [ns]; how often the controller was stepped; raw counts and bits."""
MEASURED = ("current", "tachometer", "applied_voltage")
"""Real columns of a row: [A], [counts/s], and the voltage that was in force until this row [V]."""


COPIES = 3
"""How many times the size of a log is in memory when its result is made."""


@dataclass(frozen=True)
class Layout:
    """The columns of a row: those above, then the controller's real and whole-number outputs, with their units."""

    reals: tuple[str, ...]
    integers: tuple[str, ...]
    units: Mapping[str, str]

    @property
    def row(self) -> struct.Struct:
        """The form of a row, little-endian; its number and its CRC come last."""
        whole, real = len(TIMING) + len(self.integers), len(MEASURED) + len(self.reals)
        return struct.Struct(f"<{len(TIMING)}q{real}d{whole - len(TIMING)}qII")

    @property
    def names(self) -> tuple[str, ...]:
        """The columns in the order of a row, without number and CRC; the controller's cannot be taken for the others."""
        return (*TIMING, *MEASURED, *(f"controller.{name}" for name in (*self.reals, *self.integers)))


class RowLog:
    """Rows of a run in a mapped file; the file disappears with `discard`, when its rows are safe elsewhere."""

    def __init__(self, path: Path, layout: Layout, rows: int, metadata: Mapping[str, Any]) -> None:
        """Make the file with room for `rows`; raise UserError where another run has it."""
        self.path, self.layout = path.absolute(), layout
        self.struct = layout.row
        self.capacity = rows
        columns = {
            "reals": layout.reals,
            "integers": layout.integers,
            "units": dict(layout.units),
            "metadata": metadata,
        }
        header = json.dumps({**columns, "crc32": _crc(columns)}).encode()
        self.begin = _HEAD.size + len(header)
        size = self.begin + rows * self.struct.size
        hint = "a shorter duration or a lower rate would do"
        check_disk("the run's log", size, path.parent, hint)
        check_memory("the run's log, and the result made of it,", COPIES * size, hint)
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._file = self.path.open("x+b")
        except FileExistsError:
            raise UserError(f"{path} is the log of another run") from None
        _lock(self._file)
        try:
            self._file.truncate(size)
            if hasattr(os, "posix_fallocate"):  # a full disk is an error now, not a crash in the loop
                os.posix_fallocate(self._file.fileno(), 0, size)
            self.buffer = mmap.mmap(self._file.fileno(), size)
        except BaseException as error:
            self._file.close()
            self.path.unlink()
            if isinstance(error, OSError | OverflowError | ValueError):
                raise UserError(f"there is no room for the log {path}, {size} bytes: {error}") from None
            raise
        self.buffer[: self.begin] = _HEAD.pack(MAGIC, len(header)) + header
        for page in range(self.begin, size, mmap.PAGESIZE):  # touched now, not while the loop runs
            self.buffer[page] = 0
        self.rows = 0

    def append(self, *values: float) -> None:
        """Pack one row; beyond the capacity nothing is kept."""
        rows = self.rows
        if rows < self.capacity:
            begin = self.begin + rows * self.struct.size
            end = begin + self.struct.size - _CRC.size
            self.struct.pack_into(self.buffer, begin, *values, rows + 1, 0)
            _CRC.pack_into(self.buffer, end, zlib.crc32(self.buffer[begin:end]))
            self.rows = rows + 1

    def close(self) -> None:
        """Give the file and its lock back; the rows stay in it."""
        if not self._file.closed:
            self.buffer.close()
            self._file.close()

    def discard(self) -> None:
        """Remove the file."""
        self.close()
        self.path.unlink(missing_ok=True)


class LiveLog:
    """A log that another process writes, to be looked at: the newest row, and whether its writer lives."""

    def __init__(self, path: Path) -> None:
        """Map the file; raise UserError where it is no log."""
        self._file = path.open("r+b")
        if not path.stat().st_size:
            raise UserError(f"{path} is not the log of a run, it is empty")
        self.buffer = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        self.layout, self.metadata, self.begin = _read_header(self.buffer, path)
        self.struct = self.layout.row
        self.capacity = (len(self.buffer) - self.begin) // self.struct.size
        self.rows = 0  # seen to be finished

    def written(self) -> bool:
        """Whether a process still holds the log open for writing."""
        if not _lock(self._file):
            return True
        _unlock(self._file)
        return False

    def newest(self) -> dict[str, float] | None:
        """Return the newest finished row by column; None before the first."""
        while self.rows < self.capacity and self._unpacked(self.rows)[-2] == self.rows + 1:
            self.rows += 1
        return self.row(self.rows - 1) if self.rows else None

    def row(self, index: int) -> dict[str, float]:
        """Return a finished row by column."""
        return dict(zip(self.layout.names, self._unpacked(index), strict=False))

    def _unpacked(self, index: int) -> tuple[float, ...]:
        return self.struct.unpack_from(self.buffer, self.begin + index * self.struct.size)

    def close(self) -> None:
        """Let the file go."""
        self.buffer.close()
        self._file.close()


def _read_header(buffer: mmap.mmap | bytes, path: Path) -> tuple[Layout, dict[str, Any], int]:
    magic, length = _HEAD.unpack_from(buffer) if len(buffer) >= _HEAD.size else (b"", 0)
    begin = _HEAD.size + length
    if magic != MAGIC or begin > len(buffer):
        raise UserError(f"{path} is not the log of a run")
    data = parse_json(decoded(bytes(buffer[_HEAD.size : begin]), path), path)
    header = checked(_Header, data, path)
    if data.pop("crc32", None) != _crc(data):
        raise UserError(f"the log {path} is damaged: its header does not fit its checksum")
    if header.metadata.step is None:
        raise UserError(f"{path}: metadata.step is required")
    names = [*header.reals, *header.integers]
    if len(set(names)) < len(names) or set(names) != header.units.keys():
        raise UserError(f"{path}: reals and integers must name each of the units' outputs once")
    return Layout(header.reals, header.integers, header.units), data["metadata"], begin


class _Header(BaseModel):
    """The JSON at the beginning of a log."""

    model_config = ConfigDict(extra="ignore", frozen=True)
    reals: tuple[StrictStr, ...]
    integers: tuple[StrictStr, ...]
    units: dict[StrictStr, StrictStr]
    metadata: Provenance


def _crc(header: Mapping[str, Any]) -> int:
    """Return the checksum of a header without its own."""
    return zlib.crc32(json.dumps(header).encode())


def rows_of(content: bytes, path: Path) -> tuple[Layout, dict[str, Any], np.ndarray]:
    """Return layout, header and the finished rows of a log's bytes, as a structured array by column.

    Raises UserError for what is no log, and where a row before the last finished one does not fit its checksum.
    """
    layout, metadata, begin = _read_header(content, path)
    whole = {*TIMING, *(f"controller.{name}" for name in layout.integers)}
    types = [(name, "<i8" if name in whole else "<f8") for name in layout.names]
    dtype = np.dtype([*types, ("number", "<u4"), ("crc", "<u4")])
    room = (len(content) - begin) // dtype.itemsize
    table = np.frombuffer(content, dtype=dtype, count=room, offset=begin)
    sound = _sound(content[begin : begin + room * dtype.itemsize], dtype.itemsize)
    sound &= table["number"] == np.arange(1, room + 1)
    rows = int(np.argmin(sound)) if not sound.all() else room
    if sound[rows:].any():
        raise UserError(f"the log {path} is damaged: row {rows + 1} does not fit its checksum, later ones do")
    return layout, metadata, table[:rows]


def _sound(rows: bytes, size: int) -> np.ndarray:
    """Return which of the rows of `size` bytes fit the checksum at their end."""
    view = memoryview(rows)
    sums = [zlib.crc32(view[at : at + size - _CRC.size]) for at in range(0, len(rows), size)]
    kept = np.frombuffer(rows, np.uint8).reshape(-1, size)[:, -_CRC.size :].copy().view("<u4").ravel()
    return np.array(sums, dtype=np.uint32) == kept


def to_result(layout: Layout, rows: np.ndarray, metadata: Mapping[str, Any]) -> Result:
    """Return the rows as a simulation's result has them, and the timing beside.

    time = ticks since the first row times the period. A row has what was measured at its time and the controller's
    outputs in force until then, as in a simulation; `hil.steps` says how often the controller was stepped on it.
    """
    if not len(rows):
        return Result(np.zeros(0), {}, {}, dict(metadata))
    ticks = rows["tick"] - rows["tick"][0]
    signals: dict[str, np.ndarray] = {}
    for name in layout.units:  # in the controller's own order
        signals[f"controller.{name}"] = rows[f"controller.{name}"].copy()
    units = {f"controller.{name}": unit for name, unit in layout.units.items()}

    def add(name: str, unit: str, values: np.ndarray) -> None:
        signals[name], units[name] = values, unit

    add("plant.theta_encoder", "rad", theta_of(rows["arm"]))
    add("plant.delta_encoder", "rad", delta_of(rows["pendulum"]))
    add("plant.current", "A", -rows["current"])
    add("hil.applied_voltage", "V", rows["applied_voltage"].copy())
    add("hil.tachometer", "rad/s", -RESOLUTION * rows["tachometer"])
    add("hil.lateness", "s", lateness(rows, metadata["step"]))
    add("hil.latency", "s", rows["latency"] * 1e-9)
    add("hil.step_time", "s", rows["step_time"] * 1e-9)
    add("hil.missed", "1", np.diff(ticks, prepend=-1) - 1)
    add("hil.steps", "1", rows["steps"].copy())
    add("hil.digital", "1", rows["digital"].copy())
    return Result(ticks * metadata["step"], signals, units, dict(metadata))


def lateness(rows: np.ndarray, period: float) -> np.ndarray:
    """Return how long after it was due each sample was read [s].

    Where the device's clock is another one, the due times are the line through the readings with the mean period and
    the earliest arrival on it.
    """
    woke = rows["woke"]
    if np.all(rows["due"] > 0):
        return (woke - rows["due"]) * 1e-9
    ticks = (rows["tick"] - rows["tick"][0]).astype(float)
    late = (woke - woke[0]) * 1e-9 - ticks * period
    if len(rows) > 2:
        late = late - np.polyval(np.polyfit(ticks, late, 1), ticks)
    return late - np.min(late)


def free_path(folder: Path, stem: str) -> Path:
    """Return `folder`/`stem`.csv, or the first of stem_2.csv, stem_3.csv, ... that is free; an earlier run stays."""
    number = 1
    while True:
        path = folder / f"{stem if number == 1 else f'{stem}_{number}'}.csv"
        if not any(path.with_suffix(suffix).exists() for suffix in (".csv", ".json", ".png", ".html", ".rows")):
            return path
        number += 1


def recover(folder: Path) -> list[tuple[Path, int | str]]:
    """Turn the logs that killed runs left in `folder` into results; return (file, rows) of each.

    Logs that a living process holds are left alone, and so is what is no log or damaged: a sentence says so in place of
    its rows.
    """
    recovered: list[tuple[Path, int | str]] = []
    for path in sorted(folder.glob("*.rows")):
        with path.open("r+b") as file:
            if not _lock(file):
                continue
            try:
                layout, metadata, rows = rows_of(file.read(), path)
            except UserError as error:
                recovered.append((path, str(error)))
                continue
            target = path.with_suffix(".csv")
            if target.exists() or target.with_suffix(".json").exists():  # saved, but for what a killed run did last
                target = free_path(folder, path.stem)
            to_result(layout, rows, {**metadata, "complete": False, "recovered": True}).save(target)
        path.unlink()
        recovered.append((target, len(rows)))
    return recovered


if sys.platform == "win32":
    import msvcrt

    _LOCKED_BYTE = 1 << 62
    """Windows denies others the bytes that are locked, so one is that no file has."""

    def _lock(file: IO[bytes]) -> bool:
        """Lock the file for this handle; return False where another has it."""
        file.seek(_LOCKED_BYTE)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        finally:
            file.seek(0)
        return True

    def _unlock(file: IO[bytes]) -> None:
        file.seek(_LOCKED_BYTE)
        msvcrt.locking(file.fileno(), msvcrt.LK_UNLCK, 1)
        file.seek(0)

else:
    import fcntl

    def _lock(file: IO[bytes]) -> bool:
        """Lock the file for this handle; return False where another has it."""
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def _unlock(file: IO[bytes]) -> None:
        fcntl.flock(file, fcntl.LOCK_UN)


def percentiles(values: Sequence[float] | np.ndarray) -> dict[str, float]:
    """Return p50, p99, p99.9 and max; empty without values."""
    if not len(values):
        return {}
    p50, p99, p999 = np.percentile(values, [50.0, 99.0, 99.9])
    return {"p50": float(p50), "p99": float(p99), "p99.9": float(p999), "max": float(np.max(values))}
