"""E and G of a held input: closed forms, arithmetic of 60 digits, SciPy, and what must be refused."""

from math import cosh, exp, expm1, factorial, sinh

import mpmath
import numpy as np
import pytest
from scipy.linalg import expm

from fmu_export.errors import UserError
from plant_fmu.linear.exponential import held_input

RNG = np.random.default_rng(7)


def held(A, B, h):
    return tuple(np.array(M) for M in held_input(np.array(A, float).tolist(), np.array(B, float).tolist(), h))


def augmented(A, B):
    n, m = np.shape(B)
    M = np.zeros((n + m, n + m))
    M[:n, :n], M[:n, n:] = A, B
    return M


def reference(A, B, h):
    """E and G by 2^-s, a Taylor series and squaring in long arithmetic: digits for each squaring, and 60."""
    n, m = np.shape(B)
    squarings = max(0, int(np.log2(np.abs(augmented(A, B)).sum(axis=1).max() * h))) + 5
    with mpmath.workdps(60 + squarings):
        X = mpmath.matrix(augmented(A, B).tolist()) * mpmath.mpf(h) / mpmath.mpf(2) ** squarings
        total, term = mpmath.eye(n + m), mpmath.eye(n + m)
        for k in range(1, 40):
            term = term * X / k
            total += term
        for _ in range(squarings):
            total = total * total
        total -= mpmath.eye(n + m)
        F = np.array(total.tolist(), dtype=float)
    return F[:n, :n], F[:n, n:]


def error(actual, expected):
    """The largest error of an entry, relative to the largest entry."""
    return max(np.abs(f - e).max() / np.abs(e).max() for f, e in zip(actual, expected, strict=True))


def stiff(fastest):
    """A symmetric model whose modes, 0.01 rad/s to `fastest`, all take part in all states."""
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=(4, 4)))[0]
    return Q @ np.diag([-fastest, -100.0, -1.0, -0.01]) @ Q.T


def in_units(A, exponents):
    """The same model with its states in other units."""
    D = np.diag(10.0 ** np.array(exponents))
    return D @ A @ np.linalg.inv(D)


MIXED = np.random.default_rng(2).normal(size=(4, 4))
MODELS = {  # A, h [s], largest relative error
    "moderate": (MIXED, 1.0, 2e-15),
    "short step": (MIXED, 1e-9, 1e-15),
    "fast oscillator": ([[0.0, 1.0], [-4e4, 0.0]], 0.5, 1e-13),
    "oscillator far beyond a turn": ([[0.0, 1.0], [-1e8, 0.0]], 1.0, 1e-11),
    "motor with inductance": ([[0, 1, 0], [0, -0.1, 50.0], [0, -40.0, -8.4e6]], 1e-2, 1e-15),
    "stiff 1e4": (stiff(1e4), 1.0, 1e-12),
    "stiff 1e6": (stiff(1e6), 1.0, 1e-10),
    "unstable": ([[0.0, 1.0], [1e4, 0.0]], 1.0, 1e-13),
    "units apart": (in_units(MIXED, [-6, 0, 6, 3]), 1.0, 1e-14),
    "units far apart": (in_units(MIXED, [-60, 0, 60, 30]), 1.0, 1e-14),
    "large coupling": ([[1.0, 1e6], [0.0, -1.0]], 1.0, 1e-15),
}


@pytest.mark.parametrize("name", MODELS)
def test_models_agree_with_long_arithmetic(name):
    A, h, tolerance = MODELS[name]
    A, B = np.array(A, float), np.ones((len(A), 2)) * [1.0, -3.0]
    assert error(held(A, B, h), reference(A, B, h)) < tolerance


@pytest.mark.parametrize("seed", range(16))
def test_random_models_agree_with_scipy(seed):
    rng = np.random.default_rng(seed)
    n, m = seed + 1, seed % 8 + 1
    A, B, h = rng.normal(size=(n, n)), rng.normal(size=(n, m)), 10 ** rng.uniform(-3, 0.5)
    F = expm(augmented(A, B) * h)
    E, G = held(A, B, h)
    np.testing.assert_allclose(np.eye(n) + E, F[:n, :n], rtol=1e-11, atol=1e-11 * np.abs(F).max())
    np.testing.assert_allclose(G, F[:n, n:], rtol=1e-11, atol=1e-11 * np.abs(F).max())


@pytest.mark.parametrize("n", [1, 2, 4, 16])
def test_chain_of_integrators_has_the_powers_of_the_step(n):
    """h = 1/4, and powers of 2 as gains: every entry h^k/k! times gains is rounded once."""
    gains = np.diag(2.0 ** RNG.integers(-40, 40, size=n))
    A, B, h = np.diag(np.ones(n - 1), 1) @ gains, gains[:, -1:], 0.25
    E, G = held(A, B, h)
    chain = np.diag(np.ones(n - 1), 1) @ gains
    power = np.eye(n)
    expected = np.zeros((n, n))
    expected_G = np.zeros((n, 1))
    for k in range(n):
        expected += power / factorial(k) * (k > 0)
        expected_G += h * power @ B / factorial(k + 1)
        power = power @ (chain * h)
    np.testing.assert_allclose(E, expected, rtol=4e-16, atol=0.0)
    np.testing.assert_allclose(G, expected_G, rtol=4e-16, atol=0.0)


def test_modes_keep_all_digits_beside_faster_ones():
    """The mode of 1e-6 rad/s is e^-1e-6 after 1 s; e^(A h) - I holds the 1e-6 to 16 digits, which e^(A h) does not."""
    rates = [1e6, 1.0, 1e-6]
    E, G = held(np.diag([-rate for rate in rates]), np.ones((3, 1)), 1.0)
    np.testing.assert_allclose(np.diag(E), [expm1(-rate) for rate in rates], rtol=1e-15)
    np.testing.assert_allclose(G[:, 0], [-expm1(-rate) / rate for rate in rates], rtol=1e-15)


def test_unstable_pair_is_hyperbolic():
    E, G = held([[0.0, 1.0], [9.0, 0.0]], [[0.0], [1.0]], 2.0)
    np.testing.assert_allclose(E, [[cosh(6) - 1, sinh(6) / 3], [3 * sinh(6), cosh(6) - 1]], rtol=1e-14)
    np.testing.assert_allclose(G[:, 0], [(cosh(6) - 1) / 9, sinh(6) / 3], rtol=1e-14)


def test_largest_growth_that_is_a_number_is_given_and_a_larger_one_refused():
    E, _ = held([[1.0]], [[1.0]], 709.0)
    assert E[0, 0] == pytest.approx(exp(709.0), rel=1e-12)
    with pytest.raises(UserError, match="must be shorter for the plant's fastest mode to be computed, found 710 s"):
        held([[1.0]], [[1.0]], 710.0)


REFUSED = {
    "overflow of A h": ([[1e300, 0.0], [0.0, -1e300]], [[1.0], [1.0]], 1e9),
    "overflow of B": ([[0.0, 1e200], [0.0, 0.0]], [[0.0], [1e200]], 1.0),
    "overflow in its own units": ([[0.0, 1e299], [1.0, 0.0]], [[0.0], [1.0]], 1e10),
    "stiffer than digits": (stiff(1e11), np.ones((4, 1)), 1.0),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_computed_is_refused(case):
    A, B, h = REFUSED[case]
    with pytest.raises(UserError, match="a communication step must be shorter"):
        held(A, B, h)
