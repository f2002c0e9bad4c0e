"""Units in terms of the base units, against the SI brochure's definitions."""

import math

import pytest

from fmu_export.errors import UserError
from fmu_export.units import base_unit, same_unit
from fmu_export.variables import Variable

NEWTON = {"kg": 1, "m": 1, "s": -2}
VOLT = {"kg": 1, "m": 2, "s": -3, "A": -1}


@pytest.mark.parametrize(
    ("unit", "powers", "factor"),
    [
        ("1", {}, 1.0),
        ("%", {}, 0.01),
        ("rad2/s3", {"rad": 2, "s": -3}, 1.0),
        ("V", VOLT, 1.0),
        ("V.s/rad", {"kg": 1, "m": 2, "s": -2, "A": -1, "rad": -1}, 1.0),
        ("N.m/V", {"s": 1, "A": 1}, 1.0),
        ("Ohm", {"kg": 1, "m": 2, "s": -3, "A": -2}, 1.0),
        ("H", {"kg": 1, "m": 2, "s": -2, "A": -2}, 1.0),
        ("rad/(s2.J)", {"kg": -1, "m": -2, "rad": 1}, 1.0),
        ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}, 1.0),
        ("1/s2", {"s": -2}, 1.0),
        ("s-1", {"s": -1}, 1.0),
        ("N", NEWTON, 1.0),
        ("kN", NEWTON, 1e3),
        ("mV", VOLT, 1e-3),
        ("uF", {"kg": -1, "m": -2, "s": 4, "A": 2}, 1e-6),
        ("S.Ohm", {}, 1.0),
        ("C.V/J", {}, 1.0),
        ("W.s/J", {}, 1.0),
        ("Pa.m2/N", {}, 1.0),
        ("T.m2/Wb", {}, 1.0),
        ("Wb/(V.s)", {}, 1.0),
        ("H.A2/J", {}, 1.0),
        ("lx.m2/lm", {}, 1.0),
        ("lm/(cd.sr)", {}, 1.0),
        ("kat.s/mol", {}, 1.0),
        ("Gy.kg/J", {}, 1.0),
        ("Sv/Gy", {}, 1.0),
        ("Bq/Hz", {}, 1.0),
        ("ms", {"s": 1}, 1e-3),
        ("min", {"s": 1}, 60.0),
        ("cd", {"cd": 1}, 1.0),
        ("km", {"m": 1}, 1e3),
        ("dam2", {"m": 2}, 100.0),
        ("cm3", {"m": 3}, 1e-6),
        ("mg", {"kg": 1}, 1e-6),
        ("t", {"kg": 1}, 1e3),
        ("hPa", {"kg": 1, "m": -1, "s": -2}, 100.0),
        ("mbar", {"kg": 1, "m": -1, "s": -2}, 100.0),
        ("km/h", {"m": 1, "s": -1}, 1 / 3.6),
        ("l/min", {"m": 3, "s": -1}, 1e-3 / 60),
        ("mmol/l", {"mol": 1, "m": -3}, 1.0),
        ("kW.h", {"kg": 1, "m": 2, "s": -2}, 3.6e6),
        ("mK", {"K": 1}, 1e-3),
        ("deg", {"rad": 1}, math.pi / 180),
        ("deg/s", {"rad": 1, "s": -1}, math.pi / 180),
        ("rev", {"rad": 1}, 2 * math.pi),
        ("rpm", {"rad": 1, "s": -1}, math.pi / 30),
        ("rev/min", {"rad": 1, "s": -1}, math.pi / 30),
    ],
)
def test_unit_is_a_factor_and_powers_of_base_units(unit, powers, factor):
    base = base_unit(unit)
    assert base is not None
    assert (dict(base.powers), base.offset) == (powers, 0.0)
    assert base.factor == pytest.approx(factor, rel=2e-16)


@pytest.mark.parametrize(("unit", "freezing", "boiling"), [("degC", 0.0, 99.9743), ("degF", 32.0, 211.95374)])
def test_temperatures_have_an_offset(unit, freezing, boiling):
    scale = base_unit(unit)
    assert scale is not None
    assert scale.factor * freezing + scale.offset == pytest.approx(273.15, rel=1e-15)
    assert scale.factor * boiling + scale.offset == pytest.approx(373.1243, rel=1e-12)


UNKNOWN = ["furlong", "ft", "lb", "kt", "yd", "kmin", "kkg", "mdeg", "krpm", "m%", "mm mm", "degC/s"]


@pytest.mark.parametrize(
    "unit", [*UNKNOWN, "", "N.m/V.s", "m//s", "N/(m", "m/s/", "1/s^", "N m", "m" * 300, "m99/pm99", "m100"]
)
def test_other_units_are_names_and_nothing_more(unit):
    assert base_unit(unit) is None


SPELLINGS = [
    ("m/s2", "m/s/s", "m/s^2", "m.s-2", "m*s^-2", "m/(s.s)", "m/(s*s)/1"),
    ("mm/s2", "mm/s/s"),
    ("rad/s2", "rad/s/s"),
    ("N.m", "N*m", "m.N"),
    ("J",),
    ("1", "m/m"),
    ("Hz",),
    ("1/s", "s^-1"),
    ("N m",),
]


@pytest.mark.parametrize("k", range(len(SPELLINGS)))
def test_a_unit_is_the_same_however_it_is_spelled_and_no_other(k):
    unit, *others = SPELLINGS[k]
    assert all(same_unit(unit, other) and base_unit(unit) == base_unit(other) for other in others)
    assert not any(same_unit(unit, other) for j, row in enumerate(SPELLINGS) if j != k for other in row)


@pytest.mark.parametrize(("unit", "part"), [("", "found 0"), ("a\nb", "printable"), ("x" * 201, "found 201")])
def test_unit_is_a_text_on_one_line(unit, part):
    with pytest.raises(UserError, match=f"a unit must .*{part}"):
        Variable("y", "output", "", unit)
