"""The control laws: the LC as a special case, eq. (8), the authors' numbers, degree of homogeneity, sliding motion."""

from math import exp, log
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from ihc_fmu import homogeneity, laws
from ihc_fmu.companion import chain_form, generator, weights
from ihc_fmu.sliding_mode import fitted_smc, sliding_mode_design

examples = settings(deadline=None, derandomize=True, max_examples=150)


class Law:
    """A random system with a stabilizing gain (poles -1, -2, ...) and everything that the laws take."""

    def __init__(self, n, seed=0):
        rng: Any = np.random.default_rng([n, seed])
        self.A, self.b = rng.normal(size=(n, n)), rng.normal(size=n)
        form = chain_form(self.A, self.b)
        self.Phi: Any = form.Phi
        self.row: Any = form.row
        self.kz: Any = -np.poly(-np.arange(1.0, n + 1))[:0:-1]
        self.k = self.kz @ self.Phi
        self.k_lin = self.k - self.row
        self.row_z: Any = np.linalg.solve(self.Phi.T, self.row)
        self.x = rng.normal(size=n)
        self.z = self.Phi @ self.x

    def gain(self, mu, r):
        """K(r) = r^(1-mu) k d(-ln r) - row, eq. (8), by the matrix exponential."""
        return r ** (1 - mu) * self.k @ expm(-generator(self.Phi, mu) * log(r)) - self.row

    def explicit(self, mu, r):
        return laws.implicit_homogeneous(self.k_lin, self.row, self.kz, mu, r, self.x, self.z)

    def semi_implicit(self, mu, r, h):
        return laws.implicit_homogeneous_semi(self.kz, self.row_z, mu, r, h, self.z)


@st.composite
def chain_laws(draw):
    """(mu, kz, row, Pz, z) in chain coordinates, n = 2..6, the dilation monotone for Pz."""
    n, mu = draw(st.integers(2, 6)), draw(st.floats(0.01, 1.0))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    L = rng.normal(size=(n, n))
    w = weights(n, mu)
    Pz = (L @ L.T + np.eye(n)) / (w[:, None] + w)
    return mu, rng.normal(size=n), rng.normal(size=n), Pz, rng.normal(size=n)


@examples
@given(chain_laws(), st.floats(-3, 3))
def test_chain_control_is_homogeneous_of_degree_one_minus_mu(law, s):
    """u + row x at d(s) x is e^((1-mu) s) times that at x."""
    mu, kz, row, Pz, z = law

    def chain_control(z):
        r = homogeneity.homogeneous_norm(homogeneity.norm_polynomial(Pz, z, mu), mu)
        return laws.implicit_homogeneous(kz - row, row, kz, mu, r, z, z) + row @ z

    dilated = np.exp(s * weights(len(z), mu)) * z
    rounding = (np.abs(kz) + np.abs(row)) @ (np.abs(dilated) + exp((1 - mu) * s) * np.abs(z))
    expected = exp((1 - mu) * s) * chain_control(z)
    assert chain_control(dilated) == pytest.approx(expected, rel=1e-10, abs=1e-12 * rounding)


@examples
@given(chain_laws(), st.integers(1, 8))
def test_bounds_of_one_give_the_linear_law_to_the_last_bit(law, j_max):
    mu, kz, row, Pz, z = law
    k_lin = kz - row
    c = homogeneity.norm_polynomial(Pz, z, mu)
    _, r = homogeneity.bisection_update(c, mu, (1.0, 1.0), 1.0, 1.0, j_max)
    assert laws.implicit_homogeneous(k_lin, row, kz, mu, r, z, z) == laws.linear(k_lin, z)


@examples
@given(chain_laws())
def test_laws_coincide_on_the_unit_sphere(law):
    """The premise of eq. (10): u = k_lin x where ||x||_d = 1."""
    mu, kz, row, Pz, z = law
    y = z / np.sqrt(z @ Pz @ z)
    r = homogeneity.homogeneous_norm(homogeneity.norm_polynomial(Pz, y, mu), mu)
    u = laws.implicit_homogeneous(kz - row, row, kz, mu, r, y, y)
    assert u == pytest.approx((kz - row) @ y, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("mu", [0.01, 0.5, 1.0])
@pytest.mark.parametrize("n", range(1, 7))
def test_law_is_eq_8_with_the_matrix_exponential(n, mu):
    law = Law(n)
    for r in (0.2, 0.88, 3.0):
        assert law.explicit(mu, r) == pytest.approx(law.gain(mu, r) @ law.x, rel=1e-8)


@pytest.mark.parametrize("name", ["hcs_demo", "paper_printed"])
def test_norm_and_controls_are_those_of_the_authors_toolbox(hcs_cases, name):
    case = hcs_cases[name]
    k_lin: Any = np.array(case["Klin"])
    form = chain_form(case["A"], case["B"])
    kz: Any = np.linalg.solve(form.Phi.T, k_lin + form.row)
    row: Any = form.row
    row_z: Any = np.linalg.solve(form.Phi.T, row)
    Pz = homogeneity.to_chain(form.Phi.tolist(), case["P"])
    assert len(case["vectors"]) == 100
    for v in case["vectors"]:
        assert v["monotone"]
        mu, x = -v["mu"], v["x"]
        z = form.Phi @ x
        r = homogeneity.homogeneous_norm(homogeneity.norm_polynomial(Pz, z, mu), mu)
        clamped = min(1.0, max(0.3, r))
        found = (
            r,
            laws.implicit_homogeneous(k_lin, row, kz, mu, r, x, z),
            laws.implicit_homogeneous(k_lin, row, kz, mu, clamped, x, z),
            laws.implicit_homogeneous_semi(kz, row_z, mu, clamped, 1e-3, z),
        )
        expected = [v[key] for key in ("hnorm", "u_e_hpc", "u_e_hpc_clamp_0.3_1", "u_si_hpc_h1e-3_clamp_0.3_1")]
        assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("mu", [0.01, 0.5, 1.0])
@pytest.mark.parametrize("n", range(1, 7))
def test_semi_implicit_law_is_the_dense_solution(n, mu):
    """u = K (I - h (A + b K))^-1 x."""
    law = Law(n)
    for r in (0.3, 1.0, 2.0):
        for h in (1e-4, 1e-2, 0.5):
            K = law.gain(mu, r)
            ahead = np.linalg.solve(np.eye(n) - h * (law.A + np.outer(law.b, K)), law.x)
            assert law.semi_implicit(mu, r, h) == pytest.approx(K @ ahead, rel=1e-8)


@pytest.mark.parametrize("n", range(1, 7))
def test_semi_implicit_law_tends_to_the_explicit_one_with_order_one(n):
    law, mu, r = Law(n), 1.0, 0.9
    errors = [abs(law.semi_implicit(mu, r, h) - law.explicit(mu, r)) for h in (2e-6, 1e-6)]
    assert log(errors[0] / errors[1]) / log(2) == pytest.approx(1.0, abs=0.02)


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
