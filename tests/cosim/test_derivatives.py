"""Differences with error estimates, and equilibria, against closed forms."""

import numpy as np
import pytest

from cosim.derivatives import EvaluationError, jacobian, solve

ONE = np.ones(1)


def smooth(z):
    return np.array([np.sin(z[0]) * np.exp(z[1]), z[0] ** 3 + 5.0, z[1]])


def test_a_smooth_function_is_differentiated_to_rounding_and_the_error_is_no_less_than_it_is():
    z = np.array([0.7, -0.3])
    exact = np.array([[np.cos(0.7) * np.exp(-0.3), np.sin(0.7) * np.exp(-0.3)], [3 * 0.49, 0.0], [0.0, 1.0]])
    found = jacobian(smooth, z, np.ones(2))
    np.testing.assert_allclose(found.J, exact, rtol=1e-10, atol=1e-10)
    assert found.error.max() < 1e-9
    assert (np.abs(found.J - exact) <= 10 * found.error + 1e-14).all()
    assert not found.kink.any()


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_variables_of_any_size_are_if_their_size_is_said(scale):
    found = jacobian(lambda z: np.sin(z / scale), np.array([0.5 * scale]), scale * ONE)
    assert found.J[0, 0] * scale == pytest.approx(np.cos(0.5), rel=1e-10)


def test_a_function_that_varies_faster_than_the_size_says_is_found_out_by_smaller_steps():
    found = jacobian(lambda z: np.sin(1e4 * z), 0.5e-4 * ONE, ONE)
    assert found.J[0, 0] == pytest.approx(1e4 * np.cos(0.5), rel=1e-6)


def test_a_function_that_moves_in_steps_is_told_by_its_error():
    for resolution in (1e-3, 1e-5):
        found = jacobian(lambda z, q=resolution: q * np.floor(z / q), 0.3 * ONE, ONE)
        assert found.error[0, 0] > 10 * resolution


@pytest.mark.parametrize(("f", "gap"), [(np.abs, 2.0), (lambda z: np.minimum(z, 0.0), 1.0)])
def test_a_kink_is_told_by_the_difference_of_the_slopes(f, gap):
    assert jacobian(f, np.zeros(1), ONE).kink[0, 0] == pytest.approx(gap)


def test_a_jump_has_no_derivative():
    found = jacobian(lambda z: np.sign(z) + z, np.zeros(1), ONE)
    assert found.error[0, 0] > 0.1 * abs(found.J[0, 0])


def test_smaller_steps_are_tried_where_a_function_ends():
    def root(z):
        if z[0] < 0.0:
            raise EvaluationError("negative")
        return np.sqrt(z)

    assert jacobian(root, 1e-3 * ONE, ONE).J[0, 0] == pytest.approx(0.5 / np.sqrt(1e-3), rel=1e-6)
    with pytest.raises(EvaluationError, match="negative"):
        jacobian(root, np.zeros(1), ONE)
    with pytest.raises(EvaluationError, match="not finite"), np.errstate(invalid="ignore"):
        jacobian(np.sqrt, np.zeros(1), ONE)


def pendulum(z):  # angle, rate, an integrator of the angle's rate, torque
    return np.array([z[1], np.sin(z[0]) - 0.1 * z[1] + z[3], z[1]])


def pendulum_jacobian(z):
    return np.array([[0, 1, 0, 0], [np.cos(z[0]), -0.1, 0, 1], [0, 1, 0, 0]], dtype=float)


def test_the_nearest_equilibrium_is_found_and_what_has_no_influence_stays():
    start = np.array([2.6, 0.4, 7.0, 0.0])
    found = solve(pendulum, pendulum_jacobian, start, [0, 1, 2], np.ones(4))
    np.testing.assert_allclose(found, [np.pi, 0.0, 7.0, 0.0], atol=1e-12)


def test_a_free_input_holds_what_stays():
    found = solve(pendulum, pendulum_jacobian, np.array([1.0, 0.0, 7.0, 0.0]), [1, 2, 3], np.ones(4))
    np.testing.assert_allclose(found, [1.0, 0.0, 7.0, -np.sin(1.0)], atol=1e-12)


def test_where_there_is_none_the_search_ends():
    found = solve(lambda z: z**2 + 1.0, lambda z: np.diag(2 * z), ONE, [0], ONE)
    assert abs(found[0]) < 0.1
