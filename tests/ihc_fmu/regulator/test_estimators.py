"""The homogeneous observer: the toolbox, the linear observer as a special case, convergence; an innovation weighed."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from ihc_fmu.block_form import block_form
from ihc_fmu.regulator.estimators import HomogeneousObserver, observer_gain, observer_step
from ihc_fmu.sampled_unit import weighed
from tests.ihc_fmu.reference import SYSTEMS

H = 1e-3


def coordinates(G_0):
    """Return T and e with G_0 = (T^-1 diag(e) T)', e falling."""
    values, V = map(np.real, np.linalg.eig(np.array(G_0).T))
    order = np.argsort(-values)
    return np.linalg.inv(V[:, order]), np.rint(values[order]).astype(int)


def observer(A, B, C, T, e, L_0, L, nu, limits=(1e-9, 1e9)) -> Any:
    T = np.array(T)
    Lz = np.linalg.solve(T.T, np.array(L) - L_0)
    A, B, C, T, L_0, Lz = (np.array(M, dtype=float).tolist() for M in (A, B, C, T, L_0, Lz))
    return HomogeneousObserver(A, B, C, T, [int(k) for k in e], L_0, Lz, nu, *limits)


@pytest.mark.parametrize("name", SYSTEMS)
def test_step_is_that_of_the_authors_toolbox(name):
    system = SYSTEMS[name]
    part = system["lo2ho"]
    T, e = coordinates(part["G0"])
    n = len(T)
    C, y_count = np.atleast_2d(system["C"]), len(np.atleast_2d(system["C"]))
    L, L_0 = (np.array(M, dtype=float).reshape(n, y_count) for M in (system["L_lin"], part["L0"]))
    for v in part["vectors"]:
        z, y, f = (np.ravel(v[name]).tolist() for name in ("z", "y", "f"))
        for limits, key in (((1e-9, 1e9), "z_semi_implicit_h1e-3"), ((0.4, 1.0), "z_semi_clamped_0.4_1")):
            ours = observer(system["A"], np.eye(n), C, T, e, L_0, L, v["nu"], limits)
            np.testing.assert_allclose(observer_step(ours, H, z, f, y), np.ravel(v[key]), rtol=1e-9, atol=1e-12)


def pair():
    """Return (A, B, C, block form of (A', C'), a linear observer's gain with poles near -3) of a chain of three."""
    A, B, C = np.eye(3, k=1), np.array([[0.0], [0.0], [1.0]]), np.array([[1.0, 0.0, 0.0]])
    return A, B, C, block_form(A.T, C.T), -np.array([[9.0], [27.0], [27.0]])


def test_degree_0_is_the_linear_observer():
    A, B, C, form, L = pair()
    ours = observer(A, B, C, form.T, form.exponents, form.K_0.T, L, 0.0)
    for x, y in ((np.array([0.3, -0.2, 0.5]), [0.1]), (np.zeros(3), [4.0])):
        np.testing.assert_allclose(observer_gain(ours, x.tolist(), y), L, atol=1e-12)
        expected = np.linalg.solve(np.eye(3) - H * (A + L @ C), x + H * B[:, 0] * 0.7 - H * L @ y)
        np.testing.assert_allclose(observer_step(ours, H, x.tolist(), [0.7], y), expected, rtol=1e-12)


def test_gain_is_its_formula_with_the_matrix_exponential():
    """S = L_0 + exp(ln q (nu I + G_d - I)) (L - L_0), G_d = I + nu G_0."""
    system = SYSTEMS["planar_rotorcraft"]
    A, C, nu = np.array(system["A"]), np.array(system["C"]), -0.2
    form = block_form(A.T, C.T)
    L, L_0 = np.array(system["L_lin"]), form.K_0.T
    G_0 = (form.T_inverse @ np.diag(form.exponents) @ form.T).T
    ours = observer(A, np.eye(6), C, form.T, form.exponents, L_0, L, nu)
    x, y = np.random.default_rng(1).normal(size=6), np.linspace(0.3, -0.2, len(C))
    q = np.linalg.norm(C @ x - y)
    expected = L_0 + expm(np.log(q) * nu * (np.eye(6) + G_0)) @ (L - L_0)
    np.testing.assert_allclose(observer_gain(ours, x.tolist(), y.tolist()), expected, rtol=1e-9, atol=1e-9)


def test_error_vanishes_sooner_than_that_of_the_linear_observer():
    """Far below what the linear one reaches, under a known input; the gain is bounded by q_min."""
    A, B, C, form, L = pair()
    block = expm(H * np.block([[A, B], [np.zeros((1, 4))]]))

    def error(nu):
        ours = observer(A, B, C, form.T, form.exponents, form.K_0.T, L, nu, (1e-3, 1.0))
        x, estimate = np.array([0.2, -0.1, 0.3]), np.zeros(3).tolist()
        for k in range(4000):
            u = np.sin(0.01 * k)
            x = block[:3, :3] @ x + block[:3, 3] * u
            estimate = observer_step(ours, H, estimate, [u], [float((C @ x)[0])])
        return np.abs(np.array(estimate) - x)

    linear, homogeneous = error(0.0), error(-0.2)
    assert homogeneous[0] < 0.1 * linear[0]


def test_of_an_innovation_what_is_within_half_a_count_has_the_weight():
    count, weight = 0.003, 0.6
    for e in (0.0, 1e-3, -1.5e-3):
        assert weighed(e, count, weight) == pytest.approx(weight * e, rel=1e-12)
    for e in (2e-3, -0.5):
        assert weighed(e, count, weight) == pytest.approx(e - np.sign(e) * (1.0 - weight) * count / 2.0, rel=1e-12)
    for e in (0.0, 1e-3, -0.1, 1e300):
        assert weighed(e, count, 1.0) == e
