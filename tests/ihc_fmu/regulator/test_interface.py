"""What the controller FMU of a design shows: names, units, slots of the compiled table; refusals."""

import re

import pytest

from fmu_export.errors import UserError
from fmu_export.shown import Showing
from ihc_fmu.regulator.interface import INTERFACE, Shape, quotient, shown_interface

CRANE = Shape(
    name="crane",
    states=(("position", "m"), ("speed", "m/s"), ("angle", "rad"), ("rate", "rad/s")),
    inputs=(("force", "N"), ("torque", "N.m")),
    outputs=(("position", "m"), ("angle", "rad"), ("encoder", "1")),
    set_points=("position",),
    biases=("angle",),
    estimated=True,
)


def of(causality):
    return [v.name for v in shown_interface(CRANE).of(causality)]


def test_measured_outputs_and_set_points_go_in_and_commands_come_out_under_their_own_names():
    assert of("input") == ["position", "angle", "encoder", "position_setpoint"]
    assert of("output") == [
        *("force", "torque", "homogeneous_norm", "homogeneous_norm_used", "mode"),
        *("position_estimate", "speed_estimate", "angle_estimate", "rate_estimate"),
        *("force_disturbance_estimate", "torque_disturbance_estimate", "angle_bias_estimate", "fault"),
    ]


def test_parameters_are_choices_limits_gains_and_the_equilibrium():
    parameters = of("parameter")
    for name in (
        "law",
        "a_min",
        "b_max",
        "j_max",
        "norm_solver",
        "discretization",
        "enabled",
        "compensate_disturbance",
    ):
        assert name in parameters
    assert [name for name in parameters if name.endswith(("_lower", "_upper"))] == [
        *("force_lower", "torque_lower", "force_upper", "torque_upper")
    ]
    assert [name for name in parameters if re.match("[KP]_", name)] == [
        *[f"K_{i}_{j}" for i in (1, 2) for j in (1, 2, 3, 4)],
        *[f"P_{i}_{j}" for i in (1, 2, 3, 4) for j in range(i, 5)],
    ]
    assert [name for name in parameters if name.endswith("_equilibrium")] == [
        *(f"{name}_equilibrium" for name in ("position", "angle", "encoder", "force", "torque"))
    ]
    tunable = {v.name for v in shown_interface(CRANE).variables if v.variability == "tunable"}
    assert tunable == {
        *("law", "a_min", "b_max", "j_max", "norm_solver", "discretization", "enabled", "compensate_disturbance"),
        *("force_lower", "torque_lower", "force_upper", "torque_upper", "force_sta_rate", "torque_sta_rate"),
    }


def test_without_a_filter_nothing_estimated_is_shown():
    states = CRANE.states[:2]
    shown = shown_interface(Shape(name="cart", states=states, inputs=CRANE.inputs[:1], outputs=states))
    names = {v.name for v in shown.variables}
    assert not names & {"compensate_disturbance", "force_disturbance_estimate"}
    assert {"position_estimate", "speed_estimate"} <= names


def test_units_are_those_of_the_quantities():
    units = {v.name: v.unit for v in shown_interface(CRANE).variables}
    assert units["position_setpoint"] == units["position"] == "m"
    assert units["torque_disturbance_estimate"] == units["torque_upper"] == "N.m"
    assert units["K_1_2"] == "N.s/m"
    assert units["K_2_3"] == "N.m/rad"
    assert units["torque_sta_rate"] == "N.m/s"
    assert units["P_2_4"] == "s.s/(m.rad)"


@pytest.mark.parametrize(
    ("units", "expected"),
    [
        (("1", "1"), "1"),
        (("V", "1"), "V"),
        (("1", "rad"), "1/rad"),
        (("N.m", "rad/s"), "N.m.s/rad"),
        (("V", "V/(m.s)"), "V.m.s/V"),
        (("1", "m/s", "m/s"), "s.s/(m.m)"),
    ],
)
def test_quotients_of_units(units, expected):
    assert quotient(*units) == expected


def test_every_shown_variable_fits_its_slot_in_the_order_of_the_table():
    showing = Showing(INTERFACE, shown_interface(CRANE))
    assert showing.references == sorted(showing.references)
    assert showing.names["K_5"] == "K_2_1"
    assert showing.names["P_5"] == "P_2_2"
    assert showing.names["setpoint_1"] == "position_setpoint"
    assert "setpoint_2" not in showing.names
    assert showing.names["bias_estimate_2"] == "angle_bias_estimate"


def test_dependencies_at_the_start_are_those_that_are_shown():
    by_name = shown_interface(CRANE).by_name
    assert set(by_name["force"].initial_dependencies) == {"force_lower", "force_upper"}
    assert {"position", "angle", "position_setpoint", "mu", "P_1_1"} <= set(
        by_name["homogeneous_norm"].initial_dependencies
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"states": tuple((f"x{i}", "1") for i in range(17))}, "for 1 to 16 states, found 17"),
        ({"inputs": tuple((f"u{i}", "1") for i in range(9))}, "for 1 to 8 inputs, found 9"),
        ({"outputs": ()}, "for 1 to 16 outputs, found 0"),
        ({"set_points": ("speed",)}, "set_points must name outputs, found 'speed'"),
        ({"biases": ("speed",)}, "biases must name outputs, found 'speed'"),
    ],
)
def test_shape_that_the_table_has_no_place_for_is_refused(changes, message):
    fields = {name: getattr(CRANE, name) for name in CRANE.__dataclass_fields__}
    with pytest.raises(UserError, match=message):
        Shape(**{**fields, **changes})


def test_quantity_named_as_another_variable_is_refused():
    with pytest.raises(UserError, match="the controller of x has a variable named 'mode' of its own"):
        shown_interface(Shape(name="x", states=(("mode", "1"),), inputs=(("u", "1"),), outputs=(("mode", "1"),)))
