"""The stepped plant: outputs, limits, sensors, state, refusals, and SciPy on the same voltages."""

import json
from math import asin, cos, inf, nan, pi

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant_fmu import dynamics
from plant_fmu.interface import INTERFACE
from plant_fmu.parameters import PARAMETER_SETS
from plant_fmu.unit import QubePlant

IDENT = PARAMETER_SETS["ident"].parameters
GRAVITY = IDENT.m_p * IDENT.g_p * IDENT.L_p / 2
OUTPUTS = [v.name for v in INTERFACE.calculated]
ENCODERS = ["theta_encoder", "delta_encoder"]
MOVING = {"theta_0": 0.1, "delta_0": 2.0, "theta_dot_0": 1.5, "delta_dot_0": -3.0}
STILL = (0.0, 0.0, 0.0)


def plant(**changes):
    return QubePlant(INTERFACE.start_values(changes))


def outputs(unit):
    return dict(zip(OUTPUTS, unit.outputs(), strict=True))


def run(unit, inputs, h=1e-3, start=0):
    """Return the outputs at the start and after every step, an array with a column for each output."""
    rows = [unit.outputs()]
    for k, u in enumerate(inputs, start):
        assert unit.step(k * h, h, u) == []
        rows.append(unit.outputs())
    return np.array(rows)


def column(rows, *names):
    return rows[:, [OUTPUTS.index(name) for name in names]]


def wobble(count):
    """Inputs that change in every step, the voltage beyond its limit at times."""
    return [(12.0 * cos(0.05 * k), 3.0 * cos(0.3 * k), 0.01 * cos(0.02 * k)) for k in range(count)]


@pytest.mark.parametrize("motor_model", [1, 2])
def test_local_rates_are_the_slopes_of_the_trajectory(motor_model):
    unit = plant(delta_0=0.4, theta_dot_0=2.0, delta_dot_0=-1.0, motor_model=motor_model, solver_step=1e-6)
    h, before = 1e-6, {}
    for k in range(200):
        before = outputs(unit)
        unit.step(k * h, h, (3.0, 0.5, 0.002))
    after = outputs(unit)
    pairs = [("theta_dot", "theta_ddot"), ("delta_dot", "delta_ddot")]
    pairs += [("current", "current_dot")] if motor_model == 2 else []
    for signal, rate in pairs:
        assert (after[signal] - before[signal]) / h == pytest.approx((after[rate] + before[rate]) / 2, rel=1e-5)


def test_outputs_at_the_start_are_those_of_the_start_values():
    values = outputs(plant(theta_0=0.1, delta_0=0.2, theta_dot_0=3.0, delta_dot_0=-4.0))
    assert values.pop("current_dot") == 0.0
    del values["theta_ddot"], values["delta_ddot"]
    p, count = IDENT, 2 * pi / 2048
    current = -p.k_m * 3.0 / p.R_m
    tip_x, tip_z = p.L_r * 3.0 - p.L_p / 2 * cos(0.2) * -4.0, p.L_p / 2 * np.sin(0.2) * -4.0
    across = p.L_p / 2 * np.sin(0.2) * 3.0
    kinetic = (p.J_r * 3.0**2 + p.J_p * 4.0**2 + p.m_p * (tip_x**2 + tip_z**2 + across**2)) / 2
    assert values == pytest.approx(
        {
            "theta": 0.1,
            "delta": 0.2,
            "theta_dot": 3.0,
            "delta_dot": -4.0,
            "theta_encoder": 32 * count,  # 0.1 rad are 32.59 counts, the offset 0.3 makes them 32.89
            "delta_encoder": 65 * count,  # 0.2 rad are 65.19 counts, the offset 0.8 makes them 65.99
            "current": current,
            "motor_torque": p.k_m * current,
            "energy": kinetic + GRAVITY * (cos(0.2) - 1),
        },
        rel=1e-12,
    )


