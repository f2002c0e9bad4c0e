"""The homogeneous norm: its defining equation, its homogeneity, and Algorithm 1 of the paper."""

from math import ceil, exp, inf, isnan, log, log2, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import brentq

from ihc_fmu import homogeneity as hom
from ihc_fmu.companion import generator
from ihc_fmu.linear_algebra import product
from tests.ihc_fmu.blocks import exponents_of, random_blocks, random_system
from tests.ihc_fmu.conftest import chain_of

examples = settings(deadline=None, derandomize=True, max_examples=150)
degrees = st.floats(0.01, 1.0)


def weights(e, mu):
    return 1 + mu * np.array(e)


@st.composite
def block_states(draw):
    """(e, mu, Pz, z), n = 1..16 in any blocks; Pz solves diag(w) Pz + Pz diag(w) = Q > 0, so the norm is unique."""
    n, mu = draw(st.integers(1, 16)), draw(degrees)
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    e = exponents_of(random_blocks(rng, n, draw(st.integers(1, 8))))
    L = rng.normal(size=(n, n))
    w = weights(e, mu)
    Pz = (L @ L.T + np.eye(n)) / (w[:, None] + w)
    return e, mu, Pz, rng.normal(size=n) * 10.0 ** draw(st.floats(-5, 3))


def norm(Pz, z, e, mu, guess=1.0):
    return hom.homogeneous_norm(hom.norm_polynomial(Pz.tolist(), z.tolist(), e, mu), mu, guess)


def dilated(z, e, mu, s):
    return np.exp(s * weights(e, mu)) * z


@examples
@given(block_states())
def test_norm_is_the_root_found_by_brent(state):
    e, mu, Pz, z = state

    def logarithm_of_n(sigma):
        y = dilated(z, e, mu, -sigma)
        return log(y @ Pz @ y)

    root: Any = brentq(logarithm_of_n, -20.0, 20.0, xtol=1e-15)
    assert norm(Pz, z, e, mu) == pytest.approx(exp(root), rel=1e-12)


@examples
@given(block_states(), st.floats(-5, 5))
def test_norm_is_homogeneous_of_degree_one(state, s):
    e, mu, Pz, z = state
    assert norm(Pz, dilated(z, e, mu, s), e, mu) == pytest.approx(exp(s) * norm(Pz, z, e, mu), rel=1e-12)


@examples
@given(block_states(), st.floats(-1, 1))
def test_norm_is_homogeneous_for_states_of_every_size(state, where):
    """Dilated by a power of 2 that brings coordinates to 1e-280 or 1e280: exact where the weights are integers, mu = 1."""
    e, _, Pz, z = state
    k = int(where * 900 / (1 + e[0]))
    y = np.array([entry * 2.0 ** (k * (1 + e_j)) for entry, e_j in zip(z, e, strict=True)])
    assert norm(Pz, y, e, 1.0) == pytest.approx(2.0**k * norm(Pz, z, e, 1.0), rel=1e-12)


@examples
@given(block_states(), st.floats(-27, 27))
def test_warm_start_does_not_change_the_norm(state, sigma):
    e, mu, Pz, z = state
    assert norm(Pz, z, e, mu, guess=exp(sigma)) == pytest.approx(norm(Pz, z, e, mu), rel=1e-13)


@pytest.mark.parametrize("guess", [0.0, -1.0, inf, nan])
def test_useless_guess_is_ignored(guess):
    c = hom.norm_polynomial(np.eye(4).tolist(), [0.1, -0.2, 0.3, 0.4], [1, 1, 0, 0], 1.0)
    assert hom.homogeneous_norm(c, 1.0, guess) == hom.homogeneous_norm(c, 1.0)


def test_norm_of_zero_and_of_states_that_are_not_numbers():
    assert norm(np.eye(4), np.zeros(4), hom.chain(4), 1.0) == 0.0
    for bad in (nan, inf, -inf):
        for i in range(4):
            with np.errstate(invalid="ignore"):
                assert isnan(norm(np.eye(4), np.where(np.arange(4) == i, bad, 1.0), [1, 1, 0, 0], 1.0))


@pytest.mark.parametrize("mu", [0.01, 0.5, 1.0])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 2), (3, 1), (4, 2), (5, 3), (6, 1), (9, 4), (16, 8)])
def test_polynomial_equals_the_norm_by_the_matrix_exponential(n, m, mu):
    """||d(-ln r) x||_P^2 with d(s) = expm(G_d s), in the coordinates of a random system."""
    system = random_system(n, m, mu)
    P, x = system.P, np.random.default_rng(n).normal(size=n)
    T = system.T.tolist()
    c = hom.norm_polynomial(hom.to_blocks(T, P.tolist()), product(T, x.tolist()), system.e, mu)
    assert len(c.c) == 2 * system.e[0] + 1
    assert sum(c.c) == pytest.approx(x @ P @ x, rel=1e-9)
    for r in (0.3, 0.9, 1.0, 2.5):
        y = expm(-system.generator() * log(r)) @ x
        assert hom.squared_norm(c, mu, r) == pytest.approx(y @ P @ y, rel=1e-8)


