"""The pendulum and its controller: what differs between the design's model and the plant's is found and named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.pendulum_match import Model, design_model, distance, misfit, plant_model, remarks
from ihc_fmu.companion import chain_form
from ihc_fmu.pendulum.interface import matrix, vector
from ihc_fmu.pendulum.paper_system import PAPER_A, PAPER_B, PAPER_K_LIN
from ihc_fmu.pendulum.start_values import zip_names
from plant_fmu.interface import start_values
from plant_fmu.parameters import PARAMETER_SETS

A, B, K = np.array(PAPER_A), np.array(PAPER_B), np.array(PAPER_K_LIN)
IDENT = start_values("ident")
HANGING = A * [[1], [1], [1], [-1]] * [1, 1, 1, 1], B * [1, 1, 1, -1]
"""Gravity and the coupling act the other way on the pendulum."""


def controller(A, b, k_lin=K) -> dict[str, float]:
    """Return the start values that a design for (A, b) gives the controller FMU."""
    form = chain_form(A, b)
    values = zip_names(matrix("Phi"), form.Phi.ravel()) | zip_names(vector("row"), form.row)
    return {**values, **zip_names(vector("k_lin"), k_lin)}


def changed(order=(0, 1, 2, 3), scale=(1.0, 1.0, 1.0, 1.0), model=(A, B)):
    """Return (A, b) of x_d = S Pi x."""
    A, b = model
    order, scale = list(order), np.array(scale)
    return A[np.ix_(order, order)] * np.outer(scale, 1.0 / scale), b[order] * scale


def test_the_designs_model_is_recovered_from_start_values():
    found = design_model(controller(A, B))
    assert found is not None
    np.testing.assert_allclose(found.A, A, atol=1e-9)
    np.testing.assert_allclose(found.b, B, rtol=1e-12, atol=1e-12)


def test_every_named_set_with_its_numbers_within_20_percent_fits_the_default_design():
    rng = np.random.default_rng(1)
    names = ("m_p", "L_p", "J_p", "D_p", "L_r", "J_r", "D_r", "R_m", "k_m")
    for chosen in PARAMETER_SETS.values():
        for spread in (0.0, *[0.2] * 100):
            p = chosen.parameters
            drawn = {name: getattr(p, name) * (1.0 + rng.uniform(-spread, spread)) for name in names}
            plant = start_values(replace(chosen, parameters=replace(p, **drawn)))
            assert misfit(controller(A, B), plant) is None


def test_small_differences_and_a_gain_that_does_not_stabilize_are_remarked():
    assert remarks(controller(A, B), IDENT) == []
    plant = {**IDENT, "J_p": 5e-5}
    assert misfit(controller(A, B), plant) is None
    assert remarks(controller(A, B), plant) == [
        "the controller's model is not quite the plant's: A differs by 29 %, b by +21 %"
    ]
    (said,) = remarks(controller(A, B), start_values("listed"))
    assert said == "k_lin does not stabilize this plant: the largest real part of its poles is 1.34 1/s"


DEGREE = 180.0 / np.pi


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (
            changed(order=(0, 2, 1, 3)),
            "its states are in the order theta, theta_dot, delta, delta_dot, not theta, delta,",
        ),
        (changed(order=(1, 0, 3, 2)), "its states are in the order delta, theta, delta_dot, theta_dot, not"),
        (changed(order=(2, 3, 0, 1)), "its states are in the order theta_dot, delta_dot, theta, delta, not"),
        (changed(scale=[DEGREE] * 4), "theta, delta, theta_dot, delta_dot are in degrees instead of rad"),
        (changed(scale=(1, DEGREE, 1, DEGREE)), "delta, delta_dot are in degrees instead of rad"),
        (changed(scale=(DEGREE, DEGREE, 1, 1)), "theta, delta are in degrees instead of rad"),
        (changed(scale=(1, 1, 30.0 / np.pi, 30.0 / np.pi)), "theta_dot, delta_dot are in rpm instead of rad/s"),
        (changed(scale=[1e-3] * 4), "its input is in mV instead of V"),
        (changed(scale=[-1] * 4), "the sign of its input is the opposite"),
        (changed(scale=(1, -1, 1, -1)), "the signs of delta, delta_dot are the opposite"),
        (
            changed(order=(0, 2, 1, 3), scale=(1, 1, -DEGREE, -DEGREE)),
            "its states are in the order theta, theta_dot, delta, delta_dot, not theta, delta, theta_dot, delta_dot; "
            "the signs of delta, delta_dot are the opposite; delta, delta_dot are in degrees",
        ),
        (HANGING, "it is linearized about the hanging pendulum"),
        (
            (
                np.array([[0, 0, 1, 0], [0, 0, 0, 1], [0, -0.98, 0, 0], [0, 21.6, 0, 0]]),
                np.array([0, 0, 1.0, -2.0]),
            ),
            "another system than this plant: A differs by 94 %, b by a factor of -0.00994; poles -4.65, 0, 0, 4.65 instead "
            "of -18.2, -2.04, 0, 14.6 1/s",
        ),
    ],
)
def test_a_design_for_another_model_is_told_what_differs(model, expected):
    found = misfit(controller(*model), IDENT)
    assert found is not None
    assert expected in found


def test_states_that_are_no_rates_are_told():
    found = misfit({**controller(A, B), "Phi_11": controller(A, B)["Phi_11"] * 3.0}, IDENT)
    assert found is not None
    assert "its last two states are no rates" in found


def test_poles_that_are_the_same_are_not_called_a_difference():
    real = plant_model(IDENT)
    assert real is not None
    S = np.array([1.0, 3.1, 1.0, 3.1])
    found = misfit(controller(real.A * np.outer(S, 1 / S), S * real.b), IDENT)
    assert found is not None
    assert "designed for this plant in other coordinates" in found


def test_units_that_do_not_say_are_not_judged():
    assert misfit({}, IDENT) is None
    assert misfit(controller(A, B), {"mass": 1.0}) is None
    assert design_model({**controller(A, B), "Phi_11": np.nan}) is None
    assert plant_model({**IDENT, "m_p": 0.0}) is None
    fit = distance(Model(A, B), Model(A, B))
    assert fit.fits
    assert (fit.A, fit.kinematics) == (0.0, 0.0)
