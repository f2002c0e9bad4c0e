"""The controller as an object: its example, the FMU of the same design, set-points, faults, what it refuses."""

import doctest
from typing import Any

import numpy as np
import pytest
from fmpy import extract
from scipy.linalg import expm

import ihc_fmu.controller
from fmu_export.errors import UserError
from fmu_export.native_fmu import export_native_fmu
from ihc_fmu.controller import Controller, regulator_of, resampled
from ihc_fmu.regulator.native_unit import NATIVE
from ihc_fmu.synthesis import synthesize
from ihc_fmu.system import System
from tests.fmu_export.conftest import Native
from tests.ihc_fmu.regulator.conftest import H, agree
from tests.ihc_fmu.regulator.test_closed_loop import ARM

MU, ALPHA = 1.0, 0.3
SYSTEM = System(
    **ARM, C=np.eye(2, 4), outputs=ARM["states"][:2], set_points=("elbow",),
    lower=np.array([-9.0, -4.0]), upper=np.array([9.0, 4.0]),
    x_eq=np.array([1.0, 0.5, 0.0, 0.0]), u_eq=np.array([0.5, -0.25]), y_eq=np.array([1.0, 0.5]),
).with_lqr(np.ones(4), np.full(2, 0.1))  # fmt: skip


@pytest.fixture(scope="module")
def arm():
    return synthesize(SYSTEM, MU, ALPHA)


class Plant:
    """The arm in discrete time, in absolute quantities; exact for held inputs."""

    def __init__(self):
        block = expm(H * np.block([[SYSTEM.A, SYSTEM.B], [np.zeros((2, 6))]]))
        self.F, self.G, self.x = block[:4, :4], block[:4, 4:], np.array([0.02, -0.01, 0.0, 0.0])

    @property
    def y(self) -> Any:
        return SYSTEM.C @ self.x + SYSTEM.y_eq

    def step(self, u):
        self.x = self.F @ self.x + self.G @ (u - SYSTEM.u_eq)


def filter_of(design) -> Any:
    return regulator_of(design).filter


def test_example_holds():
    assert doctest.testmod(ihc_fmu.controller).failed == 0


def test_it_is_the_fmu_of_the_design_to_the_last_bit(arm, tmp_path):
    start = {"a_min": 0.3, "elbow_setpoint": 0.52, "elbow_torque_upper": 0.5}
    interface, hidden = regulator_of(arm).exported()
    path = export_native_fmu(NATIVE, tmp_path / "arm_controller.fmu", start, interface=interface, hidden=hidden)
    native, controller, plant = Native(extract(str(path), str(tmp_path / "arm"))), Controller(arm, **start), Plant()
    names = ("shoulder", "elbow")
    native.initialize(**dict(zip(names, plant.y, strict=True)))
    for k in range(300):
        if k == 100:
            controller.set(elbow_setpoint=0.49, a_min=0.5)
            native.set(elbow_setpoint=0.49, a_min=0.5)
        u = controller(plant.y)
        native.step(k * H, H, **dict(zip(names, plant.y, strict=True)))
        agree(native.get("shoulder_torque", "elbow_torque"), u)
        agree(native.get("homogeneous_norm"), controller.norm)
        agree(native.get(*(f"{q.name}_estimate" for q in SYSTEM.states)), controller.estimate)
        agree(native.get(*(f"{q.name}_disturbance_estimate" for q in SYSTEM.inputs)), controller.disturbance)
        plant.step(u)
    native.free()


def test_set_point_is_reached_and_reset_begins_anew(arm):
    controller, plant = Controller(arm, a_min=0.2, elbow_setpoint=0.45), Plant()
    first = controller(plant.y)
    for _ in range(6000):
        plant.step(controller(plant.y))
    assert plant.y[1] == pytest.approx(0.45, abs=1e-6)
    np.testing.assert_allclose(controller.estimate - SYSTEM.x_eq, plant.x, atol=1e-6)
    controller.reset()
    assert (controller.samples, controller.norm, controller.mode) == (0, 0.0, "idle")
    np.testing.assert_array_equal(controller(Plant().y), first)


def test_sample_time_may_be_another_one_and_the_filter_follows(arm):
    ours, theirs = (filter_of(resampled(arm, time)) for time in (None, 2 * H))
    np.testing.assert_allclose(theirs.F, ours.F @ ours.F, atol=1e-12)
    assert Controller(arm, sample_time=2 * H)([1.0, 0.5]).shape == (2,)


def test_a_measurement_that_is_none_stops_it_until_reset(arm):
    controller = Controller(arm, elbow_torque_lower=0.125)
    assert controller([np.nan, 0.5]).tolist() == [0.0, 0.125]
    assert (controller.mode, controller.fault) == ("fault", "non_finite_input")
    (message,) = controller.messages
    assert message.startswith("t = 0 s: fault non_finite_input: shoulder = nan;")
    assert controller([1.0, 0.5]).tolist() == [0.0, 0.125]
    controller.reset()
    controller([1.0, 0.5])
    assert (controller.mode, controller.fault, controller.messages) == ("stabilizing", "none", [])


@pytest.mark.parametrize(
    ("y", "message"),
    [
        ([1.0], r"shape \(1,\)"),
        ([1.0, 2.0, 3.0], r"shape \(3,\)"),
        (1.0, "1.0"),
        ([[1.0, 2.0]], r"shape \(1, 2\)"),
        ("a", "'a'"),
        (["a", "b"], r"\['a', 'b'\]"),
        (None, "None"),
    ],
)
def test_measured_outputs_that_are_not_as_many_numbers_are_refused(arm, y, message):
    with pytest.raises(UserError, match=f"y must be 2 numbers, shoulder, elbow, found {message}$"):
        Controller(arm)(y)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"a_mim": 0.2}, "arm_controller has no parameter or input named 'a_mim'; did you mean a_min"),
        ({"sample_time": "fast"}, "sample_time must be a Real, found 'fast'"),
        ({"a_min": 2.0}, "a_min must not exceed b_max, found a_min = 2 and b_max = 1"),
        ({"elbow_torque_lower": 5.0}, "elbow_torque_lower must not exceed elbow_torque_upper, found 5 and 4"),
    ],
)
def test_start_values_that_the_fmu_does_not_admit_are_refused(arm, start, message):
    with pytest.raises(UserError, match=message):
        Controller(arm, **start)


def test_what_cannot_be_set_during_a_run_is_refused_and_changes_nothing(arm):
    controller = Controller(arm)
    for changes, message in (
        ({"mu": 0.5}, "'mu' cannot be set during a run"),
        ({"elbow_setpont": 0.5}, "did you mean elbow_setpoint"),
        ({"elbow_setpoint": 0.6, "a_min": 2.0}, "a_min must not exceed b_max"),
    ):
        with pytest.raises(UserError, match=message):
            controller.set(**changes)
    assert (controller.values["elbow_setpoint"], controller.values["a_min"]) == (0.5, 0.5)


def test_it_says_what_it_is(arm):
    controller = Controller(arm, a_min=0.25)
    told = f"{SYSTEM.name}, sample_time = 0.001, a_min = 0.25, b_max = 1.0"
    assert repr(controller) == f"<Controller: {told}, idle after 0 samples>"
    controller([1.0, 0.5])
    assert repr(controller) == f"<Controller: {told}, stabilizing after 1 samples>"
