"""Units mistaken for others: both directions of each angle, and factors that are near enough."""

from __future__ import annotations

import math

import pytest

from cosim.unit_slips import nearest, slips


@pytest.mark.parametrize(
    ("unit", "factor", "said"),
    [
        ("rad", math.degrees(1.0), "degrees instead of rad"),
        ("rad", math.radians(1.0), "units of 57.3 rad instead of rad"),
        ("deg", math.radians(1.0), "radians instead of degrees"),
        ("deg/s", math.degrees(2.0), "units of 0.0175 degrees instead of degrees"),
        ("deg/s", 0.2, "rpm instead of deg/s"),
        ("mm", 1e-3, "thousands of mm"),
        ("1", -800.0, "thousandths"),
    ],
)
def test_numbers_in_another_unit_are_told_by_their_factor(unit, factor, said):
    known = slips(unit)
    found = nearest(factor, known)
    assert known[abs(found)] == said
    assert math.copysign(1.0, found) == math.copysign(1.0, factor)


def test_other_factors_are_no_units():
    assert math.isnan(nearest(10.0, slips("V")))
    assert math.isnan(nearest(0.0, slips("V")))
