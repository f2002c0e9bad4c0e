"""Numbers that a user gives, as files hold them and as arrays: what they must be, refused in one sentence."""

from __future__ import annotations

from typing import Any

import numpy as np

from fmu_export.errors import UserError, counted, shown

Array = np.ndarray

QUIET = np.errstate(over="ignore", invalid="ignore", divide="ignore")
"""Numbers beyond the range end in a refusal, by the block form, the certificate or a check, not in warnings."""
LARGEST = 1e300
"""Numbers of a system are smaller."""


def matrix(name: str, value: object, *, flat: bool = False) -> Array:
    """Return a matrix of finite numbers; with `flat` a list of numbers stays one. Raises UserError that names it."""
    M = reals(name, value, "rows of numbers, all of one length")
    if M.ndim != 2 and not (flat and M.ndim == 1):
        raise UserError(f"{name} must be rows of numbers, all of one length, found shape {M.shape}")
    if not (np.abs(M) < LARGEST).all():
        raise UserError(f"{name} must be finite, found {M[~(np.abs(M) < LARGEST)].flat[0]}")
    return M


def reals(name: str, value: Any, rule: str) -> Array:
    """Return a new array of real numbers; raise UserError that names it and the rule for anything else."""
    try:
        if not np.iscomplexobj(value):
            return np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise UserError(f"{name} must be {rule}, found {shown(value)}") from None
    raise UserError(f"{name} must be real, found complex numbers, {shown(value)}")


def size(rows: int, columns: int) -> str:
    """Return "2 rows of 3 numbers"."""
    return f"{counted(rows, 'row')} of {counted(columns, 'number')}"


def check_numbers(name: str, value: Any, levels: int, otherwise: str = "") -> Any:
    """Return a number, a list or a list of lists of numbers; raise UserError that names it for anything else.

    `otherwise` says what else it could have been.
    """
    if not are_numbers(value, levels):
        kind = ("a number", "a list of numbers", "rows of numbers")[levels]
        raise UserError(f"{name} must be {kind}{' ' + otherwise if otherwise else ''}, found {shown(value)}")
    return value


def check_weights(name: str, value: Any) -> Any:
    """Return a matrix of weights or the list of its diagonal; raise UserError that names it for anything else."""
    row = is_row(value)
    return check_numbers(name, value, 1 if row else 2, "" if row else "or a list of them")


def is_row(value: object) -> bool:
    """Return whether it is a list without lists in it."""
    return isinstance(value, list) and not any(isinstance(entry, list) for entry in value)


def are_numbers(value: object, levels: int) -> bool:
    """Return whether it is a number, a list of numbers (1 level) or a list of lists of numbers (2 levels).

    A whole number that no floating-point number comes near is none.
    """
    if not levels:
        return isinstance(value, float) or (type(value) is int and abs(value) < LARGEST)
    return isinstance(value, list) and all(are_numbers(entry, levels - 1) for entry in value)
