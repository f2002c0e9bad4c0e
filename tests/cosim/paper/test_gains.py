"""The printed k and P: where k comes from, and eigenvalues of each reading computed here once more, with another Phi."""

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov

from cosim.judged_signals import kept_upright
from cosim.paper import printed
from cosim.paper.gains import (
    K_LIN,
    TILT,
    A,
    B,
    GainReading,
    capture_level,
    gain_readings,
    norm_readings,
    poles_text,
    recovered_gain,
)
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario

RECOVERED = np.array([2.0, -30.0, 2.0, -2.6])
G_CHAIN = np.diag([4.0, 3.0, 2.0, 1.0])
"""Lemma 3 of the paper, mu = 1."""


def chain(A, b):
    """Return (Phi, row) from the characteristic polynomial: x = T z, with T's columns from b to the left by Horner."""
    coefficients = np.poly(A)
    columns = [b]
    for c in coefficients[1:-1]:
        columns.insert(0, A @ columns[0] + c * b)
    return np.linalg.inv(np.column_stack(columns)), -coefficients[:0:-1] @ np.linalg.inv(np.column_stack(columns))


PHI, ROW = chain(A, B)


def test_the_chain_form_here_is_one():
    shift, last = PHI @ (A - np.outer(B, ROW)) @ np.linalg.inv(PHI), PHI @ B
    assert shift == pytest.approx(np.eye(4, k=1), abs=1e-9)
    assert last == pytest.approx([0.0, 0.0, 0.0, 1.0], abs=1e-12)


# k


def test_the_printed_k_was_made_from_another_gain_in_chain_coordinates():
    assert recovered_gain() == pytest.approx(RECOVERED, abs=1e-3)
    assert recovered_gain() == pytest.approx(100.0 * (printed.K - ROW) @ PHI, abs=1e-7)
    assert abs(recovered_gain() - K_LIN).max() > 0.09  # not the printed k_lin with its -2.5


def test_that_gain_gives_the_printed_k_as_far_as_A_and_b_are_printed():
    """A and b have four decimals; half a unit of the last one in each entry moves this k by more than it is off."""

    def k(A, b):
        Phi, row = chain(A, b)
        return RECOVERED @ np.linalg.inv(Phi) / 100.0 + row

    off = abs(k(A, B) - printed.K)
    assert off.max() < 5e-4
    entries = [(A, i) for i in np.ndindex(4, 4) if A[i] not in (0.0, 1.0)] + [(B, (i,)) for i in (2, 3)]
    allowed = np.full(4, 5e-5)
    for given, i in entries:
        changed = {id(M): M.copy() for M in (A, B)}
        changed[id(given)][i] += 5e-5
        allowed += abs(k(*changed.values()) - k(A, B))
    assert (off < allowed).all()
    assert allowed.max() < 3e-3


def test_the_same_with_the_printed_k_lin_does_not():
    k = K_LIN @ np.linalg.inv(PHI) / 100.0 + ROW
    assert (abs(k - printed.K) > 0.01).tolist() == [False, False, False, True]


def by_name():
    return {reading.name: reading for reading in gain_readings()}


def test_no_reading_of_the_printed_k_is_stable_but_the_recovered_gain_and_eq_10_are():
    readings = gain_readings()
    assert [reading.stable for reading in readings] == [False] * 4 + [True] * 2
    assert [reading.name.startswith("printed k") for reading in readings] == [True] * 4 + [False] * 2
    for reading in readings:
        poles = np.linalg.eigvals(PHI @ (A + np.outer(B, reading.K)) @ np.linalg.inv(PHI))
        assert np.poly(poles) == pytest.approx(np.poly(reading.poles), rel=1e-6)
        assert reading.stable == (poles.real.max() < 0.0)


def test_the_readings_are_what_their_names_say():
    readings = by_name()
    expected = {
        "printed k: u = k x": printed.K,
        "printed k: u = k x - row x": printed.K - ROW,
        "printed k in chain coordinates: u = k Φ x": printed.K @ PHI,
        "printed k in chain coordinates: u = k Φ x - row x": printed.K @ PHI - ROW,
        "recovered: u = 100 (k - row) Φ x": RECOVERED,
        "eq. (10), k = k_lin + row: u = k x - row x": np.array([2.0, -30.0, 2.0, -2.5]),
    }
    assert list(readings) == list(expected)
    for name, gain in expected.items():
        np.testing.assert_allclose(readings[name].K, gain, rtol=0, atol=1e-3, err_msg=name)


@pytest.mark.parametrize("index", range(6))
def test_the_fmu_loses_the_pendulum_with_each_unstable_reading_and_keeps_it_with_the_others(fmus, index):
    reading = gain_readings()[index]
    scenario, folder = load_scenario("tilt")
    changes = {f"controller.start.{name}": value for name, value in reading.start.items()}
    changes |= {"run.duration": 5.0, "controller.start.swing_up_enabled": False}
    result = run_scenario(scenario.changed(changes), fmus, folder)
    assert result.metadata["start_values"]["controller"]["k_lin_1"] == reading.K[0]
    assert kept_upright(result) == reading.stable


# P


