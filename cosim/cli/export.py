"""The command `export`."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from filing.ownership import check_replaceable

from ..errors import UserError
from ..pendulum_export import Kind, Smc
from .display import console, escaped, interruptible, say_notes
from .options import assignments, loaded_design


def export(
    design: Annotated[
        Path | None, typer.Option(help="Design file of the `design` command; none: the default design.")
    ] = None,
    parameters: Annotated[
        str | None,
        typer.Option(
            help="Pendulum: parameter set of the plant: matrices, ident, hcs, listed, swapped, or a TOML file; none: ident."
        ),
    ] = None,
    nominal: Annotated[
        str | None, typer.Option(help="Pendulum: parameter set of the controller's nominal model; none: ident.")
    ] = None,
    smc: Annotated[
        Smc | None,
        typer.Option(
            help="Pendulum: fitted: SMC1, a fit to the paper's tables; linear-poles: SMC2, its linear part is k_lin; none: "
            "fitted."
        ),
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to.")] = Path("fmus"),
    change: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="UNIT.VARIABLE=VALUE",
            help="Change a start value, e.g. `controller.a_min=0.7` or `plant.encoder_counts=0`; may be repeated.",
        ),
    ] = None,
    kind: Annotated[
        Kind, typer.Option(help="native: compiled, runs everywhere; python: the same in Python, for Python hosts.")
    ] = Kind.native,
    platforms: Annotated[
        str | None,
        typer.Option(
            help="Platforms of native FMUs, separated by commas: linux64, aarch64-linux, win64, darwin64, or `all`; "
            "none: this machine's. Others are compiled now, which the first time takes minutes."
        ),
    ] = None,
    outputs: Annotated[
        str | None,
        typer.Option(
            metavar="UNIT.OUTPUT,...",
            help="Outputs of the FMUs, separated by commas, for tools that take every output for a real number; the others "
            "become local variables. None: all are outputs.",
        ),
    ] = None,
    other_model: Annotated[
        bool, typer.Option("--other-model", help="Export a design for another model than the plant's all the same.")
    ] = False,
) -> None:
    """Export plant and controller as FMUs (FMI 2.0), and both with their wires as one SSP file.

    Without a design, or with one of a system named rotary_pendulum, these are the QUBE-Servo 2 and its controller with
    swing-up; with another, a linear plant of the design's matrices and the controller of the design, named after its system.
    A design or a parameter set only changes start values, so that nothing is compiled. `fmpy info FILE` shows them; each
    FMU carries its documentation. Native FMUs run without Python, the plant also for model exchange.
    """
    with interruptible(output):
        from ihc_fmu.pendulum.start_values import default_design

        from ..design_export import export_design, export_remarks, exported_files

        changes: dict[str, dict[str, Any]] = {"plant": {}, "controller": {}}
        for name, value in assignments(change):
            unit, dot, variable = name.partition(".")
            if not dot or unit not in changes:
                raise UserError(f"--set must name plant.VARIABLE or controller.VARIABLE, found {name!r}")
            changes[unit][variable] = value
        exported = default_design() if design is None else loaded_design(design)
        if platforms is not None and kind is Kind.python:
            raise UserError("--platforms is for native FMUs; Python FMUs hold PythonFMU's binaries for its platforms")
        names = None if platforms is None else [name.strip() for name in platforms.split(",")]
        shown = None if outputs is None else [name.strip() for name in outputs.split(",")]
        pendulum = {"parameters": parameters, "nominal": nominal, "smc": smc, "other_model": other_model or None}
        given = {option: value for option, value in pendulum.items() if value is not None}
        check_replaceable(*(output / name for name in exported_files(exported)))
        with console.status("building") if names else nullcontext() as status:
            building = None if status is None else lambda what: status.update(f"building {what}")
            paths = export_design(exported, output, changes, kind, names, building, shown, **given)
        say_notes(export_remarks(exported, changes["controller"]))
    for path in paths:
        console.print(f"wrote {escaped(path)}")
