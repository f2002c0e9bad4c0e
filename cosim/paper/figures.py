"""Figures 3 to 6 in the paper's layout, and those of the further experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..judged_signals import angle_norm
from ..metric_meanings import QUANTITIES
from ..plots import COLOURS, DELTA, OTHERS, THETA, Q, angle, save_figure
from ..results import Result
from ..studies.estimates import Share
from ..studies.numbers import counted
from . import printed
from .study import COMPARED, GAINS, Study
from .variants import sweep_name
from .verdicts import Runs, margin, verdict_of

PALETTE = COLOURS
ORDER = ("SMC1", "SMC2", "LC", "IHC")
"""In which curves are drawn: the last on top."""

STEP_COLOURS = OTHERS[:3]

Pictures = Mapping[tuple[float, str], Result]
"""The reference runs by gain and controller."""


def save_all(folder: Path, pictures: Pictures, runs: Runs, study: Study, shares: Sequence[tuple[str, Share]]) -> None:
    """Write every figure to `folder`."""
    plain = {law: pictures[0, law] for law in ORDER}
    save_figure(_figure_3(plain), folder / "figure_3.png", "Figure 3: angles of arm and pendulum")
    save_figure(_figure_4(plain), folder / "figure_4.png", "Figure 4: |q| without artificial perturbation")
    save_figure(_figure_5(plain), folder / "figure_5.png", "Figure 5: control signal")
    save_figure(_figure_6(pictures), folder / "figure_6.png", "Figure 6: |q| with artificial perturbation")
    save_figure(_shares(shares), folder / "shares.png", "Share of draws in which the IHC is better than the LC")
    save_figure(_chattering(runs, study), folder / "chattering.png", "What lowering a_min brings, and costs")
    save_figure(_swing_ups(runs), folder / "swing_ups.png", "The margin of Table I over random swing-ups")


def _figure_3(results: Mapping[str, Result]) -> Figure:
    figure, panels = _panels(2, 8)
    for row, signal, label in zip(panels, (_theta, _delta), ("(a) " + THETA, "(b) " + DELTA), strict=True):
        _pair(row, results, signal, label)
    _finish(figure, panels, results)
    return figure


def _figure_4(results: Mapping[str, Result]) -> Figure:
    figure, panels = _panels(1, 4.6)
    _pair(panels[0], results, angle_norm, Q)
    panels[0, 0].axvline(printed.SETTLED_BY, color="0.5", lw=0.8, ls=":")
    _finish(figure, panels, results)
    return figure


def _figure_5(results: Mapping[str, Result]) -> Figure:
    figure, panels = _panels(2, 5.6)
    for row, law in zip(panels, ("LC", "IHC"), strict=True):
        _pair(row, {law: results[law]}, _voltage, f"{law}: V [V]")
    _finish(figure, panels, {})
    return figure


def _figure_6(pictures: Pictures) -> Figure:
    figure, panels = _panels(len(GAINS) - 1, 9)
    results = {}
    for row, gain in zip(panels, GAINS[1:], strict=True):
        results = {law: pictures[gain, law] for law in ORDER}
        _pair(row, results, angle_norm, f"G = {gain:g}: {Q}")
    _finish(figure, panels, results)
    return figure


def _panels(rows: int, height: float) -> tuple[Figure, Any]:
    """Return a figure and its panels: the run on the left, the window of the paper's insets on the right."""
    figure = Figure(figsize=(11, height), layout="constrained")
    return figure, figure.subplots(rows, 2, sharex="col", squeeze=False, width_ratios=[3, 2])


def _pair(row: Sequence[Any], results: Mapping[str, Result], signal: Any, label: str) -> None:
    for axis, (begin, end) in zip(row, ((-np.inf, np.inf), printed.WINDOW), strict=True):
        for law, result in results.items():
            shown = (result.time >= begin) & (result.time <= end)
            axis.plot(result.time[shown], signal(result)[shown], color=PALETTE[law], lw=1.0, label=law)
        axis.grid(alpha=0.3)
        axis.margins(x=0)
    row[0].set_ylabel(label)


def _finish(figure: Figure, panels: Any, results: Mapping[str, Result]) -> None:
    for axis in panels[-1]:
        axis.set_xlabel("time [s]")
    begin, end = printed.WINDOW
    panels[0, 1].set_title(f"from {begin:g} to {end:g} s", fontsize="small")
    if results:
        panels[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(results), frameon=False)
    figure.align_ylabels(panels[:, 0])


def _theta(result: Result) -> np.ndarray:
    return angle(result, "theta")


def _delta(result: Result) -> np.ndarray:
    return angle(result, "delta")


def _voltage(result: Result) -> np.ndarray:
    return result["controller.voltage"]


