"""What the operating system and the interpreter can do for a periodic loop, where they are permitted to."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

REFERENCE_MISSES = {
    (500.0, False): 12,
    (500.0, True): 0,
    (1000.0, False): 121,
    (1000.0, True): 1,
    (2000.0, False): 144,
    (2000.0, True): 33,
}
"""Periods that a bare sleeping loop missed in REFERENCE_TIME [s] on another shared virtual machine with 2 cores and CPython
3.11, by rate [Hz] and whether scheduling was real-time with locked memory: to compare with."""
REFERENCE_TIME = 20.0

PRIORITY = 80
"""Priority under SCHED_FIFO: above ordinary work, below the kernel's own threads."""

_MCL_CURRENT_AND_FUTURE = 3


@contextmanager
def undisturbed(*, real_time: bool) -> Iterator[list[str]]:
    """Run the body without garbage collection and, with `real_time`, under SCHED_FIFO with all memory locked.

    Yields what was obtained and what was not, in words. Everything is as before afterwards.
    """
    gc.collect()
    was_enabled = gc.isenabled()
    gc.disable()
    notes: list[str] = []
    undo = _scheduled(notes) if real_time else None
    try:
        yield notes
    finally:
        if undo is not None:
            undo()
        if was_enabled:
            gc.enable()


def _scheduled(notes: list[str]) -> Callable[[], None] | None:
    """Do what the system permits, say so in `notes`, and return what undoes it."""
    if sys.platform != "linux":
        notes.append(f"no real-time scheduling: not implemented for {sys.platform}")
        return None
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    fifo = locked = False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        fifo = True
        notes.append(f"real-time scheduling: SCHED_FIFO, priority {PRIORITY}")
    except PermissionError:
        notes.append(
            "no real-time scheduling: not permitted; run as root, or add `@realtime - rtprio 90` and `@realtime - memlock "
            "unlimited` to /etc/security/limits.conf and yourself to that group"
        )
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_AND_FUTURE) == 0:
        locked = True
        notes.append("memory locked")
    else:
        notes.append(f"memory not locked: {os.strerror(ctypes.get_errno())}")

    def undo() -> None:
        if fifo:
            os.sched_setscheduler(0, policy, parameters)
        if locked:
            libc.munlockall()

    return undo
