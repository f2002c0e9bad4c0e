"""A simulated device: the plant FMU behind encoders, amplifier and digital inputs that can fail; in this process.

`Board` is the device itself, in its own time; it records what its amplifier does. `SimulatedDevice` reads it directly; the
device of another process (`udp`) has the same board behind a socket.
"""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from filing.files import write_file

from ..errors import UserError
from ..fmu import FmuError
from ..integration import opened
from ..structure import Component
from .device import (
    AMPLIFIER_FAULT,
    LED_STOPPED,
    STALL_DETECTED,
    STALL_ERROR,
    VOLTAGE_CUT,
    DeviceError,
    Led,
    LinkLostError,
    Sample,
)
from .faults import InjectedFault
from .scaling import COUNTS_PER_TURN, RESOLUTION, counts_of, hardware_voltage

HOLD = 0.02
"""A device that hears nothing for this long [s] cuts its voltage."""

HARD_LIMIT = 15.0
"""Range of the board's output [V]."""

_INPUTS = {"voltage": "V", "pendulum_torque": "N.m"}
_OUTPUTS = {"theta_encoder": "rad", "delta_encoder": "rad", "theta_dot": "rad/s", "current": "A"}
_DIGITAL = {"amplifier-fault": AMPLIFIER_FAULT, "stall": STALL_DETECTED, "stall-error": STALL_ERROR}


class Event(NamedTuple):
    """An entry of the board's own record: its time [s], what happened, and the voltage at the motor from then on [V]."""

    time: float
    what: str
    voltage: float


