"""The pendulum with its motor: power, symmetry, convergence against SciPy, and the motor's two models."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant_fmu import dynamics
from plant_fmu.parameters import PARAMETER_SETS
from rotary_pendulum.equation import FRICTION_SPEED, energy
from rotary_pendulum.runge_kutta import rk4_step

SETS = [pytest.param(entry.parameters, id=name) for name, entry in PARAMETER_SETS.items()]
IDENT = PARAMETER_SETS["ident"].parameters
RUBBING = replace(IDENT, T_r=5e-4)


def random_states(count, seed=7):
    rng = np.random.default_rng(seed)
    return rng.uniform([-4, -4, -30, -30], [4, 4, 30, 30], (count, 4)).tolist(), rng.uniform(-0.1, 0.1, (count, 2))


def swing(p, *, x=(0.1, 2.0, 1.0, -3.0), back_emf=True, voltage=0.0, h=2e-3, time=1.0):
    c, m = p.coefficients, dynamics.motor(p, back_emf=back_emf)
    for _ in range(round(time / h)):
        x = rk4_step(lambda x: dynamics.derivative_static(c, m, x, voltage, 0.0), x, h)
    return np.array(x)


@pytest.mark.parametrize("p", [*SETS, pytest.param(RUBBING, id="dry friction")])
def test_power_balance_holds_along_the_flow(p):
    c, m = p.coefficients, dynamics.motor(p)
    for x, (tau, tau_p) in zip(*random_states(100), strict=True):
        voltage = 100.0 * tau
        rate = np.array(dynamics.derivative_static(c, m, tuple(x), voltage, tau_p))
        h = 1e-6
        after, before = (energy(c, *(np.array(x) + sign * h * rate)[1:]) for sign in (1, -1))
        motor = p.k_m * (voltage - p.k_m * x[2]) / p.R_m * x[2]
        dry = -p.T_r * x[2] ** 2 / (abs(x[2]) + FRICTION_SPEED)
        terms = motor, tau_p * x[3], -p.D_r * x[2] ** 2, -p.D_p * x[3] ** 2, dry
        assert (after - before) / (2 * h) == pytest.approx(sum(terms), abs=1e-6 * sum(map(abs, terms)))


def test_derivatives_do_not_depend_on_the_arm_angle_and_mirror_with_the_state():
    c, m = IDENT.coefficients, dynamics.motor(IDENT)
    for x, (voltage, tau_p) in zip(*random_states(20), strict=True):
        rate = np.array(dynamics.derivative_static(c, m, tuple(x), voltage, tau_p))
        turned = dynamics.derivative_static(c, m, (x[0] + 1.7, *x[1:]), voltage, tau_p)
        mirrored = dynamics.derivative_static(c, m, tuple(-np.array(x)), -voltage, -tau_p)
        np.testing.assert_array_equal(rate, turned)
        np.testing.assert_array_equal(rate, -np.array(mirrored))


def test_runge_kutta_has_order_four_on_a_swing():
    def error(h):
        return np.linalg.norm(swing(IDENT, voltage=3.0, h=h) - exact)

    c, m = IDENT.coefficients, dynamics.motor(IDENT)
    exact = solve_ivp(
        lambda _, x: dynamics.derivative_static(c, m, tuple(x), 3.0, 0.0),
        (0.0, 1.0),
        (0.1, 2.0, 1.0, -3.0),
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
    ).y[:, -1]
    errors = [error(1.0 / n) for n in (200, 400, 800, 1600)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 4.0, atol=0.2)


@pytest.mark.parametrize("back_emf", [True, False])
def test_static_current_is_the_equilibrium_of_the_inductance_model(back_emf):
    c, m = IDENT.coefficients, dynamics.motor(IDENT, back_emf=back_emf)
    k_e = IDENT.k_m if back_emf else 0.0
    current = dynamics.static_current(m, 5.0, 20.0)
    assert current == pytest.approx((5.0 - k_e * 20.0) / IDENT.R_m, rel=1e-14)
    x = (0.3, 2.0, 20.0, -4.0)
    static = dynamics.derivative_static(c, m, x, 5.0, 0.01)
    np.testing.assert_allclose(
        dynamics.derivative_inductance(c, m, (*x, current), 5.0, 0.01), (*static, 0.0), atol=1e-9
    )


def test_inductance_model_tends_to_the_static_one_at_first_order():
    def final(p, derivative, x):
        c, m = p.coefficients, dynamics.motor(p)
        run = solve_ivp(
            lambda _, x: derivative(c, m, tuple(x), 5.0, 0.0), (0.0, 0.1), x, method="DOP853", rtol=1e-11, atol=1e-11
        )
        return run.y[:4, -1]

    x = (0.0, 2.5, 0.0, 0.0)
    static = final(IDENT, dynamics.derivative_static, x)
    differences = [
        np.linalg.norm(final(replace(IDENT, L_m=L_m), dynamics.derivative_inductance, (*x, 0.0)) - static)
        for L_m in (2e-4, 1e-4, 5e-5)
    ]
    np.testing.assert_allclose(np.log2(np.divide(differences[:-1], differences[1:])), 1.0, atol=0.05)


def test_current_rises_exponentially_on_a_blocked_arm():
    p = replace(IDENT, J_r=1e9)
    c, m = p.coefficients, dynamics.motor(p)
    x, h, time_constant = (0.0, pi, 0.0, 0.0, 0.0), 1e-6, p.L_m / p.R_m
    for n in range(1, 501):
        x = rk4_step(lambda x: dynamics.derivative_inductance(c, m, x, 10.0, 0.0), x, h)
        if n % 100 == 0:
            assert x[4] == pytest.approx(10.0 / p.R_m * (1.0 - np.exp(-n * h / time_constant)), rel=1e-9)
