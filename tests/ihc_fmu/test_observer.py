"""The homogeneous observer of a design: the authors' toolbox through the units, its defaults, its convergence, refusals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from fmu_export.errors import UserError
from ihc_fmu.block_form import Scaling, block_form
from ihc_fmu.controller import Controller, regulator_of
from ihc_fmu.observer import homogeneous_observer, least_degree
from ihc_fmu.observer_wish import ObserverWish
from ihc_fmu.regulator.interface import Shape, numbered
from ihc_fmu.regulator.start_values import Observer, Regulator
from ihc_fmu.synthesis import synthesize
from ihc_fmu.system import System
from tests.ihc_fmu.regulator.conftest import H, both, names, row, whole  # noqa: F401 - fixtures
from tests.ihc_fmu.regulator.test_closed_loop import ARM
from tests.ihc_fmu.test_integral import discrete

DATA = Path(__file__).parent / "data" / "hcs_general_reference.json"
SYSTEMS = {system["name"]: system for system in json.loads(DATA.read_text(encoding="utf-8"))["systems"]}


def of_toolbox(name):
    """Return A, C, L, the dual's block form and the vectors of lo2ho."""
    system, part = SYSTEMS[name], SYSTEMS[name]["lo2ho"]
    A, C = np.array(system["A"], dtype=float), np.atleast_2d(np.array(system["C"], dtype=float))
    L = np.array(system["L_lin"], dtype=float).reshape(len(A), len(C))
    plain = Scaling(np.ones(len(A)), np.ones(len(C)), 1.0)  # blocks of different sizes depend on the units
    return A, C, L, block_form(A.T, C.T, metric=plain), part


@pytest.mark.parametrize("name", SYSTEMS)
def test_lowest_degree_is_that_of_the_authors_toolbox(name):
    A, C, L, form, part = of_toolbox(name)
    degree = least_degree(A, C, L, form, np.ones(len(A)))
    assert degree == pytest.approx(part["nu_min"], rel=1e-6)


def held(A, C, form, L, v, limits) -> Any:
    """Return values of the unit whose first sample takes v's z for the state and commands v's f: x' = A x + f."""
    n, p = len(A), len(C)
    observer = Observer(
        A=A, B=np.eye(n), C=C, T=form.T, exponents=form.exponents, L_0=form.K_0.T, L=L, nu=v["nu"],
        q_min=limits[0], q_max=limits[1],
    )  # fmt: skip
    z, y, f = (np.ravel(v[key]) for key in ("z", "y", "f"))
    shape = Shape(name="plant", states=names("x", n), inputs=names("u", n), outputs=names("y", p))
    unit, nothing = np.eye(n), np.zeros((n, n))
    regulator = Regulator(
        shape=shape, exponents=[0] * n, T=unit, N=nothing, B=unit, K_0=nothing, K=np.outer(f, z) / (z @ z), P=unit, mu=1.0,
        sample_time=H, filter=observer,
    )  # fmt: skip
    first = dict(zip(numbered("first", n * p), np.ravel(np.outer(z, y) / (y @ y)), strict=True))
    return {**regulator.values(), "law": 1, **first}, y


