"""The board behind the library: outputs, encoders, watchdog, reader task and the plant, on the board's clock.

Times are integer nanoseconds since the board was first opened.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from plant_fmu.dynamics import static_current
from plant_fmu.interface import INTERFACE, start_values
from plant_fmu.unit import QubePlant

from . import stand_in

COUNTS = 2048
HANGING = -COUNTS // 2
VOLTAGE_RANGE = 15.0
CURRENT_RANGE = 3.0
LED = (11000, 11001, 11002)
TACHOMETER = 14000
INFINITE = 0x7FFFFFFF
ERROR, OVERWRITE, DISCARD, WAIT, SYNCHRONIZED = range(5)
LOW, HIGH, TRISTATE, NO_CHANGE = range(4)
WAKE = 0.005
"""A waiting reader looks this often whether the task was stopped [s]."""


class LibraryError(Exception):
    """The library's negative result."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass
class Channels:
    """The channels of a read."""

    analog: list[int] = field(default_factory=list)
    encoder: list[int] = field(default_factory=list)
    digital: list[int] = field(default_factory=list)
    other: list[int] = field(default_factory=list)

    def check(self) -> None:
        """Refuse channels that the board does not have."""
        known = ((self.analog, (0,), -121), (self.encoder, (0, 1), -124), (self.digital, (0, 1, 2), -127))
        for channels, exist, code in (*known, (self.other, (TACHOMETER,), -130)):
            if not set(channels) <= set(exist):
                raise LibraryError(code)


Sample = tuple[list[float], list[int], list[int], list[float]]


@dataclass(eq=False)
class Task:
    """A reader with its ring buffer; `due` is the time of the next sample."""

    channels: Channels
    room: int
    mode: int = ERROR
    buffer: deque[Sample] = field(default_factory=deque)
    running: bool = False
    deleted: bool = False
    failed: bool = False
    overflows: int = 0
    period: int = 0
    due: int = 0
    left: int = 0


@dataclass
class Watchdog:
    """The timer and the states that the outputs expire to; None leaves an output as it is."""

    analog: float | None = None
    digital: int | None = None
    other: dict[int, float] = field(default_factory=dict)
    timeout: int = 0
    expires: int | None = None
    expired: bool = False
    before: tuple[float, int, list[float]] | None = None


