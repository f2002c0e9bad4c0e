"""SIGTERM and SIGHUP end a command as Ctrl-C does, and its exit code tells which signal it was.

Whatever puts Ctrl-C off (a running FMU, a file being written) so puts the others off as well. What is left of an interrupted
command travels with its KeyboardInterrupt, as a note, to the one line that is said in the end.
"""

from __future__ import annotations

import signal
import sys
from types import FrameType

FORWARDED = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))
STOPPING = (signal.SIGINT, *FORWARDED)
"""The signals that ask a process to end."""

CTRL_C = 128 + signal.SIGINT
"""Exit code."""

NO_FILE = "no file was written"

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


def interrupt_behind(end: BaseException) -> KeyboardInterrupt | None:
    """Return the KeyboardInterrupt that `end` is or comes from; None where it ends for another reason."""
    error: BaseException | None = end
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


def note(interrupt: KeyboardInterrupt, kept: str) -> None:
    """Let an interrupt tell what it leaves, unless something inside has done so."""
    if not _notes(interrupt):
        interrupt.add_note(kept)


def say(interrupt: KeyboardInterrupt) -> None:
    """Say in one line that there was an interrupt, and what it leaves; without a note that is no file."""
    print(f"interrupted; {'; '.join(_notes(interrupt)) or NO_FILE}", file=sys.stderr, flush=True)


def _notes(interrupt: KeyboardInterrupt) -> list[str]:
    return getattr(interrupt, "__notes__", [])


def _forward(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        handler(signal.SIGINT, frame)
    else:  # Ctrl-C is ignored, as in a shell's background
        raise KeyboardInterrupt
