"""The control laws: the LC as a special case, eq. (8), the authors' numbers, degree of homogeneity, sliding motion."""

from math import exp, log
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from ihc_fmu import homogeneity, laws
from ihc_fmu.companion import chain_form
from ihc_fmu.sliding_mode import fitted_smc, sliding_mode_design
from tests.ihc_fmu.blocks import random_system

examples = settings(deadline=None, derandomize=True, max_examples=150)
SIZES = [(1, 1), (1, 3), (2, 1), (2, 2), (3, 2), (4, 1), (4, 2), (5, 3), (6, 1), (6, 2), (9, 4), (16, 8)]


class Law:
    """A random system, its prepared design and a state."""

    def __init__(self, n, m, mu=1.0, seed=0):
        self.system = random_system(n, m, mu, seed)
        self.design = self.system.design()
        self.x: Any = np.random.default_rng([n, m, seed, 1]).normal(size=n)
        self.z: Any = self.system.T @ self.x

    def gain(self, r):
        """K_r = K_0 + r^(1-mu) (K - K_0) d(-ln r), eq. (8), by the matrix exponential."""
        s = self.system
        return s.K_0 + r ** (1 - s.mu) * (s.K - s.K_0) @ expm(-s.generator() * log(r))

    def explicit(self, r):
        return np.array(laws.implicit_homogeneous(self.design, r, self.x, self.z))

    def semi_implicit(self, r, h):
        return np.array(laws.implicit_homogeneous_semi(self.design, r, h, self.z))


@st.composite
def random_laws(draw):
    n, m = draw(st.integers(1, 16)), draw(st.integers(1, 8))
    return Law(n, m, draw(st.floats(0.01, 1.0)), draw(st.integers(0, 10**6)))


def norm(law, z):
    mu = law.design.mu
    return homogeneity.homogeneous_norm(homogeneity.norm_polynomial(law.design.Pz, z, law.design.exponents, mu), mu)


@examples
@given(random_laws(), st.floats(-3, 3))
def test_homogeneous_part_is_homogeneous_of_degree_one_minus_mu(law, s):
    """u - K_0 x at d(s) x is e^((1-mu) s) times that at x."""
    mu, K_0 = law.system.mu, law.system.K_0

    def homogeneous_part(z):
        x = np.linalg.solve(law.system.T, z)
        return np.array(laws.implicit_homogeneous(law.design, norm(law, z), x, z)) - K_0 @ x

    dilated = np.exp(s * (1 + mu * np.array(law.system.e))) * law.z
    sizes = np.abs(law.system.K) + np.abs(K_0)
    rounding = np.linalg.norm(sizes) * (np.linalg.norm(dilated) + exp((1 - mu) * s) * np.linalg.norm(law.z))
    expected = exp((1 - mu) * s) * homogeneous_part(law.z)
    np.testing.assert_allclose(homogeneous_part(dilated), expected, rtol=1e-9, atol=1e-12 * float(rounding))


@examples
@given(random_laws(), st.integers(1, 8))
def test_bounds_of_one_give_the_linear_law_to_the_last_bit(law, j_max):
    search = homogeneity.NormSearch(False, 1.0, 1.0, j_max)
    c = homogeneity.norm_polynomial(law.design.Pz, law.z, law.design.exponents, law.design.mu)
    r, _ = homogeneity.norm_in_law(search, c, law.design.mu, norm(law, law.z), (1.0, 1.0))
    assert laws.implicit_homogeneous(law.design, r, law.x, law.z) == laws.linear(law.design.K, law.x)


