"""Integral action: the authors' toolbox, the proof's Lyapunov function, constant disturbances, limits, refusals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from fmu_export.errors import UserError
from ihc_fmu.certificate import CertificateError
from ihc_fmu.controller import Controller
from ihc_fmu.design import Design
from ihc_fmu.homogeneity import homogeneous_norm
from ihc_fmu.integral import IntegralAction, nearest
from ihc_fmu.inverse import inverse_design
from ihc_fmu.laws import block_state, controls, integrand
from ihc_fmu.options import Options
from ihc_fmu.synthesis import chosen_options, synthesize
from ihc_fmu.system import System
from tests.ihc_fmu.blocks import random_system
from tests.ihc_fmu.regulator.test_closed_loop import ARM, CART, H

DATA = Path(__file__).parent / "data" / "hcs_general_reference.json"
SYSTEMS = {system["name"]: system for system in json.loads(DATA.read_text(encoding="utf-8"))["systems"]}


@pytest.mark.parametrize("name", SYSTEMS)
def test_redesigned_gain_is_that_of_the_authors_toolbox(name):
    """For the toolbox's own P; sizes of 1."""
    system, part = SYSTEMS[name], SYSTEMS[name]["lpic2hpic"]
    B, K_i, P = (np.array(M, dtype=float) for M in (system["B"], part["K_i"], part["P"]))
    B, K_i = B.reshape(len(P), -1), K_i.reshape(-1, len(P))
    Gamma = nearest(K_i, B, P, np.ones(len(P)), np.ones(len(K_i)))
    np.testing.assert_allclose(-Gamma @ B.T @ P, np.reshape(part["K_i_new"], K_i.shape), rtol=1e-8, atol=1e-12)


def test_nearest_gain_is_the_same_in_all_units():
    """And a K_i that already is -Gamma B' P for some Gamma stays as it is."""
    rng = np.random.default_rng(0)
    B, L, G = rng.normal(size=(5, 2)), rng.normal(size=(5, 5)), rng.normal(size=(2, 2))
    P, Gamma = L @ L.T + np.eye(5), G @ G.T + np.eye(2)
    ones = np.ones(5), np.ones(2)
    np.testing.assert_allclose(nearest(-Gamma @ B.T @ P, B, P, *ones), Gamma, rtol=1e-9)
    K_i = -Gamma @ B.T @ P + 0.3 * rng.normal(size=(2, 5))
    x, u = 10 ** rng.uniform(-3, 3, 5), 10 ** rng.uniform(-3, 3, 2)
    expected = nearest(K_i, B, P, *ones)
    nearest_gain = nearest(K_i * u[:, None] / x, B * x[:, None] / u, P / x[:, None] / x, x, u)
    np.testing.assert_allclose(nearest_gain / u[:, None] / u, expected, rtol=1e-9)


# The proof


def loop(system, Gamma, limits):
    """Return V and its rate under x' = A x + B (u_h + w), w' = v', with the exact norm within the limits."""
    law, A, B, mu = system.design(), system.A, system.B, system.mu
    Kiz = (-Gamma @ B.T @ system.P @ np.linalg.inv(system.T)).tolist()

    def norms(x):
        state = block_state(law, x.tolist())
        norm = homogeneous_norm(state.polynomial, mu)
        return state, norm, min(limits[1], max(limits[0], norm))

    def V(x, w):
        _, norm, r = norms(x)
        p = 2 - 2 * mu
        energy = r**p / p
        if norm != r:
            y = expm(-np.log(r) * system.generator()) @ x
            energy += r**p * (y @ system.P @ y - 1) / 2
        return energy + w @ np.linalg.solve(Gamma, w) / 2

    def motion(x, w):
        state, norm, r = norms(x)
        u = np.array(controls(law, state, r, None))
        return A @ x + B @ (u + w), np.array(integrand(law, Kiz, r, state, norm == r))

    def predicted(x):
        _, norm, r = norms(x)
        G, closed = system.generator(), A + B @ system.K
        y = expm(-np.log(r) * G) @ x
        q = 1 / (y @ system.P @ G @ y) if norm == r else 1.0
        return q * r ** (2 - 3 * mu) * (y @ system.P @ closed @ y)

    return V, motion, predicted


