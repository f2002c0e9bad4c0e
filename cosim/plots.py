"""Figures of results: what is judged, |e|, controls, homogeneous norm, with the controller's modes marked."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from filing.files import write_file
from filing.origin import SOFTWARE
from fmu_export.files import FilePath
from ihc_fmu.pendulum.interface import LAWS

from .evaluation import NO_UNIT, ControlSignal, ErrorSignal, Evaluation, pendulum_evaluation
from .judged_signals import error_norm, evaluation_in, given, set_point, wrapped
from .recording import Recording
from .unit_definitions import with_unit


class Picture(Figure):
    """A figure that notebooks show, also those that have not imported pyplot."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        FigureCanvasAgg(self).print_png(buffer)
        return buffer.getvalue()


COLOURS = {
    "LC": "#1f77b4",
    "SMC": "#e08214",
    "IHC": "#1b7837",
    "STA": "#c51b7d",
    "SMC1": "#e08214",
    "SMC2": "#a6611a",
}
"""Of each law, in every picture."""

OTHERS = ("#6a3d9a", "#d6604d", "#35978f", "#8c510a", "#e377c2", "#525252")
"""Of what is not a law, in this order."""

MODE_COLOURS = {"idle": "#dddddd", "swing_up": "#fdd49e", "stabilizing": "#c7e9c0", "fault": "#fb6a4a"}
"""Of the controller's modes by their names."""
OTHER_MODES = ("#d0d1e6", "#fcc5c0", "#ccebc5", "#ffffb3")
"""Of modes with other names, in this order."""


def label(signal: ErrorSignal | ControlSignal) -> str:
    """Return what stands beside an axis: the name with the unit."""
    return literal(with_unit(signal.name, signal.unit))


def literal(text: str) -> str:
    """Return a user's text such that Matplotlib draws its dollar signs instead of setting formulas between them."""
    return text.replace("$", r"\$")


def logarithmic(axes: Any, which: str) -> None:
    """Make an axis, "x" or "y", logarithmic, with numbers as people write them beside 1, 2 and 5 of each decade."""
    getattr(axes, f"set_{which}scale")("log")
    ruler = getattr(axes, f"{which}axis")
    ruler.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ruler.set_major_formatter(StrMethodFormatter("{x:g}"))
    ruler.set_minor_formatter(NullFormatter())


def norm_name(evaluation: Evaluation, suffix: str) -> tuple[str, str]:
    """Return what a group's |e| is called, and its unit."""
    group = evaluation.error_groups[suffix]
    name = f"|e {evaluation.errors[group[0]].name}|" if suffix else "|q|" if evaluation.kind == "pendulum" else "|e|"
    return name, evaluation.error_unit(group)


def norm_label(evaluation: Evaluation, suffix: str) -> str:
    """Return what stands beside the axis of a group's |e|."""
    name, unit = norm_name(evaluation, suffix)
    return literal(with_unit(name, unit))


_PENDULUM = pendulum_evaluation({})
THETA, DELTA = (label(error) for error in _PENDULUM.errors)
Q, VOLTAGE, NORM = norm_label(_PENDULUM, ""), label(_PENDULUM.controls[0]), "$\\|x\\|_d$ [1]"
"""Labels of the pendulum's signals, in every picture."""

UNKNOWN = "#ffffff"
"""Of a value of the mode that has no name."""

LATE = 0.6
"""Share of a run after which a panel of its own shows it closer."""


def colours(names: Iterable[str]) -> dict[str, str]:
    """Return a colour for each name: a law's own, others in turn."""
    others = itertools.cycle(OTHERS)
    return {name: COLOURS[name] if name in COLOURS else next(others) for name in names}


def law_of(result: Recording) -> str:
    """Return the law that a result was made with, empty where it does not say."""
    law = _start_of(result.metadata.get("scenario"), "start").get("law")
    if not isinstance(law, str):
        law = _start_of(result.metadata, "start_values").get("law")
    if isinstance(law, int | float) and evaluation_in(result).kind == "pendulum" and 1 <= law <= len(LAWS):
        return LAWS[int(law) - 1]
    return law if isinstance(law, str) else ""


def _start_of(metadata: Any, name: str) -> dict[str, Any]:
    """Return the controller's start values in metadata or in a scenario, wherever either has them."""
    keys = ("controller", name) if name == "start" else (name, "controller")
    for key in keys:
        metadata = metadata.get(key) if isinstance(metadata, dict) else None
    return metadata if isinstance(metadata, dict) else {}


