"""Names that come from files: they name one thing in one folder, and never lead out of it."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from fmu_export.errors import shown

MOST_CHARACTERS = 120
_RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in "123456789")}
"""Devices on Windows, whatever suffix they have."""
_SPECIAL = set('/\\:*?"<>|')


def is_plain(name: str) -> bool:
    """Whether `name` is that of a file in a folder on every system: no path, no device, nothing unprintable."""
    return (
        0 < len(name) <= MOST_CHARACTERS
        and name.isprintable()
        and not _SPECIAL & set(name)
        and not name.startswith((".", " "))
        and not name.endswith((".", " "))
        and name.partition(".")[0].lower() not in _RESERVED
    )


def _checked(name: str) -> str:
    if not is_plain(name):
        raise ValueError(f"must be a plain name (no path, no device, not empty), found {shown(name)}")
    return name


PlainName = Annotated[str, AfterValidator(_checked)]
"""A name in a typed model of a file's contents."""
