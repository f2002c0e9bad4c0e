"""A run: the same as the simulation, logged, and at 0 V at its end however it ends."""

import gc
import math
import os
import signal
import threading

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil.device import DeviceError, LinkLostError, UnavailableError
from cosim.hil.loop import Loop, stop_signals, timing
from cosim.hil.replay import replay
from cosim.hil.simulated import HOLD, SimulatedDevice
from cosim.scenario_run import run_scenario
from cosim.scenario_system import build_system
from tests.cosim.hil.rig import (
    Between,
    at_rest,
    board_of,
    lockstep,
    loop_of,
    one_sentence,
    parts,
    run,
    scenario_of,
    settings_of,
)

SQUARE = {"kind": "square", "input": "controller.theta_setpoint", "amplitude": 0.2, "period": 0.5}
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.fixture
def handlers():
    """Assert that the handlers are afterwards what they were before."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    assert {number: signal.getsignal(number) for number in SIGNALS} == before


def about(report):
    return report.result.metadata["hil"]


# The same as the simulation


@pytest.mark.parametrize(
    ("duration", "step", "changes"),
    [
        (8.0, 1e-3, {}),  # swing-up, capture, balance
        (1.5, 2e-3, {}),
        (1.0, 5e-4, {"run__seed": 7}),
        (1.5, 1e-3, {"controller__start__velocity_source": "kalman"}),
        (1.5, 1e-3, {"run__seed": None, "plant__parameters": "hcs"}),
        (3.0, 2e-3, {"signals": [{**SQUARE, "start": 2.2}]}),
    ],
    ids=["all", "500 Hz", "2 kHz", "kalman", "hcs", "square wave"],
)
def test_in_lockstep_a_run_is_the_simulation_to_the_last_bit(fmus, tmp_path, duration, step, changes):
    scenario, folder = scenario_of(duration, step, **changes)
    simulation = run_scenario(scenario, fmus, folder)
    system = build_system(scenario, fmus, folder)
    device = lockstep(fmus, duration=duration, step=step, **changes)
    settings = settings_of(duration, 1.0 / step)
    loop = Loop(device, system.components[0], settings, tmp_path / "run", signals=system.signals)
    report = loop.run()
    loop.log.discard()
    assert (report.stop, report.failures) == ("complete", ())
    assert report.result.time.tobytes() == simulation.time.tobytes()
    common = [name for name in simulation.signals if name in report.result.signals]
    assert {"controller.voltage", "controller.mode", "plant.theta_encoder", "plant.delta_encoder"} <= set(common)
    driven = {"controller.theta_setpoint"} & simulation.signals.keys()
    assert len(common) == 12 + len(driven)
    assert driven <= set(common)
    for name in common:
        np.testing.assert_array_equal(report.result[name], simulation[name], err_msg=name)
        assert report.result.units[name] == simulation.units[name]
    if duration > 6.0:
        assert set(np.unique(report.result["controller.mode"])) == {1, 2, 3}
    for name in driven:
        assert set(np.unique(report.result[name])) == {-0.2, 0.0, 0.2}


def test_the_rehearsal_has_the_signals_extremes_before_the_device_is_opened(fmus, tmp_path):
    device, rehearsed = Between(lockstep(fmus)), []
    pulse = {"kind": "pulse", "input": SQUARE["input"], "value": 0.2, "time": 0.05, "width": 0.01}
    scenario, folder = scenario_of(0.1, signals=[pulse])
    system = build_system(scenario, fmus, folder)
    loop = Loop(device, system.components[0], settings_of(0.1), tmp_path / "run", signals=system.signals)
    command = loop.controller.command

    def noted(theta, delta, number):
        rehearsed.append((theta, delta, number, list(device.calls)))
        return command(theta, delta, number)

    loop.controller.command = noted
    assert loop.run().stop == "complete"
    loop.log.discard()
    assert rehearsed[:3] == [(0.0, -math.pi, number, []) for number in (0, 0, 50)]
    assert all(calls for *_, calls in rehearsed[3:])


@pytest.mark.parametrize(
    ("section", "problem"),
    [
        ({"amplitude": 1.6}, r"theta_setpoint must stay within ±90°.*, found 92° at 0 s"),
        ({"amplitude": 1e308, "mean": 1e308}, r"theta_setpoint must be finite, found inf at 0 s"),
        ({"input": "controller.theta"}, r"controller\.theta must have one source"),
        ({"input": "controller.voltage"}, r"controller\.voltage is an output of type Real"),
        ({"input": "controller.theta_setpiont"}, r"no variable named 'theta_setpiont'"),
    ],
    ids=["beyond the arm's bounds", "infinite", "measured", "an output", "unknown"],
)
def test_a_signal_that_may_not_be_is_refused_before_the_device_is_touched(fmus, tmp_path, section, problem):
    device = Between(lockstep(fmus))
    scenario, folder = scenario_of(0.5, signals=[{**SQUARE, **section}])
    system = build_system(scenario, fmus, folder)
    with pytest.raises(UserError, match=problem) as caught:
        Loop(device, system.components[0], settings_of(0.5), tmp_path / "run", signals=system.signals)
    one_sentence(caught.value)
    assert (device.calls, list(tmp_path.glob("*.rows"))) == ([], [])


def test_a_result_says_what_it_was(fmus, tmp_path):
    report = run(lockstep(fmus), fmus, tmp_path, 0.1)
    metadata = report.result.metadata
    assert metadata["complete"]
    assert metadata["order"] == "controller-first"
    assert (metadata["step"], metadata["every"]) == (1e-3, 1)
    assert metadata["fmus"]["controller"]["file"] == "IhcController.fmu"
    assert metadata["start_values"]["controller"]["sample_time"] == 1e-3
    assert about(report)["device"] == "simulated device"
    assert about(report)["limits"]["peak_current"] == 2.0
    assert (about(report)["stop"], about(report)["reason"]) == ("complete", report.reason)
    assert set(about(report)["timing"]) == {"lateness", "latency", "step_time"}
    report.result.save(tmp_path / "run.csv")


@pytest.mark.parametrize("duration", [0.001, 0.25])
def test_rows_are_as_in_a_simulation(fmus, tmp_path, duration):
    device = Between(lockstep(fmus))
    result = run(device, fmus, tmp_path, duration).result
    steps = round(duration * 1000)
    np.testing.assert_array_equal(result.time, np.arange(steps + 1) * 1e-3)
    assert result["hil.steps"].tolist() == [1] * steps + [0]
    assert not result["hil.missed"].any()
    assert result["hil.latency"][-1] == result["hil.step_time"][-1] == 0.0
    assert (result["hil.latency"][:-1] > 0.0).all()
    # a row's voltage is the one in force until it
    assert result["controller.voltage"][0] == result["hil.applied_voltage"][0] == 0.0
    np.testing.assert_array_equal(result["hil.applied_voltage"][1:], np.negative(device.voltages))
    np.testing.assert_array_equal(result["controller.voltage"], result["hil.applied_voltage"])


def test_the_checks_before_are_not_in_the_log(fmus, tmp_path):
    report = run(lockstep(fmus), fmus, tmp_path, 0.2, still=0.1, sign_test=True)
    assert report.stop == "complete"
    assert len(report.result.time) == 201
    assert report.result.time[0] == 0.0
    assert not report.result["hil.missed"].any()


def test_stages_are_said(fmus, tmp_path):
    said = []
    controller, _ = parts(fmus, 0.01)
    loop = Loop(
        lockstep(fmus),
        controller,
        settings_of(0.01, still=0.01, sign_test=True),
        tmp_path / "run",
        {"scenario": {"name": "x"}},
        said.append,
    )
    report = loop.run()
    loop.log.discard()
    assert [text.split()[0] for text in said] == ["the", "sign", "running"]
    assert report.result.metadata["scenario"] == {"name": "x"}


def test_the_file_stays_until_the_result_is_safe(fmus, tmp_path):
    loop = loop_of(lockstep(fmus), fmus, tmp_path, 0.01)
    loop.run()
    assert loop.log.path == tmp_path / "run.rows"
    assert loop.log.path.exists()
    loop.log.discard()


# Ends


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
    notes = about(report)["environment"]
    assert len(notes) == 2
    obtained = notes[0].startswith("real-time scheduling")
    assert {policy for _, policy in during} == {os.SCHED_FIFO if obtained else before[0]}
    at_rest(device.device.board)


def test_lockstep_asks_for_no_scheduling(fmus, tmp_path):
    assert about(run(lockstep(fmus), fmus, tmp_path, 0.01, real_time=True))["environment"] == []


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


def test_timing_is_of_the_rows_that_stepped(made_result):
    result = made_result(
        [0.0, 1.0, 2.0],
        hil_steps=[1, 1, 0],
        hil_lateness=[1e-6, 2e-6, 3e-6],
        hil_latency=[5e-6, 7e-6, 0.0],
        hil_step_time=[4e-6, 6e-6, 0.0],
    )
    found = timing(result)
    assert found["lateness"]["max"] == 3e-6
    assert found["latency"]["p50"] == pytest.approx(6e-6)
    assert found["step_time"]["p50"] == pytest.approx(5e-6)


@pytest.mark.parametrize(("late", "steps"), [(1, 2), (3, 4), (30, 11)])
def test_missed_samples_are_given_to_the_controller_afterwards(fmus, tmp_path, late, steps):
    device = lockstep(fmus, f"late@0.3={late}")
    if late * 1e-3 > HOLD:
        device.board.tick = lambda count=1, deaf=0: type(device.board).tick(device.board, count, count - 1)
    report = run(device, fmus, tmp_path, 0.5, stop_on_misses=False)
    assert report.stop == "complete"
    result = report.result
    row = int(np.flatnonzero(result["hil.missed"])[0])
    assert result["hil.steps"][row - 1 : row + 2].tolist() == [1, steps, 1]
    assert result["hil.missed"][row] == late
    assert replay(result, fmus / "IhcController.fmu").first is None
