"""Swing-up: it pumps energy toward its target and nowhere else, from rest too, with a bounded acceleration."""

from math import cos, pi

import numpy as np
import pytest

from ihc_fmu.pendulum.interface import INTERFACE
from ihc_fmu.pendulum.nominal_model import accelerations, nominal_model, predict
from ihc_fmu.pendulum.start_values import nominal_values
from ihc_fmu.pendulum.swing_up import saturate, swing_up, swing_up_voltage
from plant_fmu.parameters import parameter_set

LAW = swing_up(INTERFACE.start_values())
MODEL = nominal_model(nominal_values(parameter_set("ident").parameters))
FRICTIONLESS = MODEL._replace(pendulum_damping=0.0, arm_damping=0.0, motor_damping=0.0)
PUMP = LAW._replace(arm_stiffness=0.0, arm_damping=0.0)


def missing_energy(delta, delta_dot, law=LAW):
    """The target, rest upright and e_o above it, minus the pendulum's energy with its pivot held [J]."""
    m = MODEL
    energy = m.pendulum_inertia * delta_dot**2 / 2 + m.gravity_torque * (cos(delta) - 1)
    return law.energy_offset * m.gravity_torque - energy


def arm_acceleration(law, m, theta, delta, theta_dot, delta_dot):
    return accelerations(m, delta, theta_dot, delta_dot, swing_up_voltage(law, m, theta, delta, theta_dot, delta_dot))[
        0
    ]


def test_pumping_moves_the_energy_toward_its_target():
    """Without friction and with the arm momentarily still, dE/dt = varpi/2 cos(delta) delta' theta'' by eq. (5)."""
    moved = 0
    for delta, delta_dot in np.random.default_rng(8).uniform(-1, 1, (300, 2)) * [pi, 20.0]:
        missing = missing_energy(delta, delta_dot)
        theta_ddot, delta_ddot = accelerations(
            FRICTIONLESS, delta, 0.0, delta_dot, swing_up_voltage(PUMP, FRICTIONLESS, 0.0, delta, 0.0, delta_dot)
        )
        power = MODEL.pendulum_inertia * delta_dot * delta_ddot - MODEL.gravity_torque * np.sin(delta) * delta_dot
        assert power == pytest.approx(MODEL.coupling * cos(delta) * delta_dot * theta_ddot, rel=1e-6, abs=1e-12)
        assert power * missing >= -1e-15
        moved += missing < 0.0
    assert 20 < moved < 280  # both signs occurred


def test_energy_rises_from_hanging_to_the_target_within_a_second():
    x, h, highest = (0.0, pi, 0.0, 0.0), 1e-3, []
    for _ in range(1000):
        voltage = saturate(swing_up_voltage(LAW, MODEL, *x), 10.0)
        x = predict(MODEL, *x, voltage, h)
        highest.append(-missing_energy(x[1], x[3]))
    by_quarter = np.max(np.reshape(highest, (4, 250)), axis=1) / MODEL.gravity_torque
    assert by_quarter[0] > -2.0
    assert (np.diff(by_quarter) > 0.0).all() or by_quarter.max() > -0.1
    assert max(highest) > -0.05 * MODEL.gravity_torque
    assert abs(x[0]) < pi


@pytest.mark.parametrize(
    ("delta", "delta_dot", "expected"),
    [
        (pi, 0.0, LAW.acceleration_limit),  # at rest hanging: start anyway, forwards
        (pi + 0.02, -0.04, LAW.acceleration_limit),
        (
            pi,
            0.06,
            -LAW.acceleration_limit * 0.06 / LAW.velocity_scale * 43.0,
        ),  # no longer at rest: by delta' cos delta
        (pi / 3, 0.0, 0.0),  # at rest elsewhere: the pendulum falls by itself
        (pi, 5.0, -LAW.acceleration_limit),
        (pi, -5.0, LAW.acceleration_limit),
        (1.0, 1.0, LAW.acceleration_limit),
        (1.0, -1.0, -LAW.acceleration_limit),
    ],
)
def test_arm_is_accelerated_against_the_pendulums_motion_when_hanging_with_it_when_upright(delta, delta_dot, expected):
    acceleration = arm_acceleration(PUMP, MODEL, 0.0, delta, 0.0, delta_dot)
    limit = LAW.acceleration_limit
    assert acceleration == pytest.approx(saturate(expected, limit), abs=1e-9)


def test_pumping_is_proportional_near_the_target_and_saturates_beyond():
    """a_d = sat(k_e (E* - E) s_1) - k_th theta - k_d theta', against inverse dynamics at random states."""
    proportional = 0
    for theta, delta, theta_dot, delta_dot in np.random.default_rng(9).uniform(-1, 1, (400, 4)) * [1.0, pi, 5.0, 15.0]:
        direction = saturate(delta_dot * cos(delta) / LAW.velocity_scale, 1.0)
        pumping = LAW.energy_gain * missing_energy(delta, delta_dot) * direction
        proportional += abs(pumping) < LAW.acceleration_limit
        wanted = max(-150.0, min(150.0, pumping)) - 50.0 * theta - 10.0 * theta_dot
        acceleration = arm_acceleration(LAW, MODEL, theta, delta, theta_dot, delta_dot)
        assert acceleration == pytest.approx(wanted, rel=1e-9, abs=1e-9)
    assert 10 < proportional < 390


def test_saturation_is_symmetric():
    assert [saturate(v, 2.0) for v in (-3.0, -2.0, 0.5, 2.5)] == [-2.0, -2.0, 0.5, 2.0]
    assert saturate(1.0, 0.0) == 0.0
