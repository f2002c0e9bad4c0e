"""A system with names and units: every rule and its refusal, its file."""

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from fmu_export.errors import UserError
from ihc_fmu.quantity import Quantity
from ihc_fmu.system import System

A = [[0.0, 1.0], [-2.0, -3.0]]
B = [[0.0], [1.0]]
TWO: dict[str, Any] = {"A": A, "B": B}
CRANE: dict[str, Any] = {
    "name": "crane",
    "A": [[0.0, 1.0, 0.0], [0.0, -0.1, 0.25], [0.0, 0.0, -1e-3]],
    "B": [[0.0, 0.0], [1.0, 0.0], [0.0, 1 / 3]],
    "C": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    "K": [[-1.0, -2.0, 0.0], [0.0, 0.0, -0.1]],
    "states": ["position [m]", "velocity [m/s]", "wind"],
    "inputs": ["force [N]", "fan [1/s]"],
    "outputs": ["position [m]", "gauge [kg m^2/s]"],
    "limits": [10.0, [-1.0, 3.0]],
    "resolutions": [1e-4, 0.0],
    "deviations": [0.0, 1e-3],
    "sample_time": 2e-3,
    "equilibrium": {"states": [1.0, 0.0, 2.0], "inputs": [0.5, 1.0], "outputs": [1.0, 2.0]},
    "set_points": ["position"],
    "biases": ["gauge"],
    "bandwidth": 20.0,
}


def test_defaults_say_nothing_that_was_not_given():
    s = System(A=np.array(A), B=np.array([0.0, 1.0]))
    assert (s.n, s.m, s.p, s.name, s.measures_state) == (2, 1, 2, "system", True)
    assert [str(q) for q in (*s.states, *s.inputs, *s.outputs)] == ["x1", "x2", "u1", "x1", "x2"]
    assert s.B.shape == (2, 1)
    assert (s.K, s.bandwidth) == (None, None)
    assert (s.lower, s.upper) == ([-np.inf], [np.inf])
    assert not any(np.any(v) for v in (s.x_eq, s.u_eq, s.y_eq, s.resolutions, s.deviations))


