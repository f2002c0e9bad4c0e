"""The live line of a run, printed by a process of its own that looks at the log: it costs the loop nothing.

`python -m cosim.hil.status FILE.rows`; it ends when nobody writes the log any more.
"""

from __future__ import annotations

import math
import os
import shutil
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ihc_fmu.pendulum.interface import MODES

from ..errors import UserError
from .guards import digital_reason
from .log import LiveLog
from .scaling import delta_of, theta_of

PAUSE = 0.1
"""Time between two looks [s]."""
CLEAR = "\r\x1b[K"


class Part(NamedTuple):
    """A piece of the line: in full, short, and how soon it is left out of a narrow one (0: last)."""

    full: str
    short: str
    order: int


def parts(row: Mapping[str, float], first_tick: float, rows: int, step: float) -> list[Part]:
    """Return the newest row in words: time, mode, angles, voltage, how late, what has been missed, faults."""
    mode = int(row.get("controller.mode", 0))
    name = MODES[mode - 1].replace("_", "-") if 1 <= mode <= len(MODES) else "running"
    theta, delta = math.degrees(theta_of(int(row["arm"]))), delta_of(int(row["pendulum"]))
    upright = math.degrees(math.remainder(delta, 2.0 * math.pi))
    ticks = row["tick"] - first_tick
    missed, fault = int(ticks + 1 - rows), digital_reason(int(row["digital"]))
    latency, voltage = f"{row['latency'] * 1e-3:4.0f} us", f"{row['applied_voltage']:+6.2f} V"
    pieces = [
        Part(f"{ticks * step:7.2f} s", f"{ticks * step:.2f} s", 1),
        Part(f"{name:11}", name, 2),
        Part(f"arm {theta:+7.1f}°", f"θ {theta:+6.1f}°", 6),
        Part(f"pendulum {upright:+7.1f}°", f"δ {upright:+6.1f}°", 4),
        Part(voltage, voltage, 5),
        Part(f"{latency} to command", latency, 8),
        Part(f"missed {missed}", f"missed {missed}", 3),
    ]
    if row["due"]:
        late = f"late {(row['woke'] - row['due']) * 1e-3:4.0f} us"
        pieces.insert(-1, Part(late, late, 7))
    if fault:
        pieces.append(Part(fault, fault, 0))
    return pieces


def fitted(pieces: Sequence[Part], width: int) -> str:
    """Return the pieces in one line of at most `width` characters: in full, else short, else without the least needed."""
    full = "  ".join(piece.full for piece in pieces)
    if len(full) <= width:
        return full
    kept = list(pieces)
    while len(short := "  ".join(piece.short for piece in kept)) > width and len(kept) > 1:
        kept.remove(max(kept, key=lambda piece: piece.order))
    return short if len(short) <= width else short[: max(0, width - 1)] + "…"


def width() -> int:
    """Return the columns that a line may have without wrapping: one less than the terminal's, 79 without a terminal."""
    try:
        columns = os.get_terminal_size(sys.stderr.fileno()).columns
    except (OSError, ValueError):
        columns = shutil.get_terminal_size().columns
    return max(1, columns - 1)


def main(arguments: list[str] | None = None) -> int:
    """Print the line until the run is over."""
    (path,) = sys.argv[1:] if arguments is None else arguments
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)  # Ctrl-C is for the run, which ends this
    if hasattr(os, "nice"):
        os.nice(10)
    try:
        log = LiveLog(Path(path))
    except (OSError, UserError) as error:
        print(f"no live status: {error}", file=sys.stderr)
        return 1
    first: dict[str, Any] | None = None
    while log.written():
        row = log.newest()
        if row is not None:
            first = first or log.row(0)
            said = fitted(parts(row, first["tick"], log.rows, log.metadata["step"]), width())
            print(CLEAR + said, end="", file=sys.stderr, flush=True)
        time.sleep(PAUSE)
    if first is not None:
        print(CLEAR, end="", file=sys.stderr, flush=True)
    log.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
