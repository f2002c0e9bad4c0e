"""Pictures of a sweep: how metrics are distributed, how one hangs on what is varied, what decides all of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import PercentFormatter

from ihc_fmu.arrays import QUIET

from ..metric_meanings import lost_words
from ..plots import Picture, colours, literal, logarithmic
from ..unit_definitions import with_unit
from .sensitivity import classes_of
from .sweep import Sweep

Array = np.ndarray

COLUMNS = 3
"""Panels side by side."""
MOST_POINTS = 2000
"""Draws of each law that are drawn."""
CLASSES = 10
"""Classes of a parameter whose means are drawn."""
MOST_TICKS = 6
"""Numbers on a parameter's axis."""
SPAN = 30.0
"""Ratio of the largest to the smallest from which on a scale is logarithmic."""
DECADE = 10.0
"""The same of what is drawn evenly in its logarithm."""
BAND = 0.05
"""Height for each law's lost draws, above the others, as a part of a panel's."""
APART = "#888888"
"""Colour in the legend of what is drawn for every law."""
ENDS = ("#4393c3", "#d6604d")
"""Colours of a parameter's lowest and highest class."""


def distribution(sweep: Sweep) -> Picture:
    """Return for each metric the share of draws that have at most a value, a curve for each law; lost draws have none.

    Metrics that are the same in all runs are left out.
    """
    names = [name for name in sweep.shown if _differs(sweep, name)] or sweep.shown[:1]
    figure, axes = _panels(len(names))
    shades = colours(sweep.plan.laws)
    for name, axis in zip(names, axes, strict=True):
        ranked = {law: sweep.ranked(law, name) for law in sweep.plan.laws}
        for law, values in ranked.items():
            there = np.sort(values[np.isfinite(values)])
            shares = np.arange(1, there.size + 1) / sweep.plan.count
            some = _some(there.size)
            axis.step(there[some], shares[some], where="post", color=shades[law], label=literal(law), lw=1.4)
        _scale(axis, "x", np.concatenate(list(ranked.values())))
        axis.set_xlabel(literal(sweep.quantities[name].heading))
        axis.set_ylim(-0.02, 1.02)
        axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    for axis in axes[::COLUMNS]:
        axis.set_ylabel("share of the draws")
    _legend(figure, axes[0])
    return figure


def _differs(sweep: Sweep, name: str) -> bool:
    values = np.concatenate([sweep.ranked(law, name) for law in sweep.plan.laws])
    there = values[np.isfinite(values)]
    return bool(there.size and np.ptp(there))


def scatter(sweep: Sweep, measure: str) -> Picture:
    """Return a metric over each thing drawn, with the means of its classes over the draws that have a number.

    Those that have none are drawn apart and are in no mean: triangles are of draws that never settle, at their duration,
    crosses in a band above of lost ones.
    """
    plan = sweep.plan
    figure, axes = _panels(len(plan.names))
    shades, some = colours(plan.laws), _some(plan.count)
    counted = {law: sweep.counted(law, measure) for law in plan.laws}
    never = {law: np.isinf(sweep.ranked(law, measure)) & np.isfinite(counted[law]) for law in plan.laws}
    lost = {law: ~sweep.kept(law) for law in plan.laws}
    for (path, name), axis in zip(plan.names.items(), axes, strict=True):
        x = _positions(sweep, path)
        classes = classes_of(plan.drawn[path], bool(plan.listed(path)), CLASSES)
        for law in plan.laws:
            style = {"color": shades[law], "ls": "none"}
            values = np.where(never[law], math.nan, counted[law])
            axis.plot(x[some], values[some], ".", ms=3, alpha=0.35, zorder=1, rasterized=True, **style)
            at_end = np.flatnonzero(never[law])[:MOST_POINTS]
            axis.plot(x[at_end], counted[law][at_end], "^", ms=5, mfc="none", mew=0.8, zorder=2, **style)
            centres, means = _of_classes(classes, x), _of_classes(classes, values)
            axis.plot(centres, means, "-o", ms=3, lw=1.8, color=shades[law], label=literal(law), zorder=3)
        _scale(axis, "y", np.concatenate([*counted.values()]))
        _draw_lost(axis, [(x[lost[law]][:MOST_POINTS], shades[law]) for law in plan.laws])
        _name_axis(axis, sweep, path, name)
    for axis in axes[::COLUMNS]:
        axis.set_ylabel(literal(sweep.quantities[measure].heading))
    kinds = (("^", "never settles: at its duration", never), ("x", lost_words(sweep.quantities), lost))
    apart = [
        Line2D([], [], ls="none", marker=marker, mfc="none", color=APART, label=said)
        for marker, said, draws in kinds
        if any(np.any(of_law) for of_law in draws.values())
    ]
    _legend(figure, axes[0], apart)
    return figure


