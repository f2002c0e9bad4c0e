"""What a search for a front leaves: its points as a table, a picture, the chosen one as scenario and design."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from filing.files import staging, write_file
from fmu_export.files import FilePath

from ..plots import COLOURS, OTHERS, literal, logarithmic, save_figure
from .pareto_front import DOMINATED, FRONT, LC, LOST, RETUNED, RULE, Front, ParetoPoint
from .tuning import TuningProblem
from .tuning_files import cell, write_best

WRITTEN_FILES = ("front.csv", "front.png", "best.toml", "best.json")
"""What `save` writes."""
LARGEST_RATIO = 10.0
"""Of an axis, beyond which it is logarithmic."""


def save(front: Front, problem: TuningProblem, folder: FilePath) -> list[Path]:
    """Write front.csv, front.png and the chosen point, where there is one, as best.toml and best.json; return them.

    As by the rule, FMUs and tables that lie beside the tuned scenario are copied beside the new one.
    """
    folder, chosen = Path(folder), front.chosen
    written = ["front.csv", "front.png"]
    with staging(folder) as place:
        write_file(place / "front.csv", _table(front))
        if chosen is not None and chosen.setting is not None:
            setting = chosen.setting
            write_best(place, problem, setting.plain if problem.design else setting.changes, setting.design)
            written += ["best.toml"] if setting.design is None else ["best.toml", "best.json"]
        save_figure(_picture(front), place / "front.png", _title(front, problem))
    return [folder / name for name in written]


def _table(front: Front) -> str:
    """Return all points as CSV: kind, whether chosen, values, then of each objective search, held out, over the LC."""
    names = [t.name for t in front.search.tunables]
    names += [name for name in dict.fromkeys(n for p in front.points for n in p.values) if name not in names]
    of_objective = ("{} in the search", "{}", "{} interval", "{} over LC", "{} over LC interval")
    metrics = [cell(text.format(q.name)) for q in front.search.objectives for text in of_objective]
    lines = [",".join(["kind", "chosen", *map(cell, names), *metrics, "kept", "draws"])]
    for p in sorted(front.points, key=lambda p: (ORDER.index(p.kind), p.held_out[0].value if p.kind == FRONT else 0.0)):
        row: list[object] = [p.kind, int(p is front.chosen), *(p.values.get(name) for name in names)]
        for seen, value, over in zip(p.searched, p.held_out, p.over_linear, strict=True):
            row += [seen, value.value, value.half_width, over.value, over.half_width]
        row += [p.kept, p.draws]
        lines.append(",".join("" if value is None else str(value) for value in row))
    return "\n".join(lines) + "\n"


ORDER = (LC, RULE, FRONT, RETUNED, DOMINATED, LOST)
"""Of kinds in the table."""


def _title(front: Front, problem: TuningProblem) -> str:
    drawn = f"means of {front.linear.draws} draws that the search did not see" if front.random else "one run each"
    return f"{problem.scenario.name}: what can be had,{chr(10) if len(front.search.objectives) == 2 else ' '}{drawn}"


def _picture(front: Front) -> Figure:
    """Return a panel for each pair of objectives."""
    pairs = list(itertools.combinations(range(len(front.search.objectives)), 2))
    columns = min(3, len(pairs))
    rows = -(-len(pairs) // columns)
    few = columns == 1
    figure = Figure(
        figsize=(6.4 if few else 4.4 * columns + 0.6, 3.9 * rows + (1.2 if few else 0.6)), layout="constrained"
    )
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(pairs) :]:
        panel.remove()
    for panel, (i, j) in zip(panels, pairs, strict=False):
        _panel(panel, front, i, j)
    shown = {text: handle for panel in panels for handle, text in zip(*panel.get_legend_handles_labels(), strict=True)}
    handles, labels = list(shown.values()), list(shown)
    figure.legend(handles, labels, loc="outside lower center", ncols=4 if few else len(labels), frameon=False)
    return figure


def _panel(axis: Any, front: Front, i: int, j: int) -> None:
    """Draw two objectives of all feasible points, the rule's way, the LC, the chosen point and the limits."""

    def draw(points: Sequence[ParetoPoint], *style: str, **more: Any) -> None:
        if points:
            xy = [[p.held_out[k].value for p in points] for k in (i, j)]
            axis.plot(*xy, *style, **more)

    q = front.search.objectives
    draw(front.of(DOMINATED), "o", ms=4, color="#bbbbbb", label="beaten when judged")
    draw(front.of(FRONT), "o", ms=5, color=COLOURS["IHC"], label="front")
    way = front.of(RULE)
    draw(way, ".-", ms=4, lw=1, color=OTHERS[0], label="the paper's rule")
    draw(way[-1:], "s", ms=8, mfc="none", mew=1.5, color=OTHERS[0], label="where it stops")
    draw(front.of(RETUNED), "^", ms=5, mfc="none", color=COLOURS["LC"], label="LC, retuned")
    if front.retuned is not None:
        draw([front.retuned[0]], "^", ms=10, color=COLOURS["LC"], label="LC, retuned, chosen")
    draw([front.linear], "D", ms=8, color=COLOURS["LC"], label="LC")
    if front.chosen is not None:
        draw([front.chosen], "o", ms=13, mfc="none", mew=2, color=OTHERS[1], label="chosen")
    for k, line in ((i, axis.axvline), (j, axis.axhline)):
        for what, factors in (("limit", front.search.bounds), ("goal", front.search.goals)):
            if q[k].name in factors:
                value = factors[q[k].name] * front.linear.held_out[k].value
                line(value, ls="--", lw=1, color=OTHERS[5], label=what if k == j else None)
    shown = [p for p in front.points if p.kind != LOST]
    for k, which, label in ((i, "x", axis.set_xlabel), (j, "y", axis.set_ylabel)):
        label(literal(q[k].heading))
        if _wide(shown, k):
            logarithmic(axis, which)
    axis.grid(alpha=0.3, which="both")


def _wide(points: Sequence[ParetoPoint], k: int) -> bool:
    """Return whether an objective is over more than a decade."""
    values = [p.held_out[k].value for p in points]
    values = [v for v in values if math.isfinite(v)]
    return min(values) > 0.0 and max(values) > LARGEST_RATIO * min(values)