@pytest.mark.parametrize("name", SYSTEMS)
def test_step_of_both_units_is_that_of_the_authors_toolbox(name, both):  # noqa: F811
    A, C, L, form, part = of_toolbox(name)
    for v in part["vectors"]:
        for limits, key in (((1e-9, 1e9), "z_semi_implicit_h1e-3"), ((0.4, 1.0), "z_semi_clamped_0.4_1")):
            values, y = held(A, C, form, L, v, limits)
            pair = both(values)
            pair.step(row(y))
            outputs = pair.step(row(y))
            expected = np.ravel(v[key])
            estimate = [outputs[entry] for entry in numbered("state_estimate", len(A))]
            np.testing.assert_allclose(estimate, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


# Of a design


def arm(observer, **changes):
    entries = {**ARM, "C": np.eye(2, 4), "outputs": ARM["states"][:2], "observer": observer, **changes}
    return System(**entries).with_lqr(np.ones(4), np.full(2, 0.1))


def observer_of(wish, **changes) -> Any:
    return homogeneous_observer(synthesize(arm(ObserverWish(**wish), **changes), 1.0, 0.3))


def gain_at(o, q):
    """S for the output error q, unlimited."""
    powers = q ** (o.nu * (1 + np.array(o.exponents)))
    return o.L_0 + o.T.T @ np.diag(powers) @ np.linalg.inv(o.T).T @ (o.L - o.L_0)


GAIN = -np.array([[40.0, 5.0], [5.0, 60.0], [500.0, 100.0], [0.0, 1000.0]])


def test_gain_is_the_linear_one_where_it_is_meant_to_be():
    for rest, q in (({}, None), ({"q_linear": 0.02}, 0.02), ({"q_max": 0.3}, 0.3)):
        observer = observer_of({"L": GAIN, **rest})
        np.testing.assert_allclose(gain_at(observer, q or observer.q_max), GAIN, rtol=1e-9, atol=1e-9)
    assert observer.q_min == pytest.approx(0.003)


def test_weights_give_the_dual_of_the_linear_quadratic_regulator():
    """A S + S A' - S C' R^-1 C S + Q = 0, L = -S C' R^-1."""
    observer = observer_of({"Q": [1.0, 1.0, 50.0, 50.0], "R": [1e-3, 2e-3], "q_linear": 1.0})
    A, C, R = ARM["A"], np.eye(2, 4), np.diag([1e-3, 2e-3])
    S = solve_continuous_are(A.T, C.T, np.diag([1.0, 1.0, 50.0, 50.0]), R)
    np.testing.assert_allclose(observer.L, -S @ C.T @ np.linalg.inv(R), rtol=1e-8)
    assert np.linalg.eigvals(A + observer.L @ C).real.max() < 0.0


def test_poles_are_those_of_the_linear_observer():
    poles = [-30.0, -20.0, -25.0, -15.0]
    observer = observer_of({"poles": poles})
    L = gain_at(observer, observer.q_max)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(ARM["A"] + L @ np.eye(2, 4)).real), np.sort(poles), rtol=1e-6)


def test_without_a_gain_it_has_that_of_the_kalman_filter():
    observer = observer_of({}, resolutions=[1e-3, 1e-3])
    L = gain_at(observer, observer.q_max)
    assert np.linalg.eigvals(ARM["A"] + L @ np.eye(2, 4)).real.max() < -1.0
    assert observer.nu < 0.0
    assert observer.q_min >= 3 * 1e-3 * np.sqrt(2 / 12)


@pytest.mark.parametrize("wish", [{"L": GAIN}, {}, {"Q": [1.0, 1.0, 500.0, 500.0], "R": [1e-4, 1e-4]}])
def test_estimate_converges_and_the_law_with_it(wish):
    design = synthesize(arm(ObserverWish(**wish), resolutions=[0.0, 0.0]), 1.0, 0.3)
    controller = Controller(design, a_min=0.3)
    F, G = discrete(ARM)
    x = np.array([0.02, -0.01, 0.05, 0.0])
    for _ in range(8000):
        x = F @ x + G @ controller(x[:2])
    assert np.abs(x).max() < 1e-6
    np.testing.assert_allclose(controller.estimate, x, atol=1e-5)


def test_small_errors_vanish_sooner_than_with_the_linear_observer():
    F, G = discrete(ARM)

    def error(nu):
        controller = Controller(synthesize(arm(ObserverWish(L=GAIN, nu=nu, q_min=1e-5, q_max=0.05)), 1.0, 0.3))
        x = np.array([0.02, -0.01, 0.05, 0.0])
        for _ in range(600):
            x = F @ x + G @ controller(x[:2])
        controller(x[:2])
        return np.abs(controller.estimate - x)[:2].max()

    assert error(-0.2) < 0.1 * error(0.0)


