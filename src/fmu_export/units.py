"""Units in Modelica's notation, such as N.m.s/rad or rad/(s2.J), as exponents of the SI base units and the radian."""

from __future__ import annotations

import re

_SYMBOLS: dict[str, dict[str, int]] = {
    "1": {},
    **{base: {base: 1} for base in ("kg", "m", "s", "A", "rad")},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "H": {"kg": 1, "m": 2, "s": -2, "A": -2},
}

_FACTOR = r"(?:[A-Za-z]+[2-9]?|1)"
_PRODUCT = rf"{_FACTOR}(?:\.{_FACTOR})*"
_UNIT = re.compile(rf"({_PRODUCT})(?:/({_FACTOR})|/\(({_PRODUCT})\))?")

DISPLAY = {"rad": ("deg", 180.0 / 3.141592653589793), "rad/s": ("deg/s", 180.0 / 3.141592653589793)}
"""Units for people: name and factor."""


def base_units(unit: str) -> dict[str, int]:
    """Return the exponents of kg, m, s, A and rad in `unit`, in this order, without zeros; all factors are 1.

    A unit is factors joined by dots, each with an exponent behind it, over at most one denominator, which is one factor or
    several in parentheses. Raises ValueError for anything else.
    """
    match = _UNIT.fullmatch(unit)
    if match is None:
        raise ValueError(f"a unit must be in Modelica's notation, found {unit!r}")
    total: dict[str, int] = dict.fromkeys(("kg", "m", "s", "A", "rad"), 0)
    for sign, factors in ((1, match[1]), (-1, match[2] or match[3] or "1")):
        for symbol, exponent in re.findall(r"([A-Za-z]+|1)(\d?)", factors):
            if symbol not in _SYMBOLS:
                raise ValueError(f"a unit must be made of {', '.join(_SYMBOLS)}, found {unit!r}")
            for base, power in _SYMBOLS[symbol].items():
                total[base] += sign * power * int(exponent or 1)
    return {base: power for base, power in total.items() if power}


def per_second(unit: str) -> str:
    """Return the unit of a quantity's derivative with respect to time: m/s2 of m/s, rad/(m.s) of rad/m.

    A unit in another notation is put in parentheses: (deg C)/s.
    """
    match = _UNIT.fullmatch(unit)
    if match is None:
        return f"({unit})/s"
    below = [factor for factor in (match[2] or match[3] or "").split(".") if factor not in ("", "1")]
    seconds = next((i for i, factor in enumerate(below) if re.fullmatch("s[2-8]?", factor)), None)
    if seconds is None:
        below.append("s")
    else:
        below[seconds] = f"s{int(below[seconds][1:] or 1) + 1}"
    return f"{match[1]}/{below[0]}" if len(below) == 1 else f"{match[1]}/({'.'.join(below)})"
