"""Ctrl-C while FMUs run: the first one asks a run to end at its next look, the second ends the process if it does not.

An FMU that hangs in a call keeps the interpreter's main thread from seeing any signal. What CPython does on a signal even
then is to write its number to the wakeup descriptor; a thread of this module reads it there.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from .archives import remove_unpacked
from .signals import STOPPING

GRACE = 1.0
"""How long a run may take to end [s] before it counts as hanging."""

_SHOW_CURSOR = "\x1b[?25h"


@contextmanager
def second_ends(last: Callable[[], str] = lambda: "") -> Iterator[None]:
    """Within the block, end the process at the second signal to stop it, unless the block ends by itself within GRACE.

    `last` is then called first, in another thread: it does what must be done, such as bringing a device to 0 V, and
    returns what is to be said of it. Only in the main thread, which alone gets signals; elsewhere, and inside another such
    block, this does nothing. The signals' own handlers are called all the same, as soon as the interpreter can.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    earlier = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    if earlier != -1:  # somebody else's, or a block around this one
        signal.set_wakeup_fd(earlier)
        reader.close()
        writer.close()
        yield
        return
    over = threading.Event()
    watcher = threading.Thread(target=_watch, args=(reader, over, last), name="second Ctrl-C", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(-1)
        over.set()
        writer.close()
        watcher.join()
        reader.close()


@contextmanager
def deferred_interrupt() -> Iterator[list[int]]:
    """Collect Ctrl-C in a list instead of raising it: raised inside a Python FMU it would be that FMU's failure."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    earlier = signal.signal(signal.SIGINT, lambda number, _: received.append(number))
    try:
        yield received
    finally:
        signal.signal(signal.SIGINT, earlier)


def _watch(reader: socket.socket, over: threading.Event, last: Callable[[], str]) -> None:
    received = 0
    while True:
        numbers = [n for n in reader.recv(64) or b"\0" if n in STOPPING or not n]
        if 0 in numbers:  # the block is over
            return
        for number in numbers:
            received += 1
            if over.wait(GRACE):
                return
            if received > 1:
                _end(number, last)
        if received == 1:
            _say("the run does not end: an FMU still computes; Ctrl-C once more ends the process")


def _end(number: int, last: Callable[[], str]) -> None:
    try:
        done = last()
        remove_unpacked()
        _say("; ".join(text for text in ("ended while an FMU was computing", done) if text))
    finally:
        os._exit(128 + number)


def _say(text: str) -> None:
    if sys.stderr.isatty():
        text = f"{_SHOW_CURSOR}\r\n{text}"
    print(text, file=sys.stderr, flush=True)
