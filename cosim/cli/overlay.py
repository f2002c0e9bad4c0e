"""The command `overlay`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from filing.files import staging
from filing.ownership import check_replaceable

from ..errors import UserError
from .display import console, escaped, interruptible, print_results, progress, say_notes
from .options import OTHER_FMU, SCENARIO_HELP, ControllerOption, FmusOption, SetOption, assignments

if TYPE_CHECKING:
    from ..results import Result
    from ..scenario import Scenario


def overlay(
    run: Annotated[
        Path, typer.Argument(help="Result (CSV, with its JSON beside it); with `--scenario` also any table (CSV).")
    ],
    scenario: Annotated[
        str | None,
        typer.Option(
            help=f"What to simulate; none: a pendulum's run is met where it begins, another is made again. {SCENARIO_HELP}"
        ),
    ] = None,
    change: SetOption = None,
    parameters: Annotated[
        str | None,
        typer.Option(
            help="Of a pendulum's log: parameter set of the plant, by name or TOML file; none: the run's own."
        ),
    ] = None,
    begin: Annotated[float, typer.Option(min=0.0, help="Time in the log from which to simulate [s].")] = 0.0,
    controller: ControllerOption = None,
    fmus: FmusOption = Path("fmus"),
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; none: `NAME_overlay` beside the run.")
    ] = None,
) -> None:
    """Simulate what was measured again and lay the simulation over it: pictures, metrics, RMS differences.

    A log of the pendulum is simulated from the state in which it begins, which is found in it. Anything else is simulated as
    its scenario says, from time 0; a table has a column `time` [s] and columns named as signals, `component.variable`.
    """
    from ..judged_signals import evaluation_in
    from ..overlay import other_files, scenario_in
    from ..plots import COMPARISON
    from ..results import Result
    from ..scenario import load_located

    folder = output or run.with_name(f"{run.stem}_overlay")
    pictures = (f"{name}.png" for name in COMPARISON)
    check_replaceable(*(folder / name for name in ("simulation.csv", "simulation.json", *pictures)))
    if scenario is None:
        result = Result.load(run)
        if change:
            raise UserError("--set changes entries of a scenario, which --scenario names")
        if evaluation_in(result).kind == "pendulum":
            with interruptible(folder):
                _overlay_log(result, run, parameters, begin, controller, fmus, folder)
            return
        loaded_scenario, beside = scenario_in(result, run), run.parent
        others = other_files(result, loaded_scenario, fmus, beside)
        say_notes(f"{name} is not the file that the run was made with (another GUID)" for name in others)
    else:
        loaded_scenario, beside, fmus = load_located(scenario, fmus)
        loaded_scenario = loaded_scenario.changed(dict(assignments(change)))
    for option, given in (("--parameters", parameters), ("--controller", controller)):
        if given is not None:
            raise UserError(
                f"{option} is for logs of the pendulum; here --scenario, --set and --fmus say what is simulated"
            )
    with interruptible(folder):
        _overlay_scenario(run, loaded_scenario, fmus, beside, begin, folder)


def _overlay_scenario(run: Path, scenario: Scenario, fmus: Path, beside: Path, begin: float, folder: Path) -> None:
    from ..judged_signals import can_evaluate
    from ..overlay import compared, lay
    from ..plots import panels_of, save_comparison, save_figure
    from ..remarks import remarks_after
    from ..scenario_system import build_system

    with progress() as bar:
        task = bar.add_task("simulation", total=None)
        laid = lay(
            run, scenario, fmus, beside, begin, lambda done, total: bar.update(task, completed=done, total=total)
        )
    if laid.left_out:
        say_notes([f"columns of {run} that no signal of the scenario has the name of: {', '.join(laid.left_out)}"])
    say_notes(remarks_after(laid.simulated, build_system(scenario, fmus, beside)))
    both = {"measured": laid.measured, "simulation": laid.seen}
    title = f"{run.name} and the simulation of {scenario.name}"
    judged = can_evaluate(laid.measured)
    with staging(folder) as place:
        laid.simulated.save(place / "simulation.csv")
        if judged:
            save_comparison(both, place, title)
        else:
            save_figure(panels_of(both, tuple(laid.measured.signals)), place / "signals.png", title)
    if judged:
        print_results(both)
    for name, value in compared(laid).items():
        _say_difference(name, value, laid.measured)
    console.print(f"simulation and pictures in {escaped(folder)}", soft_wrap=True)


def _say_difference(name: str, value: float, measured: Result) -> None:
    unit = measured.units[name]
    text = f"RMS difference of {name}: {value:.4g} {'' if unit == '1' else unit}".rstrip()
    console.print(escaped(text), highlight=False, soft_wrap=True)


def _overlay_log(
    result: Result, run: Path, parameters: str | None, begin: float, controller: Path | None, fmus: Path, folder: Path
) -> None:
    from ..hil.overlay import as_seen, resimulate
    from ..hil.replay import MEASURED, controller_of, is_own
    from ..hil.scaling import RESOLUTION
    from ..overlay import differences
    from ..plots import save_comparison
    from ..provenance import provenance

    plant, own = fmus / provenance(result).scenario.plant.fmu, controller_of(result, controller, fmus)
    if not is_own(result, own):
        say_notes([OTHER_FMU])
    with progress() as bar:
        task = bar.add_task("simulation", total=None)
        resimulated = resimulate(
            result,
            (plant, own),
            parameters,
            begin,
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    measured, simulated = resimulated.measured, resimulated.simulated
    both = {"device": measured, "simulation": as_seen(simulated, measured)}
    with staging(folder) as place:
        simulated.save(place / "simulation.csv")
        save_comparison(both, place, f"{run.name} and its simulation with {parameters or 'its own plant'}")
    print_results(both)
    for name, value in differences(measured, simulated, (*MEASURED, "controller.voltage"), MEASURED[1:]).items():
        _say_difference(name, value, measured)
    console.print(
        f"over stretches of 0.25 s the model is {1e3 * resimulated.beginning.rms:.3g} mrad RMS off; counting alone gives "
        f"{1e3 * RESOLUTION / math.sqrt(12.0):.3g} mrad",
        highlight=False,
        soft_wrap=True,
    )
    console.print(f"simulation and pictures in {escaped(folder)}", soft_wrap=True)