def test_default_plant_hangs_with_the_encoder_at_half_a_turn_and_the_energy_of_hanging():
    values = outputs(plant())
    assert values["delta_encoder"] == pytest.approx(pi, rel=1e-12)
    assert values["energy"] == pytest.approx(-IDENT.m_p * IDENT.g_p * IDENT.L_p, rel=1e-12)


@pytest.mark.parametrize("motor_model", ["static", "inductance"])
def test_outputs_do_not_depend_on_the_present_inputs(motor_model):
    unit = plant(**MOVING, motor_model=motor_model, noise_std=1e-3)
    before = unit.outputs()
    assert unit.initialize(0.0, (9.0, -3.0, 0.1)) == []
    assert unit.outputs() == before


@pytest.mark.parametrize("back_emf", [True, False])
def test_current_and_torque_follow_the_voltage_of_the_ended_step(back_emf):
    voltages = [10.0 * cos(0.02 * k) for k in range(300)]
    rows = run(plant(**MOVING, back_emf=back_emf), [(v, 0.0, 0.0) for v in voltages])
    current, torque, theta_dot = column(rows, "current", "motor_torque", "theta_dot")[1:].T
    k_e = IDENT.k_m if back_emf else 0.0
    np.testing.assert_allclose(current, (voltages - k_e * theta_dot) / IDENT.R_m, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(torque, IDENT.k_m * current, rtol=1e-14)


def test_inductance_keeps_the_current_from_jumping():
    unit = plant(motor_model="inductance", solver_step=1e-6)
    assert outputs(unit)["current"] == 0.0
    rows = run(unit, [(10.0, 0.0, 0.0)], h=2e-6)
    np.testing.assert_allclose(column(rows, "current")[1], 10.0 / IDENT.L_m * 2e-6, rtol=0.01)
    np.testing.assert_allclose(column(rows, "motor_torque"), IDENT.k_m * column(rows, "current"), rtol=1e-14)


@pytest.mark.parametrize(
    ("voltage", "disturbance", "applied"),
    [(8.0, 5.0, 10.0), (-8.0, -5.0, -10.0), (12.0, -5.0, 7.0), (11.0, 0.0, 10.0), (1.0, 2.0, 3.0)],
)
@pytest.mark.parametrize("limit", [10.0, 2.5])
def test_amplifier_limits_the_sum_of_voltage_and_disturbance(voltage, disturbance, applied, limit):
    applied = min(applied, limit) if applied > 0 else max(applied, -limit)
    trajectory = run(plant(**MOVING, voltage_limit=limit), [(voltage, disturbance, 0.0)])
    expected = run(plant(**MOVING, voltage_limit=1e3), [(applied, 0.0, 0.0)])
    np.testing.assert_array_equal(trajectory, expected)


@pytest.mark.parametrize("motor_model", ["static", "inductance"])
def test_hanging_at_rest_stays_at_rest(motor_model):
    rows = run(plant(motor_model=motor_model, solver_step=2.5e-4), [STILL] * 2000)
    np.testing.assert_allclose(column(rows, *OUTPUTS[:4]), [[0.0, pi, 0.0, 0.0]] * len(rows), atol=1e-11)


def test_upright_without_disturbance_is_an_equilibrium():
    rows = run(plant(delta_0=0.0, encoder_counts=0), [STILL] * 100)
    np.testing.assert_array_equal(rows, 0.0)


def test_constant_joint_torque_holds_the_pendulum_aside():
    torque = 0.6 * GRAVITY
    angle = pi + asin(0.6)
    rows = run(plant(delta_0=angle), [(0.0, 0.0, torque)] * 500)
    np.testing.assert_allclose(column(rows, "theta", "delta"), [[0.0, angle]] * len(rows), atol=1e-12)


def test_energy_is_constant_without_damping_and_back_emf():
    rows = run(plant(delta_0=0.5, D_p=0.0, D_r=0.0, back_emf=False), [STILL] * 2000)
    energy = column(rows, "energy")
    assert np.ptp(column(rows, "delta")) > pi  # it did swing through
    assert np.ptp(energy) < 1e-8 * 2 * GRAVITY


@pytest.mark.parametrize(("motor_model", "solver_step", "segments"), [("static", 1e-4, 30), ("inductance", 4e-5, 20)])
def test_swing_under_piecewise_constant_voltage_equals_scipy(motor_model, solver_step, segments):
    unit = plant(**MOVING, motor_model=motor_model, solver_step=solver_step)
    derivative = dynamics.derivative_inductance if motor_model == "inductance" else dynamics.derivative_static
    c, m = IDENT.coefficients, dynamics.motor(IDENT)
    expected = np.array(unit.x)
    voltages = np.random.default_rng(3).uniform(-6.0, 6.0, segments)
    for k, voltage in enumerate(voltages):
        unit.step(0.1 * k, 0.1, (voltage, 0.0, 2e-3))
        segment = solve_ivp(
            lambda _, x, v=voltage: derivative(c, m, tuple(x), v, 2e-3),
            (0.0, 0.1),
            expected,
            method="DOP853",
            rtol=1e-12,
            atol=1e-12,
        )
        expected = segment.y[:, -1]
        np.testing.assert_allclose(unit.x, expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(("motor_model", "solver_step"), [("static", 5e-4), ("inductance", 6e-5)])
@pytest.mark.parametrize("h", [5e-4, 7e-4, 1.75e-3, 0.35])
def test_result_does_not_depend_on_the_communication_step(motor_model, solver_step, h):
    def final(h):
        unit = plant(**MOVING, motor_model=motor_model, solver_step=solver_step)
        return run(unit, [(4.0, 0.0, 0.0)] * round(0.35 / h), h=h)[-1][:4]

    np.testing.assert_allclose(final(h), final(1e-3), rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("k", [0, 1, 3])
def test_delay_line_delays_by_exactly_k_samples(k):
    inputs = wobble(60)
    now = column(run(plant(**MOVING), inputs), *ENCODERS)
    late = column(run(plant(**MOVING, measurement_delay=k * 1e-3), inputs), *ENCODERS)
    np.testing.assert_array_equal(late[k:], now[: len(now) - k])
    np.testing.assert_array_equal(late[:k], now[[0] * k])


def test_delay_does_not_touch_the_true_angles():
    inputs = wobble(60)
    now, late = (run(plant(**MOVING, measurement_delay=d), inputs) for d in (0.0, 2e-3))
    true = [name for name in OUTPUTS if name not in ENCODERS]
    np.testing.assert_array_equal(column(now, *true), column(late, *true))


def test_ideal_sensor_reports_the_true_angles():
    rows = run(plant(**MOVING, encoder_counts=0), wobble(50))
    np.testing.assert_array_equal(column(rows, *ENCODERS), column(rows, "theta", "delta"))


def test_encoder_errs_by_less_than_a_count_on_the_side_of_its_offset():
    rows = run(plant(**MOVING), wobble(400))
    errors = (column(rows, *ENCODERS) - column(rows, "theta", "delta")) / (2 * pi / 2048)
    assert np.all(np.abs(errors - [-0.2, 0.3]) < 0.5 + 1e-9)
    np.testing.assert_allclose(np.ptp(errors, axis=0), 1.0, atol=0.05)


def test_noise_is_reproduced_by_its_seed_and_changed_by_another():
    def noise(seed):
        rows = run(plant(noise_std=1e-3, noise_seed=seed, encoder_counts=0), [STILL] * 50)
        return column(rows, *ENCODERS) - column(rows, "theta", "delta")

    np.testing.assert_array_equal(noise(5), noise(5))
    assert not np.any(noise(5) == noise(6))


def test_noise_has_the_given_deviation_and_differs_between_the_angles():
    rows = run(plant(noise_std=2e-3, encoder_counts=0, solver_step=1e-3), [STILL] * 4000)
    noise = column(rows, *ENCODERS) - column(rows, "theta", "delta")
    np.testing.assert_allclose(noise.std(axis=0), 2e-3, rtol=0.05)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=4 * 2e-3 / np.sqrt(4000))
    assert abs(np.corrcoef(noise.T)[0, 1]) < 4 / np.sqrt(4000)
    np.testing.assert_allclose(column(rows, "delta"), pi, atol=1e-12)  # the plant itself does not feel it


def test_saved_state_continues_bit_identically_through_json():
    changes = {
        **MOVING,
        "motor_model": "inductance",
        "solver_step": 2.5e-4,
        "noise_std": 5e-3,
        "measurement_delay": 3e-3,
    }
    inputs = wobble(80)
    unit = plant(**changes)
    run(unit, inputs[:41])
    saved = json.dumps(unit.get_state())
    expected = run(unit, inputs[41:], start=41)
    for other in (plant(**changes), unit):
        other.set_state(json.loads(saved))
        assert json.dumps(other.get_state()) == saved
        np.testing.assert_array_equal(run(other, inputs[41:], start=41), expected)


def test_saved_state_is_a_snapshot_that_later_steps_leave_alone():
    unit = plant(**MOVING, noise_std=5e-3, measurement_delay=2e-3)
    run(unit, wobble(10))
    state = unit.get_state()
    text = json.dumps(state)
    run(unit, wobble(10))
    assert json.dumps(state) == text
    assert json.dumps(unit.get_state()) != text


def test_delay_between_two_steps_is_refused_with_both_numbers():
    unit = plant(measurement_delay=2.5e-3)
    with pytest.raises(ValueError, match=r"found 0\.0025 s with a step of 0\.001 s"):
        unit.step(0.0, 1e-3, STILL)
    unit.step(0.0, 5e-4, STILL)


def test_with_inductance_the_internal_step_follows_the_motors_time_constant():
    unit = plant(**MOVING, motor_model="inductance", solver_step=5e-4)
    fine = plant(**MOVING, motor_model="inductance", solver_step=2e-6)
    unit.step(0.0, 1e-3, (8.0, 0.0, 0.0))
    fine.step(0.0, 1e-3, (8.0, 0.0, 0.0))
    np.testing.assert_allclose(unit.x, fine.x, rtol=1e-3)


def test_a_delay_fixes_the_communication_step():
    unit = plant(measurement_delay=2e-3)
    unit.step(0.0, 1e-3, STILL)
    before = unit.get_state()
    with pytest.raises(ValueError, match=r"found 0\.0005 s after 0\.001 s"):
        unit.step(1e-3, 5e-4, (5.0, 0.0, 0.0))
    assert unit.get_state() == before


def test_divergence_is_an_arithmetic_error_that_leaves_the_unit_as_it_was():
    unit = plant(**MOVING)
    run(unit, wobble(5))
    before = unit.get_state()
    with pytest.raises(ArithmeticError, match="range of numbers, x = "):
        unit.step(0.005, 1e-3, (7.0, 0.0, 1e308))
    assert unit.get_state() == before


@pytest.mark.parametrize("inputs", [(nan, 0.0, 0.0), (0.0, inf, 0.0), (0.0, 0.0, nan)])
def test_inputs_that_are_not_finite_are_refused(inputs):
    unit = plant(**MOVING)
    with pytest.raises(ValueError, match="inputs must be finite, found voltage"):
        unit.step(0.0, 1e-3, inputs)


def test_constants_that_contradict_eq_5_are_refused_by_name():
    with pytest.raises(ValueError, match=r"J_p must lie in \[1e-12, 1e\+12\] kg\.m2, found 0\.0"):
        plant(J_p=0.0)
    with pytest.raises(ValueError, match="J_p and J_r must not vanish beside the pendulum's mass, found J_p = 1e-12"):
        plant(J_p=1e-12, J_r=1e-12, m_p=1.0)
