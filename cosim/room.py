"""Estimates before anything is made: whether what a run leaves fits into memory and onto the disk."""

from __future__ import annotations

import math
import os
import shutil
import sys
from pathlib import Path

from .errors import UserError

SHARE = 0.5
"""Share of the free memory that results may take; pictures and tables need some too."""

SMALL = 2.0**24
"""What is not looked at [byte]."""

BYTES_IN_CSV = 20
"""Of a number written in its shortest exact form, with its comma, in most cases less."""


def check_memory(what: str, size: float, hint: str) -> None:
    """Raise UserError where `size` [byte] is more than the share of the free memory; `hint` says what would help."""
    free = free_memory()
    if free is not None and size > SHARE * free:
        raise UserError(
            f"{what} needs {gigabytes(size)} of memory, more than half of the free {gigabytes(free)}; {hint}"
        )


def check_disk(what: str, size: float, folder: Path, hint: str) -> None:
    """Raise UserError where `size` [byte] is more than the disk of `folder` has left."""
    free = free_disk(folder)
    if size > free:
        raise UserError(f"{what} needs about {gigabytes(size)}, and {folder} has {gigabytes(free)} left; {hint}")


def check_rows(rows: int, columns: int, every: int, folder: Path | None = None) -> None:
    """Raise UserError where a result of that many rows and columns of numbers does not fit.

    size = 8 rows (columns + 1) in memory; `every` is the record.every that they were counted with; a `folder` is
    where it is written as CSV.
    """
    numbers = float(rows) * (columns + 1)
    size, text = 8.0 * numbers, BYTES_IN_CSV * numbers
    if size < SMALL:
        return
    free = free_memory()
    parts = [] if free is None else [size / (SHARE * free)]
    parts += [] if folder is None else [text / free_disk(folder)]
    fitting = max(every + 1, math.ceil(1.1 * every * max(parts, default=0.0)))
    what = f"the run of {rows} rows of {columns + 1} numbers"
    hint = f"record.every = {fitting}, fewer record.outputs or a shorter run.duration would do"
    check_memory(what, size, hint)
    if folder is not None:
        check_disk(f"writing {what}", text, folder, hint)


def free_disk(folder: Path) -> int:
    """Return what the disk of `folder`, or of the folder that it will be made in, has left [byte]."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    return max(1, shutil.disk_usage(place).free)


def free_memory() -> int | None:
    """Return the memory that is free or can be freed [byte], within a container's limit; None where nobody says."""
    if sys.platform == "win32":
        return _free_on_windows()
    limits = [size for size in (_available(), _left_in_group()) if size is not None]
    if limits:
        return min(limits)
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    except (ValueError, OSError):
        return None


def _available() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")), None)


def _left_in_group() -> int | None:
    group = Path("/sys/fs/cgroup")
    try:
        limit, used = ((group / name).read_text(encoding="ascii").strip() for name in ("memory.max", "memory.current"))
        stat = dict(line.split() for line in (group / "memory.stat").read_text(encoding="ascii").splitlines())
    except OSError:
        return None
    return None if limit == "max" else max(0, int(limit) - int(used) + int(stat.get("inactive_file", 0)))


def _free_on_windows() -> int | None:
    import ctypes  # noqa: PLC0415

    class Status(ctypes.Structure):
        _fields_ = [
            ("length", ctypes.c_uint32),
            ("load", ctypes.c_uint32),
            *[(f"n{i}", ctypes.c_uint64) for i in range(7)],
        ]

    status = Status(length=ctypes.sizeof(Status))
    kernel = ctypes.WinDLL("kernel32")  # type: ignore[attr-defined]
    return int(status.n1) if kernel.GlobalMemoryStatusEx(ctypes.byref(status)) else None


def gigabytes(size: float) -> str:
    """Return a size [byte] as text."""
    return f"{size / 1e9:.3g} GB"
