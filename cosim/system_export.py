"""The FMUs of any design, its controller and a linear plant of the same matrices, and both with their wires as an SSP."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .export import kept_outputs

if TYPE_CHECKING:
    from ihc_fmu.design import Design
    from ihc_fmu.system import System


def exported_files(system: System) -> tuple[str, str, str]:
    """Return the names of the files that an export writes: plant, controller, both as SSP."""
    return f"{system.name}_linear_plant.fmu", f"{system.name}_controller.fmu", f"{system.name}.ssp"


def wires_of(system: System) -> list[tuple[str, str]]:
    """Return the wires between both FMUs: they go by equal names."""
    wires = [(f"plant.{q.name}", f"controller.{q.name}") for q in system.outputs]
    return wires + [(f"controller.{q.name}", f"plant.{q.name}") for q in system.inputs]


def export_system(
    design: Design,
    output: Path = Path("fmus"),
    changes: Mapping[str, Mapping[str, Any]] | None = None,
    platforms: Sequence[str] | None = None,
    building: Callable[[str], object] | None = None,
    outputs: Sequence[str] | None = None,
) -> list[Path]:
    """Write NAME_linear_plant.fmu, NAME_controller.fmu and NAME.ssp for the system of a design; return their paths.

    Where the states are not measured the controller gets a Kalman filter for its sample time, which `changes` to the
    controller's start values may change too. The other arguments are those of `export_units`. Nothing is compiled for this
    machine: one binary serves every design. The three files reach the folder together. Raises UserError for what cannot be
    exported, BuildError for a missing binary or compiler.
    """
    from filing.files import staging
    from filing.origin import origin
    from fmu_export.native_fmu import export_native_fmu
    from fmu_export.ssp import write_ssp
    from ihc_fmu.controller import regulator_of, resampled
    from ihc_fmu.regulator.documentation import notes as controller_notes
    from ihc_fmu.regulator.native_unit import NATIVE as CONTROLLER
    from plant_fmu.linear.documentation import notes as plant_notes
    from plant_fmu.linear.native_unit import NATIVE as PLANT
    from plant_fmu.linear.start_values import linear_plant_values, shown_interface

    changes = {"plant": {}, "controller": {}, **(changes or {})}
    design = resampled(design, changes["controller"].get("sample_time"))
    regulator = regulator_of(design)
    interface, hidden = regulator.exported()
    system = design.system
    plant, wires = shown_interface(system), wires_of(system)
    kept = kept_outputs(outputs, {"plant": plant, "controller": interface}, wires)
    names = exported_files(system)
    plans = (
        (PLANT, plant, linear_plant_values(system), changes["plant"], plant_notes(system), "linear_plant"),
        (
            CONTROLLER,
            interface,
            hidden,
            changes["controller"],
            controller_notes(design, regulator.estimator),
            "controller",
        ),
    )
    with staging(output) as place:
        for (unit, shown, rest, start, notes, kind), stay, name in zip(plans, kept, names, strict=False):
            export_native_fmu(
                unit,
                place / name,
                start,
                notes,
                platforms,
                building,
                stay,
                interface=shown,
                hidden=rest,
                identifier=f"{system.name}_{kind}",
                origin=origin(),
            )
        units = {"controller": place / names[1], "plant": place / names[0]}
        write_ssp(place / names[2], system.name, units, wires, origin())
    return [output / name for name in names]
