"""What the command line shows: messages, tables, progress."""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from traceback import print_exception
from typing import TYPE_CHECKING, Any

from rich.console import Console

if TYPE_CHECKING:
    from rich.progress import Progress

    from ihc_fmu.design import Design

    from .experiments import Comparison
    from .paper.claims import Claim
    from .results import Result
    from .tuning import Tuning

console = Console(emoji=False)
problems = Console(stderr=True, soft_wrap=True, highlight=False, emoji=False)


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


def escaped(thing: object) -> str:
    """Return the text of a thing, whose brackets Rich then does not take for markup."""
    from rich.markup import escape

    return escape(str(thing))


NARROW = 120
"""Characters that a table of metrics needs with unbroken headings."""

METRIC_UNITS = {
    "settling_time": "s",
    "integral_q2": "rad^2 s",
    "steady_rms": "rad",
    "energy": "V^2 s",
    "peak_voltage": "V",
    "voltage_variation": "V/s",
    "capture_time": "s",
    "captures": "",
}


def number_text(value: float) -> str:
    """Return a metric as text."""
    return "never" if math.isnan(value) else f"{value:.4g}"


def warn_of_messages(result: Result) -> None:
    """Print what the FMUs of a run logged."""
    for instance, messages in result.metadata.get("messages", {}).items():
        for message in messages:
            problems.print(f"[yellow]{escaped(instance)}:[/] {escaped(message)}")


def print_metrics(result: Result) -> None:
    """Print the metrics of a result, one a line."""
    from .metrics import evaluate

    for name, value in evaluate(result).as_dict().items():
        unit = "" if math.isnan(value) else METRIC_UNITS[name]
        console.print(f"  {name:17} {number_text(value)} {unit}".rstrip())


def print_results(results: Mapping[str, Result]) -> None:
    """Print the metrics of several results side by side."""
    from rich.table import Table

    from .metrics import NAMES, evaluate

    table = Table()
    table.add_column("metric")
    for name in results:
        table.add_column(escaped(name), justify="right")
    metrics = [evaluate(result).as_dict() for result in results.values()]
    for name in NAMES:
        unit = f" [{METRIC_UNITS[name]}]" if METRIC_UNITS[name] else ""
        table.add_row(escaped(f"{name}{unit}"), *(number_text(m[name]) for m in metrics))
    console.print(table)


def print_comparison(comparison: Comparison) -> None:
    """Print the medians of a comparison."""
    from rich.table import Table

    laws = list(comparison.results)
    count = len(comparison.draws) // len(laws)
    drawn = f"medians over {count} draws of the encoder offsets" if count > 1 else "one run"
    table = Table(title=escaped(f"{comparison.scenario.name}: {drawn}"), title_justify="left")
    headings = (
        "settling [s]",
        "∫|q|² dt [rad² s]",
        "steady RMS |q| [rad]",
        "∫V² dt [V² s]",
        "peak V [V]",
        "varies [V/s]",
        "capture [s]",
    )
    names = (
        "settling_time",
        "integral_q2",
        "steady_rms",
        "energy",
        "peak_voltage",
        "voltage_variation",
        "capture_time",
    )
    columns = [[number_text(comparison.median(law, name)) for law in laws] for name in names]
    table.add_column("law", no_wrap=True)
    for heading, cells in zip(headings, columns, strict=True):
        widest = max(map(len, [*cells, *heading.split()]))  # a narrow terminal breaks headings, never numbers
        table.add_column(escaped(heading), justify="right", width=widest if console.width < NARROW else None)
    for row in zip(laws, *columns, strict=True):
        table.add_row(*row)
    console.print(table)


@contextmanager
def staged_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each stage of long work that keeps what is finished; on Ctrl-C say so."""
    with progress() as bar:
        tasks: dict[str, Any] = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        try:
            yield report
        except KeyboardInterrupt:
            bar.console.print("interrupted; finished runs are kept, and the same command goes on from there")
            raise


def progress() -> Progress:
    """Return a progress display; it vanishes when it is done."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    return Progress(*columns, TimeRemainingColumn(), console=problems, transient=True)


