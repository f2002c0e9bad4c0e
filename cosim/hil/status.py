"""The live line of a run, printed by a process of its own that looks at the log: it costs the loop nothing.

`python -m cosim.hil.status FILE.rows`; it ends when nobody writes the log any more.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ihc_fmu.interface import MODES

from ..errors import UserError
from .guards import digital_reason
from .log import LiveLog
from .scaling import delta_of, theta_of

PAUSE = 0.1
"""Time between two looks [s]."""
CLEAR = "\r\x1b[K"


def line(row: Mapping[str, float], first_tick: float, rows: int, step: float) -> str:
    """Return the newest row in words: time, mode, angles, voltage, how late, what has been missed, faults."""
    mode = int(row.get("controller.mode", 0))
    name = MODES[mode - 1].replace("_", "-") if 1 <= mode <= len(MODES) else "running"
    theta, delta = math.degrees(theta_of(int(row["arm"]))), delta_of(int(row["pendulum"]))
    upright = math.degrees(math.remainder(delta, 2.0 * math.pi))
    ticks = row["tick"] - first_tick
    late = f"  late {(row['woke'] - row['due']) * 1e-3:4.0f} us" if row["due"] else ""
    missed = int(ticks + 1 - rows)
    fault = digital_reason(int(row["digital"]))
    return (
        f"{ticks * step:7.2f} s  {name:11}  arm {theta:+7.1f}°  pendulum {upright:+7.1f}°  {row['applied_voltage']:+6.2f} V"
        f"  {row['latency'] * 1e-3:4.0f} us to command{late}  missed {missed}" + (f"  {fault}" if fault else "")
    )


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
            print(CLEAR + line(row, first["tick"], log.rows, log.about["step"]), end="", file=sys.stderr, flush=True)
        time.sleep(PAUSE)
    if first is not None:
        print(CLEAR, end="", file=sys.stderr, flush=True)
    log.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