def test_a_system_cannot_be_changed_from_outside():
    model = np.array(A)
    s = System(A=model, B=np.array(B))
    model[0, 0] = 7.0
    assert s.A[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        s.A[0, 0] = 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"A": [[0, 1]]}, "A must be a square matrix, found shape (1, 2)"),
        ({"A": []}, "A must be rows of numbers, all of one length, found shape (0,)"),
        ({"A": [[0, 1], [2]]}, "A must be rows of numbers, all of one length, found [[0, 1], [2]]"),
        ({"A": [[0, "x"], [0, 0]]}, "A must be rows of numbers, found [[0, 'x'], [0, 0]]"),
        ({"A": [[0, True], [0, 0]]}, "A must be rows of numbers, found [[0, true], [0, 0]]"),
        ({"A": [[0, 1], [float("nan"), 0]]}, "A must be finite, found nan"),
        ({"A": [[0, 1], [1e301, 0]]}, "A must be finite, found 1e+301"),
        ({"B": [[0], [1], [2]]}, "B must have 2 rows to fit A, found shape (3, 1)"),
        ({"B": [[], []]}, "B must have 2 rows and columns to fit A, found shape (2, 0)"),
        ({"b": [0, 1]}, "a system has b or B, found both"),
        ({"C": [[1, 0, 0]]}, "C must have 2 columns to fit A, found shape (1, 3)"),
        ({"k_lin": [1, 2, 3]}, "k_lin must have 1 row of 2 numbers to fit B and A, found shape (1, 3)"),
        ({"K": 1979}, "K must be rows of numbers, found 1979"),
        ({"K": [[1, 2, 3]]}, "K must have 1 row of 2 numbers to fit B and A, found shape (1, 3)"),
        ({"K": [1, 2], "lqr": {"Q": [1, 1], "R": [1]}}, "a system has lqr or K, found both"),
        ({"name": "two tanks"}, "name must be a short C identifier, found 'two tanks'"),
        ({"name": 3}, "name must be a text, found 3"),
        ({"states": ["a"]}, "states must be 2 names to fit the matrices, found 1"),
        ({"states": ["a", "a [m]"]}, "states must have different names, found 'a' twice"),
        ({"states": ["a", ""]}, "each of states must be a printable name and perhaps a [unit], found ''"),
        ({"states": ["a", "b\n"], "inputs": ["b"]}, "inputs must have other names than states and outputs, found 'b' twice"),
        ({"states": "ab"}, "states must be a list of texts, found 'ab'"),
        ({"states": ["a", 1]}, "each of states must be a text, found 1"),
        ({"outputs": ["y", "z"]}, "outputs must come with C; without C the states are measured"),
        ({"limits": [1, 2]}, "limits must be as many as inputs, 1, found 2"),
        ({"limits": [[2, 1]]}, "limits must be apart, lower below upper, found 2 and 1 for u1"),
        ({"limits": [-3]}, "limits must be positive where one number is for both sides, found -3"),
        ({"limits": [[1, 2]]}, "limits must leave room around the inputs at the equilibrium, found 1 and 2 around u1 = 0"),
        ({"limits": 1}, "limits must be a number or [lower, upper] per input, found 1"),
        ({"limits": [[1, 2, 3]]}, "limits must be a number or [lower, upper] per input, found [[1, 2, 3]]"),
        ({"resolutions": [1e-3]}, "resolutions must be as many as outputs, 2, found 1"),
        ({"resolutions": [1e-3, -1.0]}, "resolutions must not be negative, found -1"),
        ({"deviations": [float("inf"), 0]}, "deviations must be finite, found inf"),
        ({"sample_time": 0}, "sample_time must be positive and finite [s], found 0.0"),
        ({"sample_time": "1 ms"}, "sample_time must be a number, found '1 ms'"),
        ({"sample_time": 10**350}, "sample_time must be a number, found an integer of 1163 bits"),
        ({"bandwidth": -1}, "bandwidth must be 0 or more and finite [rad/s], found -1.0"),
        ({"set_points": ["x3"]}, "set_points must name outputs, found 'x3'"),
        ({"biases": ["x1", "x1"]}, "biases must have different names, found 'x1' twice"),
        ({"equilibrium": {"state": [0]}}, "equilibrium must be a table of states, inputs, outputs, found {'state': [0]}"),
        ({"equilibrium": {"states": [0]}}, "equilibrium.states must be as many as states, 2, found 1"),
        ({"equilibrium": {"inputs": [float("nan")]}}, "equilibrium.inputs must be finite, found nan"),
        ({"equilibrium": {"outputs": [1, 0]}}, "equilibrium.outputs must be left out without C, as the outputs are the "),
        ({"equilibrium": {"states": 0}}, "equilibrium.states must be a list of numbers, found 0"),
        ({"lqr": {"Q": [1, 1]}}, "lqr must be a table of Q and R, found {'Q': [1, 1]}"),
        ({"lqr": {"Q": 1, "R": [1]}}, "lqr.Q must be rows of numbers or a list of them, found 1"),
        ({"lqr": {"Q": [1], "R": [1]}}, "lqr.Q must be 2 numbers, or a symmetric matrix of that size, found [1.0]"),
        ({"lqr": {"Q": [[1, 2], [3, 4]], "R": [1]}}, "lqr.Q must be 2 numbers, or a symmetric matrix of that size"),
        ({"lqr": {"Q": [1, -1], "R": [1]}}, "lqr.Q must be positive semidefinite, found the eigenvalue -1"),
        ({"lqr": {"Q": [1, 1], "R": [0]}}, "lqr.R must be positive definite, found the eigenvalue 0"),
        ({"integral": True}, 'integral must be rows of numbers or "direct", found true'),
        ({"statse": ["a", "b"]}, "a system has no entry 'statse'"),
    ],
)  # fmt: skip
def test_every_rule_is_told_in_one_sentence(changes, message):
    with pytest.raises(UserError) as refusal:
        System.from_dict({**TWO, **changes})
    assert str(refusal.value).startswith(message)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"A": np.array(A) + 1j}, "A must be real, found complex numbers, [["),
        ({"K": [[1j, 2.0]]}, "K must be real, found complex numbers, [[1j, 2.0]]"),
        ({"lower": np.array([1j])}, "limits must be real, found complex numbers, [1j]"),
        ({"upper": "x"}, "limits must be a list of numbers, found 'x'"),
        ({"states": "ab"}, "states must be a list of texts, found 'ab'"),
        ({"inputs": Quantity("force", "N")}, "inputs must be a list of texts, found Quantity(name='force', unit='N')"),
        ({"set_points": "x1"}, "set_points must be a list of texts, found 'x1'"),
        ({"states": ["a", 1]}, "each of states must be a text, found 1"),
    ],
)  # fmt: skip
def test_what_only_python_can_give_is_refused_in_one_sentence(changes, message):
    with pytest.raises(UserError) as refusal:
        System(**{**TWO, **changes})
    assert str(refusal.value).startswith(message)


