"""The rules of a variable, and the messages of those who break them."""

import math
from dataclasses import FrozenInstanceError, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_export.errors import UserError
from fmu_export.variables import Interface, Variable, did_you_mean
from ihc_fmu.pendulum.interface import INTERFACE as CONTROLLER
from plant_fmu.interface import INTERFACE as PLANT

reproducible = settings(deadline=None, derandomize=True, database=None)


def parameter(name="p", **rest):
    return Variable(name, "parameter", "a parameter", variability="fixed", **{"start": 0.0, **rest})


REAL = parameter("gap", unit="m", start=1.0, min=0.5, max=10.0)
INTEGER = parameter("count", start=1, type="Integer", min=1, max=60)
BOOLEAN = parameter("active", start=True, type="Boolean")
CHOICE = parameter("law", start=1, type="Enumeration", items=("LC", "SMC", "IHC"))


@pytest.mark.parametrize(
    ("variable", "value", "expected"),
    [
        (REAL, 2, 2.0),
        (REAL, 0.5, 0.5),
        (REAL, 10.0, 10.0),
        (INTEGER, 3.0, 3),
        (INTEGER, 60, 60),
        (BOOLEAN, 1, True),
        (BOOLEAN, False, False),
        (CHOICE, "LC", 1),
        (CHOICE, "IHC", 3),
        (CHOICE, 2.0, 2),
    ],
)
def test_admissible_value_comes_back_in_the_variables_own_type(variable, value, expected):
    checked = variable.check(value)
    assert (checked, type(checked)) == (expected, type(expected))


@pytest.mark.parametrize(
    ("variable", "value", "parts"),
    [
        (REAL, 0.25, ["gap", "[0.5, 10] m", "0.25"]),
        (REAL, 10.5, ["gap", "[0.5, 10] m", "10.5"]),
        (REAL, math.nan, ["gap", "finite", "nan"]),
        (REAL, math.inf, ["gap", "finite", "inf"]),
        (REAL, True, ["gap", "Real", "true"]),
        (REAL, "2.0", ["gap", "Real", "'2.0'"]),
        (parameter("rate", min=0.0), -1.0, ["rate", "[0, inf]", "-1"]),
        (INTEGER, 0, ["count", "[1, 60]", "found 0"]),
        (INTEGER, 61, ["count", "[1, 60]", "61"]),
        (INTEGER, 2.5, ["count", "integer", "2.5"]),
        (INTEGER, math.nan, ["count", "integer", "nan"]),
        (INTEGER, -math.inf, ["count", "integer", "-inf"]),
        (INTEGER, False, ["count", "Integer", "false"]),
        (BOOLEAN, 2, ["active", "true or false", "2"]),
        (BOOLEAN, math.nan, ["active", "true or false", "nan"]),
        (BOOLEAN, "true", ["active", "Boolean", "'true'"]),
        (CHOICE, "PID", ["law", "LC, SMC, IHC", "'PID'"]),
        (CHOICE, "lc", ["law", "LC, SMC, IHC", "'lc'"]),
        (CHOICE, 0, ["law", "[1, 3]", "found 0"]),
        (CHOICE, 4, ["law", "[1, 3]", "found 4"]),
        (CHOICE, 1.5, ["law", "integer", "1.5"]),
        (CHOICE, True, ["law", "Enumeration", "true"]),
    ],
)
def test_refusal_names_the_variable_the_rule_and_the_value(variable, value, parts):
    with pytest.raises(ValueError, match=variable.name) as caught:
        variable.check(value)
    assert [part for part in parts if part not in str(caught.value)] == []


@reproducible
@given(st.floats(), st.floats(-1e3, 1e3), st.floats(0.0, 1e3))
def test_real_is_admitted_unchanged_exactly_within_its_limits(value, low, width):
    variable = parameter(min=low, max=low + width)
    if low <= value <= low + width:
        assert variable.check(value) == value
    else:
        with pytest.raises(ValueError, match=r"^p must"):
            variable.check(value)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_input_whose_unit_handles_it_admits_non_finite_values(value):
    variable = Variable("angle", "input", "", start=0.0, min=-1.0, max=1.0, fault_on_non_finite=True)
    assert str(variable.check(value)) == str(value)
    with pytest.raises(ValueError, match="angle must be finite"):
        replace(variable, fault_on_non_finite=False).check(value)


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"name": ""}, "must have 1 to 200 characters, found 0: ''"),
        ({"name": "x" * 201}, "must have 1 to 200 characters, found 201"),
        ({"name": "a\nb"}, r"must be printable characters .* found 'a\\nb'"),
        ({"name": "a\x85b"}, "must be printable characters"),
        ({"name": " a"}, "without a space at either end, found ' a'"),
        ({"start": None}, "parameters and inputs have a start value"),
        ({"causality": "output"}, "parameters and inputs have a start value"),
        ({"type": "Enumeration"}, "items belong to an Enumeration"),
        ({"items": ("a", "b")}, "items belong to an Enumeration"),
    ],
)
def test_impossible_variable_cannot_be_made(changes, rule):
    with pytest.raises(ValueError, match=rule):
        replace(REAL, **changes)


