"""The gain of the linear-quadratic regulator: closed form, its equation, bad scales, what has none."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from fmu_export.errors import UserError
from ihc_fmu.system import System


def test_regulator_of_a_double_integrator_has_its_closed_form():
    """Q = diag(q, 0), R = r: K = -(sqrt(q/r), sqrt(2 sqrt(q/r)))."""
    s = System(A=np.eye(2, k=1), B=np.array([0.0, 1.0]))
    K: Any = s.with_lqr(np.array([16.0, 0.0]), np.array([1.0])).K
    np.testing.assert_allclose(K, [[-4.0, -np.sqrt(8.0)]], rtol=1e-12)


def test_regulator_solves_its_riccati_equation():
    rng = np.random.default_rng(0)
    s = System(A=rng.normal(size=(5, 5)), B=rng.normal(size=(5, 2)))
    L, M = rng.normal(size=(5, 5)), rng.normal(size=(2, 2))
    Q, R = L @ L.T, M @ M.T + np.eye(2)
    K: Any = s.with_lqr(Q, R).K
    np.testing.assert_allclose(K, -np.linalg.solve(R, s.B.T @ solve_continuous_are(s.A, s.B, Q, R)), rtol=1e-9)
    file = System.from_dict({"A": s.A.tolist(), "B": s.B.tolist(), "lqr": {"Q": Q.tolist(), "R": R.tolist()}})
    np.testing.assert_array_equal(file.K, K)


@pytest.mark.parametrize("Q", [[1.0, 0.0], [0.0, 1.0]])
def test_regulator_that_does_not_stabilize_is_refused(Q):
    """An unstable state that no input moves, or that the weights do not see."""
    A = np.diag([-1.0, 0.0]) if Q[0] else np.diag([0.0, -1.0])
    B = np.array([1.0, 0.0]) if Q[0] else np.array([1.0, 1.0])
    why = (
        r"^\(A, B\) must be controllable; no input moves x2$"
        if Q[0]
        else "^lqr has no stabilizing solution: Q must weigh .* found a motion at 0 rad/s that it does not$"
    )
    with pytest.raises(UserError, match=why):
        System(A=A, B=B).with_lqr(np.array(Q), np.array([1.0]))


@pytest.mark.parametrize(
    ("A", "B", "K"),
    [
        # the squares z of the poles solve (1e12 - z) (1e-12 + 1 - z) + 1 = 0: they are -1e6 and -1
        ([[1e6, 1], [0, 1e-6]], [[0], [1]], [[-2.000002e12, -2.000001e6]]),
        ([[0, 1e200], [0, 0]], [[0], [1e-200]], [[-1.0, -np.sqrt(2) * 1e200]]),  # the double integrator in other units
    ],
)
def test_regulator_of_a_badly_scaled_plant_is_found_without_a_warning(A, B, K, recwarn):
    given = {"A": A, "B": B, "lqr": {"Q": [1, 1], "R": [1]}}
    gain: Any = System.from_dict(given).K
    np.testing.assert_allclose(gain, K, rtol=1e-9)
    assert not recwarn


def test_regulator_that_double_precision_does_not_find_is_not_said_to_be_none():
    A, B = np.array([[0, 1e-150], [1e-150, 0]]), np.array([0, 1e-150])
    with pytest.raises(UserError, match=r"^lqr could not be decided in double precision: no gain that stabilizes"):
        System(A=A, B=B).with_lqr(np.array([1e290, 1e-290]), np.array([1e-290]))


def test_regulator_of_a_pair_that_is_not_controllable_names_the_state():
    given = {"A": [[1, 0], [0, -2]], "B": [[0], [1]], "states": ["a [m]", "b"], "lqr": {"Q": [1, 1], "R": [1]}}
    with pytest.raises(UserError, match=r"^\(A, B\) must be controllable; no input moves a$"):
        System.from_dict(given)
