"""Wires join equal units, however the FMUs spell them."""

import pytest
from fmpy.model_description import ModelDescription, ScalarVariable

from cosim.errors import UserError
from cosim.structure import Wire
from cosim.unit_definitions import check_units


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