@examples
@given(random_laws())
def test_laws_coincide_on_the_unit_sphere(law):
    """The premise of eq. (10): u = K x where ||x||_d = 1."""
    x = law.x / np.sqrt(law.x @ law.system.P @ law.x)
    z = law.system.T @ x
    u = laws.implicit_homogeneous(law.design, norm(law, z), x, z)
    np.testing.assert_allclose(u, law.system.K @ x, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize(("n", "m"), SIZES)
def test_degree_zero_is_the_linear_law(n, m):
    """mu = 0: the dilation is the standard one, its gains do not depend on the norm."""
    law = Law(n, m, mu=0.0)
    for r in (0.2, 5.0):
        np.testing.assert_allclose(law.explicit(r), law.system.K @ law.x, rtol=1e-11)


@pytest.mark.parametrize("mu", [0.01, 0.5, 1.0])
@pytest.mark.parametrize(("n", "m"), SIZES)
def test_law_is_eq_8_with_the_matrix_exponential(n, m, mu):
    law = Law(n, m, mu)
    for r in (0.2, 0.88, 3.0):
        np.testing.assert_allclose(law.explicit(r), law.gain(r) @ law.x, rtol=1e-8)


@pytest.mark.parametrize("mu", [0.01, 0.5, 1.0])
@pytest.mark.parametrize(("n", "m"), SIZES)
def test_semi_implicit_law_is_the_dense_solution(n, m, mu):
    """u = K_r (I - h (A + B K_r))^-1 x."""
    law = Law(n, m, mu)
    for r in (0.6, 1.0, 2.0):
        for h in (1e-4, 1e-2, 0.5):
            K_r = law.gain(r)
            u = K_r @ np.linalg.solve(np.eye(n) - h * (law.system.A + law.system.B @ K_r), law.x)
            np.testing.assert_allclose(law.semi_implicit(r, h), u, rtol=1e-8, atol=1e-8 * float(np.linalg.norm(u)))


@pytest.mark.parametrize(("n", "m"), SIZES)
def test_semi_implicit_law_tends_to_the_explicit_one_with_order_one(n, m):
    law, r = Law(n, m), 0.9
    errors = [np.linalg.norm(law.semi_implicit(r, h) - law.explicit(r)) for h in (2e-6, 1e-6)]
    assert log(errors[0] / errors[1]) / log(2) == pytest.approx(1.0, abs=0.02)


def test_semi_implicit_law_refuses_a_singular_step():
    """x' = x + u with K = 0 and h = 1: I - h (A + B K) = 0."""
    scalar = [[1.0]]
    one = laws.block_design([0], scalar, [[0.0]], scalar, [[0.0]], [[-1.0]], scalar, 1.0)
    with pytest.raises(ZeroDivisionError):
        laws.implicit_homogeneous_semi(one, 1.0, 1.0, [1.0])
    unit = [[1.0, 0.0], [0.0, 1.0]]
    zero, minus = [[0.0, 0.0]] * 2, [[-1.0, 0.0], [0.0, -1.0]]
    two = laws.block_design([0, 0], unit, zero, unit, zero, minus, unit, 1.0)
    with pytest.raises(ValueError, match="I - g H must be regular"):
        laws.implicit_homogeneous_semi(two, 1.0, 1.0, [1.0, 1.0])


@pytest.mark.parametrize("name", ["hcs_demo", "paper_printed"])
def test_norm_and_controls_are_those_of_the_authors_toolbox(hcs_cases, name):
    case = hcs_cases[name]
    form = chain_form(case["A"], case["B"])
    assert len(case["vectors"]) == 100
    for v in case["vectors"]:
        assert v["monotone"]
        mu, x = -v["mu"], v["x"]
        design = laws.chain_design(form.Phi.tolist(), form.row.tolist(), case["Klin"], case["P"], mu)
        z = form.Phi @ x
        r = homogeneity.homogeneous_norm(homogeneity.norm_polynomial(design.Pz, z, design.exponents, mu), mu)
        clamped = min(1.0, max(0.3, r))
        u = (
            r,
            *laws.implicit_homogeneous(design, r, x, z),
            *laws.implicit_homogeneous(design, clamped, x, z),
            *laws.implicit_homogeneous_semi(design, clamped, 1e-3, z),
        )
        expected = [v[key] for key in ("hnorm", "u_e_hpc", "u_e_hpc_clamp_0.3_1", "u_si_hpc_h1e-3_clamp_0.3_1")]
        assert u == pytest.approx(expected, rel=1e-9)


def test_sliding_mode_switches_by_rho_across_its_surface_and_is_linear_on_it():
    """sign(0) = 0."""
    c, k_eq, rho = [2.0, 1.0], [3.0, 5.0], 0.7
    assert laws.sliding_mode(c, k_eq, rho, [1.0, -2.0]) == -7.0
    assert laws.sliding_mode(c, k_eq, rho, [1.0, -1.5]) == pytest.approx(-4.5 - rho)
    assert laws.sliding_mode(c, k_eq, rho, [1.0, -2.5]) == pytest.approx(-9.5 + rho)


def test_sliding_variable_follows_its_reaching_law(paper):
    """s' = c (A x + b u) = -kappa s - rho sign(s) for any state of the paper's model."""
    A, b, _ = paper
    kappa, rho = 19.3, 1.17
    smc: Any = fitted_smc(A, b)
    for x in np.random.default_rng(2).normal(size=(20, 4)):
        s = smc.c @ x
        derivative = smc.c @ (A @ x + b * laws.sliding_mode(smc.c, smc.k_eq, smc.rho, x))
        assert derivative == pytest.approx(-kappa * s - rho * np.sign(s), rel=1e-9)


def test_sliding_variable_reaches_zero_when_its_reaching_law_says():
    """s(t) = (s_0 + rho/kappa) e^(-kappa t) - rho/kappa ends at t = ln(1 + kappa s_0/rho)/kappa: a double integrator."""
    kappa, rho, h = 2.0, 1.5, 1e-5
    smc: Any = sliding_mode_design(np.eye(2, k=1), np.array([0.0, 1.0]), np.array([-1.0]), kappa, rho)
    position, velocity, t = 1.0, 0.0, 0.0
    s_0 = smc.c @ [position, velocity]
    while smc.c @ [position, velocity] > 0.0:
        u = laws.sliding_mode(smc.c, smc.k_eq, smc.rho, [position, velocity])
        position, velocity, t = position + h * velocity + h * h * u / 2, velocity + h * u, t + h
    assert t == pytest.approx(log(1 + kappa * s_0 / rho) / kappa, abs=5 * h)


def twisted(disturbance, h, *, implicit, rate=2.0, s=0.5, seconds=3.0):
    """Return s of s' = w + d at the samples, and the last v; d is held between them."""
    v, surface = 0.0, [s]
    for k in range(round(seconds / h)):
        w, v = laws.super_twisting(surface[-1], v, rate, h, implicit)
        surface.append(surface[-1] + h * (w + disturbance(k * h)))
    return np.array(surface), v


def test_implicit_super_twisting_takes_a_constant_disturbance_away_and_rests():
    """s = 0 and v = -d to rounding; Euler's explicit method chatters about both."""
    surface, v = twisted(lambda _: 0.7, 1e-3, implicit=True)
    assert np.abs(surface[-500:]).max() < 1e-15
    assert v == pytest.approx(-0.7, abs=1e-12)
    chattering, _ = twisted(lambda _: 0.7, 1e-3, implicit=False)
    assert np.abs(chattering[-500:]).max() > 1e-8


@pytest.mark.parametrize("implicit", [False, True])
def test_what_super_twisting_leaves_of_a_disturbance_below_its_rate_falls_as_the_squared_sample_time(implicit):
    """|d'| <= 1.8 < L = 2: |s| = O(h^2), which no continuous law of s alone reaches."""
    coarse, fine = (
        np.abs(twisted(lambda t: np.sin(1.8 * t), h, implicit=implicit)[0][round(1.5 / h) :]).max()
        for h in (2e-3, 2.5e-4)
    )
    assert np.log(coarse / fine) / np.log(8.0) == pytest.approx(2.0, abs=0.2)


def test_implicit_super_twisting_solves_for_the_next_root_and_is_linear_near_0():
    """Next s = s - h k_1 |next s|^(1/2) sign(s) for v = -d; near 0 (s, v + d) has both poles at 1/2."""
    h, rate = 0.01, 3.0
    k_1, k_2 = 1.5 * np.sqrt(rate), 1.1 * rate
    for s in (0.3, -0.02, 5.0 * h * h * k_2):
        w, v = laws.super_twisting(s, 0.0, rate, h, True)
        following = s + h * w
        assert following == pytest.approx(s - h * k_1 * np.sqrt(abs(following)) * np.sign(s), rel=1e-12)
        assert v == pytest.approx(-h * k_2 * np.sign(s), rel=1e-12)
    s = 1e-9
    (proportional, integral), (kept, _) = (laws.super_twisting(x, v, rate, h, True) for x, v in ((s, 0.0), (0.0, s)))
    step = np.array([[1.0 + h * proportional / s, h * kept / s], [integral / s, 1.0]])
    np.testing.assert_allclose([np.trace(step), np.linalg.det(step)], [1.0, 0.25], rtol=1e-5)


def test_integral_winds_up_only_where_it_moves_to_the_side_that_is_limited():
    assert laws.winds_up(5.1, 0.1, -5.0, 5.0)
    assert laws.winds_up(-5.1, -0.1, -5.0, 5.0)
    assert not laws.winds_up(5.1, -0.1, -5.0, 5.0)
    assert not laws.winds_up(4.9, 0.1, -5.0, 5.0)
