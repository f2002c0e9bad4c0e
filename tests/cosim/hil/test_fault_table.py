"""The table of faults and what follows them, on the real driver with its stand-in and on the simulated device."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from cosim.fmu import FmuError
from cosim.hil.controller import ControllerFmu
from cosim.hil.log import rows_of
from tests.cosim.hil.benches import (
    PERIOD,
    at,
    check_log,
    check_stopped,
    on_board,
)

T = 100
"""Tick of the event."""
END = 200
"""Tick at which a run ends where nothing else is said."""
ARM, PENDULUM = 0, 1
EARLY = 20
"""Tick at which the arm is still near its zero."""


# --- the controller


def fails_at(monkeypatch, call, action):
    """Replace the controller's command at its n-th call of the run, whose rehearsal comes before."""
    command, count, prepare = ControllerFmu.command, [0], ControllerFmu.prepare

    def replaced(self, theta, delta, number):
        count[0] += 1
        return action() if count[0] == call else command(self, theta, delta, number)

    def prepared(self):
        prepare(self)
        count[0] = 0

    monkeypatch.setattr(ControllerFmu, "command", replaced)
    monkeypatch.setattr(ControllerFmu, "prepare", prepared)


def raiser(error):
    def action():
        raise error

    return action


@pytest.mark.parametrize("voltage", [math.nan, math.inf, -math.inf, 15.1, -16.0])
def test_value_that_is_no_voltage(bench, run, monkeypatch, voltage):
    fails_at(monkeypatch, T + 1, lambda: voltage)
    b = bench()
    report = run(b)
    assert (report.stop, report.failures) == ("fault", ())
    assert f"the controller commands {voltage} V" in report.reason
    check_stopped(b, T)
    check_log(report, range(T + 1))


def test_fmu_error(bench, run, monkeypatch):
    fails_at(monkeypatch, T + 1, raiser(FmuError("controller: fmi2DoStep returned error")))
    b = bench()
    report = run(b)
    assert (report.stop, report.reason) == ("fault", "controller: fmi2DoStep returned error")
    check_stopped(b, T)
    check_log(report, range(T + 1))


def test_controller_that_gives_up(bench, run, monkeypatch):
    command = ControllerFmu.command

    def blind(self, theta, delta, number):
        return command(self, math.nan if number == T else theta, delta, number)

    monkeypatch.setattr(ControllerFmu, "command", blind)
    b = bench()
    report = run(b)
    assert report.stop == "fault"
    assert "the controller has given up" in report.reason
    check_stopped(b, T)
    check_log(report, range(T + 1))


@pytest.mark.parametrize("error", [RuntimeError("boom"), KeyError("boom"), MemoryError("boom"), SystemExit("boom")])
def test_exception_in_the_loop(bench, loop_of, monkeypatch, error):
    fails_at(monkeypatch, T + 1, raiser(error))
    b = bench()
    loop = loop_of(b.device)
    with pytest.raises(type(error), match="boom"):
        loop.run()
    check_stopped(b, T)
    _, _, rows = rows_of(loop.log.path.read_bytes(), loop.log.path)
    assert rows["tick"].tolist() == list(range(T + 1))


# --- the device: one table


@dataclass
class Case:
    """What goes wrong on either board; how the run ends, from which tick on the motor has 0 V, and the rows' ticks."""

    changes: dict[str, Any]
    script: str
    reason: str
    zero_at: int = T
    rows: list[int] = field(default_factory=lambda: list(range(T + 1)))
    settings: dict[str, Any] = field(default_factory=dict)


def inputs(channel, kind, reason):
    return Case({"digital_inputs": ((on_board(T), channel, 1),)}, kind + at(T), reason)


def current(amperes, reason, **more):
    return Case({"currents": ((on_board(T), 99.0, amperes),)}, f"current{at(T)}={amperes}:99", reason, **more)


def jump(channel, first, last, counts=500):
    """Return a change and a script: wrong counts from one tick to before another."""
    kind = ("arm", "pendulum")[channel]
    change = (on_board(first), on_board(last), channel, counts)
    return change, f"{kind}-jump{at(first)}={counts}:{(last - first - 0.5) / 1000}"