@pytest.mark.parametrize(("n", "m", "mu"), [(2, 1, 0.5), (4, 2, 0.5), (5, 2, 0.3), (6, 3, 0.1)])
def test_lyapunov_function_changes_as_the_proof_says(n, m, mu):
    """For every gain, stabilizing or not, every disturbance, and norms within, below and above the limits."""
    system, rng = random_system(n, m, mu), np.random.default_rng([n, m])
    G = rng.normal(size=(m, m))
    V, motion, predicted = loop(system, G @ G.T + np.eye(m), (0.5, 2.0))
    for size in np.geomspace(0.02, 20.0, 12):
        x = size * rng.normal(size=n)
        w = rng.normal(size=m)
        dx, dw = motion(x, w)
        h = 1e-6 / max(1.0, np.abs(dx).max() / np.abs(x).max())
        rate = (V(x + h * dx, w + h * dw) - V(x - h * dx, w - h * dw)) / (2 * h)
        scale = abs(rate) + abs(w @ np.linalg.solve(G @ G.T + np.eye(m), dw)) + abs(V(x, w))
        assert rate == pytest.approx(predicted(x), abs=1e-6 * scale)


# The closed loop


def arm(**changes):
    return System(**{**ARM, **changes}).with_lqr(np.ones(4), np.full(2, 0.1))


def discrete(entries):
    n, m = entries["B"].shape
    block = expm(H * np.block([[entries["A"], entries["B"]], [np.zeros((m, n + m))]]))
    return block[:n, :n], block[:n, n:]


def run(controller, entries, x, seconds, disturbance):
    """Return the states and integral actions of all samples."""
    F, G = discrete(entries)
    xs, vs = [], []
    for _ in range(round(seconds / H)):
        x = F @ x + G @ (controller(x) + disturbance)
        xs.append(x)
        vs.append(controller.integral)
    return np.array(xs), np.array(vs)


@pytest.mark.parametrize(
    ("law", "start"), [("LC", {}), ("IHC", {"a_min": 0.3}), ("IHC", {"a_min": 0.05, "b_max": 3.0})]
)
@pytest.mark.parametrize("integral", ["direct", "linear"])
def test_constant_disturbance_leaves_no_error(law, start, integral):
    """v ends at what takes the disturbance away; without integral action an error stays."""
    disturbance = np.array([0.3, -0.2])
    gain: Any = "direct" if integral == "direct" else -np.array([[8.0, 3.0, 2.0, 1.0], [3.0, 3.0, 1.0, 0.6]])
    design = synthesize(arm(integral=gain), 0.5, 0.3, u_max=[3.0, 3.0])
    seconds = 25.0 if (law, integral) == ("LC", "linear") else 12.0  # that pole is the slowest
    x, v = run(Controller(design, law=law, **start), ARM, np.zeros(4), seconds, disturbance)
    assert np.abs(x).max() > 1e-3
    assert np.abs(x[-1]).max() < 1e-4
    np.testing.assert_allclose(v[-1], -disturbance, atol=1e-3)
    plain = Controller(synthesize(arm(), 0.5, 0.3, u_max=[3.0, 3.0]), law=law, **start)
    without, _ = run(plain, ARM, np.zeros(4), 8.0, disturbance)
    assert np.abs(without[-1]).max() > 1e-3


def test_saturated_input_does_not_wind_up():
    """A cart far from its goal, its force limited and disturbed: v stays within what the limit leaves, and no error does."""
    entries = {
        **CART,
        "A": np.array([[0, 1.0], [0, -0.5]]),
        "B": np.array([[0.0], [1.0]]),
        "states": ("position", "speed"),
    }
    system = System(**entries, lower=-np.ones(1), upper=np.ones(1), integral="direct").with_lqr(np.ones(2), np.ones(1))
    design = synthesize(system, 0.5, 0.1)
    x, v = run(Controller(design, a_min=0.1, b_max=1.0), entries, np.array([-20.0, 0.0]), 40.0, np.array([0.4]))
    assert x[:, 0].max() < 2.0
    assert np.abs(v).max() < 1.0
    assert np.abs(x[-1]).max() < 1e-6
    assert v[-1, 0] == pytest.approx(-0.4, abs=1e-6)


def test_limited_norm_one_is_the_linear_pi_controller():
    """Its eigenvalues are stable for every Gamma > 0: the last step of the proof at r = 1."""
    design = synthesize(arm(integral="direct"), 0.5, 0.3)
    assert design.integral is not None
    poles = np.linalg.eigvals(
        np.block([[design.A + design.B @ design.K, design.B], [design.integral.K_i, np.zeros((2, 2))]])
    )
    assert poles.real.max() < 0.0


