"""The command `overlay`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from filing.files import staging
from filing.ownership import check_replaceable

from .display import console, escaped, print_results, progress, say_notes
from .options import OTHER_FMU, ControllerOption, FmusOption, RunArgument


def overlay(
    run: RunArgument,
    parameters: Annotated[
        str | None,
        typer.Option(help="Parameter set of the simulated plant, by name or TOML file; none: the run's own."),
    ] = None,
    begin: Annotated[float, typer.Option(min=0.0, help="Time in the log from which to simulate [s].")] = 0.0,
    controller: ControllerOption = None,
    fmus: FmusOption = Path("fmus"),
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; none: `NAME_overlay` beside the run.")
    ] = None,
) -> None:
    """Re-simulate a run from where its log begins and lay the simulation over the hardware: pictures, metrics."""
    from ..hil.overlay import as_seen, differences, resimulate
    from ..hil.replay import controller_of, is_own
    from ..hil.scaling import RESOLUTION
    from ..plots import COMPARISON, save_comparison
    from ..provenance import provenance
    from ..results import Result

    result = Result.load(run)
    folder = output or run.with_name(f"{run.stem}_overlay")
    pictures = (f"{name}.png" for name in COMPARISON)
    check_replaceable(*(folder / name for name in ("simulation.csv", "simulation.json", *pictures)))
    plant, own = fmus / provenance(result).scenario.plant.fmu, controller_of(result, controller, fmus)
    if not is_own(result, own):
        say_notes([OTHER_FMU])
    with progress() as bar:
        task = bar.add_task("simulation", total=None)
        found = resimulate(
            result,
            (plant, own),
            parameters,
            begin,
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    measured, simulated = found.measured, found.simulated
    both = {"device": measured, "simulation": as_seen(simulated, measured)}
    with staging(folder) as place:
        simulated.save(place / "simulation.csv")
        save_comparison(both, place, f"{run.name} and its simulation with {parameters or 'its own plant'}")
    print_results(both)
    for name, value in differences(measured, simulated).items():
        console.print(f"RMS difference of {name}: {value:.4g} {escaped(measured.units[name])}", highlight=False)
    console.print(
        f"over stretches of 0.25 s the model is {1e3 * found.beginning.rms:.3g} mrad RMS off; counting alone gives "
        f"{1e3 * RESOLUTION / math.sqrt(12.0):.3g} mrad",
        highlight=False,
        soft_wrap=True,
    )
    console.print(f"simulation and pictures in {escaped(folder)}", soft_wrap=True)
