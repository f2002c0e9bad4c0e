"""Sliding mode designs: poles of the sliding motion, reaching rate, and the variant that contains the LC."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from ihc_fmu.riccati import lqr_gain
from ihc_fmu.sliding_mode import certified_surface, fitted_smc, linear_pole_smc, sliding_mode_design


def sorted_poles(M):
    return np.sort_complex(np.linalg.eigvals(M))


@pytest.mark.parametrize("n", range(2, 7))
def test_sliding_motion_has_the_prescribed_poles_and_the_surface_is_normalized(n):
    """On s = 0 the equivalent control leaves the poles and one at 0; with kappa that one moves to -kappa."""
    rng = np.random.default_rng(n)
    A, b = rng.normal(size=(n, n)), rng.normal(size=n)
    poles = np.array([-1 + 1j, -1 - 1j, -3, -4, -5][: n - 1] if n > 2 else [-1.0])
    smc = sliding_mode_design(A, b, poles, kappa=9.0, rho=0.5)
    assert smc.c @ b == pytest.approx(1.0, rel=1e-9)
    closed = A + np.outer(b, smc.k_eq)
    np.testing.assert_allclose(sorted_poles(closed), np.sort_complex(np.append(poles, -9.0)), rtol=1e-6)
    np.testing.assert_allclose(smc.c @ closed, -9.0 * smc.c, rtol=1e-6, atol=1e-9)
    assert smc.rho == 0.5


def test_fitted_controller_has_its_documented_numbers(paper):
    A, b, _ = paper
    smc = fitted_smc(A, b)
    poles = sorted_poles(A + np.outer(b, smc.k_eq))
    np.testing.assert_allclose(poles, [-19.3, -12.6 - 17.0j, -12.6 + 17.0j, -1.08], rtol=1e-6)
    np.testing.assert_allclose(smc.k_eq, [1.65, -26.97, 1.70, -2.65], atol=0.005)
    assert (smc.c @ b, smc.rho) == (pytest.approx(1.0), 1.17)


def test_linear_part_of_the_second_variant_is_the_manufacturers_controller(paper):
    """Its surface keeps -5.9054 +- 30.4887j and -1.1206; the fastest real pole, -10.497, is the reaching rate."""
    A, b, k_lin = paper
    smc = linear_pole_smc(A, b, k_lin)
    np.testing.assert_allclose(smc.k_eq, k_lin, rtol=1e-9)
    kappa = -(smc.c @ (A + np.outer(b, k_lin))) @ smc.c / (smc.c @ smc.c)
    assert kappa == pytest.approx(10.497, abs=1e-3)
    sliding = sorted_poles(A - np.outer(b, smc.c @ A))
    np.testing.assert_allclose(sliding[[0, 1, 2]], [-5.9054 - 30.4887j, -5.9054 + 30.4887j, -1.1206], atol=1e-4)


@pytest.mark.parametrize(
    ("poles", "kappa", "rho", "message"),
    [
        ([-1.0, -2.0], 1.0, 1.0, "needs 3 stable poles"),
        ([-1.0, -2.0, 0.0], 1.0, 1.0, "needs 3 stable poles"),
        ([-1.0, -2.0, -3.0 + 1j], 1.0, 1.0, "conjugate pairs"),
        ([-1.0, -2.0, -3.0], -1.0, 1.0, "must be non-negative, found -1.0 1/s"),
        ([-1.0, -2.0, -3.0], 1.0, -2.0, r"and -2.0 V"),
    ],
)
def test_impossible_surface_is_refused(paper, poles, kappa, rho, message):
    with pytest.raises(ValueError, match=message):
        sliding_mode_design(*paper[:2], poles=np.array(poles), kappa=kappa, rho=rho)


def test_loop_without_a_real_pole_has_no_reaching_rate():
    with pytest.raises(ValueError, match="must have a real pole"):
        linear_pole_smc(np.eye(2, k=1), np.array([0.0, 1.0]), np.array([-1.0, -0.5]))


@pytest.mark.parametrize(("n", "m"), [(2, 1), (5, 1), (4, 2), (6, 3), (3, 3)])
def test_certified_surface_is_normalized_reached_at_one_rate_and_slid_on_stably(n, m):
    """S B = I, S (A + B K_s) = -kappa S, and the other n - m poles are stable, for any P that proves A + B K stable."""
    rng = np.random.default_rng(10 * n + m)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    K = lqr_gain(A, B, np.ones(n), np.ones(m), [f"x{i}" for i in range(n)])
    P = solve_continuous_lyapunov((A + B @ K).T, -np.eye(n))
    surface = certified_surface(A, B, K, P)
    closed = A + B @ surface.K_s
    np.testing.assert_allclose(surface.S @ B, np.eye(m), atol=1e-9)
    rates = -np.diag(surface.S @ closed @ np.linalg.pinv(surface.S))
    assert rates.min() > 0.0
    np.testing.assert_allclose(surface.S @ closed, -rates[0] * surface.S, atol=1e-8)
    poles = np.linalg.eigvals(closed)
    assert poles.real.max() < 0.0
    assert np.isclose(poles, -rates[0], rtol=1e-6).sum() >= m
