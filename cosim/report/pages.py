"""The pages of runs: of one, a simulation or a log of the device, and of several side by side."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from filing.files import write_file
from fmu_export.files import FilePath

from ..animation import Bodies, check_signals
from ..errors import UserError
from ..judged_signals import can_draw, can_evaluate, evaluation_in, kept_upright, overflow
from ..metrics import evaluate, evaluate_alike, unsteady
from ..plots import law_of
from ..provenance import provenance
from ..recording import Recording
from ..tables import metric_rows
from ..tables import side_by_side as rows_of
from ..typed import checked
from .charts import Plots
from .motion import bodies_in_motion, is_rotary, pendulum_in_motion
from .page import ANIMATION, CHARTS, data, link, render

if TYPE_CHECKING:
    from ihc_fmu.design import Design

SUFFIX = ".html"


@dataclass(frozen=True)
class Table:
    """Rows under headings; the first cell of a row names it."""

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Verdict:
    """What came out, in a word or a number, and of what; `kind` is good, bad or empty."""

    text: str
    about: str
    kind: str = ""


@dataclass(frozen=True)
class Findings:
    """What a page says before its plots."""

    verdicts: Sequence[Verdict] = ()
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    remarks: Sequence[str] = ()
    """What is said below the tables, to read their numbers."""


def check_name(path: FilePath) -> Path:
    """Return the path of a page; raise UserError for another suffix than .html."""
    path = Path(path)
    if path.suffix != SUFFIX:
        raise UserError(f"a report goes into a file named *{SUFFIX}, found {path}")
    return path


def found_in(result: Recording) -> Findings:
    """Return what is to be said of a single run: its metrics, and that numbers overflow."""
    if len(result.time) < 2 or not can_evaluate(result):
        return Findings()
    metrics = evaluate(result)
    rows, why = metric_rows(metrics), unsteady(metrics)
    several = sum(meaning.role == "settling" for meaning in metrics.quantities.values()) > 1
    shown = ("settling", "peak") if several else ("settling", "rms", "peak")
    numbers = zip(metrics.quantities.values(), rows, strict=True)
    verdicts = [
        _kept(result),
        Verdict("no" if why else "yes", "steady state at the end", "bad" if why else "good"),
        *(Verdict(text, symbol) for meaning, (symbol, text) in numbers if meaning.role in shown),
    ]
    beyond = overflow(result)
    return Findings(verdicts, [Table("Metrics", (), rows)], beyond, [f"* {why}"] if why else [])


def _kept(result: Recording, name: str = "") -> Verdict:
    kept = kept_upright(result)
    what = "upright to the end" if evaluation_in(result).kind == "pendulum" else "acting to the end"
    return Verdict("yes" if kept else "no", f"{name}: {what}" if name else what, "good" if kept else "bad")


def side_by_side(results: Mapping[str, Recording]) -> Findings:
    """Return what is to be said of several runs by their names; raise UserError for runs judged by different signals."""
    metrics = evaluate_alike(results)
    return Findings(
        [_kept(result, name) for name, result in results.items()],
        [Table("Metrics", ["", *results], rows_of(list(metrics.values())))],
        [f"{name}: {text}" for name, result in results.items() if (text := overflow(result))],
        [f"* {name}: {unsteady(m)}" for name, m in metrics.items() if not m.steady],
    )


def write_result(
    path: FilePath,
    result: Recording,
    title: str = "",
    notes: Sequence[str] = (),
    design: Design | None = None,
    table: FilePath | None = None,
    more: Findings | None = None,
) -> Path:
    """Write the page of one run.

    `notes` are what else is to be known, `more` what is found besides, before the rest; `table` is the file that the run
    was saved to. Raises UserError where the page cannot be written, or has another suffix than .html.
    """
    path = check_name(path)
    used = provenance(result).scenario
    own, more = found_in(result), more or Findings()
    law = law_of(result)
    return _write(
        path,
        title or _description(result) or used.name,
        Findings(
            [*more.verdicts, *own.verdicts],
            [*more.tables, *own.tables],
            [*notes, *more.notes, *own.notes],
            [*own.remarks, *more.remarks],
        ),
        {law or used.name: result},
        design,
        {} if table is None else {law or used.name: table},
    )


def write_results(
    path: FilePath,
    results: Mapping[str, Recording],
    title: str,
    findings: Findings,
    tables: Mapping[str, FilePath],
    design: Design | None = None,
) -> Path:
    """Write the page of several runs by their names, drawn over each other; `tables` are the files that they were saved to.

    Raises as `write_result`.
    """
    return _write(check_name(path), title, findings, results, design, tables)


def _write(
    path: Path,
    title: str,
    findings: Findings,
    results: Mapping[str, Recording],
    design: Design | None,
    tables: Mapping[str, FilePath],
) -> Path:
    said = [f"{k}: {text}" for run in results.values() for k, of in provenance(run).messages.items() for text in of]
    plots = Plots({name: result for name, result in results.items() if len(result.time)})
    judged = bool(plots.runs) and all(can_evaluate(run) and can_draw(run) for run in plots.runs.values())
    if judged:
        plots.add_judged()
    if len(plots.runs) == 1:
        plots.add_signals()
    downloads = {name: f"{path.stem}_{_plain(name)}_plotted.csv" for name in results}
    drawn, thin = plots.data(downloads)
    motion = _motion(plots)
    page = render(
        "run.html.j2",
        CHARTS if motion is None else (*CHARTS, ANIMATION[1]),
        ("uplot/uPlot.min.css",) if motion is None else ("uplot/uPlot.min.css", "animation.css"),
        motion=None if motion is None else data(motion),
        title=title,
        findings=findings,
        notes=list(dict.fromkeys([*findings.notes, *said])),
        about=_about(results),
        charts=[(chart, plots.text(chart)) for chart in plots.charts],
        others=[(chart, plots.text(chart)) for chart in plots.others],
        left_out=plots.left_out,
        modes=plots.modes(),
        thin=thin,
        data=data(drawn),
        files=[
            (name, *(link(tables[name], path) if name in tables else ("", "")), list(plots.runs).index(name))
            for name in plots.runs
        ],
        design=design,
        metadata={name: json.dumps(result.metadata, indent=1, default=str) for name, result in results.items()},
    )
    write_file(path, page)
    return path


def _motion(plots: Plots) -> dict[str, Any] | None:
    """Return what is shown in motion: the pendulum, or the bodies that the first run's scenario has; None where none is."""
    runs = plots.runs
    if not runs or min(len(run.time) for run in runs.values()) < 2:
        return None
    first = next(iter(runs.values()))
    if all(is_rotary(run) for run in runs.values()):
        return pendulum_in_motion(runs, plots.colours)
    scenario = first.metadata.get("scenario")
    listed = scenario.get("animation") if isinstance(scenario, dict) else None
    bodies = checked(_Bodies, {"animation": listed or ()}, "the result's metadata: scenario").animation
    for run in runs.values():
        check_signals(bodies, run.signals)
    return bodies_in_motion(runs, plots.colours, bodies) if bodies else None


