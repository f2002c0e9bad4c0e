"""The Kalman filter's gain against an independent Riccati iteration and published numbers, and what it does in the loop."""

import json
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from ihc_fmu.pendulum.interface import INTERFACE
from ihc_fmu.pendulum.kalman import KalmanOptions, kalman_gain, linearize
from ihc_fmu.pendulum.nominal_model import nominal_model
from ihc_fmu.pendulum.start_values import kalman_values, nominal_values
from ihc_fmu.pendulum.velocity import BIAS_DECAY
from plant_fmu import linearization
from plant_fmu.parameters import PARAMETER_SETS

KALMAN = {"velocity_source": "kalman"}
BEST = KALMAN | {"a_min": 0.5, "norm_solver": "exact", "discretization": "semi_implicit"}

# An independent solution for the set `ident` at 1 ms.
PUBLISHED_M = [
    [0.10558951928531082, 0.08623681357071682],
    [0.08488273262635448, 0.10469760401604909],
    [10.292195114740704, 9.956950370993905],
    [10.024331978778411, 10.023523216634182],
    [8.901448107067111, 8.691040605160786],
    [0.0013540809443623515, -0.0013842536258532208],
]


def model_of(name):
    return nominal_model(nominal_values(PARAMETER_SETS[name].parameters))


@pytest.mark.parametrize("name", PARAMETER_SETS)
def test_linearized_nominal_model_is_that_of_the_plant(name):
    A, b = linearize(model_of(name))
    expected_A, expected_b = linearization.linearize(PARAMETER_SETS[name].parameters)
    np.testing.assert_allclose(A, expected_A, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(b, expected_b, rtol=1e-12)


def test_gain_at_one_millisecond_is_the_published_one():
    np.testing.assert_allclose(kalman_gain(*linearize(model_of("ident")), 1e-3), PUBLISHED_M, rtol=1e-7)


@pytest.mark.parametrize("h", [5e-4, 2e-3, 1e-2])
def test_gain_is_the_limit_of_the_filters_recursion(h):
    """Predict and update the covariance until it stands still; process noise by quadrature over the sample."""
    A, b = linearize(model_of("hcs"))
    o = KalmanOptions()
    F = np.zeros((6, 6))
    F[:4, :4], F[:4, 4], F[5, 5] = A, b, -BIAS_DECAY
    B = np.r_[b, 0.0, 0.0]
    intensity = o.voltage_noise * np.outer(B, B) + np.diag([0.0] * 4 + [o.disturbance_noise, o.bias_noise])
    nodes, quadrature = np.polynomial.legendre.leggauss(8)
    Q = sum(
        0.5 * h * w * expm(F * t) @ intensity @ expm(F * t).T
        for t, w in zip(0.5 * h * (nodes + 1), quadrature, strict=True)
    )
    C: Any = np.zeros((2, 6))
    C[0, 0] = C[1, 1] = C[1, 5] = 1.0
    R = o.resolution**2 / 12 * 1e-3 / h * np.eye(2)
    step, covariance, gain = expm(F * h), np.eye(6) * 1e-2, np.zeros((6, 2))
    for _ in range(100_000):
        prior = step @ covariance @ step.T + Q
        before, gain = gain, prior @ C.T @ np.linalg.inv(C @ prior @ C.T + R)
        covariance = (np.eye(6) - gain @ C) @ prior
        if np.abs(gain - before).max() < 1e-13:
            break
    np.testing.assert_allclose(kalman_gain(A, b, h), gain, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("h", [0.0, -1e-3, np.nan, np.inf])
def test_impossible_sample_time_is_refused(h):
    with pytest.raises(ValueError, match="sample time must be positive and finite, found"):
        kalman_gain(*linearize(model_of("ident")), h)


def test_gain_for_another_sample_time_is_refused_with_both(controller):
    with pytest.raises(ValueError, match=r"kalman_sample_time = 0\.001 s and sample_time = 0\.002 s"):
        controller(**KALMAN, sample_time=2e-3)


def final(run, name, seconds=1.0):
    return run[name][-round(seconds / 1e-3) :]


def test_constant_disturbance_is_found_and_cancelled(controller, closed_loop):
    """A torque on the arm would need an input of its own; the plant's disturbance voltage is one in disguise."""
    unit = controller(**BEST, law="LC")
    original = unit.outputs

    def biased():
        voltage, *rest = original()
        return (voltage + 0.8, *rest)

    unit.outputs = biased
    run = closed_loop(unit, 6.0, changes={"delta_0": 0.05})
    assert np.mean(final(run, "disturbance_estimate")) == pytest.approx(0.8, abs=0.05)
    assert np.abs(np.mean(final(run, "theta"))) < 0.02


def test_bias_of_the_pendulum_encoder_is_found(controller, closed_loop):
    count = 2 * np.pi / 2048
    run = closed_loop(controller(**BEST), 8.0, changes={"delta_0": 0.05, "delta_encoder_offset": 0.0})
    assert np.mean(final(run, "bias_estimate")) == pytest.approx(-0.5 * count, abs=0.25 * count)


@pytest.mark.parametrize("parameters", ["ident", "matrices", "hcs"])
def test_swing_up_with_the_filter_captures_once_and_stays(controller, closed_loop, error_norm, parameters):
    run = closed_loop(controller(**KALMAN), 3.0, parameters)
    captures = np.flatnonzero(np.diff((run["mode"] == 3).astype(int)) == 1)
    assert len(captures) == 1
    assert captures[0] < 1500
    assert error_norm(run)[-1] < 0.3


def test_state_with_the_filter_continues_through_json(controller):
    def seen(k):
        return 0.05 * np.sin(0.01 * k), 0.1 * np.cos(0.02 * k), 0.0, 0.0, 0.0

    unit, other = controller(**BEST), controller(**BEST)
    unit.initialize(0.0, seen(0))
    for k in range(200):
        if k == 100:
            other.set_state(json.loads(json.dumps(unit.get_state())))
        unit.step(k * 1e-3, 1e-3, seen(k))
        if k >= 100:
            other.step(k * 1e-3, 1e-3, seen(k))
            assert other.outputs() == unit.outputs()
    assert INTERFACE.of("output")[6].name == "disturbance_estimate"
    assert unit.outputs()[6] != 0.0


def test_kalman_values_name_their_sample_time():
    values = kalman_values(nominal_values(PARAMETER_SETS["ident"].parameters), 2e-3)
    assert values["kalman_sample_time"] == 2e-3
    assert len(values) == 13