class Board:
    """The device in its own time: each `tick` is one period under the last command.

    The amplifier off is 0 V at the motor. Whatever has not been heard for HOLD cuts the voltage until `clear`. Raises
    UserError for a plant whose encoders are not the device's, and FmuError where the plant fails.
    """

    def __init__(self, plant: Component, faults: Sequence[InjectedFault] = ()) -> None:
        self.plant = opened("plant", Path(plant.path), plant.interface)
        for names, causality in ((_INPUTS, "input"), (_OUTPUTS, "output")):
            for name, unit in names.items():
                self.plant.require(name, causality, unit)
        self._start = self.plant.checked_start(plant.start)
        encoder = self.plant.variable("encoder_counts")
        declared = encoder.start or "0" if encoder.type in ("Integer", "Real") else "0"
        counts = self._start.get("encoder_counts", int(float(declared)))
        if counts != COUNTS_PER_TURN:
            raise UserError(f"a simulated device needs plant.start.encoder_counts = {COUNTS_PER_TURN}, found {counts}")
        self.faults = faults
        self.record: list[Event] = []
        self.sample = Sample()
        self.cut = ""  # why the voltage was cut, latched
        self.period = 0.0
        self.opened = False
        self._voltage, self._enabled, self.led = 0.0, False, LED_STOPPED
        self._command = 0.0, False, LED_STOPPED
        self._heard = False
        self._at_motor = 0.0
        self._silent_ticks = 0
        self._zero = (0, 0)

    def open(self) -> None:
        """Bring a pendulum at rest, 0 V, the amplifier off, the encoders at zero."""
        if self.opened:
            self.close()
        self.sample.tick = 0
        try:
            self.plant.start(self._start, 0.0, math.inf)
            self.plant.run()
        except FmuError:
            self.plant.close()
            raise
        (self._inputs,) = self.plant.ports(_INPUTS, "Set")
        (self._outputs,) = self.plant.ports(_OUTPUTS, "Get")
        self._step = self.plant.stepper()
        self.opened = True
        self.cut = ""
        self.plant.transfer([self._outputs])
        theta, delta = self._outputs.values[0], self._outputs.values[1]
        self._zero = (counts_of(theta), counts_of(delta))
        self._voltage, self._enabled, self._at_motor, self._heard = 0.0, False, 0.0, False
        self._note("open")

    def start(self, period: float) -> None:
        """Begin to sample: the sample of tick 0 is there."""
        self.period = period
        self.sample.tick = 0
        self._silent_ticks = 0
        self._note("start")
        self._measure()

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self.sample.tick * self.period

    def command(self, voltage: float, *, enabled: bool, led: Led) -> None:
        """Take a command for the ticks to come; refused with DeviceError while a fault says so."""
        if self.faults:
            if self._active("write-error"):
                raise DeviceError("the simulated device refused the voltage")
            if self._active("silent"):
                return
        self._command = voltage, enabled, led
        self._heard = True

    def tick(self, count: int = 1, deaf: int = 0) -> None:
        """Let `count` periods pass, of which the device itself could not hear in the last `deaf`: those are no silence."""
        for k in range(count):
            if self._heard:
                self._take_command()
            self._silent_ticks += k < count - deaf
            if self._silent_ticks * self.period > HOLD + 0.5 * self.period and not self.cut:
                self._cut("nothing heard")
            inputs = self._inputs.values
            inputs[0] = hardware_voltage(self._at_motor)
            if self.faults:
                inputs[1] = next((f.value for f in self.faults if f.kind == "push" and self._is_active(f)), 0.0)
            self.plant.transfer([self._inputs])
            self._step(self.sample.tick * self.period, self.period)
            self.sample.tick += 1
        self._measure()

    def silent(self) -> bool:
        """Whether nothing gets through now."""
        return self._active("silent")

    def refuse_to_read(self) -> None:
        """Raise DeviceError while a fault says so."""
        if self._active("read-error"):
            raise DeviceError("the simulated device could not be read")

    def late(self) -> int:
        """Return how many further periods pass before this tick's sample arrives."""
        return next((int(f.value) for f in self.faults if f.kind == "late" and self._begins(f)), 0)

    def safe_stop(self, reason: str) -> None:
        """0 V, amplifier off; also while a fault refuses commands from outside."""
        self._voltage, self._enabled, self.led, self._heard = 0.0, False, LED_STOPPED, False
        self._apply("command")
        self._note(f"stop: {reason}")

    def cut_voltage(self, reason: str) -> None:
        """0 V and amplifier off by the device's own decision, until it is opened anew."""
        if not self.cut:
            self._cut(reason)

    def close(self) -> None:
        """End the simulation of the plant."""
        if self.opened:
            self.opened = False
            self._note("close")
            self.plant.close()

    def save_record(self, path: Path) -> None:
        """Write the record as CSV: time [s], voltage at the motor [V], what happened."""
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(["time", "voltage", "what"])
        rows.writerows([repr(e.time), repr(e.voltage), e.what] for e in self.record)
        write_file(path, text.getvalue())

    def _take_command(self) -> None:
        """Let the last command act: from now on, as nothing has passed since it came."""
        self._heard = False
        self._silent_ticks = 0
        voltage, enabled, self.led = self._command
        if not math.isfinite(voltage):
            self._cut("a voltage that is not finite")
            return
        self._voltage = min(HARD_LIMIT, max(-HARD_LIMIT, voltage))
        if enabled != self._enabled:
            self._enabled = enabled
            self._note("amplifier on" if enabled else "amplifier off")
        self._apply("command")

    def _apply(self, what: str) -> None:
        at_motor = self._voltage if self._enabled and not self.cut else 0.0
        if at_motor != self._at_motor:
            self._at_motor = at_motor
            self._note(what)

    def _cut(self, reason: str) -> None:
        self.cut = reason
        self._voltage, self._enabled = 0.0, False
        self._apply("cut")
        self._note(f"cut: {reason}")

    def _note(self, what: str) -> None:
        self.record.append(Event(self.time, what, self._at_motor))

    def _is_active(self, fault: InjectedFault) -> bool:
        return fault.time - 0.5 * self.period <= self.time < fault.time + max(fault.duration, 0.5 * self.period)

    def _begins(self, fault: InjectedFault) -> bool:
        return abs(self.time - fault.time) < 0.5 * self.period

    def _active(self, kind: str) -> bool:
        return any(f.kind == kind and self._is_active(f) for f in self.faults)

    def _measure(self) -> None:
        self.plant.transfer([self._outputs])
        theta, delta, theta_dot, current = self._outputs.values
        s = self.sample
        s.arm = self._zero[0] - counts_of(theta)
        s.pendulum = counts_of(delta) - self._zero[1]
        s.tachometer = -theta_dot / RESOLUTION
        s.current = -current
        s.digital = VOLTAGE_CUT if self.cut else 0
        for fault in self.faults:
            if not self._is_active(fault):
                continue
            if fault.kind == "arm-jump":
                s.arm += int(fault.value)
            elif fault.kind == "pendulum-jump":
                s.pendulum += int(fault.value)
            elif fault.kind == "current":
                s.current = fault.value
            else:
                s.digital |= _DIGITAL.get(fault.kind, 0)


