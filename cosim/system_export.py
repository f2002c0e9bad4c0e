"""The FMUs of any design, its controller and a linear plant of the same matrices, and both with their wires as an SSP."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .pendulum_export import Kind, kept_outputs

if TYPE_CHECKING:
    from fmu_export.files import FilePath
    from fmu_export.guarded_slave import GuardedSlave
    from fmu_export.native_unit import NativeUnit
    from fmu_export.variables import Interface
    from ihc_fmu.design import Design
    from ihc_fmu.system import System


def exported_files(system: System) -> tuple[str, str, str]:
    """Return the names of the files that an export writes: plant, controller, both as SSP."""
    return f"{system.name}_linear_plant.fmu", f"{system.name}_controller.fmu", f"{system.name}.ssp"


def wires_of(system: System) -> list[tuple[str, str]]:
    """Return the wires between both FMUs: they go by equal names."""
    wires = [(f"plant.{q.name}", f"controller.{q.name}") for q in system.outputs]
    return wires + [(f"controller.{q.name}", f"plant.{q.name}") for q in system.inputs]


@dataclass(frozen=True, slots=True)
class _Plan:
    """An FMU to write: its unit in C and in Python, what it shows and hides of it, changes to start values, resources."""

    native: NativeUnit
    slave: type[GuardedSlave]
    interface: Interface
    hidden: Mapping[str, Any]
    changes: Mapping[str, Any]
    notes: str
    resources: Mapping[str, bytes]

    def check(self) -> None:
        """Raise UserError for start values that the unit refuses."""
        from fmu_export.shown import Showing

        showing = Showing(self.native.interface, self.interface)
        showing.admitted(self.native.twin, showing.interface.start_values(self.changes), self.hidden)

    def write(
        self,
        path: Path,
        outputs: Sequence[str] | None,
        kind: Kind,
        platforms: Sequence[str] | None,
        building: Callable[[str], object] | None,
    ) -> None:
        """Write the FMU of this kind to `path`, whose stem is its identifier."""
        from filing.origin import origin
        from fmu_export.native_fmu import export_native_fmu
        from fmu_export.python_fmu import export_python_fmu

        shown: dict[str, Any] = {
            "outputs": outputs,
            "interface": self.interface,
            "hidden": self.hidden,
            "identifier": path.stem,
            "origin": origin(),
            "resources": self.resources,
        }
        if kind is Kind.native:
            export_native_fmu(self.native, path, self.changes, self.notes, platforms, building, **shown)
        else:
            export_python_fmu(self.slave, path, self.changes, self.notes, **shown)


def export_system(
    design: Design,
    output: FilePath = "fmus",
    changes: Mapping[str, Mapping[str, Any]] | None = None,
    kind: Kind = Kind.native,
    platforms: Sequence[str] | None = None,
    building: Callable[[str], object] | None = None,
    outputs: Sequence[str] | None = None,
) -> list[Path]:
    """Write NAME_linear_plant.fmu, NAME_controller.fmu and NAME.ssp for the system of a design; return their paths.

    Where the states are not measured the controller gets a Kalman filter for its sample time, which `changes` to the
    controller's start values may change too; DESIGN_FILE is among its resources. The other arguments are those of
    `export_units`. Nothing is compiled for this machine: one binary, or with `kind` python one slave class, serves every
    design. The three files reach the folder together. Raises UserError for what cannot be exported, BuildError for a missing
    binary or compiler.
    """
    from filing.files import staging
    from filing.origin import origin
    from fmu_export.ssp import write_ssp

    system, names = design.system, exported_files(design.system)
    plans, kept = _planned(design, changes, outputs)
    with staging(Path(output)) as place:
        for plan, stay, name in zip(plans, kept, names, strict=False):
            plan.write(place / name, stay, kind, platforms, building)
        units = {"controller": place / names[1], "plant": place / names[0]}
        write_ssp(place / names[2], system.name, units, wires_of(system), origin())
    return [Path(output) / name for name in names]


def check_exportable(design: Design) -> None:
    """Raise UserError for a design that `export_system` refuses whatever its other arguments."""
    _planned(design, None, None)


def _planned(
    design: Design, changes: Mapping[str, Mapping[str, Any]] | None, outputs: Sequence[str] | None
) -> tuple[tuple[_Plan, _Plan], list[list[str] | None]]:
    """Return plant and controller to write, and of each the outputs that stay such; raises as `export_system`."""
    from ihc_fmu.controller import regulator_of, resampled
    from ihc_fmu.design import DESIGN_FILE
    from ihc_fmu.regulator.documentation import notes as controller_notes
    from ihc_fmu.regulator.native_unit import NATIVE as CONTROLLER
    from ihc_fmu.regulator.slave import HomogeneousController
    from plant_fmu.linear.documentation import notes as plant_notes
    from plant_fmu.linear.native_unit import NATIVE as PLANT
    from plant_fmu.linear.slave import LinearPlant
    from plant_fmu.linear.start_values import linear_plant_values, shown_interface

    changes = {"plant": {}, "controller": {}, **(changes or {})}
    design = resampled(design, changes["controller"].get("sample_time"))
    regulator = regulator_of(design)
    interface, hidden = regulator.exported()
    system = design.system
    plant = shown_interface(system)
    kept = kept_outputs(outputs, {"plant": plant, "controller": interface}, wires_of(system))
    inside = {DESIGN_FILE: design.to_json(derived=False).encode()}
    notes = plant_notes(system), controller_notes(design, regulator.estimator)
    plans = (
        _Plan(PLANT, LinearPlant, plant, linear_plant_values(system), changes["plant"], notes[0], {}),
        _Plan(CONTROLLER, HomogeneousController, interface, hidden, changes["controller"], notes[1], inside),
    )
    for plan in plans:
        plan.check()  # refuse both before writing either
    return plans, kept