# What it makes of a system


def test_direct_gain_makes_both_poles_of_a_first_order_model_equal():
    system = System(A=np.array([[0.5]]), B=np.array([[2.0]]), K=np.array([[-3.25]]), integral="direct")
    design = inverse_design(system, Options(mu=0.5, alpha=1.0, u_max=7.0))
    assert design.integral is not None
    poles = np.linalg.eigvals(np.array([[0.5 - 6.5, 2.0], [design.integral.K_i[0, 0], 0.0]]))
    # A + B K_h = -6: K_0 = -1/4 takes A away, and K_h is what remains
    np.testing.assert_allclose(poles, [-3.0, -3.0], atol=1e-4)


def test_direct_gain_does_not_depend_on_the_scale_of_P():
    design = synthesize(arm(integral="direct"), 0.5, 0.3)
    smaller = design.scaled_to(u_max=0.1)
    assert design.integral is not None
    assert smaller.integral is not None
    np.testing.assert_allclose(smaller.integral.K_i, design.integral.K_i, rtol=1e-9)


def test_file_holds_it_and_proves_it_again(tmp_path):
    design = synthesize(arm(integral="direct"), 0.5, 0.3)
    design.save(tmp_path / "arm.json")
    again = Design.load(tmp_path / "arm.json")
    assert design.integral is not None
    assert again.integral is not None
    np.testing.assert_array_equal(again.integral.K_i, design.integral.K_i)
    derived = json.loads((tmp_path / "arm.json").read_text())["derived"]
    np.testing.assert_array_equal(derived["K_i"], design.integral.K_i)
    np.testing.assert_allclose(design.integral.K_i, -np.array(derived["Gamma"]) @ design.B.T @ design.P)


@pytest.mark.parametrize("integral", ["direct", [[-8.0, -3.0, -2.0, -1.0], [-3.0, -3.0, -1.0, -0.6]]])
def test_system_file_holds_it(integral, tmp_path):
    arm(integral=integral).save(tmp_path / "arm.toml")
    again = System.load(tmp_path / "arm.toml").integral
    assert (again if isinstance(again, str) else np.asarray(again).tolist()) == integral


@pytest.mark.parametrize(
    ("integral", "message"),
    [
        ("some", 'integral must be rows of numbers or "direct", found .some'),
        ([[1.0, 2.0]], r"integral must have 1 row of 4 numbers to fit B and A, found shape \(1, 2\)"),
        ([[1.0, 2.0, 3.0, "4"]], "integral must be rows of numbers"),
        (3.0, "integral must be rows of numbers"),
        ([[1.0, 2.0, 3.0, float("nan")]], "integral must be finite, found nan"),
    ],
)
def test_entries_of_a_file_that_are_none_are_refused(integral, message):
    with pytest.raises(UserError, match=message):
        System.from_dict({"A": CART["A"].tolist(), "B": CART["B"].tolist(), "integral": integral})


def test_degree_is_chosen_for_it():
    choice = chosen_options(arm(integral="direct"))
    assert choice.options.mu == 0.5
    assert choice.reasons[0] == "mu = 0.5: the largest for integral action"


@pytest.mark.parametrize(
    ("integral", "mu", "message"),
    [
        ("direct", 1.0, "integral action needs mu <= 0.5, found mu = 1"),
        (np.ones((2, 4)), 0.5, "stabilizes: the largest real part of its poles is"),
    ],
)
def test_what_has_no_integral_action_is_refused(integral, mu, message):
    with pytest.raises(UserError, match=message):
        synthesize(arm(integral=integral), mu, 0.3)


def test_gains_without_a_proof_are_refused():
    B, P, ones = np.eye(3, 2), np.eye(3), (np.ones(3), np.ones(2))
    with pytest.raises(UserError, match="integral must have independent rows, one for each input"):
        nearest(-np.ones((2, 3)), B, P, *ones)
    with pytest.raises(UserError, match=r"must resemble -Gamma B' P for some Gamma > 0 .* found none"):
        nearest(np.eye(2, 3), B, P, *ones)
    for Gamma in (np.array([[1.0, 1.0], [1.0, 1.0]]), np.array([[1.0, 0.5], [0.5 + 1e-16 * 4, 1.0]])):
        with pytest.raises(CertificateError, match="Gamma > 0 fails"):
            IntegralAction(-Gamma @ B.T, Gamma)
