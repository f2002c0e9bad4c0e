"""A log fed to the controller again gives its outputs to the last bit, and what was changed is replayed."""

from dataclasses import replace as changed

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil.loop import Loop
from cosim.hil.replay import replay
from cosim.results import Result
from cosim.scenario_run import run_scenario
from cosim.scenario_system import build_system
from tests.cosim.hil.rig import lockstep, one_sentence, run, scenario_of, settings_of


@pytest.fixture(scope="module")
def logs(fmus, tmp_path_factory):
    """Logs of runs by fault script, saved and loaded, each made once."""
    folder = tmp_path_factory.mktemp("logs")
    made = {}

    def make(script="", duration=1.0):
        if (script, duration) not in made:
            report = run(lockstep(fmus, script), fmus, folder, duration)
            report.result.save(folder / "run.csv")
            made[script, duration] = Result.load(folder / "run.csv")
        return made[script, duration]

    return make


@pytest.fixture
def fmu(fmus):
    return fmus / "IhcController.fmu"


def with_signal(result, name, row, value):
    signal = result[name].copy()
    signal[row] = value
    return Result(result.time, {**result.signals, name: signal}, result.units, result.metadata)


def with_metadata(result, **changes):
    kept = {k: v for k, v in {**result.metadata, **changes}.items() if v is not ...}
    return Result(result.time, result.signals, result.units, kept)


@pytest.mark.parametrize(
    ("script", "duration", "samples"),
    [
        ("", 1.0, 1000),
        ("", 7.0, 7000),
        ("arm-jump@0.2=500", 0.4, 399),
        ("arm-jump@0.2=500,pendulum-jump@0.3=-900,late@0.35=3", 0.4, 395),
        ("stall@0.1", 0.4, 400),
        ("amplifier-fault@0.2", 0.4, 200),
        ("late@0.2=20", 0.4, 201),
    ],
)
def test_a_log_is_replayed_exactly(logs, fmu, script, duration, samples):
    replayed = replay(logs(script, duration), fmu)
    assert replayed.first is None
    assert (replayed.samples, replayed.differing, replayed.same_fmu) == (samples, 0, True)


@pytest.mark.parametrize("changes", [{}, {"controller__start__velocity_source": "kalman"}, {"run__step": 2e-3}])
def test_a_simulations_result_from_its_file_is_replayed_exactly(fmus, fmu, tmp_path, changes):
    scenario, folder = scenario_of(2.0, **changes)
    run_scenario(scenario, fmus, folder).save(tmp_path / "run.csv")
    replayed = replay(Result.load(tmp_path / "run.csv"), fmu)
    assert replayed.first is None
    assert replayed.samples == round(2.0 / scenario.run.step)
    assert replayed.same_fmu


@pytest.mark.parametrize("script", [None, "", "arm-jump@0.2=500,pendulum-jump@0.3=-900,late@0.35=3"])
def test_a_run_with_a_signal_on_the_controller_is_replayed_with_it(fmus, fmu, tmp_path, script):
    """Of a simulation (None), and of a device that loses samples while the signal moves."""
    sines = {"kind": "sines", "input": "controller.theta_setpoint", "sines": [{"amplitude": 0.3, "frequency": 40.0}]}
    scenario, folder = scenario_of(0.4, signals=[sines])
    if script is None:
        result = run_scenario(scenario, fmus, folder)
    else:
        system, metadata = build_system(scenario, fmus, folder), {"scenario": scenario.model_dump(mode="json")}
        device = lockstep(fmus, script)
        loop = Loop(device, system.components[0], settings_of(0.4), tmp_path / "run", metadata, signals=system.signals)
        result = loop.run().result
        loop.log.discard()
    replayed = replay(result, fmu)
    assert (replayed.first, replayed.samples) == (None, 395 if script else 400)
    moved = replay(with_signal(result, "controller.theta_setpoint", 100, 0.0), fmu)
    assert moved.first is not None
    assert moved.first.time == result.time[100]
    less = changed(result, signals={n: s for n, s in result.signals.items() if n != "controller.theta_setpoint"})
    with pytest.raises(UserError, match=r"no signal 'controller\.theta_setpoint'"):
        replay(less, fmu)


