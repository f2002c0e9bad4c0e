"""The command `paper`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from filing.ownership import check_replaceable

from ..pendulum_export import export_units
from .display import console, escaped, interruptible, print_claims, resumable, staged_progress
from .options import ClusterOption, WorkersOption, workers_at


def paper(
    quick: Annotated[
        bool, typer.Option("--quick", help="A smaller study, in less than a minute: 10 draws instead of 200.")
    ] = False,
    draws: Annotated[
        int | None, typer.Option(min=1, help="Random draws for each controller and condition; none: 200, quick 10.")
    ] = None,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for everything.")] = Path("results/paper"),
    fmus: Annotated[
        Path | None, typer.Option(help="Folder with exported FMUs; none: exports them to `fmus` in the output folder.")
    ] = None,
) -> None:
    """Repeat the paper's section V in simulation and judge each of its claims: figures, tables, one HTML report.

    Interrupt it at any time: finished runs are kept, and the same command goes on from there.
    """
    from ihc_fmu.pendulum.start_values import default_design

    from ..paper.report import make
    from ..paper.study import FULL, QUICK, Study

    size = QUICK if quick else FULL
    if draws is not None:
        size = replace(size, draws=draws)
    check_replaceable(output / "report.html")
    if fmus is None:
        fmus = output / "fmus"
        with interruptible(fmus):
            export_units(default_design(), output=fmus)
    with resumable(output / "runs.sqlite"):
        with workers_at(workers, cluster) as where, staged_progress() as progress:
            claims = make(Study(output, fmus, size, where), progress)
        print_claims(claims)
        console.print(f"wrote {escaped(output / 'report.html')} and the tables, figures and scenarios beside it")
