"""Names and their units."""

import pytest

from ihc_fmu.quantity import Quantity


@pytest.mark.parametrize(
    ("text", "name", "unit"),
    [
        ("position [m]", "position", "m"),
        (" position  [ m/s^2 ] ", "position", "m/s^2"),
        ("position", "position", "1"),
        ("tank[3]", "tank[3]", "1"),
        ("tank[3] [m]", "tank[3]", "m"),
        ("tank 3 level [mm]", "tank 3 level", "mm"),
    ],
)
def test_names_carry_units(text, name, unit):
    assert Quantity.parse(text) == Quantity(name, unit)
    assert Quantity.parse(str(Quantity(name, unit))) == Quantity(name, unit)
