"""Which start values of a controller FMU its design's certificate and equilibrium are, and whether they were changed.

The design itself is among the FMU's resources.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_export.errors import UserError
from ihc_fmu.pendulum.interface import matrix, upper_triangle, vector

if TYPE_CHECKING:
    from ihc_fmu.design import Design

    from .structure import Component

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


def is_pendulums(design: Design) -> bool:
    """Return whether the units of a design are the pendulum's own."""
    from ihc_fmu.system import PENDULUM  # noqa: PLC0415 - heavy

    return design.system.name == PENDULUM


def start_values(design: Design) -> dict[str, Any]:
    """Return the start values that the controller FMU of a design has from it."""
    from ihc_fmu.controller import regulator_of  # noqa: PLC0415 - heavy
    from ihc_fmu.pendulum.start_values import design_values  # noqa: PLC0415

    if is_pendulums(design):
        return dict(design_values(design))
    return {v.name: v.start for v in regulator_of(design).exported()[0].variables}


def design_of(controller: Component, file: Path | None = None) -> tuple[Design | None, list[str]]:
    """Return the design of a controller as it is started, and what its certificate does not cover, a sentence each.

    `file` is the design that its start values are from, where that is not the FMU's own. None where the FMU has none that
    can be read: its design is then not this project's.
    """
    from ihc_fmu.design import DESIGN_FILE, Design  # noqa: PLC0415 - heavy

    from .fmu_files import start_values_of, unpacked  # noqa: PLC0415

    fmu = unpacked(controller.path)  # and held as long as it is read
    path = file or fmu.folder / "resources" / DESIGN_FILE
    own = start_values_of(controller.path)
    if not certified_names(own) or not path.is_file():
        return None, []
    try:
        design = Design.load(path)
    except UserError:
        return None, []
    return design, remarks(start_values(design), {**own, **controller.start})
