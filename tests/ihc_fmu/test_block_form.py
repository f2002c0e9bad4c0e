"""The block form: the authors' toolbox, its identities, its invariance under units, pairs that it refuses."""

from itertools import pairwise

import numpy as np
import pytest

from fmu_export.errors import UserError
from ihc_fmu.block_form import Scaling, block_form, combination, scaling
from tests.ihc_fmu.blocks import random_system
from tests.ihc_fmu.reference import SYSTEMS

SHAPES = [(1, 1), (4, 1), (4, 2), (5, 2), (6, 3), (8, 3), (8, 1), (12, 4), (16, 8)]


def norm(M):
    return float(np.linalg.norm(M))


@pytest.mark.parametrize("name", SYSTEMS)
def test_gain_and_dilation_are_those_of_the_authors_toolbox(name):
    """With the toolbox's metric, that of the given units; its G_d is I + degree G0, and minus its degree is mu."""
    system = SYSTEMS[name]
    A, B = np.array(system["A"], float), np.array(system["B"], float)
    n, m = B.shape
    form = block_form(A, B, metric=Scaling(np.ones(n), np.ones(m), 1.0))
    K_0, G_0 = (np.array(system["lpc2hpc"][key], float).reshape(-1, n) for key in ("K0", "G0"))
    assert list(form.sizes) == np.ravel(system["blocks"]).tolist()
    np.testing.assert_allclose(form.K_0, K_0, atol=1e-9 * max(1.0, np.abs(K_0).max()))
    np.testing.assert_allclose(form.generator(1.0), np.eye(n) - G_0, atol=1e-9)
    np.testing.assert_allclose(form.generator(0.3), np.eye(n) - 0.3 * G_0, atol=1e-9)


@pytest.mark.parametrize(("n", "m"), SHAPES)
def test_form_is_what_it_says(n, m):
    """T (A + B K_0) T^-1 = N, zero but for its superdiagonal blocks; T B = B_z; full ranks; blocks that grow."""
    s = random_system(n, m)
    form = block_form(s.A, s.B)
    assert list(form.exponents) == list(s.e)
    assert list(form.sizes) == sorted(form.sizes)
    A_0 = s.A + s.B @ form.K_0
    np.testing.assert_allclose(form.T @ form.T_inverse, np.eye(n), atol=1e-10)
    np.testing.assert_allclose(form.T @ A_0 @ form.T_inverse, form.N, atol=1e-9 * norm(s.A))
    np.testing.assert_allclose(form.T @ s.B, form.Bz, atol=1e-10 * norm(s.B))
    elsewhere = form.N.copy()
    for here, following in pairwise(form.blocks):
        elsewhere[here, following] = 0.0
        assert np.linalg.matrix_rank(form.N[here, following]) == here.stop - here.start
    assert not elsewhere.any()
    assert not form.Bz[: form.blocks[-1].start].any()
    assert np.linalg.matrix_rank(form.Bz) == form.sizes[-1]


@pytest.mark.parametrize("mu", [0.25, 1.0])
@pytest.mark.parametrize(("n", "m"), SHAPES)
def test_dilation_makes_the_nilpotent_part_homogeneous(n, m, mu):
    """A_0 G_d - G_d A_0 = -mu A_0 and G_d B = B."""
    s = random_system(n, m, seed=1)
    form = block_form(s.A, s.B)
    A_0, G = s.A + s.B @ form.K_0, form.generator(mu)
    size = norm(s.A) + norm(s.B @ form.K_0)
    np.testing.assert_allclose(A_0 @ G - G @ A_0, -mu * A_0, atol=1e-9 * size)
    np.testing.assert_allclose(G @ s.B, s.B, atol=1e-9 * norm(s.B))
    np.testing.assert_allclose(np.linalg.matrix_power(A_0 / size, len(form.sizes)), 0.0, atol=1e-10)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(G).real), np.sort(1 + mu * np.array(s.e)), atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("n", "m"), [(4, 1), (5, 2), (8, 3)])
def test_units_of_states_inputs_and_time_change_nothing(n, m, seed):
    """x = X x~, u = U u~, t = t~/omega: K_0 and G_d are transformed as a gain and a matrix of the state are."""
    s, rng = random_system(n, m, seed=seed), np.random.default_rng(seed)
    X, U, omega = 10.0 ** rng.uniform(-4, 4, n), 10.0 ** rng.uniform(-4, 4, m), 10.0 ** rng.uniform(-3, 3)
    form = block_form(s.A, s.B)
    other = block_form(omega * s.A * X / X[:, None], omega * s.B * U / X[:, None])
    size = norm(form.K_0)
    assert other.sizes == form.sizes
    np.testing.assert_allclose(other.K_0 * U[:, None] / X, form.K_0, rtol=1e-7, atol=1e-7 * size)
    np.testing.assert_allclose(X[:, None] * other.generator(1.0) / X, form.generator(1.0), rtol=1e-7, atol=1e-7)


def test_scaling_brings_entries_near_one():
    """Equal entries of A and B, in units from 1e-4 to 1e4, come back as equal entries."""
    rng = np.random.default_rng(0)
    X, U, omega = 10.0 ** rng.uniform(-4, 4, 5), 10.0 ** rng.uniform(-4, 4, 2), 10.0 ** rng.uniform(-3, 3)
    A, B = omega * X[:, None] / X, omega * X[:, None] * U
    s = scaling(A, B)
    np.testing.assert_allclose(A * s.states / s.states[:, None] / s.omega, 1.0, rtol=1e-9)
    np.testing.assert_allclose(B * s.inputs / s.states[:, None] / s.omega, 1.0, rtol=1e-9)


def test_blocks_can_be_scaled():
    """The same gain and dilation in coordinates of other sizes."""
    s = random_system(5, 2)
    form = block_form(s.A, s.B)
    scaled = form.scaled([3.0 ** (i + 1) for i in range(len(form.sizes))])
    np.testing.assert_allclose(scaled.generator(0.7), form.generator(0.7), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(scaled.T @ (s.A + s.B @ scaled.K_0) @ scaled.T_inverse, scaled.N, atol=1e-9)
    np.testing.assert_allclose(scaled.T @ s.B, scaled.Bz, atol=1e-9)


@pytest.mark.parametrize("unit", [1.0, 1e-4, 1e4])
def test_pair_that_is_not_controllable_is_refused_by_name(unit):
    """Two tanks and a float that no pump moves; two equal carts pulled as one; nothing that moves anything."""
    A = np.array([[-1.0, 0.0, 0.0], [1.0, -2.0, 0.0], [0.0, 0.0, -3.0]])
    B = np.array([[unit], [0.0], [0.0]])
    with pytest.raises(UserError, match=r"must be controllable; no input moves float$"):
        block_form(A, B, ["level_1", "level_2", "float"])
    A, B = np.kron(np.eye(2), np.eye(2, k=1)), np.array([[0.0], [unit], [0.0], [unit]])
    names = ["position_1", "velocity_1", "position_2", "velocity_2"]
    with pytest.raises(UserError, match=r"no input moves (position_1 - position_2|velocity_1 - velocity_2)$"):
        block_form(A, B, names)
    with pytest.raises(UserError, match=r"no input moves x1$"):
        block_form(np.zeros((1, 1)), np.zeros((1, 1)))


def test_combination_is_read_aloud_with_its_largest_coefficient_one():
    assert combination(np.array([0.0, -2.0, 1.0]), ["a", "b", "c"]) == "b - 0.5 c"
    assert combination(np.array([1e-9, 4.0]), ()) == "x2"
