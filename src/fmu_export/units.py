"""Units in Modelica's notation, such as N.m.s/rad, kN or rad/(s2.J), in terms of the SI base units and the radian."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""Of FMI 2.0, in this order."""


@dataclass(frozen=True, slots=True)
class BaseUnit:
    """A unit in base units: a value v of it is `factor` v + `offset` in the product of the bases' powers."""

    powers: Mapping[str, int]
    factor: float = 1.0
    offset: float = 0.0

    @property
    def attributes(self) -> dict[str, str]:
        """Return what the element BaseUnit of FMI and of SSP says, without what is its default there."""
        numbers = {"factor": (self.factor, 1.0), "offset": (self.offset, 0.0)}
        return {base: str(power) for base, power in self.powers.items()} | {
            name: repr(value) for name, (value, default) in numbers.items() if value != default
        }


@dataclass(frozen=True, slots=True)
class _Quantity:
    """`number` pi^`turns` times the product of the bases' powers."""

    powers: tuple[int, ...] = (0,) * len(BASES)
    number: Fraction = Fraction(1)
    turns: int = 0

    def times(self, other: _Quantity, power: int) -> _Quantity:
        """Return this times the power of another."""
        powers = tuple(a + power * b for a, b in zip(self.powers, other.powers, strict=True))
        return _Quantity(powers, self.number * other.number**power, self.turns + power * other.turns)


def _si(number: Fraction | int = 1, turns: int = 0, **powers: int) -> _Quantity:
    return _Quantity(tuple(powers.get(base, 0) for base in BASES), Fraction(number), turns)


_PREFIXED = {
    **{base: _si(**{base: 1}) for base in BASES if base != "kg"},
    "g": _si(Fraction(1, 1000), kg=1),
    "Hz": _si(s=-1),
    "N": _si(kg=1, m=1, s=-2),
    "Pa": _si(kg=1, m=-1, s=-2),
    "bar": _si(100_000, kg=1, m=-1, s=-2),
    "J": _si(kg=1, m=2, s=-2),
    "W": _si(kg=1, m=2, s=-3),
    "C": _si(A=1, s=1),
    "V": _si(kg=1, m=2, s=-3, A=-1),
    "F": _si(kg=-1, m=-2, s=4, A=2),
    "Ohm": _si(kg=1, m=2, s=-3, A=-2),
    "S": _si(kg=-1, m=-2, s=3, A=2),
    "Wb": _si(kg=1, m=2, s=-2, A=-1),
    "T": _si(kg=1, s=-2, A=-1),
    "H": _si(kg=1, m=2, s=-2, A=-2),
    "sr": _si(rad=2),
    "lm": _si(cd=1, rad=2),
    "lx": _si(cd=1, rad=2, m=-2),
    "Bq": _si(s=-1),
    "Gy": _si(m=2, s=-2),
    "Sv": _si(m=2, s=-2),
    "kat": _si(mol=1, s=-1),
    "l": _si(Fraction(1, 1000), m=3),
    "L": _si(Fraction(1, 1000), m=3),
}
"""Units that may have a prefix."""

_SYMBOLS = _PREFIXED | {
    "1": _si(),
    "%": _si(Fraction(1, 100)),
    "min": _si(60, s=1),
    "h": _si(3600, s=1),
    "d": _si(86400, s=1),
    "t": _si(1000, kg=1),
    "deg": _si(Fraction(1, 180), 1, rad=1),
    "rev": _si(2, 1, rad=1),
    "rpm": _si(Fraction(1, 30), 1, rad=1, s=-1),
}
"""All units; none of those without a prefix reads as another with one: "ft" is no femtotonne."""

_POWERS_OF_TEN = dict(zip("yzafpnumcdhkMGTPEZY", (*range(-24, 0, 3), -2, -1, 2, *range(3, 25, 3)), strict=True)) | {
    "da": 1
}

_OFFSETS = {
    "degC": BaseUnit({"K": 1}, 1.0, 273.15),
    "degF": BaseUnit({"K": 1}, float(Fraction(5, 9)), float(Fraction(45967, 180))),
}
"""Temperatures: they are points on a scale, not factors of other units."""