PICTURES = {
    "pendulum": ("angles", "norm", "voltage", "homogeneous_norm"),
    "general": ("signals", "norm", "controls", "homogeneous_norm"),
}
"""The pictures of `save_comparison`, by the kind of the system."""
LARGEST = 1e150
"""Magnitude of what is drawn."""
COMPARISON = tuple(dict.fromkeys(name for names in PICTURES.values() for name in names))


def save_comparison(results: Mapping[str, Recording], folder: FilePath, title: str) -> list[Path]:
    """Write pictures to `folder`, one curve per entry of `results`: what is judged, its norm, controls, homogeneous norm.

    They are angles.png, norm.png, voltage.png and homogeneous_norm.png for the pendulum, and signals.png and controls.png
    for other systems; the last only where all results have one.
    """
    results = {literal(name): _within_range(result) for name, result in results.items()}
    evaluation = evaluation_in(next(iter(results.values())))
    norms = [
        (norm_label(evaluation, suffix), lambda result, group=group: error_norm(result, evaluation, group))
        for suffix, group in evaluation.error_groups.items()
    ]
    figures = [_errors(results, evaluation), _logarithmic(results, norms), _controls(results, evaluation)]
    if has_norm(evaluation, results.values()):
        homogeneous = (f"homogeneous norm {NORM}", lambda result: result[evaluation.norm or ""])
        figures.append(_logarithmic(results, [homogeneous]))
    names = PICTURES[evaluation.kind]
    return [
        save_figure(figure, Path(folder) / f"{name}.png", title)
        for name, figure in zip(names, figures, strict=False)
        if figure is not None
    ]


def errors_of(results: Mapping[str, Recording]) -> Picture:
    """Return what is judged, one curve per entry of `results`, over the whole run and its end."""
    results = {literal(name): _within_range(result) for name, result in results.items()}
    return _errors(results, evaluation_in(next(iter(results.values()))))


def _within_range(result: Recording) -> Recording:
    """Return the result with gaps where real numbers are beyond LARGEST, which Matplotlib cannot scale."""
    return replace(
        result,
        signals={
            name: np.where(np.abs(s) < LARGEST, s, np.nan) if s.dtype == np.float64 else s
            for name, s in result.signals.items()
        },
    )


def has_norm(evaluation: Evaluation, results: Iterable[Recording]) -> bool:
    """Return whether the homogeneous norm is drawn: the pendulum always has one, others where it was recorded."""
    return evaluation.norm is not None and (
        evaluation.kind == "pendulum" or all(evaluation.norm in result.signals for result in results)
    )


def save_overview(result: Recording, path: FilePath, title: str) -> Path:
    """Write the overview of a single result as a picture."""
    return save_figure(overview(result), path, title)


