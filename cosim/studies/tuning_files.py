"""What a tuning leaves: all points as a table, a picture of the landscape, the best point as scenario and design."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from filing.files import staging, write_file
from fmu_export.files import FilePath

from ..plots import OTHERS, literal, save_figure
from ..scenario_files import portable
from .tuning import Family, Point, Tuning, TuningProblem

WRITTEN_FILES = ("tuning.csv", "landscape.png", "best.toml", "best.json")
"""What `save` writes."""


def save(tuning: Tuning, problem: TuningProblem, folder: FilePath) -> list[Path]:
    """Write tuning.csv, landscape.png and the best point as best.toml (scenario) and best.json (design); return them.

    The files that lie beside the tuned scenario are copied beside the new one. Without a design of its own the
    point is a scenario only.
    """
    best = tuning.best.point
    design = tuning.designs[best.mu, best.u_max]
    own: dict[str, object] = {"record.every": 1}
    if design is not None:
        own["controller.design"] = "best.json"
    point: dict[str, object] = {"law": "IHC", "a_min": best.a_min, "b_max": best.b_max}
    start = {f"controller.start.{name}": value for name, value in point.items()}
    tuned = problem.scenario if design is None else problem.scenario.changed({"controller.design": None})
    moved, beside = portable(tuned, problem.fmus, problem.folder)
    scenario = moved.changed({**own, **start}).to_toml()
    drawn = f"means of {len(problem.numbers)} draws" if problem.chance else "one run each"
    title = (
        f"{problem.scenario.name}: {tuning.quantities[tuning.measure].symbol} and chattering, {drawn}\n"
        "square: where the rule stops; triangle: there with b_max raised"
    )
    folder = Path(folder)
    with staging(folder) as place:
        write_file(place / "tuning.csv", _table(tuning))
        for name, path in beside.items():
            write_file(place / name, path.read_bytes())
        write_file(place / "best.toml", scenario)
        if design is not None:
            design.save(place / "best.json")
        save_figure(_landscape(tuning), place / "landscape.png", title)
    return [folder / name for name in WRITTEN_FILES if design is not None or name != "best.json"]


def _table(tuning: Tuning) -> str:
    """Return all points as CSV."""
    variation = tuning.chattering
    name = "variation" if variation is None else variation.name
    lines = [f"mu,u_max,a_min,b_max,{_cell(tuning.measure)},over_lc,interval,{_cell(name)},kept,draws,stop"]
    for point, o in sorted(tuning.outcomes.items(), key=lambda item: _order(item[0])):
        over = (o.over_linear.value, o.over_linear.half_width)
        row = (*point, o.measure, *over, o.chattering, o.kept, o.draws, int(point in tuning.stops))
        lines.append(",".join("" if value is None else repr(value) for value in row))
    return "\n".join(lines) + "\n"


def _cell(name: str) -> str:
    """Return a heading; names of FMUs may have commas, quotes and line breaks in them."""
    return '"' + name.replace('"', '""') + '"' if set(name) & set(',"\r\n') else name


def _order(point: Point) -> tuple[float, float, float]:
    return (point.mu or 0.0, point.u_max or 0.0, -point.a_min)


def _landscape(tuning: Tuning) -> Figure:
    """Return the measure, and below it the chattering where the system has one, over a_min; a column for each mu."""
    mus = list(dict.fromkeys(point.mu for point in tuning.outcomes))
    rows = {"measure": tuning.quantities[tuning.measure]}
    if tuning.chattering is not None:
        rows["chattering"] = tuning.chattering
    figure = Figure(figsize=(4.2 * len(mus) + 1, 3.5 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), len(mus), sharex=True, sharey="row", squeeze=False)
    for column, mu in enumerate(mus):
        scales = dict.fromkeys(p.u_max for p in tuning.outcomes)
        for number, u_max in enumerate(scales):
            for row, name in enumerate(rows):
                _draw_family(panels[row, column], tuning, (mu, u_max), name, OTHERS[number % len(OTHERS)])
        if mu is not None:
            panels[0, column].set_title(f"μ = {mu:g}", fontsize="medium")
        panels[-1, column].set_xlabel("$a_{min}$ (1: the LC)")
    for axis in panels.flat:
        if any((np.asarray(line.get_ydata(), float) > 0.0).any() for line in axis.lines):
            axis.set_yscale("log")
        axis.grid(alpha=0.3, which="both")
    panels[0, 0].invert_xaxis()
    for row, quantity in enumerate(rows.values()):
        panels[row, 0].set_ylabel(literal(quantity.heading))
    handles, labels = panels[0, 0].get_legend_handles_labels()
    if labels:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def _draw_family(axis: Any, tuning: Tuning, family: Family, name: str, colour: str) -> None:
    """Draw `measure` or `chattering` of one mu and scale of P over a_min, and mark where the rule stopped."""
    curve = sorted(
        (o for p, o in tuning.outcomes.items() if ((p.mu, p.u_max), p.b_max) == (family, 1.0)),
        key=lambda o: -o.point.a_min,
    )
    stop = tuning.outcomes[next(p for p in tuning.stops if (p.mu, p.u_max) == family)]
    values = [getattr(o, name) if math.isfinite(getattr(o, name)) else math.nan for o in curve]
    label = None if family[1] is None else f"|k x| ≤ {family[1]:g} V on the unit ball"
    axis.plot([o.point.a_min for o in curve], values, "o-", ms=3, lw=1, color=colour, label=label)
    if stop.point.b_max == 1.0:
        axis.plot(stop.point.a_min, getattr(stop, name), "s", mfc="none", ms=9, color=colour)
    else:
        axis.plot(stop.point.a_min, getattr(stop, name), "^", ms=8, color=colour)
