"""A run: the same as the simulation, and logged."""

import math

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil.loop import Loop, timing
from cosim.hil.replay import replay
from cosim.hil.simulated import HOLD
from cosim.scenario_run import run_scenario
from cosim.scenario_system import build_system
from tests.cosim.hil.rig import (
    Between,
    lockstep,
    loop_of,
    one_sentence,
    parts,
    run,
    scenario_of,
    settings_of,
)

SQUARE = {"kind": "square", "input": "controller.theta_setpoint", "amplitude": 0.2, "period": 0.5}


def told_by(report):
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
    assert told_by(report)["device"] == "simulated device"
    assert told_by(report)["limits"]["peak_current"] == 2.0
    assert (told_by(report)["stop"], told_by(report)["reason"]) == ("complete", report.reason)
    assert set(told_by(report)["timing"]) == {"lateness", "latency", "step_time"}
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


def test_timing_is_of_the_rows_that_stepped(made_result):
    result = made_result(
        [0.0, 1.0, 2.0],
        hil_steps=[1, 1, 0],
        hil_lateness=[1e-6, 2e-6, 3e-6],
        hil_latency=[5e-6, 7e-6, 0.0],
        hil_step_time=[4e-6, 6e-6, 0.0],
    )
    times = timing(result)
    assert times["lateness"]["max"] == 3e-6
    assert times["latency"]["p50"] == pytest.approx(6e-6)
    assert times["step_time"]["p50"] == pytest.approx(5e-6)


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
