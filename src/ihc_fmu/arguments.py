"""What functions are called with besides numbers: objects, names, counts, refused in one sentence where they are others."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from operator import index
from typing import Any

from fmu_export.errors import UserError, shown
from fmu_export.variables import did_you_mean


def check_kind(what: str, value: object, kind: type, rule: str) -> None:
    """Raise UserError where `value` is of another class than `kind`; `rule` says what `what` must be."""
    if not isinstance(value, kind):
        found = "None" if value is None else f"a {type(value).__name__}"
        raise UserError(f"{what} must be {rule}, found {found}")


def check_among(what: str, value: object, known: Collection[str]) -> None:
    """Raise UserError where `value` is none of the `known` names of a `what`."""
    if not isinstance(value, str) or value not in known:
        near = did_you_mean(value, known) if isinstance(value, str) else ""
        raise UserError(f"the {what} must be one of {', '.join(known)}, found {shown(value)}{near}")


def check_whole(what: str, value: object, least: int) -> None:
    """Raise UserError for what is no whole number from `least` on."""
    try:
        fits = not isinstance(value, bool) and index(value) >= least  # type: ignore[arg-type]
    except TypeError:
        fits = False
    if not fits:
        raise UserError(f"{what} must be a whole number from {least} on, found {shown(value)}")


def as_names(what: str, given: Any, kinds: tuple[type, ...] = (str,)) -> tuple:
    """Return a list of names as a tuple.

    Raises UserError for anything else; a single text is no list of its letters.
    """
    if isinstance(given, (str, Mapping, *kinds)) or not isinstance(given, Iterable):
        raise UserError(f"{what} must be a list of texts, found {shown(given)}")
    names = tuple(given)
    for name in names:
        if not isinstance(name, kinds):
            raise UserError(f"each of {what} must be a text, found {shown(name)}")
    return names
