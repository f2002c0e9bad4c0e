"""The controller's model: equal to the plant's equations, inverted exactly, integrated with order four."""

from functools import partial
from math import log, pi
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ihc_fmu.pendulum.nominal_model import accelerations, nominal_model, predict, voltage_for
from ihc_fmu.pendulum.start_values import nominal_values
from plant_fmu import dynamics
from plant_fmu.parameters import PARAMETER_SETS, parameter_set
from rotary_pendulum.runge_kutta import rk4_step

SETS = list(PARAMETER_SETS)


def model(name="ident"):
    return nominal_model(nominal_values(parameter_set(name).parameters))


def plant_derivative(name, voltage):
    p = parameter_set(name).parameters
    return partial(dynamics.derivative_static, p.coefficients, dynamics.motor(p), voltage=voltage, tau_p=0.0)


def random_states(count=30):
    """(theta, delta, theta', delta', voltage) over all angles and fast motion."""
    return np.random.default_rng(6).uniform(-1, 1, (count, 5)) * [pi, pi, 30.0, 30.0, 18.0]


@pytest.mark.parametrize("name", SETS)
def test_accelerations_are_those_of_the_plant_with_back_emf(name):
    for theta, delta, theta_dot, delta_dot, voltage in random_states():
        expected = plant_derivative(name, voltage)((theta, delta, theta_dot, delta_dot))[2:]
        assert accelerations(model(name), delta, theta_dot, delta_dot, voltage) == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("name", SETS)
def test_inverse_dynamics_gives_the_wanted_arm_acceleration(name):
    m = model(name)
    for _, delta, theta_dot, delta_dot, wanted in random_states() * [1, 1, 1, 1, 20]:
        voltage = voltage_for(m, delta, theta_dot, delta_dot, wanted)
        acceleration, _ = accelerations(m, delta, theta_dot, delta_dot, voltage)
        assert acceleration == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("name", SETS)
def test_prediction_is_the_plants_runge_kutta_step(name):
    for *x, voltage in random_states():
        expected = rk4_step(plant_derivative(name, voltage), tuple(x), 1e-3)
        assert predict(model(name), *x, voltage=voltage, h=1e-3) == pytest.approx(expected, rel=1e-13, abs=1e-13)


def test_prediction_has_order_four():
    """Global error against SciPy over 0.2 s from a fall, for steps of 10 and 5 ms."""
    x_0, voltage, duration = (0.1, 0.5, 2.0, -1.0), 3.0, 0.2
    f = plant_derivative("ident", voltage)
    exact = solve_ivp(lambda t, x: f(tuple(x)), (0, duration), x_0, rtol=1e-12, atol=1e-13).y[:, -1]
    errors = []
    for count in (20, 40):
        x: Any = x_0
        for _ in range(count):
            x = predict(model(), *x, voltage=voltage, h=duration / count)
        errors.append(np.linalg.norm(np.array(x) - exact))
    assert log(errors[0] / errors[1]) / log(2) == pytest.approx(4.0, abs=0.2)


def test_model_takes_each_of_its_coefficients_from_its_own_parameter():
    values = {f"nominal_{name}": 9.0 - i for i, name in enumerate(model()._fields)}
    assert nominal_model(values) == tuple(range(9, 0, -1))


@pytest.mark.parametrize("inertia", [1.0, 0.5, 1.0 + 1e-12])
def test_inertia_matrix_without_a_determinant_is_refused(inertia):
    """J = [[inertia, -1], [-1, 1]]: singular, indefinite, singular in rounding."""
    values = {f"nominal_{name}": 1.0 for name in model()._fields} | {"nominal_arm_inertia": inertia}
    with pytest.raises(ValueError, match="the square of nominal_coupling must be below"):
        nominal_model(values)
