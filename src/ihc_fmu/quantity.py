"""States, inputs and outputs by name and unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fmu_export.errors import UserError, counted, shown
from fmu_export.variables import did_you_mean

from .arrays import reals

Array = np.ndarray

LONGEST_NAME = 100
"""Most characters of a name or a unit."""


class Quantity(NamedTuple):
    """A state, an input or an output.

    Parameters
    ----------
    name
        Its name.
    unit
        Its unit, "1" for none.

    Examples
    --------
    >>> from ihc_fmu import Quantity
    >>> speed = Quantity.parse("speed [m/s]")
    >>> speed, str(speed), speed.suffix
    (Quantity(name='speed', unit='m/s'), 'speed [m/s]', ' m/s')
    """

    name: str
    unit: str = "1"

    def __str__(self) -> str:
        return self.name if self.unit == "1" else f"{self.name} [{self.unit}]"

    @property
    def suffix(self) -> str:
        """What stands behind a number: a blank and the unit, nothing without one."""
        return "" if self.unit == "1" else f" {self.unit}"

    @classmethod
    def parse(cls, text: str, what: str = "a quantity") -> Quantity:
        """Return the quantity that "position [m]" or "position" means; the bracket of a unit stands behind a blank.

        Parameters
        ----------
        text
            Name and perhaps a unit.
        what
            What an error calls it.

        Returns
        -------
        Quantity
            Name and unit.

        Raises
        ------
        UserError
            For a text without a printable name, or one that is too long.
        """
        match = re.fullmatch(r"(.*\S)\s+\[([^\[\]]+)\]", text.strip())
        name, unit = (match[1], match[2].strip()) if match else (text.strip(), "1")
        for part in (name, unit):
            if not part or len(part) > LONGEST_NAME or not part.isprintable():
                raise UserError(f"{what} must be a printable name and perhaps a [unit], found {shown(text)}")
        return cls(name, unit)


def index_of(name: str, quantities: Sequence[Quantity], what: str, kind: str) -> int:
    """Return where a name stands among the quantities, which are `kind`; raise UserError that calls it `what`."""
    names = [q.name for q in quantities]
    if name not in names:
        raise UserError(f"{what} must name {kind}, found {shown(name)}{did_you_mean(name, names)}")
    return names.index(name)


def check_unique(names: Sequence[str], kind: str) -> None:
    """Raise UserError for a name that is there twice."""
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{kind} must have different names, found {shown(name)} twice")


def vector(what: str, values: ArrayLike, quantities: Sequence[Quantity]) -> Array:
    """Return a number for each quantity as an array; raise UserError that calls them `what` for another length."""
    names = [q.name for q in quantities]
    rule = f"{counted(len(names), 'number')}, {', '.join(names)}"
    numbers = reals(what, values, rule)
    if numbers.shape != (len(names),):
        raise UserError(
            f"{what} must be {rule}, found {shown(values) if numbers.ndim == 0 else f'shape {numbers.shape}'}"
        )
    return numbers
