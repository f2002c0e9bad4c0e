"""Model exchange with the native plant: its rates, its states and the time."""

import pytest

from tests.fmu_export.calls import (
    CONTINUOUS,
    DISCARD,
    EVENT,
    EXCHANGE,
    INFINITY,
    INITIALIZING,
    NAN,
    STATES,
    bring,
    real,
)
from tests.fmu_export.conftest import PLANT


def test_rates_in_initialization_are_those_of_the_start_values(native):
    instance, rate, later = native(PLANT, EXCHANGE), real(*[0.0] * 4), real(*[0.0] * 4)
    instance.set(theta_dot_0=0.3, delta_0=0.2)
    bring(instance, INITIALIZING).set(voltage=2.0)
    instance.done("GetDerivatives", rate, 4)
    assert rate[0] == 0.3
    instance.done("ExitInitializationMode")
    instance.done("GetDerivatives", later, 4)
    assert tuple(rate) == tuple(later)


def test_continuous_states_are_set_together_or_not_at_all(native):
    instance = bring(native(PLANT, EXCHANGE), CONTINUOUS)
    before = instance.everything()
    for i, bad in enumerate((NAN, INFINITY, -INFINITY, NAN)):
        x = [0.1, 0.2, 0.3, 0.4]
        x[i] = bad
        assert instance.call("SetContinuousStates", real(*x), 4) == DISCARD
        assert instance.everything() == before
        assert "must be finite" in instance.log[-1][2]
    for count in (0, 1, 3, 5):
        for function in (
            "SetContinuousStates",
            "GetContinuousStates",
            "GetDerivatives",
            "GetNominalsOfContinuousStates",
        ):
            assert "must be for 4 values" in instance.refused(function, real(*[0.0] * 5), count)
    assert "must be for 0 values" in instance.refused("GetEventIndicators", real(0.0), 1)
    assert instance.everything() == before


def test_derivatives_follow_states_and_inputs(native):
    instance, x, rate = bring(native(PLANT, EXCHANGE), CONTINUOUS), real(0.1, 0.2, 0.3, 0.4), real(*[0.0] * 4)
    instance.done("SetContinuousStates", x, 4)
    assert instance.get(*STATES) == tuple(x)
    instance.done(*instance.setting(theta=0.5, delta_dot=0.6, voltage=1.0))
    assert instance.get(*STATES, "voltage") == (0.5, 0.2, 0.3, 0.6, 1.0)
    assert "delta must be finite" in instance.refused(*instance.setting(theta=0.1, delta=NAN))
    instance.done(*instance.setting(theta=0.1, delta_dot=0.4, voltage=0.0))
    assert instance.get(*STATES) == tuple(x)
    instance.done("GetDerivatives", rate, 4)
    assert tuple(rate) == instance.get("theta_dot", "delta_dot", "theta_ddot", "delta_ddot")
    slow = rate[2]
    instance.set(voltage=3.0)
    instance.done("GetDerivatives", rate, 4)
    assert rate[2] > slow
    instance.done("SetContinuousStates", real(0.0, 0.5, 1e300, 0.0), 4)
    assert instance.call("GetDerivatives", rate, 4) == DISCARD


@pytest.mark.parametrize("bad", [NAN, INFINITY])
def test_time_must_be_a_number(bad, native):
    assert "the time must be finite" in bring(native(PLANT, EXCHANGE), EVENT).refused("SetTime", bad)


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"noise_std": 1e-3}, "noise_std must be 0"),
        ({"measurement_delay": 1e-3}, "measurement_delay must be 0"),
        ({"motor_model": 2}, "4 continuous states"),
    ],
)
def test_parameters_without_meaning_in_model_exchange_are_refused(changes, part, native):
    instance = native(PLANT, EXCHANGE)
    instance.set(**changes)
    assert part in bring(instance, INITIALIZING).refused("ExitInitializationMode")