def jumps(channel, ticks, **more):
    change, script = jump(channel, T, T + ticks, **more)
    return {"encoder_errors": (change,)}, script


def ramp(channel, counts, steps, begin):
    """Return changes and a script: counts added tick by tick, slowly enough to be believed, for good."""
    both = [jump(channel, begin + i, 90_000, counts) for i in range(steps)]
    return {"encoder_errors": tuple(change for change, _ in both)}, ",".join(script for _, script in both)


def late(missed, times=1, every=20):
    """Return changes and a script: periods missed, before T first, then once more after each `every` samples."""
    changes = {T + 1 + every * i: missed + 1 for i in range(times)}
    script = ",".join(f"late{at(T - 1 + (every + missed) * i)}={missed}" for i in range(times))
    return {"late": changes}, script


SINGLE = [*range(T), *(T + 1 + 21 * i + k for i in range(10) for k in range(20)), T + 211]
"""Ticks of a run that loses the period of T and then every 21st, eleven in all."""

TABLE = {
    "DI0 amplifier fault": inputs(0, "amplifier-fault", "the amplifier reports a fault"),
    "DI2 stall error": inputs(2, "stall-error", "stalled too long"),
    "current above 2 A": current(2.01, r"current 2\.01 A, beyond 2 A"),
    "current below -2 A": current(-2.5, r"current 2\.50 A, beyond 2 A"),
    "current not a number": current(math.nan, "the current is not finite"),
    "current above 0.5 A for 3 s": current(
        0.7,
        r"current beyond 0\.5 A for 3 s",
        zero_at=T + 3000,
        rows=list(range(T + 3001)),
        settings={"duration": 3.5},
    ),
    "5 periods missed in a row": Case(*late(5), "5 periods missed in a row", zero_at=T + 5, rows=[*range(T), T + 5]),
    "more than 1 % missed within a second": Case(
        *late(1, times=11),
        "11 of 1000 periods missed within a second",
        zero_at=SINGLE[-1],
        rows=SINGLE,
        settings={"duration": 1.0},
    ),
    "arm's encoder jumps twice": Case(
        *jumps(ARM, 2), "two encoder readings in a row", zero_at=T + 1, rows=list(range(T + 2))
    ),
    "pendulum's encoder jumps for good": Case(
        *jumps(PENDULUM, 9000, counts=-300), "two encoder readings in a row", zero_at=T + 1, rows=list(range(T + 2))
    ),
    "arm beyond 120 degrees": Case(
        *ramp(ARM, 80, 9, EARLY), r"arm at -12\d°, beyond ±120°", zero_at=EARLY + 8, rows=list(range(EARLY + 9))
    ),
    "arm beyond -120 degrees": Case(
        *ramp(ARM, -80, 9, EARLY), r"arm at 12\d°, beyond ±120°", zero_at=EARLY + 8, rows=list(range(EARLY + 9))
    ),
    "voltage refused": Case(
        {"failures": {"write_analog": (T + 2, -843)}},
        f"write-error{at(T)}",
        "setting the voltage: .*-843|refused the voltage",
        rows=list(range(T + 1)),
    ),
    "reading fails": Case(
        {"failures": {"task_read": (T + 2, -843)}}, f"read-error{at(T)}", "reading: .*-843|could not be read"
    ),
}


@pytest.mark.parametrize("case", TABLE.values(), ids=TABLE)
def test_event_stops_the_run(bench, run, case):
    b = bench(case.changes, case.script)
    report = run(b, **case.settings)
    assert (report.stop, report.failures, report.signal) == ("fault", (), 0)
    assert re.search(case.reason, report.reason), report.reason
    check_stopped(b, case.zero_at)
    check_log(report, case.rows)


# --- events that a run survives


def test_duration_ends_at_0_volts(bench, run):
    b = bench()
    report = run(b, duration=T * PERIOD)
    assert (report.stop, report.reason, report.failures) == ("complete", "the duration is over", ())
    check_stopped(b, T)
    check_log(report, range(T + 1))


