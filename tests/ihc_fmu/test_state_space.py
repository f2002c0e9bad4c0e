"""Models of others become systems: labels, measured states, the sign of a gain."""

from typing import Any

import control
import numpy as np
import pytest
import scipy.signal

from fmu_export.errors import UserError
from ihc_fmu.quantity import Quantity
from ihc_fmu.system import System

A = [[0.0, 1.0], [-2.0, -3.0]]
B = [[0.0], [1.0]]


def state_space(**changes):
    model: dict[str, Any] = {"C": [[1.0, 0.0]], "D": 0.0, "dt": 0, "outputs": ["encoder"]} | changes
    C, D, dt = (model.pop(name) for name in ("C", "D", "dt"))
    return control.ss(A, B, C, D, dt, states=["angle", "rate"], inputs=["torque"], **model)


def test_state_space_comes_with_its_labels():
    s = System.from_state_space(state_space(), sample_time=5e-3)
    assert [q.name for q in (*s.states, *s.inputs, *s.outputs)] == ["angle", "rate", "torque", "encoder"]
    np.testing.assert_array_equal(s.C, [[1.0, 0.0]])
    assert (s.measures_state, s.sample_time, s.K) == (False, 5e-3, None)
    named = System.from_state_space(state_space(), states=("angle [rad]", "rate [rad/s]"))
    assert named.states[0] == Quantity("angle", "rad")


def test_unit_matrix_as_output_stands_for_measured_states():
    for model in (state_space(C=np.eye(2), outputs=None), scipy.signal.StateSpace(A, B, np.eye(2), np.zeros((2, 1)))):
        s = System.from_state_space(model)
        assert s.measures_state
        assert s.outputs == s.states


@pytest.mark.parametrize(("law", "sign"), [("u = K x", 1.0), ("u = -K x", -1.0)])
def test_gain_has_the_sign_that_is_told(law, sign):
    K = np.array([[-1.0, -2.0]])
    np.testing.assert_array_equal(System.from_state_space(state_space(), K, law).K, sign * K)


def test_gain_of_another_toolbox_is_that_of_lqr_with_its_sign_told():
    model, Q, R = state_space(), np.diag([4.0, 1.0]), np.array([[0.5]])
    K, _, poles = control.lqr(model, Q, R)
    system: Any = System.from_state_space(model, K, "u = -K x")
    for law in ("u = K x", "u = +K x"):
        np.testing.assert_array_equal(System.from_state_space(model, -K, law).K, system.K)
    own: Any = System.from_state_space(model).with_lqr(Q, R)
    np.testing.assert_allclose(system.K, own.K, rtol=1e-9)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(system.A + system.B @ system.K)), np.sort(poles), rtol=1e-9)


@pytest.mark.parametrize("law", [None, "", "u=-Kx", -1])
def test_sign_of_a_gain_is_never_guessed(law):
    with pytest.raises(UserError, match=r"law must say how K is meant, 'u = K x' or 'u = -K x', found"):
        System.from_state_space(state_space(), np.array([[1.0, 2.0]]), law)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dt": 0.01}, r"must be in continuous time, found dt = 0\.01"),
        ({"dt": True}, r"must be in continuous time, found dt = True"),
        ({"D": [[1.0]]}, r"^the model must have D = 0, found 1 from torque to encoder$"),
    ],
)
def test_models_of_another_kind_are_refused(changes, message):
    with pytest.raises(UserError, match=message):
        System.from_state_space(state_space(**changes))
    with pytest.raises(UserError, match=r"^the model must have A, B, C and D, found a TransferFunction$"):
        System.from_state_space(control.tf([1], [1, 1]))
