"""The Kalman filter of any model: closed forms, SciPy, the recursion's limit; what is left out, what is refused."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag, expm, solve_discrete_are

from fmu_export.errors import UserError
from ihc_fmu.kalman import Noise, exponential, kalman_filter, stationary_covariance

H = 0.02


def model(n, m, p, seed=0):
    rng = np.random.default_rng([n, m, p, seed])
    return rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(p, n))


def noise(m, p, **changes):
    rng = np.random.default_rng([m, p])
    values = {"inputs": rng.uniform(0.1, 1, m), "disturbances": rng.uniform(0.1, 1, m)}
    values |= {"biases": [0.0] * (p - 1) + [0.05], "outputs": rng.uniform(0.01, 0.1, p), "leak": 0.2}
    return Noise(**{key: np.asarray(value).tolist() for key, value in (values | changes).items()})


def whole(A, B, C, w) -> Any:
    """Return F, the intensity of its noise and C of the states, disturbances and biases together."""
    (n, m), p = B.shape, len(C)
    F = block_diag(A, np.zeros((m, m)), -w.leak * np.eye(p))
    F[:n, n : n + m] = B
    Q = block_diag(B @ np.diag(w.inputs) @ B.T, np.diag(w.disturbances), np.diag(w.biases))
    return F, Q, np.hstack([C, np.zeros((p, m)), np.eye(p)])


@pytest.mark.parametrize(("n", "m", "p"), [(1, 1, 2), (2, 1, 2), (4, 2, 3), (6, 3, 4), (8, 2, 5)])
def test_gain_is_that_of_the_riccati_equation(n, m, p):
    """SciPy's solution for what is estimated, noise by quadrature over a sample; rows of what is left out are 0."""
    A, B, C = model(n, m, p)
    w = noise(m, p)
    kalman = kalman_filter(A, B, C, H, w)
    kept = [*range(n + m), n + m + p - 1]
    F, Q, seen = whole(A, B, C, w)
    F, Q, seen = F[np.ix_(kept, kept)], Q[np.ix_(kept, kept)], seen[:, kept]
    nodes, weights = np.polynomial.legendre.leggauss(8)
    Q_h: Any = sum(
        0.5 * H * c * expm(F * t) @ Q @ expm(F * t).T for t, c in zip(0.5 * H * (nodes + 1), weights, strict=True)
    )
    R = np.diag(w.outputs)
    X = solve_discrete_are(expm(F * H).T, seen.T, Q_h, R)
    np.testing.assert_allclose(kalman.M[kept], X @ seen.T @ np.linalg.inv(seen @ X @ seen.T + R), rtol=1e-6, atol=1e-8)
    assert not kalman.M[n + m : -1].any()
    assert np.abs(np.linalg.eigvals((np.eye(len(kept)) - kalman.M[kept] @ seen) @ expm(F * H))).max() < 1.0


def test_sampled_model_is_exact():
    A, B, C = model(4, 2, 3)
    kalman = kalman_filter(A, B, C, H, noise(2, 3))
    held = expm(np.block([[A, B], [np.zeros((2, 6))]]) * H)
    np.testing.assert_allclose(np.hstack([kalman.F, kalman.G]), held[:4], rtol=1e-13, atol=1e-15)
    assert kalman.decay == pytest.approx(np.exp(-0.2 * H), rel=1e-15)


def test_gain_of_a_random_walk_has_its_closed_form():
    """x+ = x + noise q h, y = x + noise r: M = (sqrt(1 + 4 r/(q h)) - 1) / (sqrt(1 + 4 r/(q h)) + 1) seen as p/(p + r)."""
    q, r = 0.3, 0.07
    w = Noise(inputs=[q], disturbances=[0.0], biases=[0.0], outputs=[r])
    kalman = kalman_filter(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), H, w)
    prior = q * H / 2 + np.sqrt((q * H / 2) ** 2 + q * H * r)
    assert kalman.M[0, 0] == pytest.approx(prior / (prior + r), rel=1e-12)
    assert not kalman.M[1:].any()


def test_what_is_noisier_is_trusted_less():
    A, B, C = model(3, 1, 2)
    gains = [kalman_filter(A, B, C, H, noise(1, 2, outputs=[r, 0.1])).M for r in (1e-3, 1e-1, 1e1)]
    sizes = [float(np.linalg.norm(M[:, 0])) for M in gains]
    assert all(more > less for more, less in pairwise(sizes))


def test_more_disturbances_and_biases_than_outputs_are_refused():
    with pytest.raises(UserError, match=r"^2 disturbances and biases cannot be told from 1 measured output$"):
        kalman_filter(*model(2, 1, 1), H, noise(1, 1))


@pytest.mark.parametrize("h", [0.0, -1.0, np.nan, np.inf])
def test_sample_time_that_is_none_is_refused(h):
    with pytest.raises(UserError, match="the sample time must be positive and finite, found"):
        kalman_filter(*model(2, 1, 1), h, noise(1, 1))


def test_model_that_is_not_finite_is_refused():
    A, B, C = model(2, 1, 1)
    with pytest.raises(UserError, match="it is not finite"):
        kalman_filter(A * np.nan, B, C, H, noise(1, 1))


@pytest.mark.parametrize("unit", [1.0, 1e-4, 1e4])
def test_what_no_output_sees_is_refused_by_name_unless_it_decays(unit):
    """A wheel's angle is not seen by its speed, nor does it decay; a temperature that does is left to its model."""
    A = np.array([[0.0, unit, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -0.1]])
    B, C = np.array([[0.0], [1.0], [1.0]]), np.array([[0.0, 1.0, 0.0]])
    w = Noise(inputs=[0.1], disturbances=[0.0], biases=[0.0], outputs=[0.01])
    names = ["angle", "speed", "temperature", "disturbance", "bias"]
    with pytest.raises(UserError, match=r"^no measured output tells angle from nothing$"):
        kalman_filter(A, B, C, H, w, names)
    kalman = kalman_filter(A[1:, 1:], B[1:], C[:, 1:], H, w, names[1:])
    assert kalman.M[0, 0] > 0.0


def test_exponential_is_that_of_scipy():
    rng = np.random.default_rng(0)
    for size in (1e-8, 1.0, 30.0):
        M = size * rng.normal(size=(6, 6))
        np.testing.assert_allclose(exponential(M.tolist()), expm(M), rtol=1e-9, atol=1e-10 * np.abs(expm(M)).max())
    assert exponential([[0.0]]) == [[1.0]]


def test_covariance_satisfies_its_equation():
    rng = np.random.default_rng(1)
    F, C, L = 0.9 * rng.normal(size=(5, 5)), rng.normal(size=(2, 5)), rng.normal(size=(5, 5))
    R, Q = np.array([0.1, 0.4]), L @ L.T
    X = np.array(stationary_covariance(F.T.tolist(), C.tolist(), Q.tolist(), R.tolist()))
    gain = X @ C.T @ np.linalg.inv(C @ X @ C.T + np.diag(R))
    np.testing.assert_allclose(X, F @ (X - gain @ C @ X) @ F.T + Q, rtol=1e-9)
