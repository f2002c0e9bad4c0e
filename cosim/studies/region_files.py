"""What a search for regions of attraction leaves: every run as a table, the maps as a picture, the numbers as JSON."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from filing.files import staging, write_file
from fmu_export.files import FilePath

from ..plots import colours, literal, save_figure
from .region_map import CERTIFIED_LAWS, Axis, LawRegion, Region, with_error

WRITTEN_FILES = ("region.csv", "region.png", "region.json")
"""What `save` writes."""

FORMAT = "qube-ihc region 1"

CERTIFIED = "certified: $\\|x\\|_d \\leq 1$"


def save(region: Region, folder: FilePath) -> list[Path]:
    """Write region.csv (a row for each run), region.png (the maps) and region.json (areas, bounds, remarks); return them."""
    folder = Path(folder)
    names = " and ".join(axis.name for axis in region.axes)
    drawn = f"in each of {region.draws} draws" if region.draws else "the scenario's own draw"
    with staging(folder) as place:
        write_file(place / WRITTEN_FILES[0], _table(region))
        figure = _maps(region) if len(region.axes) == 2 else _curves(region)
        save_figure(figure, place / WRITTEN_FILES[1], f"{region.scenario.name}: attracted over {names}, {drawn}")
        write_file(place / WRITTEN_FILES[2], json.dumps(summary(region), indent=1) + "\n")
    return [folder / name for name in WRITTEN_FILES]


def _table(region: Region) -> str:
    """Return all runs as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    metrics = list(next(iter(region.laws.values())).judge.quantities)
    writer.writerow(["law", "draw", *(axis.name for axis in region.axes), "outcome", "settled", *metrics])
    for law, found in region.laws.items():
        for (point, draw), numbers in sorted(found.runs.items(), key=lambda run: (run[0][1] or 0, run[0][0])):
            settled = found.judge.settling(numbers) if numbers else math.nan
            values = [numbers.get(name, math.nan) for name in metrics]
            row = [*region.at(point), found.outcomes[point, draw], settled, *values]
            writer.writerow([law, "" if draw is None else draw, *(_cell(value) for value in row)])
    return text.getvalue()


def _cell(value: float | str) -> str:
    """Return a value as text; empty for a number that there is not."""
    return value if isinstance(value, str) else "" if math.isnan(value) else repr(float(value))


def summary(region: Region) -> dict[str, Any]:
    """Return areas, bounds, counts and remarks in the types of JSON."""
    any_law = next(iter(region.laws.values()))
    return {
        "format": FORMAT,
        "scenario": region.scenario.model_dump(mode="json"),
        "axes": [_axis(axis) for axis in region.axes],
        "cells": {"coarse": any_law.cells.coarse, "finest": any_law.cells.finest},
        "draws": region.draws,
        "supervisor_opened": region.opened,
        "unit": region.unit,
        "laws": {law: _law(region, law) for law in region.laws},
        "certified": _certified(region),
        "remarks": region.remarks(),
    }


def _axis(axis: Axis) -> dict[str, Any]:
    named = {"name": axis.name, "entry": axis.entry, "low": axis.range.low, "high": axis.range.high, "unit": axis.unit}
    return {**named, "rest": _number(axis.rest)}


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


def _law(region: Region, law: str) -> dict[str, Any]:
    found = region.laws[law]
    inner, outer = found.bounds
    data: dict[str, Any] = {
        ("area" if len(region.axes) == 2 else "length"): {
            "value": found.area,
            "error": found.error,
            "inner": inner,
            "outer": outer,
            "range": found.volume,
        },
        "runs": len(found.runs),
        "outcomes": {name: found.count(name) for name in ("attracted", "unsettled", "lost", "failed")},
    }
    if len(region.axes) == 1:
        line = region.line(law)
        data["line"] = None if line is None else {**asdict(line), "radius": line.radius}
    return data


def _certified(region: Region) -> dict[str, Any]:
    section = region.certified.section
    if section is None:
        return {"why_not": region.certified.why_not}
    return {
        "Q": (section.Q / section.level).tolist() if section.level else None,
        "centre": section.centre.tolist(),
        "extent": section.extent.tolist(),
        "may_reach_limits": list(section.reaches),
        "held": {law: _number(region.held(law)) for law in region.laws},
    }