def overview(result: Recording) -> Picture:
    """Return one figure of a single result: what is judged, |e|, controls and homogeneous norm."""
    result = _within_range(result)
    evaluation = evaluation_in(result)
    with_norm = has_norm(evaluation, [result])
    groups = evaluation.error_groups if len(evaluation.errors) > 1 else {}
    count = len(evaluation.errors) + len(groups) + len(evaluation.controls) + with_norm
    figure = Picture(figsize=(9, 1.8 * max(count, 2)), layout="constrained")
    axes = iter(all_axes := figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
    colour = COLOURS.get(law_of(result), COLOURS["IHC"])
    for axis in all_axes:
        _shade_modes(axis, result)
        axis.margins(x=0)
        axis.grid(alpha=0.3)
    for error, axis in zip(evaluation.errors, axes):  # noqa: B905 - the axes go on
        _draw_error(axis, result, error, colour)
        axis.set_ylabel(label(error))
    for suffix, group in groups.items():
        positive(axis := next(axes), result.time, error_norm(result, evaluation, group), colour)
        axis.set_ylabel(norm_label(evaluation, suffix))
    for control in evaluation.controls:
        axis = next(axes)
        axis.plot(result.time, result[control.signal], color=colour, lw=1.0, drawstyle="steps-pre")
        axis.set_ylabel(label(control))
    if with_norm:
        positive(axis := next(axes), result.time, result[evaluation.norm or ""], colour)
        axis.set_ylabel(NORM)
    all_axes[-1].set_xlabel("time [s]")
    figure.align_ylabels(all_axes)
    _mode_legend(figure, [result])
    return figure


def panels_of(results: Mapping[str, Recording], names: Sequence[str]) -> Picture:
    """Return one figure with a panel for each of the signals `names`, in it a curve for each of `results`.

    Raises UserError for a signal that is not there.
    """
    figure = Picture(figsize=(9, 1.8 * max(len(names), 2)), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    shades = dict.fromkeys(results, COLOURS["LC"]) if len(results) == 1 else colours(results)
    for axis, name in zip(axes, names, strict=True):
        for of, result in results.items():
            axis.plot(result.time, result[name], color=shades[of], lw=1.0, label=literal(of))
        unit = next(iter(results.values())).units.get(name, NO_UNIT)
        axis.set_ylabel(label(ControlSignal(signal=name, unit=unit)).replace(".", ".\n", 1))  # the FMU, its variable
        axis.margins(x=0)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time [s]")
    if len(results) > 1:
        axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(results), frameon=False)
    figure.align_ylabels(axes)
    return figure


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


def save_figure(figure: Figure, path: FilePath, title: str) -> Path:
    """Write a PNG, the same bytes for the same figure; beside `path` first, then renamed."""
    path = Path(path)
    figure.suptitle(literal(title), fontsize="medium")
    figure.dpi = 130
    buffer = io.BytesIO()
    with np.errstate(all="ignore"):  # a run that left the range of numbers
        FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": SOFTWARE})  # savefig would draw it twice
    write_file(path, buffer.getvalue())
    return path


def angle(result: Recording, name: str) -> np.ndarray:
    """Return theta or delta [rad] to draw, measured where the true one is missing; delta wrapped, with gaps at its jumps."""
    errors = pendulum_evaluation(result.signals).errors
    return _drawn(result, errors[("theta", "delta").index(name)])


def _drawn(result: Recording, error: ErrorSignal) -> np.ndarray:
    """Return a judged signal to draw, as the controller is given it; an angle wrapped, with gaps at its jumps."""
    if not error.wraps:
        return given(result, error)
    drawn = wrapped(given(result, error))
    drawn[1:][np.abs(np.diff(drawn)) > np.pi] = np.nan  # no line across the jump from pi to -pi
    return drawn


def _draw_error(
    axis: Any, result: Recording, error: ErrorSignal, colour: str, name: str | None = None, begin: float = 0.0
) -> None:
    """Draw a judged signal from a share of the run on, and its set-point where it has one."""
    shown = result.time >= begin * result.time[-1]
    axis.plot(result.time[shown], _drawn(result, error)[shown], color=colour, lw=1.0, label=name)
    point = set_point(result, error)
    if point is not None:
        axis.plot(result.time[shown], point[shown], color="0.3", lw=0.8, ls="--", drawstyle="steps-pre")


def _errors(results: Mapping[str, Recording], evaluation: Evaluation) -> Picture:
    """Return what is judged of each result: on the left the whole run, on the right its end, each with its own scale."""
    count, ribbon = len(evaluation.errors), evaluation.mode is not None
    figure = Picture(figsize=(11, 2.9 * count + 1.0), layout="constrained")
    ratios = [*[8] * count, *[0.7 * len(results)] * ribbon]
    panels = figure.subplots(count + ribbon, 2, sharex="col", height_ratios=ratios, width_ratios=[3, 2], squeeze=False)
    shades = colours(results)
    end = max(float(result.time[-1]) for result in results.values())
    for column, begin in enumerate((0.0, LATE)):
        for axis, error in zip(panels[:count, column], evaluation.errors, strict=True):
            for law, result in results.items():
                _draw_error(axis, result, error, shades[law], law, begin)
            axis.grid(alpha=0.3)
            if column == 0:
                axis.set_ylabel(label(error))
        if ribbon:
            _ribbon(panels[count, column], results, (begin * end, end))
        else:
            panels[-1, column].set_xlabel("time [s]")
            panels[-1, column].set_xlim(begin * end, end)
    panels[0, 1].set_title(f"from {LATE * end:g} s on", fontsize="small")
    panels[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(results), frameon=False)
    figure.align_ylabels(panels[:, 0])
    _mode_legend(figure, list(results.values()))
    return figure


def _logarithmic(results: Mapping[str, Recording], curves: Sequence[tuple[str, Any]]) -> Figure:
    """Return a panel for each (label, signal of a result) on a logarithmic axis."""
    figure, axes, ribbon = _with_ribbon(len(curves), results)
    shades = colours(results)
    for axis, (text, signal) in zip(axes, curves, strict=True):
        for law, result in results.items():
            positive(axis, result.time, signal(result), shades[law], law)
        axis.set_ylabel(text)
        axis.grid(alpha=0.3)
    if axes[0].get_legend_handles_labels()[0]:
        axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(results), frameon=False)
    _finish(figure, axes, ribbon, results)
    return figure


