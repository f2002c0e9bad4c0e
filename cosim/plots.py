"""Figures of results: angles, |q|, voltage, homogeneous norm, with the controller's modes marked."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from filing.files import write_file
from filing.origin import SOFTWARE
from ihc_fmu.pendulum.interface import LAWS

from .metrics import angle_norm, wrapped
from .results import Result

COLOURS = {"LC": "#1f77b4", "SMC": "#e08214", "IHC": "#1b7837", "SMC1": "#e08214", "SMC2": "#a6611a"}
"""Of each law, in every picture."""

OTHERS = ("#6a3d9a", "#d6604d", "#35978f", "#8c510a", "#e377c2", "#525252")
"""Of what is not a law, in this order."""

MODE_COLOURS = {1: "#dddddd", 2: "#fdd49e", 3: "#c7e9c0", 4: "#fb6a4a"}
MODE_NAMES = {1: "idle", 2: "swing-up", 3: "stabilizing", 4: "fault"}

THETA, DELTA, Q, VOLTAGE, NORM = "arm θ [rad]", "pendulum δ [rad]", "|q| [rad]", "voltage V [V]", "$\\|x\\|_d$ [1]"
"""Labels of the signals, in every picture."""

LATE = 0.6
"""Share of a run after which a panel of its own shows it closer."""


def colours(names: Iterable[str]) -> dict[str, str]:
    """Return a colour for each name: a law's own, others in turn."""
    others = itertools.cycle(OTHERS)
    return {name: COLOURS[name] if name in COLOURS else next(others) for name in names}


def law_of(result: Result) -> str:
    """Return the law that a result was made with, empty where it does not say."""
    start = result.metadata.get("start_values", {}).get("controller", {})
    law = start.get("law")
    return LAWS[int(law) - 1] if isinstance(law, int | float) and 1 <= law <= len(LAWS) else str(law or "")


COMPARISON = ("angles", "norm", "voltage", "homogeneous_norm")
"""The pictures of `save_comparison`."""


def save_comparison(results: Mapping[str, Result], folder: Path, title: str) -> list[Path]:
    """Write angles.png, norm.png, voltage.png and homogeneous_norm.png, one curve per entry of `results`, to `folder`."""
    results = {literal(name): result for name, result in results.items()}
    figures = {
        "angles": _angles(results),
        "norm": _logarithmic(results, angle_norm, Q),
        "voltage": _voltage(results),
        "homogeneous_norm": _logarithmic(results, _homogeneous_norm, f"homogeneous norm {NORM}"),
    }
    return [save_figure(figure, folder / f"{name}.png", title) for name, figure in figures.items()]


def save_overview(result: Result, path: Path, title: str) -> Path:
    """Write one figure with arm angle, pendulum angle, |q|, voltage and homogeneous norm of a single result."""
    figure = Figure(figsize=(9, 9), layout="constrained")
    axes = figure.subplots(5, 1, sharex=True)
    colour = COLOURS.get(law_of(result), COLOURS["IHC"])
    for axis in axes:
        _shade_modes(axis, result)
        axis.margins(x=0)
    for axis, name in zip(axes[:2], ("theta", "delta"), strict=True):
        axis.plot(result.time, angle(result, name), color=colour, lw=1.0)
    positive(axes[2], result.time, angle_norm(result), colour)
    axes[3].plot(result.time, result["controller.voltage"], color=colour, lw=1.0, drawstyle="steps-pre")
    positive(axes[4], result.time, _homogeneous_norm(result), colour)
    for axis, label in zip(axes, (THETA, DELTA, Q, VOLTAGE, NORM), strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels(axes)
    _mode_legend(figure, [result])
    return save_figure(figure, path, title)


def positive(axis: Any, time: np.ndarray, signal: np.ndarray, colour: str, label: str | None = None) -> None:
    """Draw a signal that is not negative on a logarithmic axis: all of it, and where it is 0 a triangle at the bottom."""
    axis.set_yscale("log")
    zero = signal == 0.0
    if not zero.all():
        axis.plot(time, np.where(zero, np.nan, signal), color=colour, lw=1.1, label=label)
    if zero.any():
        begins = zero & ~np.concatenate([[False], zero[:-1]])
        place = axis.get_xaxis_transform()
        axis.plot(time[zero], np.full(zero.sum(), 0.012), ".", ms=1.5, color=colour, transform=place)
        axis.plot(time[begins], np.full(begins.sum(), 0.03), "v", ms=5, color=colour, transform=place, clip_on=False)
        axis.annotate("▾ 0", (0.005, 0.06), xycoords="axes fraction", fontsize="x-small", color="0.3")


def save_figure(figure: Figure, path: Path, title: str) -> Path:
    """Write a PNG, the same bytes for the same figure; beside `path` first, then renamed."""
    figure.suptitle(literal(title), fontsize="medium")
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130, metadata={"Software": SOFTWARE})
    write_file(path, buffer.getvalue())
    return path


def literal(text: str) -> str:
    """Return a user's text such that Matplotlib draws its dollar signs instead of setting formulas between them."""
    return text.replace("$", r"\$")


