"""The table of faults and what follows them, on the real driver with its stand-in and on the simulated device in lockstep.

What a device did is taken from its own record, never from the loop's log.
"""

from __future__ import annotations

import itertools
import math
import os
import re
import signal
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from cosim.fmu import FmuError
from cosim.hil.controller import ControllerFmu
from cosim.hil.faults import parse
from cosim.hil.guards import Limits
from cosim.hil.log import rows_of
from cosim.hil.loop import Loop
from cosim.hil.quanser import WATCHDOG, QuanserDevice
from cosim.hil.settings import Settings
from cosim.hil.simulated import HOLD, Board, SimulatedDevice
from cosim.judged_signals import STABILIZING
from cosim.scenario import load_scenario
from cosim.scenario_system import build_system

T = 100
"""Tick of the event."""
END = 200
"""Tick at which a run ends where nothing else is said."""
PERIOD = 1e-3
FIRST = 2e-3
"""Time of the stand-in's board at tick 0: one immediate reading, one period."""
ARM, PENDULUM = 0, 1
EARLY = 20
"""Tick at which the arm is still near its zero."""


class StandIn:
    """The real driver on the stand-in for the vendor's package."""

    def __init__(self, stand_in, changes):
        stand_in.configure(clock="steps", **changes)
        self.stand_in = stand_in
        self.device = QuanserDevice()

    def voltages(self):
        """Return (tick, voltage at the motor) of each change."""
        on, volts, found = 0, 0.0, []
        for event in self.stand_in.record:
            if event.what == "AO0":
                volts = event.values[0]
            elif event.what == "DO0":
                on = event.values[0]
            else:
                continue
            found.append((round((event.t - FIRST) / PERIOD), on * volts))
        return found

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


@pytest.fixture(scope="module")
def components(fmus):
    scenario, folder = load_scenario("device")
    return build_system(scenario, fmus, folder).components


@pytest.fixture(params=["stand-in", "simulated"])
def bench(request, components):
    """Make a device whose board has faults: a configuration of the stand-in, or a script; tick by tick the same."""

    def make(changes=None, script=""):
        if request.param == "stand-in":
            return StandIn(request.getfixturevalue("stand_in"), changes or {})
        return Simulated(components[1], script)

    return make


@pytest.fixture
def loop_of(components, tmp_path):
    """Make the loop of a device; its log goes at the end."""
    loops = []

    def make(device, duration=END * PERIOD, **settings):
        chosen = Settings(still=0.0, sign_test=False, real_time=False, duration=duration, **settings)
        loop = Loop(device, components[0], chosen, tmp_path / f"run{len(loops)}.csv")
        loops.append(loop)
        return loop

    yield make
    for loop in loops:
        loop.log.discard()


@pytest.fixture
def run(loop_of):
    """Run the loop on a bench and return its report."""
    return lambda bench, **settings: loop_of(bench.device, **settings).run()


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
    about = report.result.metadata["hil"]
    assert (about["reason"], about["stop"]) == (report.reason, report.stop)
    assert about["failures"] == list(report.failures)
    assert report.result.metadata["complete"] == (report.stop == "complete")


# --- signals


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_signal(bench, run, name):
    if not hasattr(signal, name):
        pytest.skip(f"no {name} here")
    number = getattr(signal, name)
    earlier = signal.getsignal(number)
    b = bench()
    calls(b.device, T, lambda: os.kill(os.getpid(), number))
    report = run(b)
    assert (report.stop, report.reason, report.signal) == ("signal", f"stopped by {name}", number)
    assert report.failures == ()
    check_stopped(b, T)
    check_log(report, range(T + 1))
    assert signal.getsignal(number) is earlier


def test_signal_while_the_device_must_rest(bench, loop_of):
    b = bench()
    loop = loop_of(b.device)
    object.__setattr__(loop.settings, "still", 0.5)
    calls(b.device, T, lambda: os.kill(os.getpid(), signal.SIGINT))
    report = loop.run()
    assert (report.stop, report.signal, len(report.result.time)) == ("signal", signal.SIGINT, 0)
    assert {volts for _, volts in b.voltages()} <= {0.0}


def test_second_signal_during_the_stop(bench, run):
    b = bench()
    calls(b.device, T, lambda: os.kill(os.getpid(), signal.SIGINT))
    stop = b.device.safe_stop

    def stopping(reason):
        os.kill(os.getpid(), signal.SIGINT)
        return stop(reason)

    b.device.safe_stop = stopping
    report = run(b)
    assert (report.stop, report.failures) == ("signal", ())
    check_stopped(b, T)


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
    about = report.result.metadata["hil"]
    assert (report.stop, about["dropped"]) == ("complete", 1)
    assert [*about["warnings"].values()] == [pytest.approx(T * PERIOD)]
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


# --- the pendulum falls

KICK = 2000
"""Tick at which the balanced pendulum is pushed."""


