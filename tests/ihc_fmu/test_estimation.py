"""Noises from resolutions and a bandwidth: the pendulum's filter, what each of them does, what cannot be observed."""

from dataclasses import replace

import numpy as np
import pytest

from fmu_export.errors import UserError
from ihc_fmu.design import Design
from ihc_fmu.estimation import bandwidth, estimator, noise, remarks
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.pendulum.kalman import linearize
from ihc_fmu.pendulum.nominal_model import nominal_model
from ihc_fmu.pendulum.paper_system import PAPER_K_LIN
from ihc_fmu.pendulum.start_values import nominal_values
from ihc_fmu.quantity import Quantity
from ihc_fmu.synthesis import chosen_options
from ihc_fmu.system import System
from plant_fmu.parameters import PARAMETER_SETS
from tests.ihc_fmu.pendulum.test_kalman import PUBLISHED_M

COUNT = 2 * np.pi / 2048
PUMPS = (Quantity("left"), Quantity("right"))


@pytest.fixture(scope="module")
def pendulum():
    """The pendulum of the set `ident` with both angles counted, as its own filter has it."""
    A, b = linearize(nominal_model(nominal_values(PARAMETER_SETS["ident"].parameters)))
    system = System(
        A=A,
        B=b,
        C=np.eye(2, 4),
        K=np.array(PAPER_K_LIN),
        outputs=(Quantity("theta", "rad"), Quantity("delta", "rad")),
        resolutions=np.full(2, COUNT),
        biases=("delta",),
    )
    return inverse_design(system, Options(alpha=0.05))


def cart(m: float = 1.0, **changes):
    """A design for a mass m [kg] moved by a force, its position measured."""
    model = {
        "A": np.eye(2, k=1),
        "B": np.array([0.0, 1 / m]),
        "C": np.array([[1.0, 0.0]]),
        "K": -m * np.array([1.0, 2.0]),
    }
    system = System(**{**model, "states": ("position", "velocity"), "inputs": ("force",), **changes})
    return Design(system, np.array([[1.0, 0.3], [0.3, 0.5]]), mu=1.0, alpha=1e-3)


def test_pendulums_own_filter_comes_out_of_its_resolution_and_a_bandwidth(pendulum):
    """Its noises were chosen by hand; those of 100 rad/s are nearly the same ones."""
    kalman = estimator(replace(pendulum, system=pendulum.system.changed(bandwidth=100.0)))
    np.testing.assert_allclose(kalman.M[[0, 1, 2, 3, 4, 6]], PUBLISHED_M, rtol=0.1)
    assert not kalman.M[5].any()  # no bias of theta


def test_without_a_bandwidth_three_times_the_fastest_pole_is_taken(pendulum):
    fastest = np.abs(np.linalg.eigvals(pendulum.A + pendulum.B @ pendulum.K)).max()
    assert bandwidth(pendulum) == pytest.approx(3 * fastest)
    np.testing.assert_allclose(estimator(pendulum).M[[0, 1, 2, 3, 4, 6]], PUBLISHED_M, rtol=0.3)
    slow = replace(pendulum, system=pendulum.system.changed(sample_time=0.02))
    assert bandwidth(slow) == pytest.approx(0.3 / 0.02)


def test_variance_is_that_of_rounding_to_counts_and_of_noise():
    assert noise(cart(resolutions=[0.6])).outputs == pytest.approx([0.03])
    assert noise(cart(deviations=[0.2])).outputs == pytest.approx([0.04])
    assert noise(cart(resolutions=[0.6], deviations=[0.2])).outputs == pytest.approx([0.07])
    extent = np.sqrt(np.linalg.inv(cart().P)[0, 0])
    assert noise(cart()).outputs == pytest.approx([(1e-4 * extent) ** 2])


@pytest.mark.parametrize("omega", [5.0, 20.0])
def test_disturbance_is_estimated_with_the_bandwidth_whatever_the_mass_and_the_sensor(omega):
    """The step of a force is told to 1 - 1/e within the time of the slowest pole; poles of magnitude omega."""
    for m, resolution in ((1.0, 1e-3), (50.0, 1e-3), (1.0, 1.0)):
        kalman = estimator(cart(m, resolutions=[resolution], bandwidth=omega))
        F = np.block([[kalman.F, kalman.G], [np.zeros((1, 2)), np.ones((1, 1))]])
        C = np.array([[1.0, 0.0, 0.0]])
        poles = np.linalg.eigvals((np.eye(3) - kalman.M[:3] @ C) @ F)
        np.testing.assert_allclose(np.abs(np.log(poles)) / 1e-3, omega, rtol=0.5)


def test_disturbances_are_left_out_on_demand():
    """Two pumps of one tank: which of them leaks cannot be told from the level; without disturbances there is a filter."""
    tank = System(name="tank", A=np.zeros((1, 1)), B=np.ones((1, 2)), K=-np.ones((2, 1)), inputs=PUMPS)
    with pytest.raises(UserError) as refusal:
        estimator(Design(tank, np.eye(1), mu=1.0, alpha=0.1))
    assert str(refusal.value) == (
        "tank has no Kalman filter: 2 disturbances and biases cannot be told from 1 measured output; "
        "bandwidth = 0 in the system leaves the disturbances out"
    )
    kalman = estimator(Design(tank.changed(bandwidth=0.0), np.eye(1), mu=1.0, alpha=0.1))
    assert 0.0 < kalman.M[0, 0] < 1.0
    assert not kalman.M[1:3].any()


def test_state_that_cannot_be_observed_is_refused_by_name():
    """What is advised is what helps: leaving out the disturbances or a bias, and where neither does, measuring more."""
    refusal = (
        r"^system has no Kalman filter: no measured output tells position from nothing; measure more, or leave out "
    )
    with pytest.raises(UserError, match=refusal):
        estimator(cart(C=np.array([[0.0, 1.0]])))
    integrates = cart().system.changed(integral="direct", biases=("y1",))
    with pytest.raises(UserError, match=r"cannot be told from 1 measured output; without biases there is one$"):
        estimator(replace(cart(), mu=0.5, system=integrates))


def test_a_count_that_moves_a_command_by_much_is_said_with_what_lessens_it():
    A, B, C, K = np.array([[0, 1], [0, -1.0]]), np.array([[0], [1.0]]), np.array([[1.0, 0]]), np.array([[-100.0, -20]])
    low, high = np.array([-1.0]), np.array([1.0])
    system = System(A=A, B=B, C=C, K=K, resolutions=np.array([1.0]), lower=low, upper=high)
    (said,) = remarks(inverse_design(system, chosen_options(system).options))
    assert said.startswith("a count of a sensor, or three deviations, moves a command by 215 % of its room")
    assert all(entry in said for entry in ("`bandwidth`", "`K`", "`lqr`", "`resolutions`"))