def test_eq_11_is_solved_by_the_solved_P_alone(design):
    readings = norm_readings(design.P)
    assert [reading.solves for reading in readings] == [False] * 4 + [True]
    assert [reading.name.startswith("printed") for reading in readings] == [True] * 4 + [False]
    assert readings[-1].P.tolist() == design.P.tolist()


def test_the_readings_of_P_are_quadratic_forms_of_the_coordinates_they_name(design):
    x = np.random.default_rng(3).standard_normal((20, 4))
    z = x @ PHI.T
    in_x, in_z, of_x_in_z, inverse, _ = (reading.P for reading in norm_readings(design.P))

    def form(P, v):
        return np.einsum("ki,ij,kj->k", v, P, v)

    assert form(in_x, x) == pytest.approx(form(printed.P, x))
    assert form(in_z, x) == pytest.approx(form(printed.P, z))
    assert form(of_x_in_z, z) == pytest.approx(form(printed.P, x))
    assert inverse @ printed.P == pytest.approx(np.eye(4), abs=1e-9)


def margins(P):
    """Return the margins of eq. (11) from a Cholesky factor, in chain coordinates."""
    T = np.linalg.inv(PHI)
    closed = PHI @ (A + np.outer(B, K_LIN)) @ T
    L = np.linalg.cholesky(T.T @ P @ T)
    back = np.linalg.inv(L)

    def eigenvalues(M):
        form = back @ (M.T @ L @ L.T + L @ L.T @ M) @ back.T
        return np.linalg.eigvalsh((form + form.T) / 2)

    return eigenvalues(G_CHAIN)[0], -eigenvalues(closed + printed.ALPHA * G_CHAIN)[-1]


def test_the_margins_of_eq_11_are_these(design):
    for reading in norm_readings(design.P):
        monotone, decrease = margins(reading.P)
        assert reading.monotone == pytest.approx(monotone, rel=1e-6), reading.name
        assert reading.decrease == pytest.approx(decrease, rel=1e-6), reading.name
        assert reading.solves == (monotone > 0.0 and decrease > 0.0)


def test_a_negative_margin_means_a_state_at_which_the_linear_control_lets_the_form_grow(design):
    """With alpha next to 0, d(x'Px)/dt > 0 somewhere on the ellipsoid; at the solved P nowhere, by a simulated second."""
    closed = A + np.outer(B, K_LIN)
    flows = [expm(closed * t) for t in np.linspace(0.0, 1.0, 201)]
    for reading in norm_readings(design.P):
        L = np.linalg.cholesky(reading.P)
        largest = [np.linalg.norm(L.T @ flow @ np.linalg.inv(L.T), 2) for flow in flows]
        assert (max(largest) > 1.0 + 1e-9) == (not reading.solves), reading.name


@pytest.mark.parametrize(("weights", "solves"), [((1.0, 1.0, 1.0, 1.0), True), ((1.0, 1e-3, 1e-3, 1e-6), False)])
def test_a_lyapunov_matrix_of_the_linear_loop_need_not_solve_eq_11(weights, solves):
    """Its form decreases along the linear loop, but the dilation must not shrink it anywhere."""
    P = solve_continuous_lyapunov((A + np.outer(B, K_LIN)).T, -np.diag(weights))
    reading = norm_readings(P)[-1]
    assert (reading.monotone, reading.decrease) == pytest.approx(margins(P), rel=1e-5)
    assert (reading.solves, reading.monotone > 0.0) == (solves, solves)


def test_scaling_P_changes_no_margin(design):
    one, other = (norm_readings(factor * design.P)[-1] for factor in (1.0, 1e4))
    assert (one.monotone, one.decrease) == pytest.approx((other.monotone, other.decrease), rel=1e-9)


def test_the_fmu_is_given_the_upper_triangle_and_takes_over_at_once_from_the_tilt(design):
    for reading in norm_readings(design.P):
        assert [reading.start[f"P_{i}{j}"] for i, j in ((1, 1), (1, 2), (2, 2), (3, 4), (4, 4))] == [
            reading.P[i - 1, j - 1] for i, j in ((1, 1), (1, 2), (2, 2), (3, 4), (4, 4))
        ]
        x = np.array([0.0, TILT, 0.0, 0.0])
        assert reading.start["capture_level"] == pytest.approx(10.0 * (x @ reading.P @ x))
        assert reading.start["capture_level"] == capture_level(reading.P)
        assert (reading.start["law"], reading.start["a_min"], reading.start["b_max"]) == ("IHC", 0.88, 1.0)


# Text


def test_poles_are_written_slowest_first_and_pairs_once():
    poles = np.array([-8.0 - 29.0j, -8.0 + 29.0j, -11.25, 1.5])
    assert poles_text(poles) == "1.5, -8 ± 29i, -11.25"
    assert poles_text(np.array([-2.0, -1.0])) == "-1, -2"


def test_a_pole_on_the_imaginary_axis_is_not_stable():
    assert not GainReading("", K_LIN, np.array([0.0, -1.0]), {}).stable
    assert GainReading("", K_LIN, np.array([-1e-9 + 5j, -1e-9 - 5j]), {}).stable
