"""The linear plant that is stepped: closed forms, SciPy on the same held inputs, limits, sensors, refusals, state."""

import json
from math import cos, floor, inf, nan, sin

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fmu_export.errors import UserError
from ihc_fmu.system import System

from .models import CRANE, OSCILLATOR, derivatives, inputs_of, measured, plant_of, random_system, states

MASS = System(A=np.array([[0.0, 1.0], [0.0, 0.0]]), B=np.array([[0.0], [2.0]]))


def test_mass_under_held_forces_follows_the_parabolas():
    """x'' = 2 sat(u + d): the limit of 1 holds for the sum."""
    plant = plant_of(MASS, x1_0=3.0, x2_0=-1.0, u1_lower=-1.0, u1_upper=1.0)
    x, v, time = 3.0, -1.0, 0.0
    for u, d, h in ((0.5, 0.0, 0.1), (7.0, 0.25, 2.0), (-7.0, -3.0, 1e-3), (0.0, 0.5, 10.0)):
        acceleration = 2.0 * min(1.0, max(-1.0, u + d))
        x, v = x + v * h + acceleration * h * h / 2, v + acceleration * h
        assert plant.step(time, h, inputs_of([u], [d])) == []
        time += h
        assert states(plant) == pytest.approx((x, v), rel=1e-14)
        assert derivatives(plant) == (states(plant)[1], acceleration)