def _maps(region: Region) -> Figure:
    """Return a panel for each law: settling times inside, boundaries of all laws, the certified ball."""
    colour = colours(region.laws)
    figure = Figure(figsize=(max(7.0, 4.6 * len(region.laws) + 1.2), 4.9), layout="constrained")
    panels = figure.subplots(1, len(region.laws), sharex=True, sharey=True, squeeze=False)[0]
    maps = {law: found.settling_map for law, found in region.laws.items()}
    times = np.concatenate([m[np.isfinite(m)] for m in maps.values()])
    latest = float(np.max(times)) if times.size else 1.0
    x, y = (np.linspace(axis.range.low, axis.range.high, len(next(iter(maps.values()))) + 1) for axis in region.axes)
    mesh = None
    for panel, (law, found) in zip(panels, region.laws.items(), strict=True):
        if region.draws:
            panel.pcolormesh(x, y, _shares(found, maps[law]).T, cmap="Greys", vmin=0.0, vmax=1.6, rasterized=True)
        mesh = panel.pcolormesh(x, y, maps[law].T, cmap="viridis_r", vmin=0.0, vmax=latest, rasterized=True)
        for other, one in sorted(region.laws.items(), key=lambda item: item[0] == law):  # its own above the others
            _boundary(panel, x, y, one, colour[other], own=other == law)
        if region.certified.section is not None and law in CERTIFIED_LAWS:
            panel.plot(*region.certified.section.outline().T, "--", color="black", lw=1.2)
        panel.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), xlabel=literal(region.axes[0].label))
        panel.set_title(_heading(region, law), fontsize="medium")
        panel.grid(alpha=0.25)
    panels[0].set_ylabel(literal(region.axes[1].label))
    if mesh is not None and times.size:
        figure.colorbar(mesh, ax=list(panels), label="settled from then on [s]", aspect=30, pad=0.02)
    if handles := _handles(region, colour):
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return figure


def _heading(region: Region, law: str) -> str:
    found = region.laws[law]
    return f"{law}: {with_error(found.area, found.error)} {literal(region.unit)}"


def _boundary(panel: Any, x: np.ndarray, y: np.ndarray, found: LawRegion, colour: str, *, own: bool) -> None:
    if _has_boundary(found):
        grid = found.cells.grid()
        panel.contour(x, y, grid.T.astype(float), levels=[0.5], colors=[colour], linewidths=1.6 if own else 0.8)


def _has_boundary(found: LawRegion) -> bool:
    grid = found.cells.grid()
    return bool(grid.any() and not grid.all())


def _shares(found: LawRegion, inside: np.ndarray) -> np.ndarray:
    """Return the share of draws attracted in each finest cell outside the region, NaN where it is none."""
    shares = found.cells.averaged({point: found.share(point) for point in found.cells.known})
    return np.where(np.isfinite(inside) | (shares == 0.0), np.nan, shares)


def _handles(region: Region, colour: dict[str, str]) -> list[Any]:
    lines = [
        Line2D([], [], color=colour[law], lw=1.8, label=f"boundary, {law}")
        for law, found in region.laws.items()
        if _has_boundary(found)
    ]
    section = region.certified.section
    certified = section is not None and any(law in CERTIFIED_LAWS for law in region.laws)
    lines += [Line2D([], [], ls="--", color="black", lw=1.2, label=CERTIFIED)] if certified else []
    return lines


def _curves(region: Region) -> Figure:
    """Return the settling time over the axis, a curve for each law with its boundary."""
    axis, colour = region.axes[0], colours(region.laws)
    figure = Figure(figsize=(7.6, 4.2), layout="constrained")
    panel = figure.subplots()
    for law, found in region.laws.items():
        known = sorted(found.cells.known)
        values = [found.settling.get(point, math.nan) for point in known]
        panel.plot([region.at(point)[0] for point in known], values, ".-", ms=3, lw=1.2, color=colour[law], label=law)
        for edge in _edges(found, known):
            panel.axvline(axis.value(edge, found.cells.finest), color=colour[law], lw=0.8)
    section = region.certified.section
    if section is not None and any(law in CERTIFIED_LAWS for law in region.laws):
        low, high = section.outline(2)[:, 0]
        panel.axvspan(low, high, color="black", alpha=0.12, lw=0, label=CERTIFIED)
    panel.set(xlim=(axis.range.low, axis.range.high), xlabel=literal(axis.label), ylabel="settled from then on [s]")
    panel.set_ylim(bottom=0.0)
    panel.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=len(region.laws) + 1, frameon=False)
    return figure


def _edges(found: LawRegion, known: Sequence[tuple[int, ...]]) -> list[int]:
    """Return the lattice's points where a line's answer changes."""
    answers = [found.cells.known[point] for point in known]
    return [known[i if answers[i] else i + 1][0] for i in range(len(known) - 1) if answers[i] != answers[i + 1]]
