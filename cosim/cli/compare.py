"""The command `compare`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from filing.ownership import check_replaceable

from ..errors import UserError
from .display import console, escaped, print_comparison, print_results, progress, say_notes
from .options import SCENARIO_HELP, FmusOption, SetOption, assignments, varied


def compare(
    scenario: Annotated[
        list[str],
        typer.Argument(help=f"{SCENARIO_HELP} Or results of `run` or `hil` (*.csv)."),
    ],
    laws: Annotated[
        str | None,
        typer.Option(
            help="Laws to compare, separated by commas; none: those of LC, SMC and IHC that the controller has."
        ),
    ] = None,
    vary: Annotated[
        str | None,
        typer.Option(
            metavar="ENTRY=VALUE,...",
            help="Compare values of another entry of the scenario than the law, e.g. `controller.start.a_min=0.2,0.5,1`.",
        ),
    ] = None,
    draws: Annotated[
        int,
        typer.Option(
            min=0,
            help="Encoder offsets, the same for all laws: a Sobol set, best a power of two; 0: the scenario's, once. "
            "A plant without encoders is run once.",
        ),
    ] = 128,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; none: one per core.")] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for results; the scenario's name is added.")
    ] = Path("results"),
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Run a scenario with each law and draw; print means with their intervals and what they decide, write results, pictures.

    Given results of `run` or `hil` instead, show them side by side.
    """
    from ..experiments import LAW, LAWS, Experiment, check_names, laws_of
    from ..remarks import remarks_before
    from ..scenario import load_located
    from ..scenario_system import build_system

    if laws is not None and vary is not None:
        raise UserError("compare takes --laws or --vary, not both")
    if all(name.endswith(".csv") for name in scenario):
        _compare_results([Path(name) for name in scenario], output / "compared")
        return
    if len(scenario) > 1:
        raise UserError(f"compare takes one scenario, or results (*.csv), found {', '.join(scenario)}")
    loaded_scenario, folder, fmus = load_located(scenario[0], fmus)
    loaded_scenario = loaded_scenario.changed(dict(assignments(change)))
    if vary is not None:
        entry, values = varied(vary)
        names = list(values)
    else:
        entry, values, known = LAW, None, laws_of(loaded_scenario, fmus, folder)
        names = [name for name in known if name in LAWS] if laws is None else [law.strip() for law in laws.split(",")]
        if not names or not set(names) <= set(known) or len(set(names)) < len(names):
            raise UserError(f"--laws must be different ones of {', '.join(known)}, found {laws or ', '.join(names)!r}")
    check_names(names)
    compared = (
        [loaded_scenario] if values is None else [loaded_scenario.changed({entry: value}) for value in values.values()]
    )
    say_notes(dict.fromkeys(note for one in compared for note in remarks_before(build_system(one, fmus, folder), one)))
    check_folder(output / loaded_scenario.name, names)
    run_and_write([Experiment(loaded_scenario, folder, draws, entry, values)], fmus, output, names, workers)


def check_folder(folder: Path, laws: Sequence[str] = ()) -> None:
    """Raise UserError where a comparison in `folder` would replace a file that is not this project's."""
    from ..plots import COMPARISON

    files = [f"{name}{suffix}" for name in (*laws, "comparison") for suffix in (".csv", ".json")] if laws else []
    check_replaceable(*(folder / name for name in (*files, *(f"{name}.png" for name in COMPARISON))))


def _compare_results(paths: list[Path], folder: Path) -> None:
    from filing.files import staging

    from ..hil.overlay import alike
    from ..plots import save_comparison
    from ..results import Result

    stems = [path.stem for path in paths]
    names = stems if len(set(stems)) == len(stems) else [str(path.with_suffix("")) for path in paths]
    if len(set(names)) < len(names):
        raise UserError(f"results to compare must be different files, found {', '.join(map(str, paths))}")
    results = alike({name: Result.load(path) for name, path in zip(names, paths, strict=True)})
    check_folder(folder)
    print_results(results)
    with staging(folder) as place:
        save_comparison(results, place, ", ".join(names))
    console.print(f"pictures in {escaped(folder)}")


def run_and_write(
    experiments: list[Any], fmus: Path, output: Path, laws: list[str], workers: int | None = None
) -> None:
    """Compare the laws in each experiment; print what comes out, write it to folders named after the scenarios."""
    from ..experiments import run_experiments
    from ..plots import save_comparison
    from ..remarks import rest_remarks
    from ..scenario_system import build_system

    written: list[str] = []
    try:
        with progress() as bar:
            task = bar.add_task("co-simulation", total=None)
            comparisons = run_experiments(
                experiments, fmus, laws, workers, lambda done, total: bar.update(task, completed=done, total=total)
            )
        for experiment, comparison in zip(experiments, comparisons, strict=True):
            folder = output / comparison.scenario.name
            title = comparison.scenario.description or comparison.scenario.name
            comparison.save(folder, partial(save_comparison, comparison.results, title=title))
            written.append(comparison.scenario.name)
            print_comparison(comparison)
            first = next(iter(comparison.results.values()))
            say_notes(rest_remarks(first, build_system(comparison.scenario, fmus, experiment.folder)))
            console.print(f"results and pictures in {escaped(folder)}\n")
    except KeyboardInterrupt:
        kept = f"whole: {', '.join(written)}" if written else "nothing was kept"
        console.print(f"interrupted: a comparison is written whole or not at all; {escaped(kept)}")
        raise
