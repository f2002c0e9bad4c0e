"""A run re-simulated from where its log begins."""

import math

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil.overlay import alike, as_seen, resimulate
from cosim.hil.replay import MEASURED
from cosim.hil.scaling import RESOLUTION
from cosim.judged_signals import angle_norm
from cosim.overlay import differences
from cosim.results import Result
from tests.cosim.hil.rig import lockstep, one_sentence, run


@pytest.fixture(scope="module")
def log(fmus, tmp_path_factory):
    return run(lockstep(fmus), fmus, tmp_path_factory.mktemp("log"), 3.0).result


@pytest.fixture
def both(fmus):
    return fmus / "QubeServo2.fmu", fmus / "IhcController.fmu"


@pytest.fixture(scope="module")
def long_log(fmus, tmp_path_factory):
    return run(lockstep(fmus, plant__start__delta_encoder_offset=0.9), fmus, tmp_path_factory.mktemp("log"), 6.0).result


def test_a_perfect_model_lies_on_the_device_but_for_the_counts(long_log, both):
    """The encoder was zeroed near the end of a count; centred, the arm's angle would be 7 counts off.

    The first sample of the capture may be another, which the arm forgets in the two seconds after it.
    """
    overlay = resimulate(long_log, both)
    np.testing.assert_array_equal(overlay.measured.time, long_log.time)
    np.testing.assert_allclose(overlay.simulated.time, long_log.time, atol=1e-12)
    assert overlay.simulated.metadata["start_values"]["plant"]["delta_encoder_offset"] == pytest.approx(0.9, abs=0.1)
    assert overlay.beginning.rms == pytest.approx(RESOLUTION / math.sqrt(12.0), rel=0.1)
    late = overlay.measured.time >= 3.0
    signals = {name: signal[late] for name, signal in overlay.measured.signals.items()}
    settled = Result(overlay.measured.time[late], signals, overlay.measured.units, overlay.measured.metadata)
    different = differences(settled, overlay.simulated, MEASURED)
    assert different["plant.theta_encoder"] < 3.0 * RESOLUTION
    assert different["plant.delta_encoder"] < 2.0 * RESOLUTION


def test_the_passive_pendulum_of_a_log_is_met_from_the_middle(log, both):
    overlay = resimulate(log, both, "ident", begin=0.7)
    measured, simulated = overlay.measured, overlay.simulated
    assert measured.time[0] == simulated.time[0] == 0.0
    assert len(measured.time) == len(simulated.time) == 2301
    for name in ("plant.theta_encoder", "plant.delta_encoder"):
        assert simulated[name][0] == pytest.approx(log[name][700], abs=1.1 * RESOLUTION)
        np.testing.assert_array_equal(measured[name], log[name][700:])


def test_the_plant_is_the_runs_own_unless_another_is_named(fmus, log, both):
    own = resimulate(log, both).simulated.metadata["start_values"]["plant"]
    assert not {"m_p", "back_emf"} & own.keys()  # the scenario names no set
    plant = {"parameters": "hcs", "start": {"m_p": 0.03, "theta_0": 1.0, "noise_std": 0.1}}
    told = Result(log.time, log.signals, log.units, {**log.metadata, "scenario": {"plant": plant}})
    start = resimulate(told, both).simulated.metadata["start_values"]["plant"]
    assert (start["m_p"], start["D_r"], abs(start["theta_0"]) < 0.1, "noise_std" in start) == (0.03, 1e-3, True, False)
    named = resimulate(told, both, "ident").simulated.metadata["start_values"]["plant"]
    assert (named["m_p"], named["D_r"]) == (0.024, 2.7e-4)


def test_other_parameters_lie_further_away(log, both):
    overlays = [resimulate(log, both, name) for name in ("ident", "hcs")]
    own, other = (differences(o.measured, o.simulated, MEASURED) for o in overlays)
    assert overlays[1].beginning.rms > 1.2 * overlays[0].beginning.rms
    assert all(math.isfinite(value) and value >= 0.0 for value in own.values())
    assert own["plant.theta_encoder"] != other["plant.theta_encoder"]


def test_the_metadata_says_which_parameters(log, both):
    simulated = resimulate(log, both, "ident", begin=2.5).simulated
    assert simulated.metadata["overlay"]["parameters"] == "ident"
    start = simulated.metadata["start_values"]
    assert start["controller"] == log.metadata["start_values"]["controller"]
    assert start["plant"]["theta_encoder_offset"] == 0.5


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
    overlay = resimulate(gaps, both, "ident")
    measured, simulated = overlay.measured, overlay.simulated
    assert len(measured.time) == 501 - 7
    assert len(simulated.time) == 501
    picked = np.round(measured.time * 1000).astype(int)
    same = Result(measured.time, {n: s[picked] for n, s in simulated.signals.items()}, simulated.units, {})
    assert set(differences(same, simulated, (*MEASURED, "controller.voltage")).values()) == {0.0}


def test_differences_of_the_pendulum_know_no_turns(made_result):
    time = np.arange(5) * 1e-3
    signals = {"plant_theta_encoder": 0.0, "controller_voltage": 1.0}
    a = made_result(time, plant_delta_encoder=0.1, **signals)
    b = made_result(time, plant_delta_encoder=0.1 + 4.0 * math.pi, **{**signals, "controller_voltage": 3.0})
    overlay = differences(a, b, ("plant.delta_encoder", "controller.voltage"), ("plant.delta_encoder",))
    assert overlay["plant.delta_encoder"] == pytest.approx(0.0, abs=1e-12)
    assert overlay["controller.voltage"] == 2.0


def test_a_simulation_is_compared_as_an_encoder_sees_it(made_result):
    angles = {"plant_theta_encoder": 0.1, "plant_delta_encoder": -0.2}
    simulated = made_result([0.0, 1.0], **angles)
    log = made_result([0.0, 1.0], **angles)
    for name in ("plant.theta", "plant.delta"):
        del log.signals[name]
    assert list(alike({"simulation": simulated, "log": log})["simulation"].signals) == list(log.signals)
    assert alike({"a": simulated, "b": simulated})["b"] is simulated
    seen = as_seen(simulated, log)
    assert list(seen.signals) == [name for name in simulated.signals if name not in ("plant.theta", "plant.delta")]
    assert angle_norm(seen)[0] == pytest.approx(math.hypot(0.1, -0.2), rel=1e-12)
