"""The command `run`."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from filing.ownership import check_replaceable

from ..errors import UserError
from .display import (
    console,
    escaped,
    interruptible,
    print_metrics,
    progress,
    remove_earlier,
    say_notes,
    warn_of_messages,
)
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
    from ihc_fmu.design import Design

    from ..results import Interrupted, Result, SimulationError


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

    A run that fails or is interrupted leaves what was recorded until then in `NAME.partial.csv`, its page in
    `NAME.partial.html` or the file of `--report-file`.
    """
    from ..judged_signals import can_draw, can_evaluate
    from ..remarks import remarks_after, remarks_before, rest_remarks
    from ..results import Interrupted, SimulationError
    from ..scenario import load_located
    from ..scenario_run import run_scenario
    from ..scenario_system import build_system, controller_design

    loaded_scenario, folder, fmus = load_located(scenario, fmus)
    changes = dict(assignments(change)) | ({} if engine is None else {"run.engine": engine})
    loaded_scenario = loaded_scenario.changed(changes)
    path = output or Path("results") / f"{loaded_scenario.name}.csv"
    if path.suffix != ".csv":
        raise UserError(f"--output must name a .csv file, found {path}")
    unfinished = path.with_suffix(".partial.csv")  # an earlier complete result stays
    check_replaceable(
        *(file.with_suffix(suffix) for file in (path, unfinished) for suffix in (".csv", ".json")), kind="result"
    )
    if plot:
        check_replaceable(path.with_suffix(".png"))
    page, page_of_failure = (page_wanted(report, report_file, p.with_suffix(".html")) for p in (path, unfinished))
    system = build_system(loaded_scenario, fmus, folder)
    notes = remarks_before(system, loaded_scenario)
    say_notes(notes)
    of_controller = (None, []) if page is None else controller_design(system, loaded_scenario, folder)
    written = (file.with_suffix(suffix) for file in (path, unfinished) for suffix in (".csv", ".json", ".png", ".html"))
    with interruptible(*written, *(p.path for p in (page, page_of_failure) if p is not None and p.path is not None)):
        with progress() as bar:
            task = bar.add_task(loaded_scenario.name, total=None)
            try:
                result = run_scenario(
                    loaded_scenario,
                    fmus,
                    folder,
                    progress=lambda done, total: bar.update(task, completed=done, total=total),
                    target=path.parent,
                )
            except (SimulationError, Interrupted) as stopped:
                if count := len(stopped.result.time):
                    partial = _save(stopped.result, unfinished)
                    bar.console.print(f"wrote what was recorded until then, {count} rows, to {escaped(partial)}")
                _report_failure(stopped, page_of_failure, notes, of_controller, unfinished)
                raise
            _save(result, path)
        for suffix, what, again in ((".png", "picture", plot), (".html", "report", page is not None)):
            if not again:
                remove_earlier(path.with_suffix(suffix), what)
        warn_of_messages(result)
        say_notes(remarks_after(result, system))
        console.print(f"wrote {escaped(path)} and {escaped(path.with_suffix('.json'))}")
        if plot and can_evaluate(result) and can_draw(result):
            from ..plots import save_overview

            picture = save_overview(
                result, path.with_suffix(".png"), loaded_scenario.description or loaded_scenario.name
            )
            console.print(f"wrote {escaped(picture)}")
        if can_evaluate(result):
            print_metrics(result)
        if page is not None:
            _report(result, page, [*notes, *rest_remarks(result, system)], of_controller, path)


def _report_failure(
    stopped: SimulationError | Interrupted,
    page: Page | None,
    notes: Sequence[str],
    of_controller: tuple[Design | None, list[str]],
    table: Path,
) -> None:
    from ..results import SimulationError

    if page is None:
        remove_earlier(table.with_suffix(".html"), "report")
        return
    what = "failed" if isinstance(stopped, SimulationError) else "interrupted"
    why = str(stopped) or "by the user"
    _report(stopped.result, page, notes, of_controller, table, (what, why))


def _report(
    result: Result,
    page: Page,
    notes: Sequence[str],
    of_controller: tuple[Design | None, list[str]],
    table: Path,
    failure: tuple[str, str] | None = None,
) -> None:
    """Write the page of a run; `failure` is what happened to it, in a word, and why."""
    from ..report.pages import Findings, Verdict, write_result

    design, uncovered = of_controller
    more = None if failure is None else Findings([Verdict(*failure, "bad")])
    notes = [*dict.fromkeys([*notes, *uncovered])]
    path, saved = page.path or table.with_suffix(".html"), table if len(result.time) else None
    written = write_result(path, result, notes=notes, design=design, table=saved, more=more)
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