class _Bodies(BaseModel):
    animation: Bodies = ()


def _plain(name: str) -> str:
    """Return a name such that a file's may have it in it."""
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name)


def _description(result: Recording) -> str:
    scenario = result.metadata.get("scenario")
    text = scenario.get("description") if isinstance(scenario, dict) else None
    return text if isinstance(text, str) else ""


def _about(results: Mapping[str, Recording]) -> Table:
    """Return what was run: a row for each fact, a column for each run, one where all runs agree."""
    facts = {name: _facts(result) for name, result in results.items()}
    names = list(dict.fromkeys(name for of in facts.values() for name in of))
    rows = [[name, *(of.get(name, "") for of in facts.values())] for name in names]
    if all(len(set(row[1:])) == 1 for row in rows):
        return Table("What was run", (), [row[:2] for row in rows])
    return Table("What was run", ("", *results), rows)


def _facts(result: Recording) -> dict[str, str]:
    used = provenance(result)
    law, device = law_of(result), _device(result.metadata)
    facts = {"scenario": used.scenario.name, "law": law, "device": device}
    facts |= {f"FMU {name}": f"{fmu.file} {fmu.guid}" for name, fmu in used.fmus.items()}
    if used.step is not None:
        facts["step"] = f"{used.step:g} s"
    facts["order of coupling"] = used.order or ""
    rows = len(result.time)
    facts["rows"] = f"{rows}, until {result.time[-1]:g} s" if rows else "none"
    return {name: text for name, text in facts.items() if text}


def _device(metadata: Mapping[str, Any]) -> str:
    device_run = metadata.get("hil")
    return str(device_run.get("device", "")) if isinstance(device_run, dict) else ""