def test_norm_of_the_papers_system_solves_eq_12(designs):
    """Random states of the pendulum in its own coordinates, where Phi spans eleven decades."""
    for mu, design in designs.items():
        G, Pz = generator(chain_of(design).Phi, mu), hom.to_blocks(chain_of(design).Phi.tolist(), design.P.tolist())
        for x in np.random.default_rng(5).normal(size=(30, 4)) * [0.3, 0.1, 1.0, 1.0]:
            r = norm(np.array(Pz), chain_of(design).Phi @ x, hom.chain(4), mu)
            y = expm(-G * log(r)) @ x
            assert y @ design.P @ y == pytest.approx(1.0, abs=1e-9)


# Algorithm 1


def clip(value, low, high):
    return min(high, max(low, value))


@st.composite
def searches(draw):
    """(c, mu, norm, starting interval, a_min, b_max, j_max): bounds on either side of the norm, or both beyond it."""
    e, mu, Pz, z = draw(block_states())
    c = hom.norm_polynomial(Pz.tolist(), z.tolist(), e, mu)
    r = hom.homogeneous_norm(c, mu)
    a_min = r * 2.0 ** draw(st.floats(-8, 4))
    b_max = a_min * 2.0 ** draw(st.floats(0, 8))
    low, high = sorted(clip(a_min * 2.0 ** draw(st.floats(0, 8)), a_min, b_max) for _ in range(2))
    return c, mu, r, (low, high), a_min, b_max, draw(st.integers(1, 6))


@examples
@given(searches())
def test_estimate_converges_to_the_norm_within_its_bounds(search):
    c, mu, r, interval, a_min, b_max, j_max = search
    until_bracketed = ceil(log2(b_max / a_min)) + 2
    for _ in range(until_bracketed + ceil(44 / j_max)):
        interval = hom.bisection_update(c, mu, interval, a_min, b_max, j_max)
        assert a_min <= interval[0] <= interval[1] <= b_max
    assert interval[1] == pytest.approx(clip(r, a_min, b_max), rel=1e-9)


@examples
@given(block_states(), st.integers(1, 8))
def test_bracket_contracts_by_two_to_the_j_max_and_keeps_the_norm(state, j_max):
    e, mu, Pz, z = state
    c = hom.norm_polynomial(Pz.tolist(), z.tolist(), e, mu)
    r = hom.homogeneous_norm(c, mu)
    a, b = 0.7 * r, 1.9 * r
    low, high = hom.bisection_update(c, mu, (a, b), a, b, j_max)
    assert high - low == pytest.approx((b - a) * 2.0**-j_max, rel=1e-9)
    assert low * (1 - 1e-12) <= r <= high * (1 + 1e-12)


@examples
@given(block_states(), st.integers(1, 8))
def test_bounds_of_one_give_exactly_one(state, j_max):
    """With a_min = b_max = 1 the controller is the linear one, section IV-A."""
    e, mu, Pz, z = state
    c, interval = hom.norm_polynomial(Pz.tolist(), z.tolist(), e, mu), (1.0, 1.0)
    for _ in range(5):
        interval = hom.bisection_update(c, mu, interval, 1.0, 1.0, j_max)
        assert interval == (1.0, 1.0)


def printed_algorithm_1(c, mu, interval, a_min, b_max, j_max):
    """Lines 1 to 12 as printed."""
    a, b = interval
    if hom.squared_norm(c, mu, b) > 1.0:
        a, b = b, min(2.0 * b, b_max)
    elif hom.squared_norm(c, mu, b) < 1.0:
        a = b
        a = max(a / 2.0, a_min)
    else:
        for _ in range(j_max):
            middle = (a + b) / 2.0
            a, b = (a, middle) if hom.squared_norm(c, mu, middle) < 1.0 else (middle, b)
    return a, b


def test_algorithm_as_printed_stays_linear_inside_the_unit_ball():
    e, mu, a_min, b_max = hom.chain(4), 1.0, 0.05, 1.0
    z = dilated(np.array([0.5, 0.5, 0.5, 0.5]), e, mu, log(0.2))  # norm 0.2 for P = I
    c = hom.norm_polynomial(np.eye(4).tolist(), z.tolist(), e, mu)
    printed = ours = (a_min, b_max)
    for _ in range(20):
        printed = printed_algorithm_1(c, mu, printed, a_min, b_max, 3)
        ours = hom.bisection_update(c, mu, ours, a_min, b_max, 3)
    assert printed[1] == b_max
    assert ours[1] == pytest.approx(0.2, rel=1e-9)


def test_norm_is_found_from_any_guess_where_newton_alone_would_cycle(design):
    """States on which an unguarded Newton iteration jumps to and fro for ever, and many more from far guesses."""
    Pz = hom.to_blocks(chain_of(design).Phi.tolist(), design.P.tolist())
    rng = np.random.default_rng(4)
    states: list[Any] = [np.array([4.54209828, 0.89417266, 0.05005187, -3.00770324])]
    states += [np.array([112839.47, 36.992, -303.178, -2.51214])]
    states += list(rng.normal(size=(500, 4)) * 10.0 ** rng.uniform(-5, 4, (500, 4)))
    for x in states:
        c = hom.norm_polynomial(Pz, (chain_of(design).Phi @ x).tolist(), hom.chain(4), 1.0)
        for guess in (1.0, 1e-6, 1e10, 1e100, 1e-60, 0.0, nan):
            r = hom.homogeneous_norm(c, 1.0, guess)
            assert hom.squared_norm(c, 1.0, r * (1 - 1e-9)) > 1.0 > hom.squared_norm(c, 1.0, r * (1 + 1e-9))
