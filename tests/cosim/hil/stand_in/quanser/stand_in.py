"""What the board is to do, and the record of what was done to it.

`configure(...)` in the test process, before the driver opens the board; in another process a JSON file with fields of
`Configuration`, named by the environment variable QUBE_STAND_IN. The module's state is the bench: one per process.
"""

from __future__ import annotations

import atexit
import json
import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

if TYPE_CHECKING:
    from .board import Board

VARIABLE = "QUBE_STAND_IN"


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """The board and its faults; times in seconds of the board's clock, which starts at 0 when it is first opened.

    JSON has lists for tuples. A failure is (n, code): the n-th call of that name, from 1, raises HILError(code) and does
    nothing else; (n, code, True): that call and all later ones.
    """

    clock: str = "monotonic"  # "monotonic": time.perf_counter_ns; "steps": a sample read is one period, no waiting
    immediate_step: float = 1e-3  # "steps": an immediate read with no task running takes this long [s]
    late: Mapping[int, int] = field(
        default_factory=dict
    )  # "steps": periods that pass before the n-th task read, from 1

    libhil_missing: bool = False  # OSError at import
    driver: bool = True  # False: open raises -107
    card_types: tuple[str, ...] = ("qube_servo2_usb",)  # others: -179
    identifiers: tuple[str, ...] = ("0",)  # the boards plugged in, others: -108; with "@": a virtual card
    opened_elsewhere: bool = False  # another process has the board
    already_open: int = -1073  # code of a second open; the documentation also knows -109

    max_rate: float = 2000.0  # [Hz], above: -150; the real limit is unknown
    task_stops_at: float | None = None  # the running task stops by itself: task_read returns 0
    unplugged_at: float | None = None  # from then on every call raises -1029; outputs hold
    failures: Mapping[str, tuple[int, int] | tuple[int, int, bool]] = field(default_factory=dict)

    watchdog: bool = True  # False: its calls raise -591 ... -599
    expire_to_zero_only: bool = False  # expiration states other than 0 raise -601, -1051, -1053
    expired_code: int = -854  # of I/O after expiry
    expired_refuses_reads: bool = True
    clear_restores_outputs: bool = False  # watchdog_clear brings back the outputs as they were before expiry

    plant: Mapping[str, Any] = field(default_factory=dict)  # start values of the plant unit that differ
    power_on_counts: tuple[int, int] = (137, -52)  # of the encoders before set_encoder_counts, hanging and at the mark
    digital_inputs: tuple[tuple[float, int, int], ...] = ()  # (from, channel, state)
    encoder_errors: tuple[tuple[float, float, int, int], ...] = ()  # (from, to, channel, counts added)
    currents: tuple[tuple[float, float, float], ...] = ()  # (from, to, A read instead)

    log: str | None = None  # file for the record, one JSON object per line, appended as it goes

    def __post_init__(self) -> None:
        if self.clock not in ("monotonic", "steps"):
            raise ValueError(f"clock must be monotonic or steps, found {self.clock!r}")


class Event(NamedTuple):
    """A line of the record."""

    t: float
    what: str
    values: list[Any]


current = Configuration()
record: list[Event] = []
"""Every change of AO0, DO0 and LED; open, close, counts, directions, task, watchdog, error, unplugged, exit."""
calls: Counter[str] = Counter()
"""How often each call of HIL was made, refused ones included."""
boards: dict[str, Board] = {}
"""The boards that have been opened, by identifier."""
_log: TextIO | None = None


def configure(**changes: Any) -> Configuration:
    """Set the fields of a new configuration, all others to their default, and forget boards, record and calls."""
    global current  # noqa: PLW0603
    current = Configuration(**changes)
    reset()
    return current


def reset() -> None:
    """Forget boards, record and calls; the configuration stays."""
    global _log  # noqa: PLW0603
    for forgotten in (boards, record, calls):
        forgotten.clear()
    if _log:
        _log.close()
    _log = Path(current.log).open("a", encoding="utf-8", buffering=1) if current.log else None  # noqa: SIM115


def note(t: float, what: str, values: list[Any]) -> None:
    """Append to the record, and to the log as a line."""
    record.append(Event(t, what, values))
    if _log:
        _log.write(json.dumps({"t": t, "what": what, "values": values}) + "\n")


def history(what: str) -> list[Event]:
    """Return the events of one kind, for instance "AO0"."""
    return [event for event in record if event.what == what]


def to_json(**changes: Any) -> str:
    """Return the text of a configuration file for another process."""
    return json.dumps(asdict(Configuration(**changes)))


def failure(name: str) -> int:
    """Count a call of `name` and return the code it is to fail with, or 0."""
    calls[name] += 1
    planned = current.failures.get(name)
    if planned is None:
        return 0
    n, code, *onwards = planned
    return code if calls[name] == n or (any(onwards) and calls[name] > n) else 0


def _at_exit() -> None:
    for board in boards.values():
        note(board.seconds, "exit", [*board.outputs(), board.opened])


def _from_environment() -> None:
    path = os.environ.get(VARIABLE)
    if path:
        text = json.loads(Path(path).read_text(encoding="utf-8"))
        late = {int(n): periods for n, periods in text.pop("late", {}).items()}
        configure(**text, late=late)


_from_environment()
atexit.register(_at_exit)