_SYMBOL = r"(?:[A-Za-z]+|%)"
_FACTOR = rf"(?:{_SYMBOL}(?:\^?[+-]?[0-9]{{1,2}})?|1)"
_PRODUCT = rf"{_FACTOR}(?:[.*]{_FACTOR})*"
_UNIT = re.compile(rf"({_PRODUCT})((?:/{_FACTOR}|/\({_PRODUCT}\))*)")

DISPLAY = {"rad": ("deg", 180.0 / 3.141592653589793), "rad/s": ("deg/s", 180.0 / 3.141592653589793)}
"""Units for people: name and factor."""


def base_unit(unit: str) -> BaseUnit | None:
    """Return the base units of `unit`, None where they are not known: any other unit is a name and nothing more.

    A unit is factors joined by dots, each a symbol with a prefix before and an exponent behind it, over at most one
    denominator, which is one factor or several in parentheses. Other spellings of that are read too: m/s/s and m/s^2 as
    m/s2, N*m as N.m.
    """
    if unit in _OFFSETS:
        return _OFFSETS[unit]
    factors = _factors(unit)
    if factors is None:
        return None
    total = _si()
    for symbol, power in factors:
        quantity = _symbol(symbol)
        if quantity is None:
            return None
        total = total.times(quantity, power)
    try:
        factor = float(total.number) * math.pi**total.turns
    except OverflowError:
        return None
    powers = {base: power for base, power in zip(BASES, total.powers, strict=True) if power}
    return BaseUnit(powers, factor) if 0.0 < factor < math.inf else None


def same_unit(one: str, other: str) -> bool:
    """Return whether two units are the same symbols to the same powers, however they are spelled: m/s/s and m/s2.

    What other symbols would make of them does not count: a torque in N.m is not taken for an energy in J.
    """
    if one == other:
        return True
    powers, others = _powers(one), _powers(other)
    return powers is not None and powers == others


def _factors(unit: str) -> list[tuple[str, int]] | None:
    """Return the symbols of a unit with their exponents in its order, negative below a stroke; None in another notation."""
    match = _UNIT.fullmatch(unit)
    if match is None:
        return None
    return [
        (symbol, sign * int(exponent or 1))
        for sign, part in ((1, match[1]), (-1, match[2]))
        for symbol, exponent in re.findall(rf"({_SYMBOL}|1)\^?([+-]?\d*)", part)
    ]


def _powers(unit: str) -> dict[str, int] | None:
    factors = _factors(unit)
    if factors is None:
        return None
    powers: Counter[str] = Counter()
    for symbol, power in factors:
        powers[symbol] += power
    return {symbol: power for symbol, power in powers.items() if power and symbol != "1"}


def _symbol(symbol: str) -> _Quantity | None:
    if symbol in _SYMBOLS:
        return _SYMBOLS[symbol]
    for length in (1, 2):
        power, rest = _POWERS_OF_TEN.get(symbol[:length]), _PREFIXED.get(symbol[length:])
        if power is not None and rest is not None:
            return _si(Fraction(10) ** power).times(rest, 1)
    return None


def per_second(unit: str) -> str:
    """Return the unit of a quantity's derivative with respect to time: m/s2 of m/s, rad/(m.s) of rad/m.

    A unit in another notation is put in parentheses: (deg C)/s.
    """
    match = _UNIT.fullmatch(unit)
    if match is None:
        return f"({unit})/s"
    below = [factor for factor in re.findall(_FACTOR, match[2]) if factor != "1"]
    seconds = [factor for factor in below if re.fullmatch(r"s\^?[1-9]?", factor)]
    if seconds:
        power = 1 + sum(int(factor.strip("s^") or 1) for factor in seconds)
        below[below.index(seconds[0])] = f"s{power}"
        below = [factor for factor in below if factor not in seconds]
    else:
        below.append("s")
    return f"{match[1]}/{below[0]}" if len(below) == 1 else f"{match[1]}/({'.'.join(below)})"