@pytest.mark.parametrize("row", [1, 500, 1000])
def test_a_changed_voltage_is_found_where_it_is(logs, fmu, row):
    log = logs()
    value = np.nextafter(log["controller.voltage"][row], 99.0)
    replayed = replay(with_signal(log, "controller.voltage", row, value), fmu)
    assert replayed.differing == 1
    first = replayed.first
    assert first is not None
    assert (first.time, first.name) == (log.time[row], "voltage")
    assert (first.logged, first.replayed) == (value, log["controller.voltage"][row])


def test_a_changed_mode_is_found(logs, fmu):
    replayed = replay(with_signal(logs(), "controller.mode", 700, 4), fmu)
    assert replayed.first is not None
    assert (replayed.differing, replayed.first.name, replayed.first.logged) == (1, "mode", 4)


def test_a_changed_measurement_shows_in_the_row_after(logs, fmu):
    log = logs()
    replayed = replay(with_signal(log, "plant.theta_encoder", 500, log["plant.theta_encoder"][500] + 0.1), fmu)
    assert replayed.first is not None
    assert replayed.first.time == log.time[501]
    assert replayed.differing > 1


def test_a_sign_of_zero_is_a_difference(logs, fmu):
    log = logs()
    assert log["controller.voltage"][0] == 0.0
    first = replay(with_signal(log, "controller.voltage", 0, -0.0), fmu).first
    assert first is not None
    assert (first.time, first.name) == (0.0, "voltage")


def test_another_start_value_shows(logs, fmu):
    log = logs()
    start = {"controller": {**log.metadata["start_values"]["controller"], "swing_up_energy_gain": 100.0}}
    replayed = replay(with_metadata(log, start_values=start), fmu)
    assert replayed.first is not None


def test_another_file_is_told(logs, fmu):
    log = logs()
    other = {"controller": {**log.metadata["fmus"]["controller"], "guid": "{other}"}}
    replayed = replay(with_metadata(log, fmus=other), fmu)
    assert (replayed.first, replayed.same_fmu) == (None, False)


@pytest.mark.parametrize("rows", [0, 1])
def test_a_log_without_a_sample_shows_nothing(logs, fmu, rows):
    log = logs()
    short = Result(log.time[:rows], {n: s[:rows] for n, s in log.signals.items()}, log.units, log.metadata)
    with pytest.raises(UserError, match=f"at least 2 rows, the log has {rows}"):
        replay(short, fmu)


@pytest.mark.parametrize(
    "metadata",
    [
        {"start_values": ...},
        {"start_values": {}},
        {"start_values": None},
        {"step": ...},
        {"fmus": ...},
        {"fmus": {"controller": {}}},
        {"order": "parallel"},
        {"order": ...},
        {"every": 2},
        {"every": ...},
        {"wires": [["plant.theta", "controller.theta"], ["plant.delta", "controller.delta"]]},
        {"start_values": {"controller": {"nonsense": 1.0}}},
        {"start_values": {"controller": {"sample_time": "fast"}}},
        {"step": 2e-3},
    ],
    ids=str,
)
def test_logs_that_cannot_be_replayed_are_user_errors(logs, fmu, metadata):
    with pytest.raises(UserError) as caught:
        replay(with_metadata(logs(), **metadata), fmu)
    one_sentence(caught.value)


@pytest.mark.parametrize(
    "name", ["plant.theta_encoder", "plant.delta_encoder", "controller.voltage", "controller.mode"]
)
def test_a_log_without_a_signal_is_a_user_error(logs, fmu, name):
    log = logs()
    less = changed(log, signals={n: s for n, s in log.signals.items() if n != name})
    with pytest.raises(UserError, match=name):
        replay(less, fmu)


def test_an_ideal_measurement_cannot_be_replayed(fmus, fmu):
    scenario, folder = scenario_of(0.1, plant__measurement="ideal")
    with pytest.raises(UserError, match="encoders"):
        replay(run_scenario(scenario, fmus, folder), fmu)


def test_another_fmu_is_a_user_error(logs, fmus):
    with pytest.raises(UserError):
        replay(logs(), fmus / "QubeServo2.fmu")
    with pytest.raises(UserError, match="does not exist"):
        replay(logs(), fmus / "nothing.fmu")
