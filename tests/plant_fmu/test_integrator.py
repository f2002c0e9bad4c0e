"""Runge-Kutta steps against exact solutions, and the number of substeps."""

from math import ceil, cos, exp, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_fmu.integrator import rk4_step, substeps

LENGTHS = st.floats(1e-6, 1.0)
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
    (found,) = rk4_step(lambda x: (z * x[0],), (1.0,), 1.0)
    assert found == pytest.approx(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, rel=1e-12, abs=1e-13)


def test_coupled_states_follow_the_exact_rotation():
    x, n = (1.0, 0.0), 1000
    for _ in range(n):
        x = rk4_step(lambda x: (-x[1], x[0]), x, 5.0 / n)
    assert x == pytest.approx((cos(5.0), sin(5.0)), abs=1e-10)


def test_state_of_a_different_length_than_its_derivative_is_refused():
    with pytest.raises(ValueError, match="zip"):
        rk4_step(lambda x: (exp(x[0]),), (0.0, 1.0), 0.1)


@reproducible
@given(LENGTHS, LENGTHS)
def test_substeps_are_the_fewest_that_are_short_enough(step, largest):
    n = substeps(step, largest)
    assert isinstance(n, int)
    assert n >= 1
    assert step / n <= largest * (1 + 2e-9)
    assert n == 1 or step / (n - 1) > largest


@reproducible
@given(st.integers(1, 100_000), LENGTHS)
def test_a_multiple_is_divided_exactly_in_spite_of_rounding(n, largest):
    assert substeps(n * largest, largest) == n
    assert substeps(n * largest * (1 + 1e-12), largest) == n


@reproducible
@given(st.integers(1, 10_000), st.floats(0.01, 0.99), LENGTHS)
def test_a_remainder_needs_one_substep_more(n, remainder, largest):
    assert substeps((n + remainder) * largest, largest) == n + 1 == ceil(n + remainder)