@pytest.mark.parametrize("channel", [ARM, PENDULUM])
def test_single_jump_is_dropped(bench, run, channel):
    b = bench(*jumps(channel, 1))
    report = run(b)
    told = report.result.metadata["hil"]
    assert (report.stop, told["dropped"]) == ("complete", 1)
    assert [*told["warnings"].values()] == [pytest.approx(T * PERIOD)]
    assert np.flatnonzero(report.result["hil.steps"] == 0).tolist() == [T, END]  # the last row is not answered
    for name in ("hil.applied_voltage", "controller.voltage"):
        assert report.result[name][T + 1] == report.result[name][T] != report.result[name][T + 2]
    changed = [tick for tick, _ in b.voltages()]
    assert (T - 1 in changed, T in changed, T + 1 in changed) == (True, False, True)  # the voltage is held


@pytest.mark.parametrize("apart", [2, 10])
def test_jumps_with_good_samples_between_are_dropped(bench, run, apart):
    both = [jump(ARM, T, T + 1), jump(ARM, T + apart, T + apart + 1)]
    b = bench({"encoder_errors": tuple(change for change, _ in both)}, ",".join(script for _, script in both))
    report = run(b)
    assert (report.stop, report.result.metadata["hil"]["dropped"]) == ("complete", 2)


def test_arm_beyond_90_degrees_is_a_warning(bench, run):
    b = bench(*ramp(ARM, 80, 7, EARLY))
    report = run(b, duration=(EARLY + 12) * PERIOD)
    assert report.stop == "complete"
    assert report.result.metadata["hil"]["warnings"] == {"arm beyond ±90°": pytest.approx((EARLY + 6) * PERIOD)}


def test_stall_limits_the_voltage(bench, run, monkeypatch):
    commanded = itertools.cycle((8.0, -8.0, 4.0))
    monkeypatch.setattr(ControllerFmu, "command", lambda *_: next(commanded))
    b = bench({"digital_inputs": ((on_board(T), 1, 1), (on_board(T + 50), 1, 0))}, f"stall{at(T)}=1:0.0495")
    report = run(b)
    assert report.stop == "complete"
    (warning,) = report.result.metadata["hil"]["warnings"].items()
    assert warning == ("motor stalled: voltage limited to 5 V", pytest.approx(T * PERIOD))
    size = {tick: abs(volts) for tick, volts in b.voltages() if 0 <= tick < END}
    assert {size[tick] for tick in range(1, T)} == {8.0, 4.0}
    assert {size[tick] for tick in range(T, T + 50)} == {5.0, 4.0}
    assert {size[tick] for tick in range(T + 50, END)} == {8.0, 4.0}


@pytest.mark.parametrize(("missed", "times"), [(4, 1), (1, 10)])
def test_few_missed_periods_are_counted(bench, run, missed, times):
    b = bench(*late(missed, times=times))
    report = run(b, duration=0.5)
    assert report.stop == "complete"
    assert report.result.metadata["hil"]["missed"] == missed * times
    assert np.sum(report.result["hil.missed"]) == missed * times
    assert len(report.result.time) == 501 - missed * times
    check_stopped(b, 500)


def test_missed_periods_can_be_a_warning(bench, run):
    b = bench(*late(8))
    report = run(b, stop_on_misses=False)
    assert report.stop == "complete"
    assert [*report.result.metadata["hil"]["warnings"].values()] == [pytest.approx((T + 8) * PERIOD)]


# --- the log


def test_voltages_of_the_log_are_the_devices(bench, run):
    b = bench()
    report = run(b, duration=T * PERIOD)
    logged = report.result["hil.applied_voltage"]
    record = dict(b.voltages())
    held = {}
    volts = 0.0
    for tick in range(T):
        volts = held[tick] = record.get(tick, volts)
    # a row has what was in force until it; the model's sign is the other one
    assert [-volts for volts in logged[1:]] == [held[tick] for tick in range(T)]
