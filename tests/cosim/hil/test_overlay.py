"""A run re-simulated from where its log begins."""

import math

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil.overlay import FIT_TIME, as_seen, differences, resimulate, start_state
from cosim.hil.scaling import RESOLUTION
from cosim.metrics import angle_norm
from cosim.results import Result
from tests.cosim.hil.rig import lockstep, one_sentence, run

STATE = {"theta_0": 0.2, "theta_dot_0": -3.0, "delta_0": -math.pi + 0.4, "delta_dot_0": 2.0}


@pytest.fixture(scope="module")
def log(fmus, tmp_path_factory):
    return run(lockstep(fmus), fmus, tmp_path_factory.mktemp("log"), 3.0).result


@pytest.fixture
def both(fmus):
    return fmus / "QubeServo2.fmu", fmus / "IhcController.fmu"


def motion(begin=0.0, *, counted=False, duration=0.2):
    """A log whose angles are cubic in time from `begin` on, with `STATE` there; counted or exact."""
    time = np.arange(round(duration * 1000) + 1) * 1e-3
    t = time - begin
    signals = {}
    for short in ("theta", "delta"):
        angle = STATE[f"{short}_0"] + STATE[f"{short}_dot_0"] * t + 20.0 * t**2 - 100.0 * t**3
        signals[f"plant.{short}_encoder"] = RESOLUTION * np.round(angle / RESOLUTION) if counted else angle
    return Result(time, signals, dict.fromkeys(signals, "rad"), {})


@pytest.mark.parametrize("begin", [0.0, 0.1])
def test_a_cubic_motion_is_recovered(begin):
    assert start_state(motion(begin), begin) == pytest.approx(STATE, abs=1e-9)


def test_a_counted_motion_is_recovered_within_the_counts():
    found = start_state(motion(counted=True), 0.0)
    for name, value in STATE.items():
        assert found[name] == pytest.approx(value, abs=0.3 if "dot" in name else RESOLUTION)


def test_only_the_stretch_after_the_beginning_counts():
    log = motion(0.1)
    log["plant.theta_encoder"][:100] = 77.0
    log["plant.theta_encoder"][100 + round(FIT_TIME * 1000) + 1 :] = -77.0
    assert start_state(log, 0.1) == pytest.approx(STATE, abs=1e-9)


@pytest.mark.parametrize("begin", [0.198, 0.2, 5.0])
def test_too_short_a_rest_is_a_user_error(begin):
    with pytest.raises(UserError, match=r"0\.05 s") as caught:
        start_state(motion(), begin)
    one_sentence(caught.value)


def test_a_log_without_rows_has_no_start():
    log = motion()
    with pytest.raises(UserError):
        start_state(Result(log.time[:0], {n: s[:0] for n, s in log.signals.items()}, log.units, {}), 0.0)


def test_a_simulated_device_lies_on_its_simulation(log, both):
    measured, simulated = resimulate(log, both, "ident")
    np.testing.assert_array_equal(measured.time, log.time)
    np.testing.assert_allclose(simulated.time, measured.time, atol=1e-12)
    second = measured.time <= 0.5
    for name in ("plant.theta_encoder", "plant.delta_encoder"):
        assert np.max(np.abs(simulated[name] - measured[name])[second]) < math.radians(3.0)
        assert np.ptp(measured[name][second]) > math.radians(3.0)


def test_the_passive_pendulum_of_a_log_is_met_from_the_middle(log, both):
    measured, simulated = resimulate(log, both, "ident", begin=0.7)
    assert measured.time[0] == simulated.time[0] == 0.0
    assert len(measured.time) == len(simulated.time) == 2301
    for name in ("plant.theta_encoder", "plant.delta_encoder"):
        assert simulated[name][0] == pytest.approx(log[name][700], abs=2.5 * RESOLUTION)
        np.testing.assert_array_equal(measured[name], log[name][700:])


def test_other_parameters_lie_further_away(log, both):
    own, other = (differences(*resimulate(log, both, name)) for name in ("ident", "hcs"))
    assert set(own) == {"plant.theta_encoder", "plant.delta_encoder", "controller.voltage"}
    assert all(math.isfinite(value) and value >= 0.0 for value in own.values())
    assert own["plant.theta_encoder"] != other["plant.theta_encoder"]


def test_the_metadata_says_which_parameters(log, both):
    _, simulated = resimulate(log, both, "ident", begin=2.5)
    assert simulated.metadata["overlay"]["parameters"] == "ident"
    start = simulated.metadata["start_values"]
    assert start["controller"] == log.metadata["start_values"]["controller"]
    assert start["plant"]["theta_encoder_offset"] == start["plant"]["delta_encoder_offset"] == 0.5


def test_progress_is_told(log, both):
    told = []
    resimulate(log, both, "ident", 2.5, lambda done, total: told.append((done, total)))
    assert told[-1] == (500, 500)


@pytest.mark.parametrize("begin", [2.9999, 3.0, 3.1, 1e9, 2.998])
def test_a_beginning_too_late_is_a_user_error(log, both, begin):
    with pytest.raises(UserError) as caught:
        resimulate(log, both, "ident", begin=begin)
    assert "ends at 3 s" in one_sentence(caught.value)


@pytest.mark.parametrize("metadata", [{}, {"step": 1e-3}, {"start_values": {}, "step": 1e-3}, {"start_values": None}])
def test_a_log_without_start_values_is_a_user_error(log, both, metadata):
    with pytest.raises(UserError) as caught:
        resimulate(Result(log.time, log.signals, log.units, metadata), both, "ident")
    one_sentence(caught.value)


def test_unknown_parameters_are_a_user_error(log, both):
    with pytest.raises(UserError):
        resimulate(log, both, "idnet")


def test_missed_rows_are_compared_at_their_own_times(fmus, tmp_path, both):
    gaps = run(lockstep(fmus, "late@0.2=4,late@0.3=3"), fmus, tmp_path, 0.5).result
    measured, simulated = resimulate(gaps, both, "ident")
    assert len(measured.time) == 501 - 7
    assert len(simulated.time) == 501
    picked = np.round(measured.time * 1000).astype(int)
    same = Result(measured.time, {n: s[picked] for n, s in simulated.signals.items()}, simulated.units, {})
    assert set(differences(same, simulated).values()) == {0.0}


def test_differences_of_the_pendulum_know_no_turns(made_result):
    time = np.arange(5) * 1e-3
    signals = {"plant_theta_encoder": 0.0, "controller_voltage": 1.0}
    a = made_result(time, plant_delta_encoder=0.1, **signals)
    b = made_result(time, plant_delta_encoder=0.1 + 4.0 * math.pi, **{**signals, "controller_voltage": 3.0})
    found = differences(a, b)
    assert found["plant.delta_encoder"] == pytest.approx(0.0, abs=1e-12)
    assert found["controller.voltage"] == 2.0


def test_a_simulation_is_compared_as_an_encoder_sees_it(made_result):
    angles = {"plant_theta_encoder": 0.1, "plant_delta_encoder": -0.2}
    simulated = made_result([0.0, 1.0], **angles)
    log = made_result([0.0, 1.0], **angles)
    for name in ("plant.theta", "plant.delta"):
        del log.signals[name]
    seen = as_seen(simulated, log)
    assert list(seen.signals) == [name for name in simulated.signals if name not in ("plant.theta", "plant.delta")]
    assert angle_norm(seen)[0] == pytest.approx(math.hypot(0.1, -0.2), rel=1e-12)
