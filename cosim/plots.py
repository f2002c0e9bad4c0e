"""Figures of results: angles, |q|, voltage, homogeneous norm, with the controller's modes marked."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fmu_export.files import write_file
from fmu_export.ownership import SOFTWARE

from .metrics import angle_norm, wrapped
from .results import Result

COLOURS = {"LC": "#1f77b4", "SMC": "#e08214", "IHC": "#1b7837"}
MODE_COLOURS = {1: "#dddddd", 2: "#fdd49e", 3: "#c7e9c0", 4: "#fb6a4a"}
MODE_NAMES = {1: "idle", 2: "swing-up", 3: "stabilizing", 4: "fault"}


COMPARISON = ("angles", "norm", "voltage", "homogeneous_norm")
"""The pictures of `save_comparison`."""


def save_comparison(results: Mapping[str, Result], folder: Path, title: str) -> list[Path]:
    """Write angles.png, norm.png, voltage.png and homogeneous_norm.png, one curve per entry of `results`, to `folder`."""
    figures = {
        "angles": _angles(results),
        "norm": _logarithmic(results, angle_norm, "|q| [rad]", floor=1e-5),
        "voltage": _voltage(results),
        "homogeneous_norm": _logarithmic(results, _homogeneous_norm, "homogeneous norm $\\|x\\|_d$ [1]", floor=1e-4),
    }
    return [save_figure(figure, folder / f"{name}.png", title) for name, figure in figures.items()]


def save_overview(result: Result, path: Path, title: str) -> Path:
    """Write one figure with arm angle, pendulum angle, voltage and homogeneous norm of a single result."""
    panels = (
        ("arm $\\theta$ [rad]", angle(result, "theta"), False),
        ("pendulum $\\delta$ [rad]", angle(result, "delta"), False),
        ("voltage [V]", result["controller.voltage"], True),
        ("$\\|x\\|_d$ [1]", np.maximum(_homogeneous_norm(result), 1e-4), False),
    )
    figure = Figure(figsize=(9, 9), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True)
    for axis, (label, signal, steps) in zip(axes, panels, strict=True):
        _shade_modes(axis, result)
        axis.plot(result.time, signal, color=COLOURS["IHC"], lw=1.0, drawstyle="steps-pre" if steps else "default")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[-1].set_yscale("log")
    axes[-1].set_xlabel("time [s]")
    _mode_legend(figure, [result])
    return save_figure(figure, path, title)


def save_figure(figure: Figure, path: Path, title: str) -> Path:
    """Write a PNG, the same bytes for the same figure; beside `path` first, then renamed."""
    figure.suptitle(title, fontsize="medium")
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130, metadata={"Software": SOFTWARE})
    write_file(path, buffer.getvalue())
    return path


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
    figure, (top, bottom), ribbon = _with_ribbon(2, results)
    panels = ((top, "theta", "arm $\\theta$ [rad]"), (bottom, "delta", "pendulum $\\delta$ [rad]"))
    for axis, name, label in panels:
        for law, result in results.items():
            axis.plot(result.time, angle(result, name), color=COLOURS.get(law), lw=1.1, label=law)
        inset = axis.inset_axes((0.45, 0.57 if _ends_low(axis, results, name) else 0.1, 0.53, 0.4))
        for law, result in results.items():
            late = result.time >= 0.6 * result.time[-1]
            inset.plot(result.time[late], angle(result, name)[late], color=COLOURS.get(law), lw=0.9)
        inset.tick_params(labelsize="x-small")
        inset.margins(x=0)
        inset.grid(alpha=0.3)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    top.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(results), frameon=False)
    _finish(figure, ribbon, results)
    return figure


def _ends_low(axis: Any, results: Mapping[str, Result], name: str) -> bool:
    """Whether the second halves of the curves lie in the lower half of the axis, and leave room for an inset above."""
    low, high = axis.get_ylim()
    late = np.concatenate([angle(r, name)[len(r.time) // 2 :] for r in results.values()])
    return bool(np.nanmean(late) <= 0.5 * (low + high))


def _logarithmic(results: Mapping[str, Result], signal: Any, label: str, floor: float) -> Figure:
    figure, (axis,), ribbon = _with_ribbon(1, results)
    for law, result in results.items():
        axis.semilogy(result.time, np.maximum(signal(result), floor), color=COLOURS.get(law), lw=1.1, label=law)
    axis.set_ylabel(label)
    axis.grid(alpha=0.3, which="both")
    axis.legend(loc="upper right", ncols=len(results))
    _finish(figure, ribbon, results)
    return figure


def _voltage(results: Mapping[str, Result]) -> Figure:
    figure, axes, ribbon = _with_ribbon(len(results), results)
    for axis, (law, result) in zip(axes, results.items(), strict=True):
        _shade_modes(axis, result)
        axis.plot(result.time, result["controller.voltage"], color=COLOURS.get(law), lw=0.7, drawstyle="steps-pre")
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
    for row, result in enumerate(results.values()):
        for mode, start, end in mode_spans(result):
            ribbon.broken_barh([(start, end - start)], (-row - 0.4, 0.8), color=MODE_COLOURS[mode])
    ribbon.set_yticks([-row for row in range(len(results))], list(results))
    ribbon.set_xlabel("time [s]")
    ribbon.set_xlim(0.0, max(float(result.time[-1]) for result in results.values()))
    _mode_legend(figure, list(results.values()))


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
