"""SIGTERM and SIGHUP end a command as Ctrl-C does, and its exit code tells which signal it was.

Whatever puts Ctrl-C off (a running FMU, a file being written) so puts the others off as well.
"""

from __future__ import annotations

import signal
from types import FrameType

FORWARDED = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))
STOPPING = (signal.SIGINT, *FORWARDED)
"""The signals that ask a process to end."""

CTRL_C = 128 + signal.SIGINT
"""Exit code."""

_received: list[int] = []


def as_ctrl_c() -> None:
    """Let each signal that would end the process do what SIGINT's handler does at that moment.

    One that is ignored, as by `nohup`, stays ignored.
    """
    _received.clear()
    for number in FORWARDED:
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _forward)


def exit_code() -> int:
    """Return 128 + the signal that came first; SIGINT where none was forwarded."""
    return 128 + (_received[0] if _received else signal.SIGINT)


def _forward(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        handler(signal.SIGINT, frame)
    else:  # Ctrl-C is ignored, as in a shell's background
        raise KeyboardInterrupt