def _draw_lost(axis: Any, lost: list[tuple[Array, str]]) -> None:
    """Draw lost draws as crosses in a band above all others, a row for each law's, where there are any."""
    if not any(x.size for x, _ in lost):
        return
    transform, band = axis.get_yaxis().get_transform(), BAND * (len(lost) + 0.5)
    low, high = transform.transform(np.array(axis.get_ylim()))
    axis.set_ylim(top=float(transform.inverted().transform(low + (high - low) / (1.0 - band))))
    shaded = Rectangle(
        (0.0, 1.0 - band), 1.0, band, transform=axis.transAxes, color=APART, alpha=0.15, lw=0.0, zorder=0
    )
    axis.add_patch(shaded)
    for row, (x, shade) in enumerate(lost):
        places = np.full(x.size, 1.0 - BAND * (row + 0.75))
        axis.plot(x, places, "x", ms=4, color=shade, transform=axis.get_xaxis_transform(), zorder=4)


def tornado(sweep: Sweep, measure: str) -> Picture:
    """Return a metric's mean in the lowest and the highest class of each thing drawn, about the mean, for each law."""
    plan = sweep.plan
    figure, axes = _panels(len(plan.laws), height=0.9 + 0.32 * len(plan.names), share="x")
    for law, axis in zip(plan.laws, axes, strict=True):
        values = sweep.counted(law, measure)
        centre = _mean(values)
        ends = {}
        for path, name in plan.names.items():
            listed = plan.listed(path)
            means = _of_classes(classes_of(plan.drawn[path], bool(listed), CLASSES), values)
            ends[name] = (means[0], means[-1])
        order = sorted(ends, key=lambda name: np.nan_to_num(abs(ends[name][1] - ends[name][0])))
        for row, name in enumerate(order):
            for end, shade in zip(ends[name], ENDS, strict=True):
                axis.barh(row, end - centre, left=centre, height=0.6, color=shade)
        axis.axvline(centre, color="#333333", lw=0.8)
        axis.set_yticks(range(len(order)), [literal(name) for name in order], fontsize="small")
        axis.set_title(literal(law), fontsize="medium")
        axis.set_xlabel(literal(f"mean of {sweep.quantities[measure].heading}"))
    handles = [Patch(color=shade) for shade in ENDS]
    shown = ["lowest tenth of the parameter, first of a list", "highest tenth, last of a list"]
    figure.legend(handles, shown, loc="outside lower center", ncols=2, frameon=False, fontsize="small")
    return figure


