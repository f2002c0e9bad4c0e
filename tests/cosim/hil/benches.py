"""The real driver on its stand-in and the simulated device in lockstep, tick by tick the same.

What a device did is taken from its own record, never from the loop's log.
"""

from __future__ import annotations

import numpy as np

from cosim.hil.faults import parse
from cosim.hil.quanser import QuanserDevice
from cosim.hil.simulated import Board, SimulatedDevice

PERIOD = 1e-3
FIRST = 2e-3
"""Time of the stand-in's board at tick 0: one immediate reading, one period."""


class StandIn:
    """The real driver on the stand-in for the vendor's package."""

    def __init__(self, stand_in, changes):
        stand_in.configure(clock="steps", **changes)
        self.stand_in = stand_in
        self.device = QuanserDevice()

    def voltages(self):
        """Return (tick, voltage at the motor) of each change."""
        on, volts, changes = 0, 0.0, []
        for event in self.stand_in.record:
            if event.what == "AO0":
                volts = event.values[0]
            elif event.what == "DO0":
                on = event.values[0]
            else:
                continue
            changes.append((round((event.t - FIRST) / PERIOD), on * volts))
        return changes

    def check_off(self):
        """Assert that voltage and amplifier were off when the board was given back."""
        assert self.stand_in.history("AO0")[-1].values == [0.0]
        assert self.stand_in.history("DO0")[-1].values == [0]
        assert self.stand_in.history("close")[-1].values == [0.0, 0]


class Simulated:
    """The simulated device in lockstep."""

    def __init__(self, plant, script):
        self.board = Board(plant, parse(script))
        self.device = SimulatedDevice(self.board, real_time=False)

    def voltages(self):
        """Return (tick, voltage at the motor) of each event."""
        return [(round(event.time / PERIOD), event.voltage) for event in self.board.record]

    def check_off(self):
        """Assert that voltage and amplifier were off when the board was closed, by a stop or by its own cut."""
        *_, before, last = self.board.record
        assert last[1:] == ("close", 0.0)
        assert before.what.startswith(("stop: ", "cut: "))
        assert before.voltage == 0.0


def on_board(tick):
    """Return the time of the stand-in's board at a tick [s]."""
    return round(FIRST / PERIOD + tick) / 1000


def at(tick):
    """Return the part of a script that says when [s]."""
    return f"@{tick / 1000}"


def calls(device, tick, action):
    """Let `action` happen while the device is read for the sample of `tick`."""
    read = device.read

    def reading(timeout):
        sample = read(timeout)
        if sample.tick == tick:
            action()
        return sample

    device.read = reading


def last_tick(report):
    return round(report.result.time[-1] / PERIOD)


def check_stopped(bench, zero_at):
    """Assert that the motor had a voltage until the tick `zero_at`, then 0 V to the end, and the amplifier off."""
    record = bench.voltages()
    zeros = len(record)
    while record[zeros - 1][1] == 0.0:
        zeros -= 1
    assert record[zeros][0] == zero_at
    bench.check_off()


def check_log(report, ticks):
    """Assert that the log has each tick up to the event, and how the run ended."""
    assert np.round(report.result.time / PERIOD).tolist() == list(ticks)
    told = report.result.metadata["hil"]
    assert (told["reason"], told["stop"]) == (report.reason, report.stop)
    assert told["failures"] == list(report.failures)
    assert report.result.metadata["complete"] == (report.stop == "complete")
