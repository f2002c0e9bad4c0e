"""The command `compare`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from filing.ownership import check_replaceable

from .. import signals
from ..errors import UserError
from .display import (
    console,
    escaped,
    interruptible,
    print_comparison,
    print_results,
    progress,
    remove_earlier,
    say_notes,
)
from .options import (
    SCENARIO_HELP,
    ClusterOption,
    FmusOption,
    Page,
    ReportFileOption,
    ReportOption,
    SetOption,
    WorkersOption,
    assignments,
    page_wanted,
    varied,
    workers_at,
)

if TYPE_CHECKING:
    from ..studies.comparison import Comparison
    from ..studies.engine import Workers

REPORT = "report.html"
"""The page among a comparison's files."""


def compare(
    scenario: Annotated[
        list[str],
        typer.Argument(help=f"{SCENARIO_HELP} Or results of `run` or `hil` (*.csv)."),
    ],
    laws: Annotated[
        str | None,
        typer.Option(help="Laws to compare, separated by commas; none: those of this project that the controller has."),
    ] = None,
    vary: Annotated[
        str | None,
        typer.Option(
            metavar="ENTRY=VALUE,...",
            help="Compare values of another entry of the scenario than the law, e.g. `controller.a_min=0.2,0.5,1`.",
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
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for results; the scenario's name is added.")
    ] = Path("results"),
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
    report: ReportOption = False,
    report_file: ReportFileOption = None,
) -> None:
    """Run a scenario with each law and draw; print means with their intervals and what they decide, write results, pictures.

    Given results of `run` or `hil` instead, show them side by side.
    """
    from ..remarks import remarks_before
    from ..scenario import load_located
    from ..scenario_system import build_system, controller_design
    from ..studies.experiments import LAW, LAWS, Experiment, check_names, laws_of

    if laws is not None and vary is not None:
        raise UserError("compare takes --laws or --vary, not both")
    if all(name.endswith(".csv") for name in scenario):
        place = output / "compared"
        _compare_results([Path(name) for name in scenario], place, page_wanted(report, report_file, place / REPORT))
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
    systems = [build_system(one, fmus, folder) for one in compared]
    notes = dict.fromkeys(
        note for system, one in zip(systems, compared, strict=True) for note in remarks_before(system, one)
    )
    say_notes(notes)
    check_folder(output / loaded_scenario.name, names)
    page = page_wanted(report, report_file, output / loaded_scenario.name / REPORT)
    if page is not None:
        designs = [controller_design(system, one, folder) for system, one in zip(systems, compared, strict=True)]
        uncovered = (note for _, said in designs for note in said)
        one = entry not in ("controller.design", "controller.fmu")
        page = replace(page, notes=[*dict.fromkeys([*notes, *uncovered])], design=designs[0][0] if one else None)
    with workers_at(workers, cluster) as where:
        run_and_write([Experiment(loaded_scenario, folder, draws, entry, values)], fmus, output, names, where, page)


def check_folder(folder: Path, laws: Sequence[str] = ()) -> None:
    """Raise UserError where a comparison in `folder` would replace a file that is not this project's."""
    from ..plots import COMPARISON

    files = [f"{name}{suffix}" for name in (*laws, "comparison") for suffix in (".csv", ".json")] if laws else []
    check_replaceable(*(folder / name for name in (*files, *(f"{name}.png" for name in COMPARISON))))


def _compare_results(paths: list[Path], folder: Path, page: Page | None) -> None:
    from filing.files import staging

    from ..hil.overlay import alike
    from ..plots import save_comparison
    from ..report.pages import side_by_side, write_results
    from ..results import Result

    stems = [path.stem for path in paths]
    names = stems if len(set(stems)) == len(stems) else [str(path.with_suffix("")) for path in paths]
    if len(set(names)) < len(names):
        raise UserError(f"results to compare must be different files, found {', '.join(map(str, paths))}")
    results = alike({name: Result.load(path) for name, path in zip(names, paths, strict=True)})
    check_folder(folder)
    print_results(results)
    path = folder / REPORT if page is None or page.path is None else page.path
    with interruptible(folder, path):
        with staging(folder) as place:
            save_comparison(results, place, ", ".join(names))
        console.print(f"pictures in {escaped(folder)}")
        if page is None:
            remove_earlier(path, "report")
            return
        write_results(path, results, ", ".join(names), side_by_side(results), dict(zip(names, paths, strict=True)))
        console.print(f"wrote {escaped(path)}")


def run_and_write(
    experiments: list[Any],
    fmus: Path,
    output: Path,
    laws: list[str],
    workers: Workers = None,
    page: Page | None = None,
) -> None:
    """Compare the laws in each experiment; print what comes out, write it to folders named after the scenarios.

    `page` is written besides where there is one experiment.
    """
    from ..remarks import rest_remarks
    from ..scenario_system import build_system
    from ..studies.experiments import run_experiments

    written: list[str] = []
    try:
        with progress() as bar:
            task = bar.add_task("co-simulation", total=None)
            comparisons = run_experiments(
                experiments, fmus, laws, workers, lambda done, total: bar.update(task, completed=done, total=total)
            )
        for experiment, comparison in zip(experiments, comparisons, strict=True):
            folder = output / comparison.scenario.name
            first = next(iter(comparison.results.values()))
            at_rest = rest_remarks(first, build_system(comparison.scenario, fmus, experiment.folder))
            if page is not None:
                page = replace(page, notes=[*page.notes, *at_rest])
            _save(comparison, folder, page)
            written.append(comparison.scenario.name)
            print_comparison(comparison)
            say_notes(at_rest)
            console.print(f"results and pictures in {escaped(folder)}\n")
    except KeyboardInterrupt as interrupt:
        kept = f"whole: {', '.join(written)}" if written else "nothing was kept"
        signals.note(interrupt, f"a comparison is written whole or not at all; {kept}")
        raise


def _save(comparison: Comparison, folder: Path, page: Page | None) -> None:
    """Write a comparison with its pictures; a page in its folder is one of its files, another is written after them."""
    from ..plots import save_comparison

    path = None if page is None else page.path or folder / REPORT

    def besides(place: Path) -> None:
        save_comparison(comparison.results, place, comparison.scenario.description or comparison.scenario.name)
        if page is not None and path is not None and path.parent == folder:
            comparison.report(place / path.name, notes=page.notes, design=page.design, folder=place)

    comparison.save(folder, besides)
    if page is not None and path is not None and path.parent != folder:
        comparison.report(path, notes=page.notes, design=page.design, folder=folder)
