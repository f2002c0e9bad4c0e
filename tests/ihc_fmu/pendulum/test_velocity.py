"""Velocity estimation: the manufacturer's filter as scipy discretizes it, and the stationary Kalman gains."""

from math import exp, log, pi
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.signal import cont2discrete, dlsim

from ihc_fmu.pendulum.nominal_model import nominal_model, predict
from ihc_fmu.pendulum.start_values import nominal_values
from ihc_fmu.pendulum.velocity import alpha_beta_gains, filter_decay, filter_velocity, observe
from plant_fmu.parameters import parameter_set


def filtered(angles, cutoff, h):
    decay, lag, velocities = filter_decay(cutoff, h), 0.0, []
    for angle in angles:
        velocity, lag = filter_velocity(cutoff, decay, lag, angle)
        velocities.append(velocity)
    return np.array(velocities)


@pytest.mark.parametrize(("cutoff", "h"), [(50.0, 1e-3), (50.0, 1e-4), (50.0, 0.02), (7.0, 0.5)])
def test_filter_is_the_zero_order_hold_response_of_its_transfer_function(cutoff, h):
    """T(s) = w s/(s + w), Remark 4, with w = 50 rad/s."""
    angles = np.random.default_rng(0).normal(size=300)
    discrete: Any = cont2discrete(([cutoff, 0.0], [1.0, cutoff]), h, "zoh")
    expected = dlsim((discrete[0].ravel(), discrete[1], h), angles)[1]
    np.testing.assert_allclose(filtered(angles, cutoff, h), expected[:, 0], rtol=1e-9, atol=1e-9 * cutoff)


def test_filter_forgets_a_constant_angle_at_its_cutoff():
    """DC gain 0: a step of 1 rad gives w e^(-w t)."""
    velocities = filtered(np.ones(500), 50.0, 1e-3)
    np.testing.assert_allclose(velocities, 50.0 * np.exp(-50.0 * 1e-3 * np.arange(500)), atol=1e-12)


def test_filter_turns_a_ramp_into_its_slope_with_first_order_in_the_sample_time():
    """Sampled right after the held angle has stepped, the velocity is slope w h/(1 - e^(-w h))."""
    slope, w, errors = 3.0, 50.0, []
    for h in (2e-4, 1e-4):
        slope_estimate = filtered(slope * h * np.arange(round(1 / h)), w, h)[-1]
        assert slope_estimate == pytest.approx(slope * w * h / (1 - exp(-w * h)), rel=1e-9)
        errors.append(slope_estimate - slope)
    assert log(errors[0] / errors[1]) / log(2) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("h", [1e-5, 1e-4, 1e-3, 5e-3, 2e-2, 0.1, 1.0])
@pytest.mark.parametrize("q", [1e-3, 1.0, 10.0])
@pytest.mark.parametrize("resolution", [2 * pi / 2048, 2 * pi / 4096])
def test_gains_are_those_of_the_riccati_equation(q, resolution, h):
    """Double integrator driven by white acceleration, angle measured with resolution^2/12 at 1 ms."""
    F, H = np.array([[1.0, h], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    Q = q * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
    R = np.array([[resolution**2 / 12 * 1e-3 / h]])
    scale = np.diag([1.0, h])  # SciPy's solver wants the velocity in rad per sample
    F, Q = scale @ F @ np.linalg.inv(scale), scale @ Q @ scale
    P = solve_discrete_are(F.T, H.T, Q / R[0, 0], np.eye(1))
    gain = P[:, 0] / (P[0, 0] + 1.0)
    assert alpha_beta_gains(q, resolution, h) == pytest.approx((gain[0], gain[1] / h), rel=1e-6)


def test_gains_of_the_default_observer_are_the_published_numbers():
    assert alpha_beta_gains(1.0, 2 * pi / 2048, 1e-3) == pytest.approx((0.2345029875, 31.240102994), rel=1e-8)


def test_observer_with_the_right_model_forgets_a_wrong_start_and_stays_exact():
    """Free fall from near upright under a voltage, 12 rad/s and more; the first estimate is off in every state."""
    m, h = nominal_model(nominal_values(parameter_set("ident").parameters)), 1e-3
    gains = alpha_beta_gains(1.0, 2 * pi / 2048, h)
    x, estimate = (0.0, 0.3, 0.0, 0.0), (0.05, 0.25, 1.0, -1.0)
    for _ in range(300):
        x = predict(m, *x, 2.0, h)
        estimate = observe(m, gains, estimate, 2.0, h, x[0], x[1])
    assert abs(x[3]) > 1.0
    np.testing.assert_allclose(estimate, x, atol=1e-9)
    following = predict(m, *x, 2.0, h)
    assert observe(m, gains, x, 2.0, h, following[0], following[1]) == pytest.approx(following, rel=1e-14)


def test_observer_corrects_each_channel_by_its_own_error():
    m = nominal_model(nominal_values(parameter_set("ident").parameters))
    x = (0.1, 2.0, 1.0, -3.0)
    p = predict(m, *x, 1.0, 1e-3)
    estimate = observe(m, (0.25, 30.0), x, 1.0, 1e-3, p[0] + 0.01, p[1] - 0.02)
    assert np.subtract(estimate, p) == pytest.approx([0.0025, -0.005, 0.3, -0.6], rel=1e-9)