class Board:
    """One QUBE-Servo 2. Every method but `read_samples` expects `lock` to be held."""

    def __init__(self, virtual: bool) -> None:
        changes: dict[str, Any] = {"delta_0": -math.pi, "voltage_limit": VOLTAGE_RANGE, **stand_in.current.plant}
        self.plant = QubePlant(INTERFACE.start_values({**start_values("ident"), **changes}))
        self.virtual = virtual
        self.lock = threading.RLock()
        self.origin = time.perf_counter_ns()
        self.time = 0
        self.opened = False
        self.unplugged = False
        self.ao0, self.do0, self.led = 0.0, 0, [0.0, 0.0, 0.0]
        self.zero = list(stand_in.current.power_on_counts)
        self.watchdog = Watchdog()
        self.tasks: list[Task] = []
        self.reads = 0

    @property
    def seconds(self) -> float:
        """The board's clock [s]."""
        return self.time / 1e9

    @property
    def running(self) -> Task | None:
        """The task that has the clock."""
        return next((task for task in self.tasks if task.running), None)

    def outputs(self) -> tuple[float, int]:
        """Return AO0 [V] and DO0."""
        return self.ao0, self.do0

    def note(self, what: str, *values: Any) -> None:
        """Record an event at the board's time."""
        stand_in.note(self.seconds, what, list(values))

    # --- time

    def now(self) -> int:
        """Return the time that the board has reached by its clock."""
        return time.perf_counter_ns() - self.origin if stand_in.current.clock == "monotonic" else self.time

    def advance(self, until: int) -> None:
        """Let time pass: the plant moves, samples are taken, the watchdog may expire, the cable may come off."""
        while self.time < until:
            task = self.running
            if task and task.mode in (WAIT, SYNCHRONIZED) and len(task.buffer) >= task.room:
                self.origin += until - self.time  # the simulated board waits for its reader
                return
            at = min(until, *self._events(task))
            self._move(at)
            self._happen(task)

    def _events(self, task: Task | None) -> list[int]:
        planned = [stand_in.current.unplugged_at] if not self.unplugged else []
        planned += [stand_in.current.task_stops_at] if task else []
        events = [_ns(t) for t in planned if t is not None]
        if task:
            events.append(task.due)
        if self.watchdog.expires is not None:
            events.append(self.watchdog.expires)
        return [max(t, self.time) for t in events] or [2**62]

    def _move(self, until: int) -> None:
        if until > self.time:
            voltage = -self.ao0 if self.do0 and math.isfinite(self.ao0) else 0.0
            self.plant.step(self.seconds, (until - self.time) * 1e-9, (voltage, 0.0, 0.0))
            self.time = until

    def _happen(self, task: Task | None) -> None:
        setting = stand_in.current
        if not self.unplugged and setting.unplugged_at is not None and self.time >= _ns(setting.unplugged_at):
            self.unplugged = True
            self.note("unplugged", *self.outputs())
        if task and setting.task_stops_at is not None and self.time >= _ns(setting.task_stops_at):
            task.running = False
            self.note("task", "ended")
        elif task and self.time >= task.due:
            self._sample(task)
        if self.watchdog.expires is not None and self.time >= self.watchdog.expires:
            self._expire()

    def _expire(self) -> None:
        watchdog = self.watchdog
        watchdog.expires, watchdog.expired = None, True
        watchdog.before = (self.ao0, self.do0, list(self.led))
        self.note("watchdog", "expired")
        led = [watchdog.other.get(channel, value) for channel, value in zip(LED, self.led, strict=True)]
        self.set_outputs(
            self.ao0 if watchdog.analog is None else watchdog.analog,
            self.do0 if watchdog.digital is None else watchdog.digital,
            led,
        )

    # --- immediate input and output

    def begin(self, io: bool) -> None:
        """Bring the board up to now; refuse when unplugged, or input and output after the watchdog's expiry."""
        self.advance(self.now())
        self.refuse(io)

    def refuse(self, io: bool) -> None:
        """Raise LibraryError where the board gives no access."""
        if self.unplugged:
            raise LibraryError(-1029)
        if io and self.watchdog.expired:
            raise LibraryError(stand_in.current.expired_code)

    def pass_immediate_read(self) -> None:
        """With the stepped clock, let an immediate read take its time, unless a task sets the pace."""
        if stand_in.current.clock == "steps" and not self.running:
            self.advance(self.time + _ns(stand_in.current.immediate_step))
            self.refuse(io=stand_in.current.expired_refuses_reads)

    def read(self, channels: Channels) -> Sample:
        """Return the values of the channels now, as they would be sampled."""
        encoders = self.encoders()
        other = [-self.plant.x[2] * COUNTS / math.tau] * len(channels.other)
        analog = [self.current()] * len(channels.analog)
        digital = [self.digital_input(channel) for channel in channels.digital]
        return analog, [encoders[channel] for channel in channels.encoder], digital, other

    def encoders(self) -> list[int]:
        """Return the counts: theta = -2 pi enc0/2048, delta = 2 pi enc1/2048 - pi, from the last zero."""
        counts = [a + b for a, b in zip(self._turned(), self.zero, strict=True)]
        for start, end, channel, error in stand_in.current.encoder_errors:
            if start <= self.seconds < end:
                counts[channel] += error
        return counts

    def _turned(self) -> tuple[int, int]:
        theta, delta = self.plant.delay_line[0]
        return -round(theta * COUNTS / math.tau), round(delta * COUNTS / math.tau) - HANGING

    def set_encoder(self, channel: int, counts: int) -> None:
        """Make the encoder show `counts` where it is."""
        self.zero[channel] = counts - self._turned()[channel]

    def current(self) -> float:
        """Return the motor current [A] with the sign of AO0; 0 with the amplifier off."""
        for start, end, amperes in stand_in.current.currents:
            if start <= self.seconds < end:
                return amperes
        if not self.do0:
            return 0.0
        if self.plant.inductance:
            return -self.plant.x[4]
        voltage = max(-VOLTAGE_RANGE, min(VOLTAGE_RANGE, -self.ao0))
        amperes = -static_current(self.plant.motor, voltage, self.plant.x[2])
        return max(-CURRENT_RANGE, min(CURRENT_RANGE, amperes))

    def digital_input(self, channel: int) -> int:
        """Return DI0 amplifier fault, DI1 stall detected, DI2 stall error as configured."""
        state = 0
        for start, of, value in sorted(stand_in.current.digital_inputs):
            if of == channel and start <= self.seconds:
                state = value
        return state

    def set_outputs(self, ao0: float, do0: int, led: list[float]) -> None:
        """Change the outputs; each change is an event."""
        if ao0 != self.ao0:
            self.ao0 = ao0
            self.note("AO0", ao0)
        if do0 != self.do0:
            self.do0 = do0
            self.note("DO0", do0)
        if led != self.led:
            self.led = led
            self.note("LED", *led)

    def write(self, analog: dict[int, float], digital: dict[int, int], other: dict[int, float]) -> None:
        """Write all outputs at once."""
        for channels, exist, code in ((analog, (0,), -133), (digital, (0,), -139), (other, LED, -142)):
            if not set(channels) <= set(exist):
                raise LibraryError(code)
        led = [other.get(channel, value) for channel, value in zip(LED, self.led, strict=True)]
        self.set_outputs(analog.get(0, self.ao0), int(digital.get(0, self.do0) != 0), led)

    # --- tasks

    def create(self, room: int, channels: Channels) -> Task:
        """Return a new reader task."""
        if room < 1:
            raise LibraryError(-320)
        channels.check()
        self.tasks.append(Task(channels, room))
        return self.tasks[-1]

    def start(self, task: Task, clock: int, frequency: float, samples: int) -> None:
        """Start a task; its first sample is due after one period."""
        if not -4 <= clock <= 0:
            raise LibraryError(-144)
        if self.running:
            raise LibraryError(-145)
        if not frequency > 0:
            raise LibraryError(-149)
        if frequency > stand_in.current.max_rate:
            raise LibraryError(-150)
        if samples < 1:
            raise LibraryError(-321)
        task.buffer.clear()
        task.running, task.failed, task.overflows, task.left = True, False, 0, samples
        task.period = round(1e9 / frequency)
        task.due = self.time + task.period
        self.note("task", "started", frequency)

    def _sample(self, task: Task) -> None:
        task.due += task.period
        if task.left < INFINITE:
            task.left -= 1
            task.running = task.left > 0
        if len(task.buffer) >= task.room:
            task.overflows += 1
            if task.mode == ERROR:
                task.failed = True
            if task.mode != OVERWRITE:
                return
            task.buffer.popleft()
        task.buffer.append(self.read(task.channels))

    def stop(self, task: Task) -> None:
        """Stop a task; samples not yet read are gone."""
        if task.running:
            task.running = False
            self.note("task", "stopped")
        task.buffer.clear()

    def read_samples(self, task: Task, n: int) -> list[Sample]:
        """Wait for n samples and return them; fewer when the task has stopped."""
        if n < 1:
            raise LibraryError(-321)
        if n > task.room:
            raise LibraryError(-159)
        with self.lock:
            self.reads += 1
            for _ in range(stand_in.current.late.get(self.reads, 0) if stand_in.current.clock == "steps" else 0):
                self.advance(task.due if task.running else self.time)
        while True:
            with self.lock:
                missing = n - len(task.buffer)
                if stand_in.current.clock == "steps" and task.running and missing > 0:
                    self.advance(task.due)
                else:
                    self.advance(self.now())
                self.refuse(io=stand_in.current.expired_refuses_reads)
                if task.failed:
                    raise LibraryError(-111)
                missing = n - len(task.buffer)
                if missing <= 0 or not task.running:
                    return [task.buffer.popleft() for _ in range(min(n, len(task.buffer)))]
                wait = (task.due + (missing - 1) * task.period - self.now()) * 1e-9
            if stand_in.current.clock == "monotonic":
                time.sleep(min(max(wait, 0.0), WAKE))

    # --- watchdog

    def start_watchdog(self, timeout: float) -> None:
        """Start or restart the timer."""
        if not timeout > 0:
            raise LibraryError(-607)
        self.watchdog.timeout = _ns(timeout)
        self.watchdog.expires = None if self.watchdog.expired else self.time + self.watchdog.timeout
        self.note("watchdog", "started", timeout)

    def reload_watchdog(self) -> bool:
        """Restart the time; False after expiry."""
        if self.watchdog.expires is not None:
            self.watchdog.expires = self.time + self.watchdog.timeout
        return not self.watchdog.expired

    def clear_watchdog(self) -> None:
        """Allow access again; the timer goes on if it had not been stopped."""
        watchdog = self.watchdog
        if watchdog.expired:
            watchdog.expired = False
            self.note("watchdog", "cleared")
            if watchdog.timeout:
                watchdog.expires = self.time + watchdog.timeout
            if stand_in.current.clear_restores_outputs and watchdog.before:
                self.set_outputs(*watchdog.before)

    def stop_watchdog(self) -> None:
        """Stop the timer; an expiry stays."""
        self.watchdog.expires, self.watchdog.timeout = None, 0
        self.note("watchdog", "stopped")


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
