"""Start values of variables: their types and rules, and which of them FMI lets be set."""

import copy
import math

import pytest

from cosim.errors import UserError
from cosim.fmu_files import describe
from cosim.start_values import as_value, not_settable
from ihc_fmu.pendulum.interface import LAWS


@pytest.fixture(scope="module")
def variables(fmus):
    """The variables of the pendulum's controller."""
    return {v.name: v for v in describe(fmus / "IhcController.fmu").modelVariables}


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("law", "SMC", 2),
        ("law", 3, 3),
        ("j_max", 7, 7),
        ("j_max", 7.0, 7),
        ("enabled", False, False),
        ("a_min", 1, 1.0),
        ("mu", 0.0, 0.0),
        ("mu", 1.0, 1.0),
        ("theta", -1e300, -1e300),
    ],
)
def test_values_are_brought_into_their_type(variables, name, value, expected):
    typed = as_value(variables[name], value)
    assert (type(typed), typed) == (type(expected), expected)


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("law", "PID", f"law must be one of {', '.join(LAWS)}, found 'PID'"),
        ("law", 5, f"law must be one of {', '.join(LAWS)}, found 5"),
        ("law", 0, f"law must be one of {', '.join(LAWS)}, found 0"),
        ("law", True, f"law must be one of {', '.join(LAWS)}, found true"),
        ("j_max", 2.5, "j_max must be an integer of 32 bits, found 2.5"),
        ("j_max", "three", "j_max must be a number, found 'three'"),
        ("j_max", True, "j_max must be a number, found true"),
        ("j_max", 0, "j_max must lie in [1, 60]"),
        ("j_max", 61, "j_max must lie in [1, 60]"),
        ("enabled", 1, "enabled must be true or false, found 1"),
        ("enabled", "yes", "enabled must be true or false, found 'yes'"),
        ("a_min", "small", "a_min must be a number, found 'small'"),
        ("a_min", False, "a_min must be a number, found false"),
        ("a_min", 0.0, "a_min must lie in [1e-06, 1e+12]"),
        ("mu", 1.0000001, "mu must lie in [0, 1]"),
        ("mu", -1e-9, "mu must lie in [0, 1]"),
        ("sample_time", 2.0, "sample_time must lie in [1e-06, 1] s, found 2.0"),
        ("theta", math.nan, "theta must be finite, found nan"),
        ("a_min", math.inf, "a_min must be finite, found inf"),
        ("voltage_limit", -math.inf, "voltage_limit must be finite, found -inf"),
    ],
)
def test_values_outside_their_rule_are_refused(variables, name, value, rule):
    with pytest.raises(UserError) as refusal:
        as_value(variables[name], value)
    assert str(refusal.value).startswith(rule)


@pytest.mark.parametrize(
    ("attributes", "rule"),
    [
        ({"initial": "approx"}, None),
        ({"causality": "local"}, "is a local variable that the FMU calculates"),
        (
            {"causality": "calculatedParameter", "initial": "approx"},
            "is a parameter that the FMU calculates from others",
        ),
        ({"causality": "independent", "initial": None}, "is the independent variable, the time"),
        ({"causality": "local", "variability": "constant", "initial": "exact"}, "is a constant and cannot be set"),
    ],
)
def test_what_fmi_lets_be_set_before_the_initialization_and_what_not(variables, attributes, rule):
    variable = copy.copy(variables["voltage"])
    for name, value in attributes.items():
        setattr(variable, name, value)
    reason = not_settable(variable)
    assert reason is None if rule is None else str(reason).startswith(rule)
