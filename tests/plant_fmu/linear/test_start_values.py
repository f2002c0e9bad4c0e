"""What the linear plant's FMU shows of a system, and what it hides."""

import numpy as np
import pytest

from fmu_export.errors import UserError
from fmu_export.shown import Showing
from fmu_export.units import base_unit, per_second
from ihc_fmu.system import System
from plant_fmu.linear.documentation import notes
from plant_fmu.linear.interface import INTERFACE, UNLIMITED
from plant_fmu.linear.start_values import linear_plant_values, shown_interface

from .models import CRANE, random_system


def test_crane_is_shown_by_its_own_names_and_units():
    shown = shown_interface(CRANE)
    listed = {v.name: (v.causality, v.unit, v.start, v.compiled) for v in shown.variables}
    assert listed == {
        "force": ("input", "N", 0.0, "input_1"),
        "force_disturbance": ("input", "N", 0.0, "disturbance_1"),
        "position": ("output", "m", None, "output_1"),
        "angle_sensor": ("output", "rad", None, "output_2"),
        "position_true": ("output", "m", None, "state_1"),
        "velocity": ("output", "m/s", None, "state_2"),
        "angle": ("output", "rad", None, "state_3"),
        "rate": ("output", "rad/s", None, "state_4"),
        "position_0": ("parameter", "m", 0.0, "initial_state_1"),
        "velocity_0": ("parameter", "m/s", 0.0, "initial_state_2"),
        "angle_0": ("parameter", "rad", 0.0, "initial_state_3"),
        "rate_0": ("parameter", "rad/s", 0.0, "initial_state_4"),
        "force_lower": ("parameter", "N", -5.0, "lower_1"),
        "force_upper": ("parameter", "N", 4.0, "upper_1"),
        "position_resolution": ("parameter", "m", 1e-3, "resolution_1"),
        "angle_sensor_resolution": ("parameter", "rad", 0.0, "resolution_2"),
        "position_resolution_offset": ("parameter", "1", 0.5, "resolution_offset_1"),
        "angle_sensor_resolution_offset": ("parameter", "1", 0.5, "resolution_offset_2"),
        "position_bias": ("parameter", "m", 0.0, "bias_1"),
        "angle_sensor_bias": ("parameter", "rad", 0.0, "bias_2"),
        "position_derivative": ("local", "m/s", None, "derivative_1"),
        "velocity_derivative": ("local", "m/s2", None, "derivative_2"),
        "angle_derivative": ("local", "rad/s", None, "derivative_3"),
        "rate_derivative": ("local", "rad/s2", None, "derivative_4"),
    }
    assert (shown.name, shown.step_size) == ("crane_linear_plant", 2e-3)


def test_shown_dependencies_are_those_of_the_matrices():
    shown = shown_interface(CRANE).by_name
    sensor = ("position_0", "position_resolution", "position_resolution_offset", "position_bias")
    assert shown["position"].initial_dependencies == sensor
    assert shown["velocity"].initial_dependencies == ("velocity_0",)
    assert shown["velocity_derivative"].initial_dependencies == ("velocity_0", "angle_0")


def test_plant_starts_at_the_equilibrium_and_inputs_without_limits_have_the_largest_numbers():
    system = System(A=-np.eye(2), B=np.ones(2), x_eq=np.array([0.5, -2.0]), upper=np.array([3.0]))
    start = shown_interface(system).start_values()
    assert [start[name] for name in ("x1_0", "x2_0", "u1_lower", "u1_upper")] == [0.5, -2.0, -UNLIMITED, 3.0]


@pytest.mark.parametrize("seed", [3, 15])
def test_all_numbers_of_a_system_are_in_the_values_of_its_table(seed):
    system = random_system(seed)
    shown = shown_interface(system)
    values = Showing(INTERFACE, shown).compiled_values(shown.start_values(), linear_plant_values(system))
    for stem, M in (("A", system.A), ("B", system.B), ("C", np.asarray(system.C))):
        entries = [[values[f"{stem}_{i + 1}_{j + 1}"] for j in range(M.shape[1])] for i in range(M.shape[0])]
        np.testing.assert_array_equal(entries, M)
    rows = {
        "input_equilibrium": system.u_eq,
        "output_equilibrium": system.y_eq,
        "state_equilibrium": system.x_eq,
        "resolution": system.resolutions,
        "upper": np.minimum(np.asarray(system.upper), UNLIMITED),
    }
    for stem, v in rows.items():
        np.testing.assert_array_equal([values[f"{stem}_{i + 1}"] for i in range(len(np.asarray(v)))], v)
    assert [values[f"{what}_count"] for what in ("state", "input", "output")] == [system.n, system.m, system.p]


@pytest.mark.parametrize(
    ("sizes", "words"),
    [
        ((17, 1, 1), "at most 16 states, found 17 of large"),
        ((2, 9, 1), "at most 8 inputs, found 9 of large"),
        ((2, 1, 17), "at most 16 outputs, found 17 of large"),
    ],
)
def test_system_that_is_too_large_is_refused(sizes, words):
    n, m, p = sizes
    system = System(A=-np.eye(n), B=np.ones((n, m)), C=np.ones((p, n)), name="large")
    for function in (shown_interface, linear_plant_values):
        with pytest.raises(UserError, match=words):
            function(system)


def test_name_that_the_fmu_gives_to_something_else_is_refused():
    system = System(A=-np.eye(2), B=np.ones(2), states=("x", "x_0"))  # type: ignore[arg-type]
    with pytest.raises(UserError, match="variable names must be unique, found 'x_0' more than once"):
        shown_interface(system)


@pytest.mark.parametrize(
    ("unit", "rate"),
    [
        ("1", "1/s"),
        ("cm", "cm/s"),
        ("m/s", "m/s2"),
        ("rad/s2", "rad/s3"),
        ("N.m", "N.m/s"),
        ("rad/m", "rad/(m.s)"),
        ("V/(m.s)", "V/(m.s2)"),
        ("m/s/s", "m/s3"),
        ("W/s^2/m", "W/(s3.m)"),
    ],
)
def test_unit_of_a_derivative_has_a_second_below(unit, rate):
    assert per_second(unit) == rate
    before, after = base_unit(unit), base_unit(rate)
    assert before is not None
    assert after is not None
    exponents = {**before.powers, "s": before.powers.get("s", 0) - 1}
    assert after.powers == {base: exponent for base, exponent in exponents.items() if exponent}


def test_unit_in_another_notation_is_put_in_parentheses():
    assert per_second("deg C") == "(deg C)/s"


def test_documentation_has_the_names_and_numbers_and_no_markup_of_the_names():
    system = CRANE.changed(states=("position [m]", "velocity [m/s]", "a<b", "rate [rad/s]"))
    text = notes(system)
    assert "a&lt;b" in text
    assert "a<b" not in text
    assert "-27." in text
    assert "u_eq =" not in text
    assert "u_eq = [2.5]" in notes(CRANE.changed(u_eq=np.array([2.5])))