def test_variable_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        REAL.min = 0.0  # type: ignore[misc]


def interface(*variables):
    return Interface("Thing", "a thing", variables, step_size=0.1, stop_time=1.0, variable_step=True)


def test_two_variables_of_one_name_are_refused():
    with pytest.raises(UserError, match="Thing: variable names must be unique, found 'gap' more than once"):
        interface(REAL, INTEGER, REAL)


@pytest.mark.parametrize("name", ["a.b", "2x", "x" * 200, "Stoß %s", 'the "tip" <m/s>', "der(x)", "\\"])
def test_name_is_any_text_on_one_line(name):
    assert interface(replace(REAL, name=name)).start_values({name: 2.0}) == {name: 2.0}


def test_what_is_shown_keeps_its_nature_and_depends_on_what_is_shown():
    level = Variable("level_1", "output", "of tank 1", initial_dependencies=("gap", "count"), dependencies=("flow_1",))
    table = interface(REAL, INTEGER, Variable("flow_1", "input", "in", start=0.0), level)
    shown = table.showing(
        [table.by_name["level_1"].shown_as("h [m]", unit="m"), REAL.shown_as("slit", "of the valve")], name="Tank"
    )
    assert (shown.name, shown.step_size) == ("Tank", table.step_size)
    height, slit = shown.variables
    assert (height.name, height.slot, height.unit, height.description) == ("h [m]", "level_1", "m", "of tank 1")
    assert (height.initial_dependencies, height.dependencies) == (("slit",), ())
    assert (slit.compiled, slit.description, slit.limits()) == ("gap", "of the valve", (0.5, 10.0))
    assert shown.start_values() == {"slit": 1.0}
    assert slit.shown_as("gap width").compiled == "gap"


def test_step_is_told_by_a_variable_that_there_is():
    with pytest.raises(ValueError, match="there is no variable period to tell the step"):
        replace(interface(REAL), step_parameter="period")


def test_start_values_are_those_of_the_table_with_checked_changes():
    thing = interface(REAL, Variable("y", "output", ""), CHOICE, BOOLEAN)
    table = {"gap": 1.0, "law": 1, "active": True}
    assert thing.start_values() == thing.start_values({}) == table
    assert thing.start_values({"law": "SMC", "active": 0}) == {**table, "law": 2, "active": False}
    assert thing.start_values() == table
    with pytest.raises(ValueError, match="gap must lie in"):
        thing.start_values({"gap": 11.0})


def test_unknown_start_value_suggests_the_names_that_are_close():
    with pytest.raises(ValueError, match=r"IhcController has no parameter or input named 'a_mim'.*did you mean a_min"):
        CONTROLLER.start_values({"a_mim": 0.5})
    with pytest.raises(ValueError, match=r"named 'xyzzy'$"):
        CONTROLLER.start_values({"xyzzy": 0.5})


@pytest.mark.parametrize(("unit", "name"), [(PLANT, "theta"), (CONTROLLER, "voltage")])
def test_output_has_no_start_value_to_change(unit, name):
    with pytest.raises(ValueError, match=f"{unit.name} has no parameter or input named '{name}'"):
        unit.start_values({name: 0.0})


def test_suggestions_are_the_nearest_names():
    assert did_you_mean("thets", ["theta", "delta", "voltage"]) == "; did you mean theta?"
    assert did_you_mean("k_1", ["k_2", "k_3"]) in ("; did you mean k_2 or k_3?", "; did you mean k_3 or k_2?")
    assert did_you_mean("thets", []) == ""


@pytest.mark.parametrize("unit", [PLANT, CONTROLLER], ids=lambda unit: unit.name)
def test_own_start_values_keep_the_rules_and_every_variable_is_explained(unit):
    start = unit.start_values()
    assert unit.start_values(start) == start
    assert set(start) == {v.name for v in unit.variables if not v.calculated}
    assert [v.name for v in unit.variables if not v.description or not v.unit] == []


@pytest.mark.parametrize("unit", [PLANT, CONTROLLER], ids=lambda unit: unit.name)
def test_variables_of_each_causality_keep_their_order(unit):
    parts = [unit.of(causality) for causality in ("input", "output", "parameter", "local")]
    assert sorted(sum(parts, ()), key=unit.variables.index) == list(unit.variables)
    assert all(list(part) == sorted(part, key=unit.variables.index) for part in parts)