def test_oscillator_swings_about_the_equilibrium_of_its_input():
    """x'' = -4 x + u: about u/4 with 2 rad/s, in steps of any length."""
    plant = plant_of(OSCILLATOR, x1_0=1.0)
    time = 0.0
    for h in (1e-3, 0.1, 3.0, 50.0):
        plant.step(time, h, inputs_of([2.0]))
        time += h
        expected = (0.5 + 0.5 * cos(2 * time), -sin(2 * time))
        np.testing.assert_allclose(states(plant), expected, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("seed", range(16))
def test_random_plants_agree_with_scipy_on_the_same_inputs(seed):
    system, rng = random_system(seed), np.random.default_rng(100 + seed)
    plant = plant_of(system)
    scale = 1.0 / np.abs(np.linalg.eigvals(system.A)).max()
    x_eq = np.array(system.x_eq)
    x, time = x_eq, 0.0
    largest = np.zeros(system.n)
    for _ in range(20):
        h = scale * 10 ** rng.uniform(-2, 0.5)
        u, d = rng.uniform(-3, 3, size=system.m), rng.uniform(-0.1, 0.1, size=system.m)
        w = np.clip(u + d, np.asarray(system.lower), np.asarray(system.upper)) - np.asarray(system.u_eq)
        plant.step(time, h, inputs_of(u.tolist(), d.tolist()))
        rate = lambda _, x, w=w: system.A @ (x - x_eq) + system.B @ w  # noqa: E731
        size = np.abs(system.A @ (x - x_eq)) * h + np.abs(system.B @ w) * h + 1e-300
        x = solve_ivp(rate, (0.0, h), x, rtol=1e-11, atol=1e-12 * size, method="DOP853").y[:, -1]
        largest = np.maximum(largest, np.abs(x - x_eq))
        time += h
        assert (np.abs(states(plant) - x) <= 1e-8 * largest).all()
        np.testing.assert_allclose(derivatives(plant), rate(0.0, x), rtol=0.0, atol=1e-7 * np.abs(rate(0.0, x)).max())


@pytest.mark.parametrize("seed", range(16))
def test_step_in_parts_ends_where_the_whole_step_ends(seed):
    system = random_system(seed)
    h = 3.0 / np.abs(np.linalg.eigvals(system.A)).max()
    held = inputs_of([0.7] * system.m, [0.1] * system.m)
    x_eq = np.array(system.x_eq)
    start = {f"x{i + 1}_0": float(x) for i, x in enumerate(x_eq + np.abs(system.B[:, 0]))}
    whole, parts = plant_of(system, **start), plant_of(system, **start)
    whole.step(0.0, h, held)
    for k in range(8):
        parts.step(k * h / 8, h / 8, held)
    size = np.maximum(np.abs(states(whole)), np.abs(np.array(states(whole)) - x_eq).max() * 1e-3)
    np.testing.assert_allclose(np.array(states(parts)) / size, np.array(states(whole)) / size, rtol=0.0, atol=1e-11)


def test_equilibrium_is_kept_exactly():
    system = CRANE.changed(x_eq=np.array([0.3, 0.0, 1.1, 0.0]), u_eq=np.array([2.5]), y_eq=np.array([0.3, 7.0]))
    plant = plant_of(system)
    before = plant.outputs()
    for k in range(1000):
        plant.step(k * 1e-3, 1e-3, inputs_of([2.5]))
    assert plant.outputs() == before
    assert states(plant) == (0.3, 0.0, 1.1, 0.0)
    assert measured(plant) == (0.3, 7.0)


def test_sensors_count_with_their_bias_before_and_the_states_stay_true():
    plant = plant_of(
        CRANE,
        position_0=0.01234,
        angle_0=0.5,
        position_bias=-3e-4,
        position_resolution_offset=0.25,
        angle_sensor_bias=0.125,
    )
    assert measured(plant) == (1e-3 * floor((0.01234 - 3e-4) / 1e-3 + 0.25), 0.625)
    assert states(plant) == (0.01234, 0.0, 0.5, 0.0)
    assert measured(plant_of(CRANE, position_0=0.0126))[0] == 1e-3 * 13  # 0.5: to the nearest
    assert measured(plant_of(CRANE, position_0=-0.0126, position_resolution_offset=0.0))[0] == 1e-3 * -13


def test_outputs_follow_the_states_and_not_the_inputs():
    plant = plant_of(CRANE, angle_0=0.5)
    before = plant.outputs()
    assert plant.initialize(0.0, inputs_of([4.0], [1.0])) == []
    assert plant.outputs() == before
    plant.step(0.0, 1e-3, inputs_of())
    assert measured(plant)[1] == states(plant)[2]


def test_state_decays_to_exactly_0_and_never_to_what_slows_a_processor():
    plant = plant_of(System(A=np.array([[-100.0]]), B=np.array([[1.0]])), x1_0=1.0)
    seen = []
    for k in range(100):
        plant.step(k * 0.1, 0.1, inputs_of())
        seen += states(plant)
    assert seen[-1] == 0.0
    assert min(x for x in seen if x) > 1e-91


@pytest.mark.parametrize(("u", "d"), [(nan, 0.0), (inf, 0.0), (0.0, -inf), (-1e308, -1e308)])
def test_inputs_that_are_not_finite_are_refused_and_change_nothing(u, d):
    plant = plant_of(MASS, x1_0=1.0)
    plant.step(0.0, 0.1, inputs_of([1.0]))
    before = plant.get_state()
    with pytest.raises(UserError, match=r"^inputs must be finite, found input_1, disturbance_1 = \("):
        plant.step(0.1, 0.2, inputs_of([u], [d]))
    assert plant.get_state() == before


def test_plant_that_leaves_the_range_of_numbers_is_stopped_before():
    plant = plant_of(System(A=np.array([[100.0]]), B=np.array([[1.0]])), x1_0=1.0)
    plant.step(0.0, 7.0, inputs_of())
    before = plant.get_state()
    with pytest.raises(
        ArithmeticError, match=r"the state left the range of numbers, x = \(1.01\d*e\+304\) before the step"
    ):
        plant.step(7.0, 1.0, inputs_of())
    assert plant.get_state() == before
    with pytest.raises(UserError, match="must be shorter"):
        plant.step(7.0, 8.0, inputs_of())
    assert plant.get_state() == before
    plant.step(7.0, 0.01, inputs_of())


def test_start_values_beyond_reason_are_refused():
    plant = plant_of(System(A=np.array([[1e10]]), B=np.array([[1.0]])), x1_0=1e300)
    with pytest.raises(ArithmeticError, match=r"start values must give finite outputs, found x = \(1e\+300\)"):
        plant.initialize(0.0, inputs_of())


def test_limits_that_cross_are_refused():
    with pytest.raises(UserError, match=r"^lower_1 must not exceed upper_1, found 2 and 1.5$"):
        plant_of(CRANE, force_lower=2.0, force_upper=1.5)


def test_restored_state_continues_as_if_nothing_had_been_between():
    plant, twin = plant_of(CRANE, angle_0=0.1), plant_of(CRANE)
    for k in range(10):
        plant.step(k * 1e-2, 1e-2, inputs_of([3.0 * sin(k)]))
    twin.set_state(json.loads(json.dumps(plant.get_state())))
    assert twin.outputs() == plant.outputs()
    for k, h in ((10, 1e-2), (11, 3e-2)):
        for unit in (plant, twin):
            unit.step(k * 1e-2, h, inputs_of([1.0]))
    assert twin.outputs() == plant.outputs()