def angle(result: Result, name: str) -> np.ndarray:
    """Return theta or delta [rad] to draw, measured where the true one is missing; delta wrapped, with gaps at its jumps."""
    signal = result[f"plant.{name}"] if f"plant.{name}" in result.signals else result[f"plant.{name}_encoder"]
    if name == "theta":
        return signal
    drawn = wrapped(signal)
    drawn[1:][np.abs(np.diff(drawn)) > np.pi] = np.nan  # no line across the jump from pi to -pi
    return drawn


def _homogeneous_norm(result: Result) -> np.ndarray:
    return result["controller.homogeneous_norm"]


def _angles(results: Mapping[str, Result]) -> Figure:
    """Return both angles of each result: on the left the whole run, on the right its end, each with its own scale."""
    figure = Figure(figsize=(11, 6.8), layout="constrained")
    ratios = [8, 8, 0.7 * len(results)]
    panels = figure.subplots(3, 2, sharex="col", height_ratios=ratios, width_ratios=[3, 2])
    shades = colours(results)
    end = max(float(result.time[-1]) for result in results.values())
    for column, begin in enumerate((0.0, LATE)):
        for axis, name, label in zip(panels[:2, column], ("theta", "delta"), (THETA, DELTA), strict=True):
            for law, result in results.items():
                shown = result.time >= begin * result.time[-1]
                axis.plot(result.time[shown], angle(result, name)[shown], color=shades[law], lw=1.0, label=law)
            axis.grid(alpha=0.3)
            if column == 0:
                axis.set_ylabel(label)
        _ribbon(panels[2, column], results, (begin * end, end))
    panels[0, 1].set_title(f"from {LATE * end:g} s on", fontsize="small")
    panels[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(results), frameon=False)
    figure.align_ylabels(panels[:, 0])
    _mode_legend(figure, list(results.values()))
    return figure


def _logarithmic(results: Mapping[str, Result], signal: Any, label: str) -> Figure:
    figure, (axis,), ribbon = _with_ribbon(1, results)
    shades = colours(results)
    for law, result in results.items():
        positive(axis, result.time, signal(result), shades[law], law)
    axis.set_ylabel(label)
    axis.grid(alpha=0.3)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(results), frameon=False)
    _finish(figure, ribbon, results)
    return figure


def _voltage(results: Mapping[str, Result]) -> Figure:
    figure, axes, ribbon = _with_ribbon(len(results), results)
    shades = colours(results)
    for axis, (law, result) in zip(axes, results.items(), strict=True):
        _shade_modes(axis, result)
        axis.plot(result.time, result["controller.voltage"], color=shades[law], lw=0.7, drawstyle="steps-pre")
        axis.set_ylabel(f"{law} [V]")
        axis.grid(alpha=0.3)
    _finish(figure, ribbon, results)
    return figure


def _with_ribbon(panels: int, results: Mapping[str, Result]) -> tuple[Figure, Sequence[Any], Any]:
    """Return a figure, its panels, and a narrow axis below them that shows each result's modes."""
    figure = Figure(figsize=(9, 2.6 * panels + 1.6 if panels > 1 else 4.6), layout="constrained")
    ratios = [*[8] * panels, 0.7 * len(results)]
    *axes, ribbon = figure.subplots(panels + 1, 1, sharex=True, height_ratios=ratios)
    return figure, axes, ribbon


def _finish(figure: Figure, ribbon: Any, results: Mapping[str, Result]) -> None:
    _ribbon(ribbon, results, (0.0, max(float(result.time[-1]) for result in results.values())))
    _mode_legend(figure, list(results.values()))


def _ribbon(axis: Any, results: Mapping[str, Result], limits: tuple[float, float]) -> None:
    """Draw a row of modes for each result."""
    for row, result in enumerate(results.values()):
        for mode, start, end in mode_spans(result):
            axis.broken_barh([(start, end - start)], (-row - 0.4, 0.8), color=MODE_COLOURS[mode])
    axis.set_yticks([-row for row in range(len(results))], list(results))
    axis.set_xlabel("time [s]")
    axis.set_xlim(*limits)


def mode_spans(result: Result) -> list[tuple[int, float, float]]:
    """Return (mode, start, end) [s] of each stretch of time in one mode."""
    mode, time = result["controller.mode"], result.time
    starts = np.concatenate([[0], np.flatnonzero(np.diff(mode)) + 1])
    ends = np.concatenate([starts[1:], [len(time) - 1]])
    return [(int(mode[a]), float(time[a]), float(time[b])) for a, b in zip(starts, ends, strict=True)]


def _shade_modes(axis: Any, result: Result) -> None:
    for mode, start, end in mode_spans(result):
        axis.axvspan(start, end, color=MODE_COLOURS[mode], alpha=0.45, lw=0)


def _mode_legend(figure: Figure, results: Sequence[Result]) -> None:
    seen = sorted({mode for result in results for mode, start, end in mode_spans(result) if end - start > 0.01})
    handles = [Patch(color=MODE_COLOURS[mode], label=MODE_NAMES[mode]) for mode in seen]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize="small")
