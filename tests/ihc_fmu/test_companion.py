"""Chain coordinates: closed forms for any order, the paper's construction, the authors' dilation."""

import numpy as np
import pytest

from ihc_fmu.companion import chain_form, checked_system, generator, time_scale, weights

# Phi and row of the paper's A and b, from an independent implementation of the paper's section III-B.
PHI = [
    [-0.00017629222671676026, 0.00017836615585760412, -3.2719015078925947e-11, 3.310392665485145e-11],
    [0.0, 3.7761542108335205e-09, -0.00017629222671745296, 0.00017836615585760412],
    [0.0, 0.020346169731897082, -3.732247471811853e-09, 3.7761542108335205e-09],
    [0.0, 4.3074468997790607e-07, -7.901466474199354e-14, 0.020346169731897082],
]
ROW = [0.0, 5.3227431519970425, -0.0002095655482377182, 4.3074468997790607e-07]
ORDERS = range(1, 8)


def random_system(n, seed=0):
    rng = np.random.default_rng([n, seed])
    return rng.normal(size=(n, n)), rng.normal(size=n)


def spread_system(n):
    """Real poles from -1 to -1000 1/s, all excited, in coordinates that mix them."""
    T = np.linalg.qr(np.random.default_rng(n).normal(size=(n, n)))[0]
    return T @ np.diag(-np.geomspace(1.0, 1e3, n)) @ T.T, T @ np.ones(n)


def stretched_system(n):
    """A random system whose states are in units as far apart as km and mm."""
    A, b = random_system(n)
    D = np.geomspace(1e3, 1e-3, n)
    return D[:, None] * A / D, D * b


def test_published_model_has_the_known_transformation(paper):
    form = chain_form(*paper[:2])
    np.testing.assert_allclose(form.Phi, PHI, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(form.row, ROW, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("zero_eigenvalue", [True, False])
@pytest.mark.parametrize("n", ORDERS)
def test_transformation_is_the_papers_inverse_of_e1_to_en(n, zero_eigenvalue):
    """Section III-B: e_n = b, e_i = A e_{i+1} + alpha_{n-i} b with the characteristic polynomial's coefficients."""
    A, b = random_system(n)
    if zero_eigenvalue:
        A[:, 0] = 0.0
    coefficients = np.poly(A)
    columns = [b]
    for c in coefficients[1:n]:
        columns.insert(0, A @ columns[0] + c * b)
    form = chain_form(A, b)
    np.testing.assert_allclose(form.Phi @ np.column_stack(columns), np.eye(n), atol=1e-9)
    # Cayley-Hamilton: in chain coordinates the row is minus the coefficients, the constant one included
    np.testing.assert_allclose(form.row @ np.column_stack(columns), -coefficients[:0:-1], atol=1e-9)


@pytest.mark.parametrize("system", [random_system, stretched_system, spread_system])
@pytest.mark.parametrize("n", ORDERS)
def test_chain_of_integrators_is_reached_exactly(system, n):
    """z' = shift z + e_n (u + row x): backward error of each identity, relative to what rounding acts on."""
    A, b = system(n)
    form = chain_form(A, b)
    shift, e_n = np.eye(n, k=1), np.eye(n)[-1]
    residual = form.Phi @ form.A_0 - shift @ form.Phi
    scale = np.abs(form.Phi) @ (np.abs(A) + np.outer(np.abs(b), np.abs(form.row))) + np.abs(shift @ form.Phi)
    assert (np.abs(residual) <= 1e-8 * scale).all()
    assert (np.abs(form.Phi @ b - e_n) <= 1e-8 * np.abs(form.Phi) @ np.abs(b)).all()
    assert (np.abs(form.row - form.Phi[-1] @ A) <= 1e-8 * np.abs(form.Phi[-1]) @ np.abs(A)).all()


@pytest.mark.parametrize("n", ORDERS)
def test_system_without_zero_eigenvalue_is_made_nilpotent(n):
    A, b = random_system(n)
    assert abs(np.linalg.det(A)) > 1e-3
    form = chain_form(A, b)
    chain = form.Phi @ form.A_0 @ np.linalg.inv(form.Phi)
    np.testing.assert_allclose(chain, np.eye(n, k=1), atol=1e-8)


@pytest.mark.parametrize("mu", [0.01, 0.3, 1.0])
@pytest.mark.parametrize("n", ORDERS)
def test_identities_of_the_dilation_hold(n, mu):
    """Eq. (1) with degree -mu, G_d b = b, and the weights as eigenvalues of G_d."""
    A, b = random_system(n)
    form = chain_form(A, b)
    G = generator(form.Phi, mu)
    scale = float(np.linalg.norm(form.A_0) * np.linalg.norm(G))
    np.testing.assert_allclose(form.A_0 @ G - G @ form.A_0, -mu * form.A_0, atol=1e-12 * scale)
    np.testing.assert_allclose(G @ b, b, atol=1e-12 * scale)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(G).real), 1 + mu * np.arange(n), rtol=1e-7)


