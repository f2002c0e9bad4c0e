"""Tables: whole at any width; numbers with the digits that their interval leaves; "better" only where it is decided."""

import io
import re

import numpy as np
import pytest
from rich.console import Console

from cosim.cli import display
from cosim.cli.display import (
    print_claims,
    print_comparison,
    print_design,
    print_results,
    show_table,
)
from cosim.metric_meanings import QUANTITIES
from cosim.metrics import Metrics
from cosim.paper.verdicts import Claim
from cosim.scenario import Scenario
from cosim.studies.comparison import Comparison, Draw
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.system import System

WIDTHS = (200, 80, 60, 40)


@pytest.fixture
def shown(monkeypatch, capsys):
    """Call a function with a terminal of some width; return what it prints."""

    def show(width, function, *arguments):
        monkeypatch.setattr(display, "console", Console(width=width))
        capsys.readouterr()
        function(*arguments)
        return capsys.readouterr().out

    return show


def cells_of(text):
    return {cell.strip() for line in text.splitlines() for cell in re.split(r"  +|[│┃]", line)}


@pytest.mark.parametrize("width", WIDTHS)
def test_a_comparison_shows_every_number_at_every_width(shown, width):
    values = [(2.0 + n, 0.01, 0.0123 + 0.001 * n, 1.0, 0.7, 3.258, 36.1, 0.001, 1) for n in range(3)]
    metrics = [Metrics(dict(zip(QUANTITIES, numbers, strict=True)), QUANTITIES) for numbers in values]
    draws = tuple(Draw(law, n, True, m) for law in ("LC", "SMC", "IHC") for n, m in enumerate(metrics, start=1))
    comparison = Comparison(Scenario(), draws, {})
    text = shown(width, print_comparison, comparison)
    assert max(map(len, text.splitlines())) <= width
    rows = [row for _, _, rows in comparison.tables() for row in rows]
    assert {cell for row in rows for cell in row} <= cells_of(text)
    assert len(rows) == 2 * len(comparison.shown)
    assert ("settling [s]\n  LC" in text) == (width <= 60)


@pytest.mark.parametrize("width", WIDTHS)
def test_results_side_by_side_and_claims_lose_no_cell(shown, made_result, width):
    results = {name: made_result([0.0, 1.0], 0.01) for name in ("a run", "another run", "a third one")}
    text = shown(width, print_results, results)
    assert {q.heading for q in QUANTITIES.values()} <= cells_of(text)
    assert text.count("0.01*") == 3
    claim = Claim("Table I", "LMSE of IHC relative to LC", -1.514, -1.47, "%", -2.5, -0.5, main=True)
    text = shown(width, print_claims, [claim])
    assert {"-1.514 %", "-1.47 %", "holds"} <= cells_of(text)


def test_markup_in_a_name_is_text(shown):
    assert "[red]x[/red]" in shown(80, show_table, "[bold]", ["", "[red]x[/red]"], [["a", "[/]"]])


@pytest.mark.parametrize("n", [4, 5])
def test_a_large_design_leaves_its_p_to_the_file(shown, n):
    """P of 4 states has its rows in the table, larger ones only their size."""
    gain = -np.poly(-np.arange(1.0, n + 1))[:0:-1]
    design = inverse_design(System(A=np.eye(n, k=1), B=np.eye(n)[-1], K=gain), Options(alpha=1e-3))
    rows = [line for line in shown(200, print_design, design).splitlines() if "[" in line]
    assert len(rows) == 2 + (n if n <= 4 else 0)  # K, K - K_0 and P
    assert (f"│ {n} x {n}, in the file" in shown(200, print_design, design)) == (n > 4)


def test_where_colours_are_forced_nothing_moves(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    stream = io.StringIO()
    output = display.Output(stream, file=stream)
    monkeypatch.setattr(display, "problems", output)
    with display.progress() as bar:
        bar.update(bar.add_task("runs", total=2), completed=1)
    with output.status("building"):
        output.print("[red]built[/]")
    assert stream.getvalue() == "\x1b[31mbuilt\x1b[0m\n"


def test_where_nothing_moves_long_work_says_a_line_in_a_while(monkeypatch):
    stream, now = io.StringIO(), [0.0]
    monkeypatch.setattr(display, "problems", display.Output(stream, file=stream, soft_wrap=True))
    monkeypatch.setattr(display.time, "monotonic", lambda: now[0])
    with display.staged_progress() as report:
        for stage, kept in (("first [of two]", 0), ("second", 400)):  # of the second, some were finished before
            for i in range(101):
                now[0] += 1.0
                report(stage, min(i, 5) * kept // 5 + 5 * i, 1000)
    assert stream.getvalue().splitlines() == [
        "first [of two]: 295 of 1000, about 141 s left",
        "second: 490 of 1000, about 19 s left",  # at a pace with those that were finished before
        "second: 790 of 1000, about 42 s left",
    ]
