"""A and b against differences of the dynamics, the printed matrices, and the poles of the manufacturer's gain."""

from dataclasses import replace

import numpy as np
import pytest

from plant_fmu import dynamics
from plant_fmu.linearization import linearize
from plant_fmu.parameters import PARAMETER_SETS

SETS = [pytest.param(entry.parameters, id=name) for name, entry in PARAMETER_SETS.items()]
MANUFACTURERS_GAIN = np.array([2.0, -30.0, 2.0, -2.5])


def closed_loop_poles(name, *, back_emf=True):
    A, b = linearize(PARAMETER_SETS[name].parameters, back_emf=back_emf)
    return np.sort_complex(np.linalg.eigvals(A + np.outer(b, MANUFACTURERS_GAIN)))


@pytest.mark.parametrize("p", SETS)
@pytest.mark.parametrize("back_emf", [True, False])
def test_matrices_are_the_derivatives_of_the_nonlinear_model_upright(p, back_emf):
    c, m = p.coefficients, dynamics.motor(p, back_emf=back_emf)

    def rate(z):
        return np.array(dynamics.derivative_static(c, m, tuple(z[:4]), z[4], 0.0))

    h = 1e-4
    differences = np.column_stack([(rate(h * e) - rate(-h * e)) / (2 * h) for e in np.eye(5)])
    A, b = linearize(p, back_emf=back_emf)
    assert A.shape == (4, 4)
    assert b.shape == (4,)
    np.testing.assert_allclose(A, differences[:, :4], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(b, differences[:, 4], rtol=1e-6, atol=1e-9)


def test_set_matrices_reproduces_the_papers_printed_a_and_b():
    A, b = linearize(PARAMETER_SETS["matrices"].parameters, back_emf=False)
    printed = [[0, 0, 1, 0], [0, 0, 0, 1], [0, 149.2751, -0.0104, 0], [0, 261.6091, -0.0103, 0]]
    np.testing.assert_allclose(A, printed, atol=5.1e-5)
    np.testing.assert_allclose(b, [0, 0, 49.7275, 49.1493], atol=5.1e-5)


def test_back_emf_changes_only_the_column_of_the_arms_velocity():
    p = PARAMETER_SETS["matrices"].parameters
    (A, b), (A_0, b_0) = linearize(p), linearize(p, back_emf=False)
    np.testing.assert_allclose(A[2:, 2], [-2.10, -2.07], atol=5e-3)
    np.testing.assert_allclose(A[2:, 2] - A_0[2:, 2], -p.k_m * b[2:], rtol=1e-12)
    np.testing.assert_array_equal(np.delete(A, 2, axis=1), np.delete(A_0, 2, axis=1))
    np.testing.assert_array_equal(b, b_0)


def test_dry_friction_is_left_out():
    p = PARAMETER_SETS["ident"].parameters
    for with_friction, without in zip(linearize(replace(p, T_r=1e-3)), linearize(p), strict=True):
        np.testing.assert_array_equal(with_friction, without)


def test_manufacturers_gain_has_its_known_poles_on_the_printed_matrices():
    poles = closed_loop_poles("matrices", back_emf=False)
    np.testing.assert_allclose(poles, [-10.50, -5.91 - 30.49j, -5.91 + 30.49j, -1.12], atol=5.1e-3)


def test_listed_damping_makes_the_manufacturers_gain_unstable():
    poles = closed_loop_poles("listed")
    np.testing.assert_allclose(poles[poles.real > 0], [1.34 - 12.7j, 1.34 + 12.7j], atol=0.03)


@pytest.mark.parametrize("name", ["matrices", "ident", "hcs", "swapped"])
@pytest.mark.parametrize("back_emf", [True, False])
def test_manufacturers_gain_is_stable_on_every_other_set(name, back_emf):
    assert closed_loop_poles(name, back_emf=back_emf).real.max() < -1.0