def _controls(results: Mapping[str, Recording], evaluation: Evaluation) -> Figure | None:
    """Return a panel for each result and control, all of a control on the same scale; None where nothing is controlled."""
    if not evaluation.controls:
        return None
    figure, axes, ribbon = _with_ribbon(len(results) * len(evaluation.controls), results)
    shades = colours(results)
    pairs = [(law, result, control) for law, result in results.items() for control in evaluation.controls]
    for axis, (law, result, control) in zip(axes, pairs, strict=True):
        _shade_modes(axis, result)
        axis.plot(result.time, result[control.signal], color=shades[law], lw=0.7, drawstyle="steps-pre")
        named = literal(with_unit(law, control.unit)) if evaluation.kind == "pendulum" else f"{law}\n{label(control)}"
        axis.set_ylabel(named)
        axis.grid(alpha=0.3)
    count = len(evaluation.controls)
    for i in range(count):
        limits = [axis.get_ylim() for axis in axes[i::count]]
        for axis in axes[i::count]:
            axis.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
    _finish(figure, axes, ribbon, results)
    return figure


def _with_ribbon(panels: int, results: Mapping[str, Recording]) -> tuple[Figure, Sequence[Any], Any]:
    """Return a figure, its panels, and, where results have modes, a narrow axis below them that shows each one's."""
    figure = Picture(figsize=(9, 2.6 * panels + 1.6 if panels > 1 else 4.6), layout="constrained")
    modes = any(evaluation_in(result).mode is not None for result in results.values())
    ratios = [*[8] * panels, *[0.7 * len(results)] * modes]
    axes = list(figure.subplots(panels + modes, 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0])
    return figure, axes[:panels], axes[panels] if modes else None


def _finish(figure: Figure, axes: Sequence[Any], ribbon: Any, results: Mapping[str, Recording]) -> None:
    end = max(float(result.time[-1]) for result in results.values())
    if ribbon is not None:
        _ribbon(ribbon, results, (0.0, end))
    else:
        axes[-1].set_xlabel("time [s]")
        axes[-1].set_xlim(0.0, end)
    _mode_legend(figure, list(results.values()))


def _ribbon(axis: Any, results: Mapping[str, Recording], limits: tuple[float, float]) -> None:
    """Draw a row of modes for each result."""
    for row, result in enumerate(results.values()):
        shades = mode_colours(result)
        for mode, start, end in mode_spans(result):
            axis.broken_barh([(start, end - start)], (-row - 0.4, 0.8), color=shades.get(mode, UNKNOWN))
    axis.set_yticks([-row for row in range(len(results))], list(results))
    axis.set_xlabel("time [s]")
    axis.set_xlim(*limits)


def mode_names(result: Recording) -> dict[int, str]:
    """Return the names of the controller's modes by their values, as people write them; none where it has no modes."""
    mode = evaluation_in(result).mode
    return {} if mode is None else {value: name.replace("_", "-") for value, name in mode.names.items()}


def mode_colours(result: Recording) -> dict[int, str]:
    """Return a colour for each mode of the controller: a usual mode's own, others in turn."""
    mode, others = evaluation_in(result).mode, itertools.cycle(OTHER_MODES)
    named = {} if mode is None else mode.names
    return {value: MODE_COLOURS[name] if name in MODE_COLOURS else next(others) for value, name in named.items()}


def mode_spans(result: Recording) -> list[tuple[int, float, float]]:
    """Return (mode, start, end) [s] of each stretch of time in one mode; none where the controller has no modes."""
    output = evaluation_in(result).mode
    if output is None:
        return []
    mode, time = result[output.signal], result.time
    starts = np.concatenate([[0], np.flatnonzero(np.diff(mode)) + 1])
    ends = np.concatenate([starts[1:], [len(time) - 1]])
    return [(int(mode[a]), float(time[a]), float(time[b])) for a, b in zip(starts, ends, strict=True)]


def _shade_modes(axis: Any, result: Recording) -> None:
    shades = mode_colours(result)
    for mode, start, end in mode_spans(result):
        axis.axvspan(start, end, color=shades.get(mode, UNKNOWN), alpha=0.45, lw=0)


def _mode_legend(figure: Figure, results: Sequence[Recording]) -> None:
    seen = {
        (mode, mode_names(result).get(mode, str(mode)), mode_colours(result).get(mode, UNKNOWN))
        for result in results
        for mode, start, end in mode_spans(result)
        if end - start > 0.01
    }
    if seen:
        handles = [Patch(color=shade, label=literal(name)) for _, name, shade in sorted(seen)]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize="small")
