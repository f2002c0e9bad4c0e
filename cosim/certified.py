"""Which start values of a controller FMU its design's certificate and equilibrium are, and whether they were changed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from ihc_fmu.pendulum.interface import matrix, upper_triangle, vector

_PENDULUM = {*matrix("Phi"), *upper_triangle("P"), *vector("row"), *vector("k_lin"), "mu"}
_ANY = re.compile(r"[KP]_\d+_\d+|mu")
_EQUILIBRIUM = "_equilibrium"
SHOWN = 3
"""Most names in a sentence."""


def certified_names(own: Mapping[str, Any]) -> list[str]:
    """Return the start values that a certificate is about; none of an FMU, with these start values, that has none."""
    if own.keys() >= _PENDULUM:
        return [name for name in own if name in _PENDULUM]
    return [name for name in own if _ANY.fullmatch(name)] if {"K_1_1", "P_1_1", "mu"} <= own.keys() else []


def remarks(own: Mapping[str, Any], start: Mapping[str, Any]) -> list[str]:
    """Return sentences that `start` start values differ from those of the design in `own`; nothing where none does."""
    certified = certified_names(own)
    equilibrium = [name for name in own if certified and name.endswith(_EQUILIBRIUM)]
    changed, moved = (
        [name for name in names if name in start and start[name] != own[name]] for names in (certified, equilibrium)
    )
    them = "it" if len(changed) == 1 else "them"
    said = [f"{_differ(changed)} from the design's: its certificate does not cover {them}"] if changed else []
    if moved:
        said.append(f"{_differ(moved)} from the design's: the controller holds another equilibrium than its model's")
    return said


def _differ(names: Sequence[str]) -> str:
    more = len(names) - SHOWN
    listed = ", ".join(names[:SHOWN]) + (f" and {more} more" if more > 0 else "")
    return f"{listed} {'differs' if len(names) == 1 else 'differ'}"
