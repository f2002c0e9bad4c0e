"""A user's mistake, told apart from a bug, and how what was found is shown in its sentence.

Standard library only: this module travels inside the Python FMUs.
"""

from __future__ import annotations

import reprlib
from typing import Any

_MOST_BITS = 256


class UserError(ValueError):
    """A file, name, number or combination that cannot work: one sentence with the thing, the rule and the value found.

    Examples
    --------
    >>> from ihc_fmu import System, UserError
    >>> try:
    ...     System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4])
    ... except UserError as error:
    ...     print(error)
    K must have 1 row of 2 numbers to fit B and A, found shape (1, 1)
    """


class _Shown(reprlib.Repr):
    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = self.maxlong = 80
        self.maxlist = self.maxtuple = self.maxdict = self.maxset = 4
        self.maxlevel = 3

    def repr_int(self, x: int, level: int) -> str:
        return repr(x) if x.bit_length() <= _MOST_BITS else f"an integer of {x.bit_length()} bits"

    def repr_bool(self, x: bool, level: int) -> str:
        return "true" if x else "false"  # as files have it

    def repr_date(self, x: Any, level: int) -> str:
        return x.isoformat()

    repr_datetime = repr_time = repr_date

    def repr_ndarray(self, x: Any, level: int) -> str:
        return self.repr1(x.tolist(), level)


def shown(value: object) -> str:
    """Return `value` as a message may show it: on one line, and short, however large or deep it is."""
    return _Shown().repr(value)


def counted(number: int, thing: str) -> str:
    """Return "1 row", "2 rows"."""
    return f"{number} {thing}{'' if number == 1 else 's'}"
