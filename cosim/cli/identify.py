"""The command `identify`."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Annotated

import typer

from filing.ownership import check_replaceable

from .display import console, escaped, interruptible, problems, show_table
from .options import RunArgument


def identify(
    run: RunArgument,
    names: Annotated[str, typer.Option("--fit", help="Parameters to fit, separated by commas.")] = "D_r,D_p,T_r",
    parameters: Annotated[
        str, typer.Option(help="Parameter set to start from, by name or TOML file; what is not fitted stays.")
    ] = "ident",
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="TOML file to write; none: `NAME_parameters.toml` beside the run."),
    ] = None,
) -> None:
    """Fit damping and friction of the plant to a log and write them as a parameter set, with confidence intervals.

    The file goes into `--parameters` of `export` and `overlay`, or `plant.parameters` of a scenario.
    """
    from plant_fmu.parameters import QubeParameters

    from .. import parameter_files
    from ..hil.identify import LIKE_VOLTAGE
    from ..hil.identify import identify as run_identify
    from ..hil.scaling import RESOLUTION
    from ..results import Result

    result = Result.load(run)
    start = parameter_files.named_set(parameters)
    path = output or run.with_name(f"{run.stem}_parameters.toml")
    check_replaceable(path)
    with console.status("identification") as shown:
        fit = run_identify(
            result,
            start,
            tuple(name.strip() for name in names.split(",")),
            progress=lambda trials, rms: shown.update(f"trial {trials}: residual {rms:.3g} rad"),
        )
    with interruptible(path):
        parameter_files.save(path, fit.parameters)
        headings, rows = ("parameter", "fitted", "from", "to", f"in {start.name}", "unit"), []
        units = {f.name: f.metadata["unit"] for f in fields(QubeParameters)}
        for name, e in fit.estimates.items():
            numbers = (e.value, e.low, e.high, getattr(start.parameters, name))
            rows.append([name, *(f"{number:.4g}" for number in numbers), units[name]])
        show_table(f"{run.name}: parameters and 95 % confidence intervals", headings, rows)
        unknown = [name for name, e in fit.estimates.items() if not e.identifiable]
        if fit.disturbed:
            p = fit.parameters.parameters
            problems.print(
                "[yellow]note:[/] the residuals show a disturbance that the model lacks, like "
                f"{fit.disturbance:.2g} V RMS at the motor, {fit.disturbance * p.k_m / p.R_m:.2g} N.m: the arm's damping "
                "and friction cannot be told from it, whatever their intervals say"
            )
            unknown = [name for name in unknown if name not in LIKE_VOLTAGE]
        if unknown:
            problems.print(f"[yellow]note:[/] this log does not tell {', '.join(unknown)}; leave it out of --fit")
        console.print(
            f"RMS residual {fit.rms_before:.3g} rad before, {fit.rms_after:.3g} rad after, from {fit.samples} samples in "
            f"{fit.segments} segments; one encoder count is {RESOLUTION:.3g} rad",
            soft_wrap=True,
        )
        console.print(f"wrote {escaped(path)}", soft_wrap=True)
