"""The proof that an observer's errors vanish: its inequality on simulated errors, its reach, and what it does not prove."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ihc_fmu.observer import homogeneous_observer, remark
from ihc_fmu.observer_proof import bernstein, prove
from ihc_fmu.observer_wish import ObserverWish
from ihc_fmu.synthesis import synthesize
from tests.ihc_fmu.test_observer import GAIN, arm, gain_at


def test_values_of_a_polynomial_lie_within_its_bernstein_coefficients():
    parts = [np.array([[c]]) for c in (1.0, 2.0, -3.0, 0.5)]
    a, b = 1.0, 3.0
    coefficients = bernstein(parts, a, b).ravel()
    values = [sum(part[0, 0] * s**j for j, part in enumerate(parts)) for s in np.linspace(a, b, 50)]
    assert coefficients[[0, -1]] == pytest.approx([values[0], values[-1]])
    assert coefficients.min() <= min(values)
    assert max(values) <= coefficients.max()
    middle = coefficients @ np.array([1, 3, 3, 1]) / 8
    assert middle == pytest.approx(sum(part[0, 0] * 2.0**j for j, part in enumerate(parts)))


@pytest.mark.parametrize("nu", [-0.05, -0.2])
def test_errors_on_the_edge_of_what_is_proven_vanish_inside(nu):
    """e' = (A + S C) e from the edge of the ellipsoid: it is never left again, and its end is near 0."""
    system_design = synthesize(arm(ObserverWish(L=GAIN, nu=nu)), 1.0, 0.3)
    observer = homogeneous_observer(system_design)
    proof = prove(observer, system_design.extent)
    assert proof is not None
    A, C = np.asarray(observer.A), np.asarray(observer.C)

    def moved(_, e):
        q = np.clip(np.linalg.norm(C @ e), observer.q_min, observer.q_max)
        return (A + gain_at(observer, q) @ C) @ e

    rng, to_edge = np.random.default_rng(1), np.linalg.inv(np.linalg.cholesky(proof.P)).T
    for _ in range(5):
        y = rng.normal(size=4)
        e = to_edge @ y / np.linalg.norm(y)
        assert e @ proof.P @ e == pytest.approx(1.0)
        path = solve_ivp(moved, (0.0, 3.0), e, method="LSODA", rtol=1e-8, atol=1e-10).y.T
        assert (np.einsum("ti,ij,tj->t", path, proof.P, path) <= 1.0 + 1e-6).all()
        assert np.abs(path[-1]).max() < 1e-3 * np.abs(e).max()


def test_what_is_not_proven_is_said():
    nowhere = synthesize(arm(ObserverWish(L=GAIN, nu=-0.49)), 1.0, 0.3)
    assert prove(homogeneous_observer(nowhere), nowhere.extent) is None
    assert "no proof was found" in remark(nowhere)
    assert "errors vanish within an ellipsoid that reaches to" in remark(
        synthesize(arm(ObserverWish(L=GAIN)), 1.0, 0.3)
    )