def print_design(found: Design) -> None:
    """Print a design's numbers and its certificate."""
    import numpy as np
    from rich.table import Table

    def row(values: Iterable[float]) -> str:
        return "[" + ", ".join(f"{v:.6g}" for v in values) + "]"

    table = Table(
        title=escaped(f"implicit homogeneous controller, {found.method}"), show_header=False, title_justify="left"
    )
    table.add_row("k_lin", row(found.k_lin))
    table.add_row("k = k_lin + row", row(found.k))
    table.add_row("P", "\n".join(row(line) for line in found.P))
    table.add_row("mu, alpha", f"{found.mu:g}, {found.alpha:g} 1/s")
    table.add_row("origin reached from the unit sphere within", f"{1.0 / (found.mu * found.alpha):.4g} s")
    table.add_row("largest |k x| on the unit ball", f"{found.u_max:.6g} V")
    table.add_row("largest states on the unit ball", row(found.extent))
    poles = np.linalg.eigvals(found.A + np.outer(found.b, found.k_lin))
    table.add_row("poles of A + b k_lin", ", ".join(f"{p:.4g}" for p in poles))
    for name, margin in found.certificate.as_dict().items():
        table.add_row(f"certificate: {name}", f"{margin:.4g}")
    console.print(table)


def print_tuning(tuning: Tuning) -> None:
    """Print where the paper's rule stopped."""
    from rich.table import Table

    title = (
        f"{tuning.measure} [{METRIC_UNITS[tuning.measure]}]: where the paper's rule stops, for each mu and scale of P"
    )
    table = Table(title=escaped(title), title_justify="left")
    for heading in ("mu", "u_max [V]", "a_min", "b_max", "measure", "over LC", "variation [V/s]", "upright"):
        table.add_column(escaped(heading), justify="right")
    linear = tuning.linear
    table.add_row(
        "LC", "", "", "", f"{linear.measure:.4g}", "", f"{linear.chattering:.4g}", f"{linear.kept}/{linear.draws}"
    )
    for point in tuning.stops:
        o = tuning.outcomes[point]
        change = f"{100 * (o.measure / linear.measure - 1):+.1f} %"
        cells = (*(f"{v:g}" for v in point), f"{o.measure:.4g}", change, f"{o.chattering:.4g}", f"{o.kept}/{o.draws}")
        table.add_row(*cells, style="bold" if o is tuning.best else None)
    console.print(table)
    best, lowest = tuning.best.point, min(point.a_min for point in tuning.outcomes)
    if best.a_min == lowest < 1.0:
        console.print(f"the best is at the smallest a_min tried, {lowest:g}; --a-min takes smaller ones")


def print_claims(claims: list[Claim]) -> None:
    """Print the paper's main claims and the counts of all verdicts."""
    from rich.table import Table

    def value(number: float, unit: str) -> str:
        return "" if math.isnan(number) else f"{number:.4g}" + ("" if unit == "1" else f" {unit}")

    table = Table(title="the paper's main claims", title_justify="left")
    table.add_column("claim")
    for heading in ("printed", "ours", "draws"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    colours = {"holds": "green", "does not hold": "red", "undecided": "yellow"}
    for claim in (claim for claim in claims if claim.main):
        draws = "" if claim.share is None else f"{claim.share.wins}/{claim.share.draws}"
        values = (value(number, claim.unit) for number in (claim.printed, claim.ours))
        verdict = f"[{colours[claim.verdict]}]{claim.verdict}[/]"
        table.add_row(escaped(f"{claim.section}: {claim.text}"), *values, draws, verdict)
    console.print(table)
    counts = {verdict: sum(claim.verdict == verdict for claim in claims) for verdict in colours}
    console.print("all claims: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