def test_controller_with_it_shows_no_disturbance_estimates():
    shown, hidden = regulator_of(synthesize(arm(ObserverWish(L=GAIN)), 1.0, 0.3)).exported()
    assert "shoulder_rate_estimate" in shown.by_name
    assert not any("disturbance" in name for name in shown.by_name)
    assert hidden["estimator"] == 3


def test_system_file_and_design_hold_the_wish(tmp_path):
    system = arm(ObserverWish(L=GAIN, nu=-0.1, q_min=1e-3))
    system.save(tmp_path / "arm.toml")
    again = System.load(tmp_path / "arm.toml").observer
    assert again is not None
    assert again.as_table() == {"L": GAIN.tolist(), "nu": -0.1, "q_min": 1e-3}


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        ({"L": -GAIN}, "L must make A [+] L C stable, .*; -L would, if the observer is meant as"),
        ({"L": GAIN, "nu": -0.9}, r"observer.nu must lie in \[-0\.\d+, 0\] for this gain, found -0.9"),
        ({"L": GAIN, "q_min": 0.2, "q_max": 0.1}, "observer.q_min must not exceed observer.q_max, found 0.2 and 0.1"),
        ({"Q": [1.0], "R": [1.0, 1.0]}, "observer.Q must be 4 numbers"),
        ({"poles": [-1.0, -2.0]}, "observer.poles must be 4 numbers, one for each state, found 2"),
        (
            {"poles": [-1.0, -1.0, -1.0, -2.0]},
            "observer.poles must not hold a number more often than there are independent outputs, 2, found -1 3 times; set",
        ),
    ],
)
def test_what_makes_no_observer_is_refused(wish, message):
    with pytest.raises(UserError, match=message):
        observer_of(wish)


def test_a_model_that_is_not_observable_is_refused():
    design = synthesize(arm(ObserverWish(), C=np.array([[0.0, 0.0, 1.0, 0.0]]), outputs=("rate",), A=np.diag([1.0, 1.0], -2)
                       + np.diag([1.0, 1.0], 2)), 1.0, 0.3)  # fmt: skip
    with pytest.raises(UserError, match=r"needs outputs that tell all states, \(A, C\) observable"):
        homogeneous_observer(design)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"observer": 3}, "observer must be a table of L, poles, Q, R, nu, q_min, q_max, q_linear, found 3"),
        ({"observer": {"l": 3}}, "observer must be a table of L"),
        ({"observer": {"L": [[1, "2"]]}}, "observer.L must be rows of numbers"),
        ({"observer": {"L": [[1.0, 2.0]]}}, r"observer.L must have 4 rows of 2 numbers .* found shape \(1, 2\)"),
        ({"observer": {"Q": [1.0]}}, "observer must have L, or poles, or both Q and R, or none of them"),
        ({"observer": {"poles": [1.0, -1.0, -2.0, -3.0]}}, r"observer.poles must be negative \[1/s\], found 1"),
        ({"observer": {"nu": 0.1}}, r"observer.nu must lie in \[-1, 0\], found 0.1"),
        ({"observer": {"q_min": 0}}, "observer.q_min must be positive and finite, found 0"),
        ({"observer": {}, "biases": ["y1"]}, "biases must be left out with observer"),
        ({"observer": {}, "bandwidth": 3.0}, "bandwidth must be left out with observer"),
        (
            {"observer": {}, "integral": "direct"},
            "integral needs states that a disturbance does not falsify: .*, found obs",
        ),
        ({"bandwidth": 0, "integral": "direct"}, "integral needs states .*, found bandwidth = 0"),
        ({"observer": {}, "C": None}, "observer is for outputs y = C x; without C the states are measured"),
    ],
)
def test_entries_of_a_file_that_are_none_are_refused(entries, message):
    given = {"A": ARM["A"].tolist(), "B": ARM["B"].tolist(), "C": np.eye(2, 4).tolist(), **entries}
    with pytest.raises(UserError, match=message):
        System.from_dict({name: value for name, value in given.items() if value is not None})