def test_at_mu_one_the_weights_are_those_of_lemma_3():
    assert weights(4, 1.0).tolist() == [4.0, 3.0, 2.0, 1.0]


@pytest.mark.parametrize("name", ["hcs_demo", "paper_printed"])
def test_dilation_and_row_are_those_of_the_authors_toolbox(hcs_cases, name):
    case = hcs_cases[name]
    form = chain_form(case["A"], case["B"])
    np.testing.assert_allclose(form.row, -np.array(case["K0"]), atol=1e-12)
    for mu in (0.25, 1.0):
        expected = np.eye(4) - mu * np.array(case["G0"])
        np.testing.assert_allclose(generator(form.Phi, mu), expected, rtol=1e-9, atol=1e-11)


def test_time_scale_is_the_fastest_pole_and_one_without_dynamics():
    assert time_scale(np.diag([-3.0, 1e3, 0.0])) == pytest.approx(1e3)
    assert time_scale(np.eye(4, k=1)) == 1.0


@pytest.mark.parametrize(
    ("A", "b"),
    [
        (np.diag([1.0, 2.0]), [1.0, 0.0]),  # a mode that the input does not reach
        (np.eye(3), [1.0, 2.0, 3.0]),  # one eigenvalue for three states
        (np.eye(2, k=1), [1.0, 0.0]),  # the chain driven at the wrong end
        (np.diag([1.0, 2.0]), [0.0, 0.0]),
        (np.diag([1.0, 1.0 + 1e-13]), [1.0, 1.0]),  # controllable, but not by numbers of this length
    ],
)
def test_uncontrollable_pair_is_refused(A, b):
    with pytest.raises(ValueError, match=r"\(A, b\) must be controllable"):
        chain_form(A, b)


@pytest.mark.parametrize(
    ("A", "b", "message"),
    [
        (np.ones((2, 3)), [1.0, 1.0], r"A must be a square matrix, found shape \(2, 3\)"),
        (np.ones(4), [1.0], r"A must be a square matrix, found shape \(4,\)"),
        (np.ones((0, 0)), [], r"A must be a square matrix, found shape \(0, 0\)"),
        (np.eye(3), [1.0, 2.0], r"b must have 3 entries to fit A, found shape \(2,\)"),
        (np.eye(2), np.ones((1, 2)), r"b must have 2 entries to fit A, found shape \(1, 2\)"),
        ([[np.nan]], [1.0], "must be finite"),
        ([[1.0]], [np.inf], "must be finite"),
    ],
)
def test_malformed_system_is_refused_with_what_was_found(A, b, message):
    with pytest.raises(ValueError, match=message):
        checked_system(A, b)


def test_input_column_is_taken_as_a_vector(paper):
    A, b, _ = paper
    np.testing.assert_array_equal(chain_form(A, b[:, None]).Phi, chain_form(A, b).Phi)
