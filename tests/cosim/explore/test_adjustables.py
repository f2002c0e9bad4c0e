"""What of a scenario can be set on the page, found in its FMUs: of the pendulum and of an FMU that nobody here has made."""

import math
from typing import Any

import pytest

import cosim
import ihc_fmu
from cosim.errors import UserError
from cosim.explore.adjustables import Choice, Slider, controller_of, groups_of, slider, with_disturbance
from cosim.scenario import Scenario, load_scenario

ARM: dict[str, Any] = {"plant": {"fmu": "arm_linear_plant.fmu"}, "controller": {"fmu": "arm_controller.fmu"}}


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The folder with the FMUs of an arm of one joint."""
    folder = tmp_path_factory.mktemp("arm")
    states = ("angle [rad]", "rate [rad/s]")
    system = ihc_fmu.System(A=[[0, 1], [4, 0]], B=[[0], [1]], K=[[-8, -4]], states=states, name="arm")
    cosim.export(ihc_fmu.synthesize(system), folder)
    return folder


def members(groups):
    return {member.entry: member for group in groups for member in group.members}


@pytest.mark.parametrize("name", ["tilt_kalman", "swing_up", "square_wave", "paper"])
def test_every_value_of_the_pendulum_lies_in_its_slider(name, fmus):
    scenario, folder = load_scenario(name)
    controller = controller_of(scenario, fmus, folder)
    groups = groups_of(with_disturbance(scenario, fmus, folder), fmus, folder, controller, 10.0)
    found = members(groups)
    for member in found.values():
        if isinstance(member, Slider):
            assert member.low <= member.value + member.step, member
            assert member.value - member.step <= member.high, member
            assert member.low < member.high, member
        else:
            assert member.value in member.items, member
    initial = next(group for group in groups if group.title == "initial state")
    assert [m.name for m in initial.members] == ["theta_0", "delta_0", "theta_dot_0", "delta_dot_0"]
    assert [m.unit for m in initial.members if isinstance(m, Slider)] == ["rad", "rad", "rad/s", "rad/s"]
    noises = {f"controller.{name}" for name in ("voltage_noise", "disturbance_noise", "bias_noise")}
    assert {"controller.mu", "controller.u_max", "disturbance.gain", "controller.start.a_min", *noises} <= found.keys()
    assert [m.label for m in found.values() if m.name == "voltage_noise" and isinstance(m, Slider)] == [
        "voltage_noise [V² s]"
    ]
    assert not {"controller.start.law", "controller.start.enabled"} & found.keys()


def test_the_value_in_force_is_the_scenarios_and_a_choice_is_by_its_names(fmus):
    scenario, folder = load_scenario("tilt_kalman")
    found = members(groups_of(scenario, fmus, folder, None, 10.0))
    assert found["controller.start.a_min"].value == 0.5
    assert found["plant.start.delta_0"].value == 0.1
    source = found["controller.start.velocity_source"]
    assert isinstance(source, Choice)
    assert (source.value, list(source.items)) == ("kalman", ["filter", "inputs", "kalman"])


def test_any_plants_states_and_inputs_are_found(arm):
    scenario = Scenario(**ARM)
    disturbed = with_disturbance(scenario, arm, None)
    assert (disturbed.disturbance.input, disturbed.disturbance.gain) == ("u1_disturbance", 0.0)
    groups = groups_of(disturbed, arm, None, controller_of(scenario, arm, None), 3.0)
    assert [g.title for g in groups if not g.folded] == [
        "controller",
        "initial state",
        "disturbance",
        "run",
    ]
    found = members(groups)
    assert {"plant.start.angle_0", "plant.start.rate_0"} <= found.keys()
    gain = found["disturbance.gain"]
    assert isinstance(gain, Slider)
    assert gain.high == 3.0  # as much as the control, by a sine of amplitude 1
    assert {"controller.mu", "controller.u_max", "controller.K_1_1", "controller.K_1_2"} <= found.keys()
    changed = scenario.changed({"controller.start.K_1_1": -9.0})  # what runs is not the design
    assert (
        not {"controller.mu", "controller.K_1_1"}
        & members(groups_of(changed, arm, None, controller_of(changed, arm, None), 3.0)).keys()
    )


@pytest.mark.parametrize(
    ("value", "limits", "more", "low", "high", "step"),
    [
        (3.0, (-math.inf, math.inf), {}, 0.0, 6.0, 0.05),  # to twice the value
        (-3.0, (-math.inf, math.inf), {}, -6.0, 0.0, 0.05),
        (0.0, (0.0, math.inf), {}, 0.0, 1.0, 0.005),
        (0.3, (0.0, 1.0), {}, 0.0, 1.0, 0.005),  # limits that are near
        (50.0, (0.1, 1e9), {}, 0.5, 100.0, 0.5),  # steps are counted from 0, not from the limit
        (0.1, (-math.inf, math.inf), {"extent": 0.5}, -0.5, 0.5, 0.005),
        (3.0, (-math.inf, math.inf), {"extent": 0.5}, -3.1, 3.1, 0.05),  # an angle: once around
        (3, (1, 60), {"whole": True}, 1.0, 60.0, 1.0),
        (7.0, (-math.inf, math.inf), {"span": (0.0, 5.0)}, 0.0, 7.0, 0.05),  # the value is in it
    ],
)
def test_a_slider_is_about_its_value_within_the_limits(value, limits, more, low, high, step):
    made = slider("entry", "name", "rad", "", value, limits, **more)
    assert (made.low, made.high, made.step) == pytest.approx((low, high, step), rel=1e-9)


def test_what_a_page_sends_is_taken_without_a_rest_of_binary_fractions_or_refused():
    number, choice = slider("entry", "name", "1", "", 1.0), Choice("entry", "name", "", 1, {1: "one", 2: "two"})
    assert (number.taken(0.1 + 0.2), choice.taken(2)) == (0.3, 2)
    for value in (None, "1", True, math.nan, -math.inf, 1e200, [1.0]):
        with pytest.raises(UserError, match="name must be a finite number, found"):
            number.taken(value)
    for value in (None, 3, "one", [1]):
        with pytest.raises(UserError, match="name must be one of one, two, found"):
            choice.taken(value)
