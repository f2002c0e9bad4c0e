"""What counting leaves: closed forms of a scalar loop, Bennett's correlation, bounds that hold, loops that count in fact."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ihc_fmu import System, residual_set, synthesize
from ihc_fmu.controller import regulator_of
from ihc_fmu.observer_wish import ObserverWish
from ihc_fmu.pendulum.paper_system import paper_system
from ihc_fmu.pendulum.start_values import default_design
from ihc_fmu.regulator.interface import INTERFACE
from ihc_fmu.regulator.unit import HomogeneousControllerUnit
from ihc_fmu.residual import (
    SampledController,
    Sensors,
    ball,
    counting_correlation,
    direct,
    filtered,
    gain_at,
    held,
    residual_of,
)

H = 5e-3
CART = System(
    A=[[0, 1], [4, 0]],
    B=[0, 1],
    C=[[1, 0]],
    K=[-8, -4],
    states=("angle [rad]", "rate [rad/s]"),
    resolutions=[3e-3],
    sample_time=H,
    lower=[-5.0],
    upper=[5.0],
)


@pytest.fixture(scope="module")
def design():
    return synthesize(CART)


@pytest.mark.parametrize("a", [0.9, -0.6])
def test_scalar_loop_has_its_closed_form(a):
    """x+ = a x + b e: white b q/sqrt(12 (1 - a^2)); moving |b| q/2/(1 - |a|) and constant |b| q/2/(1 - a) bound it."""
    f, g, q = 1.05, 0.1, 0.02
    b = a - f
    found = residual_of(
        np.array([[f]]),
        np.array([[g]]),
        np.eye(1),
        direct(np.array([[b / g]])),
        Sensors(np.array([q]), np.zeros(1)),
        np.array([[3.0]]),
        np.array([np.inf]),
    )
    assert found.radius == pytest.approx(abs(a))
    assert found.white[0] == pytest.approx(abs(b) * q / math.sqrt(12 * (1 - a * a)), rel=1e-3)
    assert found.bound[0] == pytest.approx(abs(b) * q / 2 * (1 / (1 - abs(a)) + 1 / (1 - a)), rel=1e-3)
    assert found.white[0] < found.rms[0] < found.bound[0]
    assert found.norm_bound == pytest.approx(3.0 * q / 2 * (1 + abs(b) / (1 - abs(a)) + abs(1 + b / (1 - a))), rel=1e-3)


def test_noise_of_a_sensor_that_does_not_count_is_white_in_all():
    """The stationary variance b^2 s^2/(1 - a^2), and no bound."""
    a, b, s = 0.8, -0.25, 0.01
    one = np.ones((1, 1))
    controller, sensors = direct(np.array([[b]])), Sensors(np.zeros(1), np.array([s]))
    found = residual_of((a - b) * one, one, one, controller, sensors, one, np.array([np.inf]))
    expected = abs(b) * s / math.sqrt(1 - a * a)
    np.testing.assert_allclose([*found.white, *found.rms], expected, rtol=1e-3)
    assert found.bound[0] == math.inf
    assert not found.proven


@pytest.mark.parametrize("moved", [0.02, 0.19, 0.21, 0.4, 0.8])
def test_correlation_of_counting_errors_is_the_mean_over_place_and_displacement(moved):
    """Of (frac(u) - 1/2)(frac(u + moved g) - 1/2), u uniform, g Gaussian, by quadrature."""
    x = np.linspace(-8.0 * moved, 8.0 * moved, 200_001)
    density = np.exp(-0.5 * (x / moved) ** 2)
    expected = density @ (0.5 * ((x % 1.0) ** 2 - x % 1.0 + 1 / 6)) / density.sum()
    assert counting_correlation(np.array(moved)) == pytest.approx(expected, abs=1e-6)
    u = np.random.default_rng(1).random(200_000)
    later = u + moved * np.random.default_rng(2).normal(size=u.size)
    drawn = np.mean((u - 0.5) * (later % 1.0 - 0.5))
    assert counting_correlation(np.array(moved)) == pytest.approx(drawn, abs=1e-3)


def test_correlation_is_the_variance_at_once_and_is_forgotten():
    np.testing.assert_allclose(counting_correlation(np.array([0.0, 3.0])), [1 / 12, 0.0], atol=1e-12)


def test_the_law_at_1_is_the_linear_one_and_gains_are_those_of_the_unit(design):
    np.testing.assert_allclose(gain_at(design, 1.0, 0.0), design.K, rtol=1e-12)
    x = np.array([0.01, -0.02])
    for h in (0.0, H):
        values = regulator_of(replace(design, system=design.system.changed(C=np.eye(2), outputs=("a", "b")))).values()
        unit = unit_of(values, discretization=1 if h == 0.0 else 2)
        unit.step(0.0, H, (*x, *[0.0] * 30))
        assert unit.outputs()[0] == pytest.approx((gain_at(design, 0.5, h) @ x)[0], rel=1e-9)
    assert np.linalg.norm(ball(design, 0.5) @ x) < 1.0


def unit_of(values, **changes):
    return HomogeneousControllerUnit(INTERFACE.start_values({**values, "estimator": 1, **changes}))


def counted_runs(design, K, draws=64, samples=8000):
    """Return the states (samples/2, n, draws) of the linear loop with counters that are zeroed at random, to the end."""
    s = design.system
    F, G = held(s.A, s.B, s.sample_time)
    estimator: Any = regulator_of(design).filter
    E, L, U, V, *_ = filtered(estimator, K)
    offsets = np.random.default_rng(3).random((s.p, draws))
    q = s.resolutions[:, None]
    x, z, seen = np.full((s.n, draws), 1e-3), np.zeros((len(E), draws)), []
    for k in range(samples):
        y = q * np.floor(s.C @ x / q + offsets)
        x, z = F @ x + G @ (U @ z + V @ y), E @ z + L @ y
        if k >= samples // 2:
            seen.append(x)
    return np.array(seen)


@pytest.mark.parametrize("a_min", [1.0, 0.6])
def test_counters_leave_what_is_foretold_and_never_more_than_the_bound(a_min):
    """A pendulum that never rests: the root mean square to a quarter, of which white noise of q^2/12 is less than 60 %."""
    sensors = {
        "C": np.eye(2, 4),
        "outputs": ("theta", "delta"),
        "resolutions": [2 * np.pi / 2048] * 2,
        "biases": ("delta",),
    }
    system = paper_system().changed(name="balanced", sample_time=2e-3, **sensors)
    design = replace(default_design(), system=system)
    found = residual_set(design, a_min)
    seen = counted_runs(design, gain_at(design, a_min, system.sample_time))
    rms = np.sqrt((seen**2).mean(axis=(0, 2)))
    np.testing.assert_allclose(found.rms, rms, rtol=0.25)
    assert (found.white < 0.6 * rms).all()
    assert (np.abs(seen).max(axis=(0, 2)) < found.bound).all()


def test_it_scales_with_the_count_and_is_unproven_where_the_ball_is_left_or_a_limit_met(design):
    """The filter's noises scale with the count too."""
    fine = residual_set(design)
    coarse = residual_set(replace(design, system=design.system.changed(resolutions=[0.1])))
    for name in ("white", "rms", "bound", "input_bound", "norm_bound"):
        np.testing.assert_allclose(getattr(coarse, name), getattr(fine, name) * (0.1 / 3e-3), rtol=1e-3)
    assert coarse.norm_bound > 1.0 > fine.norm_bound
    assert fine.proven
    assert not coarse.proven
    tight = replace(design, system=design.system.changed(lower=[-1e-3], upper=[1e-3]))
    assert residual_set(tight).limited
    assert not residual_set(tight).proven


def test_what_has_no_residual_set_is_refused(design):
    with pytest.raises(ValueError, match="a_min must be positive, found 0"):
        residual_set(design, 0.0)
    observed = replace(design, system=design.system.changed(observer=ObserverWish(), biases=(), bandwidth=None))
    with pytest.raises(ValueError, match="that of a Kalman filter or measured states"):
        residual_set(observed)
    slow = SampledController(*direct(np.array([[-1.0]]))[:3], np.array([[3.0]]), np.zeros((1, 0)), np.eye(1))
    with pytest.raises(ValueError, match="not stable: a pole has the magnitude 4"):
        residual_of(np.eye(1), np.eye(1), np.eye(1), slow, Sensors(np.ones(1), np.zeros(1)), np.eye(1), np.ones(1))