def sensitivities(sweep: Sweep) -> Picture | None:
    """Return for each metric the share of its variance that each thing drawn decides; None where nothing is said of any."""
    plan = sweep.plan
    found = sweep.sensitivities
    metrics = [name for name in sweep.shown if any(name in found[law] for law in plan.laws)]
    if not metrics:
        return None
    weights = dict.fromkeys(plan.names.values(), 0.0)
    for of in found.values():
        for one in of.values():
            for name, estimate in one.single.items():
                weights[name] += max(0.0, estimate.value)
    rows = [*sorted(weights, key=lambda name: -weights[name])]
    height = 0.9 + (0.1 + 0.13 * len(plan.laws)) * len(rows)
    figure, axes = _panels(len(metrics), height=height, share="y")
    shades, thick = colours(plan.laws), 0.8 / len(plan.laws)
    for metric, axis in zip(metrics, axes, strict=True):
        for k, law in enumerate(plan.laws):
            one = found[law].get(metric)
            if one is None:
                continue
            shares = np.array([max(0.0, one.single[name].value) for name in rows])
            halves = np.array([one.single[name].half_width for name in rows])
            places = np.arange(len(rows)) + (k - (len(plan.laws) - 1) / 2) * thick
            bars = {"height": thick, "color": shades[law], "label": literal(law)}
            axis.barh(places, shares, xerr=[np.minimum(halves, shares), halves], error_kw={"lw": 0.8}, **bars)
        axis.set_yticks(range(len(rows)), [literal(name) for name in rows], fontsize="small")
        axis.set_xlim(0.0, 1.05)
        axis.xaxis.set_major_formatter(PercentFormatter(1.0))
        axis.set_title(literal(sweep.quantities[metric].symbol), fontsize="medium")
        axis.set_xlabel("share of the variance")
    axes[0].invert_yaxis()
    drawn = next(axis for axis in axes if len(axis.containers) == len(axes[0].containers))
    _legend(figure, drawn)
    return figure


def _panels(count: int, height: float = 2.7, share: str = "") -> tuple[Picture, list[Any]]:
    """Return a figure with that many panels, COLUMNS side by side."""
    columns = min(count, COLUMNS)
    rows = math.ceil(count / columns)
    figure = Picture(figsize=(4.0 * columns + 1.0, height * rows + 0.8), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=share == "x", sharey=share == "y").ravel().tolist()
    for axis in axes[count:]:
        axis.set_axis_off()
    for axis in axes[:count]:
        axis.grid(alpha=0.3)
        axis.set_axisbelow(True)
    return figure, axes[:count]


def _legend(figure: Picture, axis: Any, besides: Sequence[Line2D] = ()) -> None:
    handles = [*axis.get_legend_handles_labels()[0], *besides]
    figure.legend(handles=handles, loc="outside lower center", ncols=max(1, len(handles)), frameon=False)


def _some(size: int) -> Array:
    """Return the numbers of at most MOST_POINTS of `size` draws, spread evenly, the first and the last among them."""
    return np.unique(np.linspace(0, max(0, size - 1), min(size, MOST_POINTS)).astype(np.intp))


def _scale(axis: Any, which: str, values: Array, span: float = SPAN) -> None:
    there = values[np.isfinite(values)]
    if there.size and there.min() > 0.0 and there.max() > span * there.min():
        logarithmic(axis, which)


def _positions(sweep: Sweep, path: str) -> Array:
    """Return where the draws stand on an entry's axis: at their values, at the numbers of those of a list of texts."""
    values = sweep.plan.values(path)
    return values if values.dtype.kind in "if" else sweep.plan.drawn[path]


def _name_axis(axis: Any, sweep: Sweep, path: str, name: str) -> None:
    axis.set_xlabel(literal(with_unit(name, sweep.plan.units[path])))
    listed = sweep.plan.listed(path)
    if listed and sweep.plan.values(path).dtype.kind not in "if":
        axis.set_xticks(range(len(listed)), [literal(str(value)) for value in listed])
    elif listed and len(listed) <= MOST_TICKS:
        axis.set_xticks(listed)
    else:
        axis.locator_params(axis="x", nbins=MOST_TICKS)
        if sweep.plan.logarithmic(path):
            _scale(axis, "x", sweep.plan.drawn[path], DECADE)


@QUIET
def _of_classes(classes: Array, values: Array) -> Array:
    """Return the mean of the values of each class, NaN where there is none."""
    there = np.isfinite(values)
    count = int(classes.max()) + 1
    sums = np.bincount(classes[there], values[there], minlength=count)
    return sums / np.bincount(classes[there], minlength=count)


def _mean(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(np.mean(there)) if there.size else math.nan
