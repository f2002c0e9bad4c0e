"""What counting leaves of the pendulum, computed and simulated: the table and the picture of docs/residual.md.

    python -m benchmarks.residual [--draws 32] [--picture docs/images/residual.png]

The FMUs of the default design run the scenario tilt_kalman with the IHC, for each sample time, a_min and encoder, over draws
of the encoders' zero offsets.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.metrics import evaluate
from cosim.pendulum_export import export_units
from cosim.scenario import load_scenario
from cosim.studies.draws import drawn
from cosim.studies.engine import run_all
from cosim.studies.jobs import Job
from ihc_fmu.pendulum.residual import angle_rms, residual_set
from ihc_fmu.pendulum.start_values import default_design
from ihc_fmu.residual import Residual

TIMES, NORMS, COUNTS = (5e-4, 1e-3, 2e-3), (0.3, 0.5, 0.88, 1.0), (1024, 2048, 4096)
"""Sample times [s], values of a_min, counts per turn."""
COLOURS = {1024: "#b2182b", 2048: "#1b7837", 4096: "#2166ac"}

Key = tuple[float, float, int]


def simulated(draws: int) -> dict[Key, float]:
    """Return the root mean square of |q| over the draws' steady states [rad]."""
    scenario, folder = load_scenario("tilt_kalman")
    with tempfile.TemporaryDirectory() as place:
        export_units(default_design(), output=place)
        jobs = [
            Job((key, draw), drawn(scenario, draw).changed(changes(key)), folder)
            for key in itertools.product(TIMES, NORMS, COUNTS)
            for draw in range(1, draws + 1)
        ]
        found = run_all(jobs, place, lambda result: evaluate(result).values["steady_rms"])
    squares: dict[Key, list[float]] = {}
    for (key, _), value in found.items():
        squares.setdefault(key, []).append(value**2)
    return {key: float(np.sqrt(np.mean(values))) for key, values in squares.items()}


def changes(key: Key) -> dict[str, float]:
    """Return what a run changes in the scenario."""
    h, a_min, counts = key
    start = {"controller.start.sample_time": h, "controller.start.a_min": a_min, "plant.start.encoder_counts": counts}
    return {"run.step": h, **start}


def computed(key: Key) -> Residual:
    """Return what is foretold."""
    h, a_min, counts = key
    start = {"velocity_source": "kalman", "discretization": "semi_implicit", "sample_time": h, "a_min": a_min}
    return residual_set(default_design(), start, counts=counts)


def table(runs: Mapping[Key, float]) -> str:
    """Return the table in Markdown."""
    lines = [
        "| h [ms] | a_min | counts | simulated [rad] | computed | white noise | θ, δ at most | ball |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for (h, a_min, counts), rms in runs.items():
        found = computed((h, a_min, counts))
        cells = [f"{1e3 * h:g}", f"{a_min:g}", str(counts), f"{rms:.5f}", f"{angle_rms(found):.5f}"]
        cells += [f"{np.hypot(*found.white[:2]):.5f}", f"{found.bound[0]:.3f}, {found.bound[1]:.4f}"]
        lines.append(f"| {' | '.join([*cells, f'{found.norm_bound:.2f}'])} |")
    return "\n".join(lines)


def draw(runs: Mapping[Key, float], path: Path) -> None:
    """Draw |q| over a_min at 1 ms for each encoder, and over the sample time at a_min 0.5."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for counts in COUNTS:
        _curves(left, runs, [(1e-3, a, counts) for a in NORMS], list(NORMS), counts)
        _curves(right, runs, [(h, 0.5, counts) for h in TIMES], [1e3 * h for h in TIMES], counts)
    left.set(xlabel="a_min, at h = 1 ms", ylabel="RMS |q| in the steady state [rad]", yscale="log")
    right.set(xlabel="sample time h [ms], at a_min = 0.5", xscale="log", xticks=[0.5, 1.0, 2.0])
    right.set_xticks([], minor=True)
    right.set_xticklabels(["0.5", "1", "2"])
    for axis in (left, right):
        axis.grid(alpha=0.3)
    figure.legend(*left.get_legend_handles_labels(), loc="outside right center", fontsize=8)
    figure.savefig(path, dpi=120, metadata={"Software": None})


def _curves(axis: Axes, runs: Mapping[Key, float], keys: list[Key], x: list[float], counts: int) -> None:
    colour, founds = COLOURS[counts], [computed(key) for key in keys]
    axis.plot(x, [runs[key] for key in keys], "o", color=colour, label=f"{counts} counts: simulated")
    axis.plot(x, [angle_rms(found) for found in founds], "-", color=colour, label="computed")
    axis.plot(x, [np.hypot(*found.white[:2]) for found in founds], ":", color=colour, label="as white noise")


def main() -> None:
    """Run all, print the table, draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=32)
    parser.add_argument("--picture", type=Path, default=Path("docs/images/residual.png"))
    arguments = parser.parse_args()
    runs = simulated(arguments.draws)
    print(table(runs))
    draw(runs, arguments.picture)


if __name__ == "__main__":
    main()