class SimulatedDevice:
    """A board in this process.

    In real time its clock is an absolute one: whoever reads late finds that the plant has moved on with the voltage held,
    and gets the newest sample.
    In lockstep each reading is one period later than the one before, however long it took.
    """

    name = "simulated device"

    def __init__(self, board: Board, *, real_time: bool = True) -> None:
        self.board, self.real_time = board, real_time
        self.counters: dict[str, int] = {}
        self._first = True
        self._stopped = False
        self._enabled = False
        self._period_ns = 0
        self._began = 0

    def open(self) -> None:
        """Take the board with the pendulum at rest."""
        try:
            self.board.open()
        except FmuError as error:
            raise DeviceError(str(error)) from None

    def start(self, period: float) -> None:
        """Start the clock; tick 0 is now."""
        self._period_ns = round(period * 1e9)
        self.board.start(period)
        self._first = True
        self._began = time.perf_counter_ns()
        self.board.sample.due = self._began

    def read(self, timeout: float) -> Sample:
        """Return the next sample, sleeping until it is due."""
        board, sample = self.board, self.board.sample
        if board.faults:
            board.refuse_to_read()
            if board.silent():
                self._wait_in_vain(timeout)
        if self._first:
            self._first = False
            return sample
        ticks, deaf = 1 + board.late(), 0
        if self.real_time:
            due = self._began + (sample.tick + ticks) * self._period_ns
            ahead = due - time.perf_counter_ns()
            if ahead > 0:
                time.sleep(ahead * 1e-9)
            behind = (time.perf_counter_ns() - due) // self._period_ns
            if behind > 0:
                ticks += behind
                due += behind * self._period_ns
                deaf = behind  # in the loop's process the device hears only while it is called
            sample.due = due
        try:
            board.tick(ticks, deaf)
        except FmuError as error:
            raise DeviceError(str(error)) from None
        if not self.real_time:
            sample.due = time.perf_counter_ns()
        return sample

    def write(self, voltage: float, led: Led) -> None:
        """Set the voltage from now on."""
        if self._stopped:
            raise DeviceError("the device has been stopped")
        self.board.command(voltage, enabled=self._enabled, led=led)

    def enable(self, on: bool) -> None:
        """Switch the amplifier with the next voltage."""
        self._enabled = on

    def safe_stop(self, reason: str) -> list[str]:
        """0 V and the amplifier off; unless nothing gets through, when the board's own hold has to do it."""
        self._stopped, self._enabled = True, False
        if self.board.silent():
            return ["the stop did not get through; the device cuts its voltage by itself"]
        self.board.safe_stop(reason)
        return []

    def close(self) -> list[str]:
        """Let the plant go."""
        if (
            self.board.opened and self.board.period and self.board.silent()
        ):  # what the board does without us, for its record
            self.board.tick(round(2 * HOLD / self.board.period))
        self.board.close()
        return []

    def _wait_in_vain(self, timeout: float) -> None:
        board = self.board
        for _ in range(max(1, round(timeout / board.period))):
            if self.real_time:
                time.sleep(board.period)
            board.tick()
            if not board.silent():
                return
        raise LinkLostError(f"nothing came from the device for {timeout:g} s")
