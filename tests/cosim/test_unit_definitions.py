"""Wires join equal units, however the FMUs spell them."""

import pytest
from fmpy.model_description import ModelDescription, ScalarVariable

from cosim.errors import UserError
from cosim.structure import Wire
from cosim.unit_definitions import check_units, shown_unit, with_unit


def described(name, unit):
    return ModelDescription(modelVariables=[ScalarVariable(name=name, valueReference=0, type="Real", unit=unit)])


def check(source, target):
    check_units(
        Wire("plant.y", "controller.y"), {"plant": described("y", source), "controller": described("y", target)}
    )


def test_a_wire_joins_units_that_are_only_spelled_differently():
    check("m/s/s", "m/s2")
    for source, target in (("mm/s/s", "m/s2"), ("N.m", "J")):
        with pytest.raises(UserError, match=f"must join equal units, found {source} and {target}"):
            check(source, target)


@pytest.mark.parametrize(
    ("unit", "shown"),
    [
        ("1", ""),
        ("V2.s", "V² s"),
        ("N.m.s/rad", "N m s/rad"),
        ("rad/(s2.J)", "rad/(s² J)"),
        ("1/s2", "1/s²"),
        ("s-1", "s⁻¹"),
        ("m/s^2", "m/s²"),
        ("kg.m12", "kg m¹²"),
    ],
)
def test_a_unit_is_shown_with_raised_powers(unit, shown):
    assert shown_unit(unit) == shown
    assert with_unit("x", unit) == (f"x [{shown}]" if shown else "x")
