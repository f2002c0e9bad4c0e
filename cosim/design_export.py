"""The FMUs of a design: the pendulum's units for the system of its name, a linear plant and its controller for any other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ihc_fmu.controller import resampled
from ihc_fmu.estimation import remarks as estimation_remarks
from ihc_fmu.observer import remark as observer_remark

from . import certified, pendulum_export, system_export
from .certified import is_pendulums
from .errors import UserError
from .pendulum_export import Kind

if TYPE_CHECKING:
    from fmu_export.files import FilePath
    from ihc_fmu.design import Design


def export_design(
    design: Design,
    output: FilePath = "fmus",
    changes: Mapping[str, Mapping[str, Any]] | None = None,
    kind: Kind = Kind.native,
    platforms: Sequence[str] | None = None,
    building: Callable[[str], object] | None = None,
    outputs: Sequence[str] | None = None,
    **pendulum: Any,
) -> list[Path]:
    """Write plant, controller and both as an SSP file to the folder `output`; return their paths.

    As `pendulum_export.export_units`, which alone takes the options `pendulum`, or as `system_export.export_system`.
    """
    common = {"changes": changes, "kind": kind, "platforms": platforms, "building": building, "outputs": outputs}
    if is_pendulums(design):
        return pendulum_export.export_units(design, output=output, **common, **pendulum)
    if pendulum:
        option = next(iter(pendulum))
        raise UserError(
            f"--{option.replace('_', '-')} is for the rotary pendulum's units, found with a design of the system "
            f"{design.system.name}"
        )
    return system_export.export_system(design, output, **common)


def exported_files(design: Design) -> tuple[str, ...]:
    """Return the names of the files that an export writes: plant, controller, both as SSP."""
    return pendulum_export.EXPORTED if is_pendulums(design) else system_export.exported_files(design.system)


def check_exportable(design: Design) -> None:
    """Raise UserError for a design that `export_design` refuses with its other arguments as by default."""
    (pendulum_export if is_pendulums(design) else system_export).check_exportable(design)


def export_remarks(design: Design, changes: Mapping[str, Any]) -> list[str]:
    """Return what is to be known of exported FMUs, a sentence each; `changes` are those of the controller's start values.

    Of the estimator of what is not measured; of start values that no certificate covers.
    """
    if is_pendulums(design):
        return certified.remarks(certified.start_values(design), changes)
    design = resampled(design, changes.get("sample_time"))
    observer = [] if design.system.observer is None else [observer_remark(design)]
    return [*estimation_remarks(design), *observer, *certified.remarks(certified.start_values(design), changes)]
