"""Both units as FMU files, and both with their wires as an SSP file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import UserError
from .pendulum_files import PENDULUM_FMUS

if TYPE_CHECKING:
    from fmu_export.files import FilePath
    from fmu_export.guarded_slave import GuardedSlave
    from fmu_export.native_unit import NativeUnit
    from fmu_export.variables import Interface, Value
    from ihc_fmu.design import Design

    Plan = tuple[NativeUnit, type[GuardedSlave], Mapping[str, Value], str, Mapping[str, bytes]]


class Kind(StrEnum):
    """What an FMU's code is."""

    native = "native"
    python = "python"


class Smc(StrEnum):
    """Which sliding mode controller the FMU carries."""

    fitted = "fitted"
    linear_poles = "linear-poles"


EXPORTED = (*PENDULUM_FMUS, "QubeWithController.ssp")
"""The files that an export writes."""


def export_units(
    design: Design,
    parameters: str = "ident",
    nominal: str = "ident",
    output: FilePath = "fmus",
    changes: Mapping[str, Mapping[str, Any]] | None = None,
    smc: Smc = Smc.fitted,
    kind: Kind = Kind.native,
    platforms: Sequence[str] | None = None,
    building: Callable[[str], object] | None = None,
    outputs: Sequence[str] | None = None,
    *,
    other_model: bool = False,
) -> list[Path]:
    """Write QubeServo2.fmu, IhcController.fmu and QubeWithController.ssp to the folder `output`; return their paths.

    `parameters` and `nominal` name the parameter sets of the plant and of the controller's nominal model, or files (*.toml)
    that hold them; `changes` to start values are given per unit, "plant" and "controller", and what follows from them does:
    the Kalman filter's gain from the nominal model and the sample time, the capture level from the voltage limit.
    `platforms` and `building` as in `export_native_fmu`; `outputs` names the outputs that stay such, as plant.VARIABLE or
    controller.VARIABLE, None: all. The three files reach the folder together: where one fails, earlier ones stay as they
    are. Raises UserError for what cannot be exported, also a design for another model than the plant's, unless
    `other_model`, and BuildError for a missing binary or compiler.
    """
    from filing.files import staging

    plans, kept, wires = _planned(design, parameters, nominal, changes or {}, smc, outputs, other_model=other_model)
    with staging(Path(output)) as place:
        names = [path.name for path in _export(plans, kept, wires, place, kind, platforms, building)]
    return [Path(output) / name for name in names]


def check_exportable(design: Design) -> None:
    """Raise UserError for a design that `export_units` refuses with its other arguments as by default."""
    _planned(design, "ident", "ident", {}, Smc.fitted, None, other_model=False)


def _planned(
    design: Design,
    parameters: str,
    nominal: str,
    changes: Mapping[str, Mapping[str, Any]],
    smc: Smc,
    outputs: Sequence[str] | None,
    *,
    other_model: bool,
) -> tuple[tuple[Plan, Plan], list[list[str] | None], list[tuple[str, str]]]:
    """Return plant and controller to write, of each the outputs that stay such, and the wires; raises as `export_units`."""
    from ihc_fmu.design import DESIGN_FILE
    from ihc_fmu.pendulum.documentation import notes as controller_notes
    from ihc_fmu.pendulum.native_unit import NATIVE as CONTROLLER
    from ihc_fmu.pendulum.slave import IhcController
    from ihc_fmu.pendulum.start_values import check_order, controller_start_values
    from ihc_fmu.sliding_mode import fitted_smc, linear_pole_smc
    from plant_fmu.documentation import notes as plant_notes
    from plant_fmu.interface import start_values as plant_start_values
    from plant_fmu.native_unit import NATIVE as PLANT
    from plant_fmu.slave import QubeServo2

    from .parameter_files import named_set
    from .pendulum import WIRES
    from .pendulum_match import misfit

    check_order(design)
    wires = [(w.source, w.target) for w in WIRES["encoders"]]
    plant_set, nominal_set = named_set(parameters), named_set(nominal)
    changes = {"plant": {}, "controller": {}, **changes}
    A, b, k_lin = design.A, design.b, design.k_lin
    sliding = fitted_smc(A, b) if smc is Smc.fitted else linear_pole_smc(A, b, k_lin)
    plans = (
        (PLANT, QubeServo2, {**plant_start_values(plant_set), **changes["plant"]}, plant_notes(plant_set), {}),
        (
            CONTROLLER,
            IhcController,
            controller_start_values(design, nominal_set, sliding, changes["controller"]),
            controller_notes(design, nominal_set.name),
            {DESIGN_FILE: design.to_json(derived=False).encode()},
        ),
    )
    for native, _, start, *_ in plans:
        native.twin(native.interface.start_values(start))  # refuse both before writing either
    kept = kept_outputs(outputs, {"plant": PLANT.interface, "controller": CONTROLLER.interface}, wires)
    problem = misfit(plans[1][2], plans[0][2])
    if problem is not None and not other_model:
        raise UserError(f"{problem}; --other-model exports them all the same")
    return plans, kept, wires


def _export(
    plans: Sequence[Plan],
    kept: Sequence[Sequence[str] | None],
    wires: Sequence[tuple[str, str]],
    output: Path,
    kind: Kind,
    platforms: Sequence[str] | None,
    building: Callable[[str], object] | None,
) -> list[Path]:
    """Write the FMUs of plant and controller and the SSP that holds both."""
    from filing.origin import origin
    from fmu_export.native_fmu import export_native_fmu
    from fmu_export.python_fmu import export_python_fmu
    from fmu_export.ssp import write_ssp

    paths = []
    for (native, slave, start, notes, inside), shown in zip(plans, kept, strict=True):
        path, common = output / f"{native.interface.name}.fmu", {"origin": origin(), "resources": inside}
        if kind is Kind.native:
            paths.append(export_native_fmu(native, path, start, notes, platforms, building, shown, **common))
        else:
            paths.append(export_python_fmu(slave, path, start, notes, shown, **common))
    plant, controller = paths
    system = write_ssp(
        output / "QubeWithController.ssp", "Qube", {"controller": controller, "plant": plant}, wires, origin()
    )
    return [plant, controller, system]


def kept_outputs(
    names: Sequence[str] | None, interfaces: Mapping[str, Interface], wires: Sequence[tuple[str, str]]
) -> list[list[str] | None]:
    """Return per unit the outputs that stay such, None for all; raise UserError for others or without a wire's source."""
    if names is None:
        return [None for _ in interfaces]
    kept: dict[str, list[str]] = {unit: [] for unit in interfaces}
    for name in names:
        unit, _, variable = name.partition(".")
        if unit not in kept:
            raise UserError(f"--outputs must name plant.VARIABLE or controller.VARIABLE, found {name!r}")
        kept[unit].append(variable)
    for unit, variables in kept.items():
        interfaces[unit].exposing(variables)  # refuses what is no output
    for source, _ in wires:
        if source not in names:
            raise UserError(f"--outputs must name {source}, which a wire begins at")
    return list(kept.values())