def _shares(shares: Sequence[tuple[str, Share]]) -> Figure:
    shares = [(name, share) for name, share in shares if share.draws]
    figure = Figure(figsize=(9, 0.22 * len(shares) + 1.2), layout="constrained")
    axis = figure.subplots()
    for row, (_, share) in enumerate(shares):
        low, high = share.interval
        colour = {"holds": "#1b7837", "does not hold": "#b2182b", "undecided": "#777777"}[verdict_of(share)]
        axis.plot([100 * low, 100 * high], [-row, -row], color=colour, lw=2)
        axis.plot(100 * share.value, -row, "o", color=colour, ms=4)
    axis.axvline(50.0, color="0.4", lw=0.8)
    axis.set_yticks([-row for row in range(len(shares))], [name for name, _ in shares], fontsize="x-small")
    axis.set(xlim=(0, 100), xlabel="share of draws [%], with its 95 % confidence interval")
    axis.grid(axis="x", alpha=0.3)
    axis.margins(y=0.01)
    return figure


def _chattering(runs: Runs, study: Study) -> Figure:
    chains = dict.fromkeys(variant.about.removeprefix("IHC ") for variant in study.sweep.values())
    runs = sweep_runs(runs)
    figure = Figure(figsize=(10, 7), layout="constrained")
    panels = figure.subplots(2, len(chains), sharex=True, sharey="row", squeeze=False)
    for column, chain in enumerate(chains):
        for name, axis in zip(("integral_q2", "voltage_variation"), panels[:, column], strict=True):
            for step, colour in zip(study.size.sample_times, STEP_COLOURS, strict=False):
                values = [sweep_median(runs, chain, a, step, name) for a in study.size.a_mins]
                axis.plot(study.size.a_mins, values, "o-", ms=3, lw=1, color=colour, label=f"{step * 1e3:g} ms")
            axis.grid(alpha=0.3)
        panels[0, column].set_title(chain, fontsize="medium")
        panels[0, column].set_yscale("log")
        panels[1, column].set_yscale("log")
        panels[1, column].set_xlabel("$a_{min}$ (1: the LC)")
    panels[0, 0].invert_xaxis()
    panels[0, 0].set_ylabel(QUANTITIES["integral_q2"].heading)
    panels[1, 0].set_ylabel(QUANTITIES["voltage_variation"].heading)
    panels[0, -1].legend(title="sample time", fontsize="small")
    return figure


def sweep_runs(runs: Runs) -> Runs:
    """Return the few runs of the sweep among all."""
    return {key: numbers for key, numbers in runs.items() if key.experiment == "chattering"}


def sweep_median(runs: Runs, chain: str, a_min: float, step: float, name: str) -> float:
    """Return the median of a number over the draws of one point of the sweep; a lost pendulum counts as infinite."""
    variant = sweep_name(chain, a_min)
    keys = [key for key in runs if key.experiment == "chattering" and key.variant == variant and key.step == step]
    median = float(np.median([counted(runs[key], name) for key in keys]))
    return median if np.isfinite(median) else np.nan


def _swing_ups(runs: Runs) -> Figure:
    figure = Figure(figsize=(9, 5), layout="constrained")
    axis = figure.subplots()
    pairs = swing_up_pairs(runs)
    near = [abs(lc["integral_q2"] / printed.LMSE[0]["LC"] - 1.0) < 0.1 for _, lc, _ in pairs]
    for inside, colour, label in ((False, "0.7", "all"), (True, COLOURS["IHC"], "LMSE of the LC within 10 % of 11.23")):
        group = [pair for pair, flag in zip(pairs, near, strict=True) if flag is inside]
        x = [lc["arm_peak"] for _, lc, _ in group]
        y = [margin(ihc["integral_q2"], lc["integral_q2"]) for _, lc, ihc in group]
        axis.plot(x, y, ".", color=colour, ms=4, label=label)
    said = margin(printed.LMSE[0]["IHC"], printed.LMSE[0]["LC"])
    axis.axhline(said, color=COLOURS["LC"], lw=0.9, ls="--", label=f"Table I: {said:.2f} %")
    axis.axhline(0.0, color="0.3", lw=0.8)
    axis.set(xlabel="largest |θ| after the capture, LC [rad]", ylabel="LMSE of IHC relative to LC [%]", ylim=(-5, 3))
    axis.set_xlim(0, 4)
    axis.grid(alpha=0.3)
    axis.legend(loc="lower left")
    return figure


def swing_up_pairs(runs: Runs) -> list[tuple[int, Mapping[str, float], Mapping[str, float]]]:
    """Return (draw, numbers with LC, numbers with IHC) of the random swing-ups that both laws kept upright."""
    pairs = []
    for key in runs:
        if key.experiment == "swing-ups" and key.variant == COMPARED[0]:
            ihc = runs[key._replace(variant=COMPARED[1])]
            if runs[key].get("kept") and ihc.get("kept"):
                pairs.append((key.draw, runs[key], ihc))
    return pairs
