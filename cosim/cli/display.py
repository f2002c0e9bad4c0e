"""What the command line shows: messages, tables, progress."""

from __future__ import annotations

import io
import math
import sys
import time
from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from traceback import print_exception
from typing import TYPE_CHECKING, Any, TextIO

from rich.console import Console

from filing.ownership import is_ours
from fmu_export.files import is_file, is_folder

from .. import signals

if TYPE_CHECKING:
    from rich.progress import Progress

    from ihc_fmu.design import Design
    from ihc_fmu.residual import Residual

    from ..paper.verdicts import Claim
    from ..results import Result
    from ..studies.comparison import Comparison
    from ..studies.pareto_front import Front, ParetoPoint
    from ..studies.tuning import Outcome, Tuning


class Output(Console):
    """An output stream; colours also where `FORCE_COLOR` wants them, but what moves, and the cursor, on terminals only."""

    def __init__(self, stream: TextIO, **options: Any) -> None:
        super().__init__(emoji=False, force_interactive=None if stream.isatty() else False, **options)

    def show_cursor(self, show: bool = True) -> bool:
        """Show or hide the cursor; return whether there is one."""
        return self.is_interactive and super().show_cursor(show)


console = Output(sys.stdout)
problems = Output(sys.stderr, stderr=True, soft_wrap=True, highlight=False)


def degrade_output() -> None:
    """Let characters that the output cannot encode become question marks instead of an error."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def say_error(error: BaseException, sentence: str = "", *, traceback: bool = False) -> None:
    """Print an error as one sentence to the error output, after its traceback where that is wanted."""
    if traceback:
        print_exception(error)
    problems.print(f"[bold red]error:[/] {escaped(sentence or str(error))}")


def say_fault(error: BaseException) -> None:
    """Print the traceback of an error that is no one's mistake but this program's, and where to report it."""
    from importlib.metadata import metadata

    print_exception(error)
    urls = [url.partition(",")[2].strip() for url in metadata("qube-ihc").get_all("Project-URL") or []]
    where = f" at {urls[0]}" if urls else ""
    problems.print(f"[bold red]fault:[/] this is an error of qube-ihc; please report it{where} with the lines above")


def say_notes(notes: Iterable[str]) -> None:
    """Print what the user should know, a line each, to the error output."""
    for note in notes:
        problems.print(f"[yellow]note:[/] {escaped(note)}")


@contextmanager
def interruptible(*places: Path) -> Iterator[None]:
    """Let Ctrl-C in the block tell which of these files, or of the files in these folders, were written until then."""
    before = _stamps(places)
    try:
        yield
    except KeyboardInterrupt as interrupt:
        written = ", ".join(str(path) for path, stamp in _stamps(places).items() if before.get(path) != stamp)
        signals.note(interrupt, f"wrote {written}" if written else signals.NO_FILE)
        raise


@contextmanager
def resumable(journal: Path) -> Iterator[Path]:
    """Give the file of finished runs, and let Ctrl-C in the block tell whether there are any."""
    try:
        yield journal
    except KeyboardInterrupt as interrupt:
        kept = "finished runs are kept, and the same command goes on from there"
        signals.note(interrupt, kept if is_file(journal) else "no run was finished")
        raise


def remove_earlier(path: Path, what: str) -> None:
    """Remove a file of an earlier run that its new results are not in, and say so; one of somebody else stays."""
    if path.is_file() and is_ours(path):
        path.unlink()
        console.print(f"removed {escaped(path)}, the {what} of an earlier run")


def _stamps(places: Iterable[Path]) -> dict[Path, tuple[int, int]]:
    """Return what tells a file that was replaced from the earlier one, of files that there are."""
    stamps = {}
    for path in (file for place in places for file in (place.iterdir() if is_folder(place) else (place,))):
        with suppress(OSError, ValueError):
            status = path.stat()
            stamps[path] = (status.st_ino, status.st_mtime_ns)
    return stamps


def escaped(thing: object) -> str:
    """Return the text of a thing, whose brackets Rich then does not take for markup."""
    from rich.markup import escape

    return escape(str(thing))


def show_table(
    title: str,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    text: bool = False,
    bold: Container[int] = (),
) -> None:
    """Print a table; where the terminal is too narrow for it, without lines; where for that too, one line for each cell.

    The first column names the row; with `text` it may be broken. No other cell is ever broken or left out.
    """
    from rich import box
    from rich.cells import cell_len
    from rich.table import Table

    console.print(escaped(title))
    wide = console.options.update(max_width=10_000)
    for lines in (box.HEAVY_HEAD, None):
        table = Table(box=lines, pad_edge=lines is not None)
        for number, heading in enumerate(headings):
            broken = text and number == 0
            widest = max(cell_len(cell) for cell in (heading, *(row[number] for row in rows)))
            table.add_column(
                escaped(heading),
                justify="right" if number else "left",
                no_wrap=not broken,
                min_width=min(widest, LEAST_TEXT) if broken else widest,
            )
        for number, row in enumerate(rows):
            table.add_row(*map(escaped, row), style="bold" if number in bold else None)
        if console.measure(table, options=wide).minimum <= console.width:
            console.print(table)
            return
    for row in rows:
        console.print(escaped(f"{headings[0]} {row[0] or '-'}".strip()), style="bold")
        widest = max(map(cell_len, headings[1:]), default=0)
        for heading, cell in zip(headings[1:], row[1:], strict=True):
            if cell:
                console.print(f"  {escaped(heading)}{' ' * (widest - cell_len(heading))}  {escaped(cell)}")


LEAST_TEXT = 20
"""Characters below which a column of text is not broken."""


def warn_of_messages(result: Result) -> None:
    """Print what the FMUs of a run logged."""
    for instance, messages in result.metadata.get("messages", {}).items():
        for message in messages:
            problems.print(f"[yellow]{escaped(instance)}:[/] {escaped(message)}")


def print_metrics(result: Result) -> None:
    """Print the metrics of a result, one a line."""
    from rich.cells import cell_len

    from ..metrics import evaluate, unsteady
    from ..tables import metric_rows

    metrics = evaluate(result)
    why = unsteady(metrics)
    rows = metric_rows(metrics)
    widest = max(cell_len(symbol) for symbol, _ in rows)
    for symbol, cell in rows:
        console.print(f"  {escaped(symbol)}{' ' * (widest - cell_len(symbol))}  {escaped(cell)}")
    if why:
        console.print(f"  * {escaped(why)}")


def print_results(results: Mapping[str, Result]) -> None:
    """Print the metrics of several results side by side; raise UserError where they are judged by different signals."""
    from ..metrics import evaluate_alike, unsteady
    from ..tables import side_by_side

    metrics = evaluate_alike(results)
    show_table("results", ["", *results], side_by_side(list(metrics.values())))
    for name, m in metrics.items():
        if not m.steady:
            console.print(escaped(f"* {name}: {unsteady(m)}"))


def print_comparison(comparison: Comparison) -> None:
    """Print the means of a comparison, and what they say of each law against the first one."""
    for title, headings, rows in comparison.tables():
        show_table(title, headings, rows)
    for remark in comparison.remarks():
        console.print(escaped(remark))


@contextmanager
def staged_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each stage of long work; where nothing can move, as in a batch job's log, a line in a while."""
    if not problems.is_interactive:
        yield ProgressLines()
        return
    with progress() as bar:
        tasks: dict[str, Any] = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        yield report