@pytest.mark.parametrize("data", [None, [], "A", 3])
def test_what_is_no_table_is_refused(data):
    with pytest.raises(UserError, match="a system must be a table of entries, found"):
        System.from_dict(data)


@pytest.mark.parametrize("missing", ["A", "B"])
def test_model_must_be_there(missing):
    with pytest.raises(UserError, match=f"a system must have {missing}"):
        System.from_dict({name: value for name, value in TWO.items() if name != missing})


# Files


def same(one, other):
    for f in fields(System):
        np.testing.assert_array_equal(getattr(one, f.name), getattr(other, f.name), err_msg=f.name)


@pytest.mark.parametrize("data", [TWO, CRANE, {**TWO, "limits": [[-5.0, float("inf")]]}])
def test_system_survives_its_file_to_the_last_bit(tmp_path, data):
    s = System.from_dict(data)
    path = tmp_path / "new" / "system.toml"
    s.save(path, "a comment\nof two lines")
    same(System.load(path), s)
    text = path.read_text(encoding="utf-8")
    assert "# a comment\n# of two lines\n" in text
    assert System.load(path).to_toml("a comment\nof two lines") == text


def test_entries_of_a_file_mean_what_they_say(tmp_path):
    s = System.from_dict(CRANE)
    np.testing.assert_array_equal(np.array([s.lower, s.upper]).T, [[-10.0, 10.0], [-1.0, 3.0]])
    np.testing.assert_array_equal(s.u_eq, [0.5, 1.0])
    assert s.outputs[1] == Quantity("gauge", "kg m^2/s")
    path = tmp_path / "2 tanks.toml"
    path.write_text("A = [[0]]\nb = [2]\nk_lin = [-3]\n", encoding="utf-8")
    scalar = System.load(path)
    assert (scalar.name, scalar.B[0, 0], scalar.K) == ("_2_tanks", 2.0, [[-3.0]])


def test_errors_name_the_file(tmp_path):
    path = tmp_path / "crane.toml"
    path.write_text("A = [[0]]\n", encoding="utf-8")
    with pytest.raises(UserError) as refusal:
        System.load(path)
    assert str(refusal.value) == f"{path}: a system must have B"


def test_change_of_the_outputs_forgets_what_was_about_them():
    s = System.from_dict(CRANE)
    changed = s.changed(C=np.eye(3)[1:2])
    assert [q.name for q in changed.outputs] == ["y1"]
    assert (changed.set_points, changed.biases, changed.resolutions) == ((), (), [0.0])
    same(s.changed(sample_time=2e-3), s)
    assert System.from_dict(TWO).changed(K=np.ones((1, 2))).measures_state


def test_only_column_is_for_one_input():
    np.testing.assert_array_equal(System.from_dict(TWO).b, [0.0, 1.0])
    with pytest.raises(UserError, match="b is for systems with one input, found 2 inputs"):
        System.from_dict(CRANE).b  # noqa: B018


def test_unknown_output_is_told_with_what_is_near():
    assert System.from_dict(CRANE).output("gauge") == 1
    with pytest.raises(UserError, match=r"output must name outputs, found 'guage'.*gauge"):
        System.from_dict(CRANE).output("guage")
