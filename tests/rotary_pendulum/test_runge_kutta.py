"""Runge-Kutta steps against exact solutions, of numbers and of arrays."""

from math import cos, exp, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotary_pendulum.runge_kutta import rk4_step

reproducible = settings(deadline=None, derandomize=True, database=None)


def integrate_power(degree, t, h):
    """One step of y' = (degree + 1) t^degree with the time as first state, from y(t) = t^(degree + 1)."""
    return rk4_step(lambda x: (1.0, (degree + 1) * x[0] ** degree), (t, t ** (degree + 1)), h)


@pytest.mark.parametrize("degree", range(4))
def test_solutions_that_are_polynomials_up_to_degree_four_are_exact(degree):
    t, h = 0.7, 1.9
    assert integrate_power(degree, t, h) == pytest.approx((t + h, (t + h) ** (degree + 1)), rel=1e-14)


def test_fifth_degree_solution_has_the_error_of_simpsons_rule():
    h = 0.8
    assert integrate_power(4, 0.0, h)[1] - h**5 == pytest.approx(5 * h**5 / 120, rel=1e-12)


@reproducible
@given(st.floats(-4.0, 4.0))
def test_one_step_of_a_linear_equation_is_the_truncated_exponential(z):
    (factor,) = rk4_step(lambda x: (z * x[0],), (1.0,), 1.0)
    assert factor == pytest.approx(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, rel=1e-12, abs=1e-13)


def test_coupled_states_follow_the_exact_rotation():
    x, n = (1.0, 0.0), 1000
    for _ in range(n):
        x = rk4_step(lambda x: (-x[1], x[0]), x, 5.0 / n)
    assert x == pytest.approx((cos(5.0), sin(5.0)), abs=1e-10)


def test_state_of_a_different_length_than_its_derivative_is_refused():
    with pytest.raises(ValueError, match="zip"):
        rk4_step(lambda x: (exp(x[0]),), (0.0, 1.0), 0.1)


def test_arrays_are_many_models_at_once():
    rates: Any = np.array([-1.0, 0.5, 2.0])
    ones: Any = np.ones(3)
    states: Any = rk4_step(lambda x: (x[1], rates * x[0]), (ones, rates), 0.1)
    for i, rate in enumerate(rates.tolist()):
        assert rk4_step(lambda x, rate=rate: (x[1], rate * x[0]), (1.0, rate), 0.1) == (states[0][i], states[1][i])