class ProgressLines:
    """Says in lines of its own how far a stage is, and how long the rest takes at its latest pace."""

    EVERY = 60.0  # [s]
    WINDOW = 30.0  # [s] of the pace: what a journal had is counted at once

    def __init__(self) -> None:
        self.stage, self.said = "", time.monotonic()
        self.latest: deque[tuple[float, int]] = deque()

    def __call__(self, what: str, done: int, total: int) -> None:
        """Take note that `done` of `total` of the stage `what` are done."""
        now = time.monotonic()
        if what != self.stage:
            self.stage = what
            self.latest.clear()
        self.latest.append((now, done))
        while self.latest[0][0] < now - self.WINDOW:
            self.latest.popleft()
        begin, first = self.latest[0]
        if now - self.said < self.EVERY or not first < done < total:
            return
        self.said = now
        left = (total - done) * (now - begin) / (done - first)
        problems.print(f"{escaped(what)}: {done} of {total}, about {left:.0f} s left")


def progress() -> Progress:
    """Return a progress display, for terminals; it vanishes when it is done."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    return Progress(
        *columns, TimeRemainingColumn(), console=problems, transient=True, disable=not problems.is_interactive
    )


def print_design(design: Design, reasons: Sequence[str] = ()) -> None:
    """Print a design's numbers, why they were chosen, and its certificate."""
    from rich.table import Table

    table = Table(title=escaped(design.title), show_header=False, title_justify="left")
    for label, text in design.summary():
        table.add_row(label, escaped(text))
    console.print(table)
    for reason in reasons:
        console.print(f"chosen: {escaped(reason)}", highlight=False)


def print_residual(design: Design, a_min: float, found: Residual) -> None:
    """Print what counted sensors leave with this a_min, and whether the bound is proven."""
    from rich.table import Table

    title = f"what counting leaves with a_min = {a_min:g}"
    table = Table("", "RMS", "RMS if it were white noise", "at most", title=title, title_justify="left")
    for i, q in enumerate(design.system.states):
        table.add_row(escaped(str(q)), *(f"{values[i]:.3g}" for values in (found.rms, found.white, found.bound)))
    for i, q in enumerate(design.system.inputs):
        table.add_row(escaped(str(q)), f"{found.input_rms[i]:.3g}", "", f"{found.input_bound[i]:.3g}")
    console.print(table)
    ball = f"in the ball of a_min, where the law is linear, the estimate reaches {found.norm_bound:.3g} of the radius"
    limits = ", and an input may be limited" if found.limited else ""
    console.print(f"the bound is {'proven' if found.proven else 'not proven of the law'}: {ball} at most{limits}")


