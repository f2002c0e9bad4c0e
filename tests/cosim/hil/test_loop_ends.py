"""A run is at 0 V at its end, however it ends, and what it changed around it is as before.

The fault table has the ends that both devices have.
"""

import gc
import os
import signal
import threading

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil.device import DeviceError, LinkLostError, UnavailableError
from cosim.hil.loop import stop_signals
from cosim.hil.simulated import SimulatedDevice
from tests.cosim.hil.rig import (
    Between,
    at_rest,
    board_of,
    lockstep,
    loop_of,
    one_sentence,
    run,
)

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.fixture
def handlers():
    """Assert that the handlers are afterwards what they were before."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    assert {number: signal.getsignal(number) for number in SIGNALS} == before


def told_by(report):
    return report.result.metadata["hil"]


@pytest.mark.parametrize(
    ("script", "stop", "said"),
    [
        ("", "complete", "duration is over"),
        ("amplifier-fault@0.81", "fault", "amplifier"),
        ("silent@0.81", "fault", "nothing came"),
        ("write-error@0.81", "fault", "refused the voltage"),
        ("late@0.81=30", "fault", "30 periods missed"),
        ("push@0.81=1e300", "fault", "doStep"),
    ],
)
def test_however_a_run_with_its_checks_ends_the_motor_is_at_0_V(fmus, tmp_path, script, stop, said):
    """The fault table has the other ways to end; the checks last for 0.61 s."""
    device = lockstep(fmus, script)
    report = run(device, fmus, tmp_path, 0.4, still=0.1, sign_test=True)
    assert report.stop == stop
    assert said in one_sentence(report.reason)
    at_rest(device.board)
    assert device.board.record[-1].what == "close"
    assert report.result.metadata["complete"] == (stop == "complete")
    assert (len(report.result.time) == 401) == (stop == "complete")
    assert np.any(report.result["hil.applied_voltage"] != 0.0)
    if script.startswith("silent"):
        assert len(report.failures) == 1
    else:
        assert report.failures == ()
        assert device.board.record[-2].what == f"stop: {report.reason}"


@pytest.mark.parametrize(
    "script",
    [
        "amplifier-fault@0.05",
        "read-error@0.05",
        "write-error@0.05",
        "current@0.05=nan",
        "silent@0.05",
        "arm-jump@0.05=9",
    ],
)
def test_a_fault_in_the_checks_ends_the_run_before_it_began(fmus, tmp_path, script):
    device = Between(lockstep(fmus, script))
    report = run(device, fmus, tmp_path, 0.4, still=0.1, sign_test=True)
    assert report.stop == "fault"
    one_sentence(report.reason)
    assert len(report.result.time) == 0
    assert report.result.metadata["complete"] is False
    assert "on" not in device.calls
    assert set(device.voltages) <= {0.0}
    at_rest(device.device.board)


def test_the_stop_comes_last_and_once(fmus, tmp_path):
    for script in ("", "amplifier-fault@0.01", "read-error@0.01", "write-error@0.01"):
        device = Between(lockstep(fmus, script))
        run(device, fmus, tmp_path, 0.02)
        assert device.calls[:3] == ["open", "start", "on"]
        assert device.calls[-2:] == ["safe_stop", "close"]
        assert device.calls.count("safe_stop") == device.calls.count("close") == 1


def test_the_last_row_tells_why(fmus, tmp_path):
    report = run(lockstep(fmus, "amplifier-fault@0.2"), fmus, tmp_path, 0.4)
    assert report.result.time[-1] == 0.2
    assert report.result["hil.digital"][-1] == 1
    assert report.result["hil.steps"][-1] == 0
    report = run(lockstep(fmus, "current@0.2=3"), fmus, tmp_path, 0.4)
    assert report.result["plant.current"][-1] == -3.0


def test_a_last_sample_that_is_late_ends_the_run(fmus, tmp_path):
    report = run(lockstep(fmus, "late@0.398=4"), fmus, tmp_path, 0.4)
    assert report.stop == "complete"
    assert report.result.time[-1] > 0.4


@pytest.mark.parametrize("error", [ValueError("odd"), SystemExit(3)])
def test_an_error_of_the_program_stops_the_device_and_is_raised(fmus, tmp_path, error, handlers):
    def fail(n, sample):
        if n == 100:
            raise error

    device = Between(lockstep(fmus), fail)
    loop = loop_of(device, fmus, tmp_path, 0.4)
    with pytest.raises(type(error)) as caught:
        loop.run()
    assert caught.value is error
    at_rest(device.device.board)
    assert device.calls[-2:] == ["safe_stop", "close"]
    assert loop.log.rows == 100  # the log is kept
    assert loop.log.path.exists()
    loop.log.discard()


@pytest.mark.parametrize("error", [DeviceError("broken"), LinkLostError("gone"), UserError("wrong")])
def test_an_error_of_the_device_is_the_reason(fmus, tmp_path, error):
    def fail(n, sample):
        if n == 100:
            raise error

    device = Between(lockstep(fmus), fail)
    report = run(device, fmus, tmp_path, 0.4)
    assert (report.stop, report.reason) == ("fault", str(error))
    assert len(report.result.time) == 100
    at_rest(device.device.board)


# Signals


def test_a_signal_from_elsewhere_ends_a_run_in_real_time(fmus, tmp_path, handlers):
    device = SimulatedDevice(board_of(fmus))
    timer = threading.Timer(0.15, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    report = run(device, fmus, tmp_path, 20.0, 200.0, stop_on_misses=False)
    timer.join()
    assert report.stop in ("signal", "fault")  # a stall of the machine beyond the hold time is a fault
    if report.stop == "signal":
        assert report.signal == signal.SIGINT
    at_rest(device.board)


def test_the_first_of_two_signals_counts_and_a_fault_counts_more(fmus, tmp_path, handlers):
    def both(n, sample):
        if n == 100:
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGINT)

    report = run(Between(lockstep(fmus), both), fmus, tmp_path, 0.4)
    assert report.stop == "signal"
    assert report.signal in (signal.SIGTERM, signal.SIGINT)  # delivered together, in the order of their numbers
    report = run(Between(lockstep(fmus, "amplifier-fault@0.1"), both), fmus, tmp_path, 0.4)
    assert (report.stop, report.signal) == ("fault", 0)


def test_signals_are_only_collected(handlers):
    with stop_signals() as received:
        for number in SIGNALS:
            os.kill(os.getpid(), number)
        assert received == SIGNALS


# Around a run


def test_collection_and_scheduling_are_as_before(fmus, tmp_path):
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, gc.isenabled(), gc.get_freeze_count()
    during = []
    device = Between(
        SimulatedDevice(board_of(fmus)), lambda n, sample: during.append((gc.isenabled(), os.sched_getscheduler(0)))
    )
    report = run(device, fmus, tmp_path, 0.05, 200.0, real_time=True, stop_on_misses=False)
    after = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, gc.isenabled(), gc.get_freeze_count()
    assert after == before
    assert not any(enabled for enabled, _ in during)
    notes = told_by(report)["environment"]
    assert len(notes) == 2
    obtained = notes[0].startswith("real-time scheduling")
    assert {policy for _, policy in during} == {os.SCHED_FIFO if obtained else before[0]}
    at_rest(device.device.board)


def test_lockstep_asks_for_no_scheduling(fmus, tmp_path):
    assert told_by(run(lockstep(fmus), fmus, tmp_path, 0.01, real_time=True))["environment"] == []


def test_collection_that_was_off_stays_off(fmus, tmp_path):
    gc.disable()
    try:
        run(lockstep(fmus), fmus, tmp_path, 0.01)
        assert not gc.isenabled()
    finally:
        gc.enable()


@pytest.mark.parametrize("error", [UnavailableError("not there"), DeviceError("broken"), OSError("odd")])
def test_a_device_that_cannot_be_opened_leaves_no_log(fmus, tmp_path, error, handlers):
    class Missing(Between):
        def open(self):
            raise error

    device = Missing(lockstep(fmus))
    loop = loop_of(device, fmus, tmp_path, 0.4)
    with pytest.raises(type(error)) as caught:
        loop.run()
    assert caught.value is error
    assert not list(tmp_path.iterdir())
    assert device.calls == ["close"]


def test_a_plant_that_cannot_begin_leaves_no_log(fmus, tmp_path):
    loop = loop_of(
        lockstep(
            fmus, plant__start__J_p=1e-12, plant__start__J_r=1e-12, plant__start__m_p=1.0, controller__other_model=True
        ),
        fmus,
        tmp_path,
        0.4,
    )
    with pytest.raises(DeviceError) as caught:
        loop.run()
    one_sentence(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_device_that_cannot_start_is_stopped(fmus, tmp_path):
    class Lame(Between):
        def start(self, period):
            raise DeviceError("no clock")

    device = Lame(lockstep(fmus))
    report = run(device, fmus, tmp_path, 0.4)
    assert (report.stop, report.reason) == ("fault", "no clock")
    at_rest(device.device.board)
