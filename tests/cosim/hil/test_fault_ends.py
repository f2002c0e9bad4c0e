"""Signals, pendulums that fall and links that break, on the real driver with its stand-in and on the simulated device."""

from __future__ import annotations

import math
import os
import signal

import numpy as np
import pytest

from cosim.hil.guards import Limits
from cosim.hil.quanser import WATCHDOG
from cosim.hil.simulated import HOLD
from cosim.judged_signals import STABILIZING
from tests.cosim.hil.benches import (
    PERIOD,
    Simulated,
    StandIn,
    at,
    calls,
    check_log,
    check_stopped,
    last_tick,
    on_board,
)

T = 100
"""Tick of the event."""


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
    b = Simulated(components[1], f"late{at(T - 1)}=25")
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