def print_tuning(tuning: Tuning) -> None:
    """Print where the paper's rule stopped."""
    from ..metric_meanings import is_pendulum
    from ..studies.estimates import change_text

    q, linear, variation = tuning.quantities[tuning.measure], tuning.linear, tuning.chattering
    drawn = f", {linear.draws} draws; ± 95 % interval" if linear.draws > 1 else ""
    families = any(point.mu is not None for point in tuning.stops)
    title = f"{q.heading}: where the paper's rule stops{', for each mu and scale of P' if families else ''}{drawn}"
    kept = "upright" if is_pendulum(tuning.quantities) else "acting"
    first = ("mu", "u_max [V]") if families else ("",)
    chattering = [] if variation is None else [variation.heading]
    headings = (*first, "a_min", "b_max", q.symbol, "over LC", *chattering, kept)

    def row(names: Sequence[str], over: str, o: Outcome) -> list[str]:
        shown = [] if variation is None else [f"{o.chattering:.4g}"]
        return [*names, f"{o.measure:.4g}", over, *shown, f"{o.kept}/{o.draws}"]

    rows = [row(["LC", *[""] * (len(first) + 1)], "", linear)]
    for point in tuning.stops:
        o = tuning.outcomes[point]
        named = [f"{v:g}" for v in point if v is not None]
        rows.append(row(named if families else ["IHC", *named], change_text(o.over_linear), o))
    best = [number for number, point in enumerate(tuning.stops, start=1) if point == tuning.best.point]
    show_table(title, headings, rows, bold=best)
    lowest = min(point.a_min for point in tuning.outcomes)
    if tuning.best.point.a_min == lowest < 1.0:
        console.print(f"the best is at the smallest a_min tried, {lowest:g}; --a-min takes smaller ones")


def print_front(front: Front) -> None:
    """Print the LC, where the paper's rule stopped and the front, in the draws held out, and whether the LC gains."""
    from ..studies.estimates import change_text
    from ..studies.pareto_front import DOMINATED, FRONT, LC, LOST, RULE
    from ..unit_definitions import shown_unit

    objectives = front.search.objectives
    drawn = f", {front.linear.draws} draws that the search did not see; change over the LC" if front.random else ""

    def row(name: str, p: ParetoPoint) -> list[str]:
        cells = [name]
        for q, value, over in zip(objectives, p.held_out, p.over_linear, strict=True):
            change, _, verdict = change_text(over).rpartition(" ")
            shown = change if verdict in ("better", "open", "worse") else change_text(over)
            cells.append(q.quantity.text(value.value) + ("" if p.kind == LC else f" ({shown})"))
        return cells

    rows = [row("LC", front.linear), *(row("rule", p) for p in front.of(RULE)[-1:])]
    points = sorted(front.of(FRONT), key=lambda p: p.held_out[0].value)
    rows += [row("chosen" if p is front.chosen else "", p) for p in points]
    if front.retuned is not None:
        rows.append(row("LC, retuned", front.retuned[0]))
    bold = [number for number, cells in enumerate(rows) if cells[0] == "chosen"]
    show_table(f"the front{drawn}", ["", *(q.heading for q in objectives)], rows, bold=bold)
    beaten, lost = len(front.of(DOMINATED)), len(front.of(LOST))
    if beaten or lost:
        console.print(f"found by the search, but not of the front in these draws: {beaten} beaten, {lost} infeasible")
    if front.chosen is not None:
        units = {t.name: shown_unit(t.unit) for t in front.search.tunables}
        values = (f"{name} {value:g} {units[name]}".rstrip() for name, value in front.chosen.values.items())
        console.print(escaped(f"chosen: {', '.join(values)}"))
    if ends := front.at_ends():
        console.print(escaped(f"the chosen point is at the end of a range: {', '.join(ends)}; --over takes others"))
    console.print(escaped(front.verdict()), style="bold")
    if said := front.over_retuned():
        console.print(escaped(said), style="bold")


def print_claims(claims: list[Claim]) -> None:
    """Print the paper's main claims and the counts of all verdicts."""

    def value(number: float, unit: str) -> str:
        return "" if math.isnan(number) else f"{number:.4g}" + ("" if unit == "1" else f" {unit}")

    rows = [
        [
            f"{claim.section}: {claim.text}",
            value(claim.printed, claim.unit),
            value(claim.ours, claim.unit),
            "" if claim.share is None else f"{claim.share.wins}/{claim.share.draws}",
            claim.verdict,
        ]
        for claim in claims
        if claim.main
    ]
    show_table("the paper's main claims", ("claim", "printed", "ours", "draws", "verdict"), rows, text=True)
    for name, some in (("all", claims), ("independent", [claim for claim in claims if claim.basis == "independent"])):
        counts = {verdict: sum(claim.verdict == verdict for claim in some) for verdict in VERDICT_NAMES}
        console.print(f"{name} claims: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items()))


VERDICT_NAMES = ("holds", "does not hold", "undecided")
