"""The command `run`."""

from __future__ import annotations

import secrets
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from filing.ownership import check_replaceable

from ..errors import UserError
from .display import console, escaped, print_metrics, progress, remove_earlier, say_notes, warn_of_messages
from .options import (
    SCENARIO_HELP,
    FmusOption,
    Page,
    ReportFileOption,
    ReportOption,
    SetOption,
    assignments,
    page_wanted,
)

if TYPE_CHECKING:
    from ..results import Result


def run(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="CSV file to write; none: `results/NAME.csv`.")
    ] = None,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
    engine: Annotated[
        str | None,
        typer.Option(
            help="Loop: `native` (C) or `fmpy` (Python), to the same result; `auto`: native unless an FMU is Python."
        ),
    ] = None,
    plot: Annotated[bool, typer.Option(help="Also write a picture beside the CSV.")] = True,
    report: ReportOption = False,
    report_file: ReportFileOption = None,
) -> None:
    """Run one scenario with the exported FMUs; write its signals (CSV, JSON) and a picture, print its metrics.

    A run that fails or is interrupted leaves what was recorded until then in `NAME.partial.csv`.
    """
    from ..metrics import can_draw, can_evaluate, overflow
    from ..results import Interrupted, SimulationError
    from ..scenario import build_system, controller_design, load_located, remarks, rest_remarks, run_scenario

    chosen, folder, fmus = load_located(scenario, fmus)
    changes = dict(assignments(change)) | ({} if engine is None else {"run.engine": engine})
    chosen = chosen.changed(changes)
    path = output or Path("results") / f"{chosen.name}.csv"
    if path.suffix != ".csv":
        raise UserError(f"--output must name a .csv file, found {path}")
    unfinished = path.with_suffix(".partial.csv")  # an earlier complete result stays
    check_replaceable(
        *(file.with_suffix(suffix) for file in (path, unfinished) for suffix in (".csv", ".json")), kind="result"
    )
    if plot:
        check_replaceable(path.with_suffix(".png"))
    page = page_wanted(report, report_file, path.with_suffix(".html"))
    system = build_system(chosen, fmus, folder)
    notes = remarks(system, chosen)
    say_notes(notes)
    with progress() as bar:
        task = bar.add_task(chosen.name, total=None)
        try:
            result = run_scenario(
                chosen,
                fmus,
                folder,
                progress=lambda done, total: bar.update(task, completed=done, total=total),
                target=path.parent,
            )
        except (SimulationError, Interrupted) as stopped:
            if len(stopped.result.time):
                partial = _save(stopped.result, unfinished)
                count = len(stopped.result.time)
                bar.console.print(f"wrote what was recorded until then, {count} rows, to {escaped(partial)}")
            raise
        try:
            _save(result, path)
        except KeyboardInterrupt:
            bar.console.print(f"interrupted while it was written: {escaped(path)} is whole")
            raise
    for suffix, what, again in ((".png", "picture", plot), (".html", "report", page is not None)):
        if not again:
            remove_earlier(path.with_suffix(suffix), what)
    warn_of_messages(result)
    at_rest = rest_remarks(result, system)
    say_notes(at_rest)
    console.print(f"wrote {escaped(path)} and {escaped(path.with_suffix('.json'))}")
    if plot and can_evaluate(result) and can_draw(result):
        from ..plots import save_overview

        picture = save_overview(result, path.with_suffix(".png"), chosen.description or chosen.name)
        console.print(f"wrote {escaped(picture)}")
    if can_evaluate(result):
        say_notes(filter(None, [overflow(result)]))
        print_metrics(result)
    if page is not None:
        found, uncovered = controller_design(system, chosen, folder)
        said = [*dict.fromkeys([*notes, *uncovered, *at_rest])]
        _report(result, replace(page, notes=said, design=found), path)


def _report(result: Result, page: Page, table: Path) -> None:
    written = result.report(page.path or table.with_suffix(".html"), notes=page.notes, design=page.design, table=table)
    console.print(f"wrote {escaped(written)}")


def _save(result: Result, path: Path) -> Path:
    """Write a result; where that fails, as on a full disk, write it to the temporary folder and raise with its place."""
    import tempfile

    try:
        result.save(path)
    except UserError as error:
        rescued = Path(tempfile.gettempdir()) / f"qube-ihc-rescued-{secrets.token_hex(4)}" / path.name
        try:
            result.save(rescued)
        except UserError:
            raise error from None
        raise UserError(f"{error}; the rows are in {rescued}") from None
    return path