@pytest.fixture
def pushed(bench):
    """A bench on which the pendulum is captured, balanced and pushed over."""
    b = bench(script=f"push{at(KICK)}=0.03:0.02")

    def push():
        plant = b.stand_in.boards["0"].plant
        theta, delta, theta_dot, delta_dot, *rest = plant.x
        plant.x = (theta, delta, theta_dot, delta_dot + 4.6, *rest)

    if isinstance(b, StandIn):
        calls(b.device, KICK, push)
    return b


def test_pendulum_that_falls_ends_the_run(pushed, run):
    report = run(pushed, duration=2.5, on_fall="stop")
    assert (report.stop, report.failures) == ("fault", ())
    assert "the pendulum fell" in report.reason
    result = report.result
    assert result["controller.mode"][KICK] == STABILIZING
    check_stopped(pushed, last_tick(report))
    away = np.degrees(np.abs(np.remainder(result["plant.delta_encoder"] + math.pi, 2 * math.pi) - math.pi))
    assert away[KICK] < 5.0
    assert max(away[KICK:-1]) < 20.0 < away[-1] or result["controller.mode"][-1] != STABILIZING
    assert KICK < last_tick(report) < KICK + 100


def test_pendulum_that_falls_is_swung_up_again(pushed, run):
    report = run(pushed, duration=2.3, on_fall="swing-up", limits=Limits(arm=math.radians(360.0)))
    assert report.stop == "complete", report.reason
    mode = report.result["controller.mode"]
    assert mode[KICK] == STABILIZING
    assert 2 in mode[KICK:]
    check_stopped(pushed, 2300)


# --- the link


def test_unplugged_board_is_named(stand_in, components, loop_of):
    b = StandIn(stand_in, {"unplugged_at": on_board(T)})
    report = loop_of(b.device).run()
    assert report.stop == "fault"
    assert "not connected any more; check its USB cable" in report.reason
    assert [text.partition(":")[0] for text in report.failures[:2]] == ["setting 0 V", "switching the amplifier off"]
    assert all("-1029" in text for text in report.failures)
    check_log(report, range(T))
    (unplugged,) = stand_in.history("unplugged")
    assert b.voltages()[-1] == (T - 1, unplugged.values[0])  # the stand-in holds its outputs
    assert unplugged.values[0] != 0.0


def test_silent_device_cuts_its_voltage(components, loop_of):
    b = Simulated(components[1], f"silent{at(T)}")
    report = loop_of(b.device).run()
    assert report.stop == "fault"
    assert "nothing came from the device" in report.reason
    assert report.failures == ("the stop did not get through; the device cuts its voltage by itself",)
    check_stopped(b, T - 1 + round(HOLD / PERIOD))
    check_log(report, range(T + 1))


def test_silent_device_that_is_heard_again_stays_at_0_volts(components, loop_of):
    b = Simulated(components[1], f"silent{at(T)}=1:0.04")
    report = loop_of(b.device, stop_on_misses=False).run()
    assert (report.stop, report.failures) == ("fault", ())
    assert "the device cut its voltage by itself" in report.reason
    check_stopped(b, T - 1 + round(HOLD / PERIOD))


@pytest.mark.parametrize("restores", [False, True])
@pytest.mark.parametrize("refuses_reads", [False, True])
def test_expired_watchdog(stand_in, loop_of, refuses_reads, restores):
    changes = {"expired_refuses_reads": refuses_reads, "clear_restores_outputs": restores}
    b = StandIn(stand_in, {"late": {T + 1: 62}, **changes})
    report = loop_of(b.device).run()
    assert (report.stop, report.failures) == ("fault", ())
    assert ("watchdog expired" if refuses_reads else "61 periods missed in a row") in report.reason
    b.check_off()
    cut = T - 1 + round(WATCHDOG / PERIOD)
    assert (cut, 0.0) in b.voltages()
    stop = T + 61
    assert [tick for tick, volts in b.voltages() if tick >= cut and volts != 0.0] == []
    check_log(report, [*range(T)] if refuses_reads else [*range(T), stop])


def test_simulated_devices_own_hold(components, loop_of):
    b = Simulated(components[1], late(25)[1])
    report = loop_of(b.device, stop_on_misses=False).run()
    assert (report.stop, report.failures) == ("fault", ())
    assert "the device cut its voltage by itself" in report.reason
    check_stopped(b, T - 1 + round(HOLD / PERIOD))


def test_stop_that_fails_is_in_the_report(stand_in, loop_of):
    b = StandIn(stand_in, {"failures": {"task_stop": (1, -843, True)}})
    report = loop_of(b.device, duration=T * PERIOD).run()
    assert report.stop == "complete"
    (failure,) = report.failures
    assert failure.startswith("stopping the task: ")
    check_stopped(b, T)
    check_log(report, range(T + 1))


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
