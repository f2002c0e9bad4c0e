"""Steps per second of the closed loop on Python FMUs: this project's master against FMPy's own `simulate_ssp`.

Both run the same two FMU files, plant and controller, in the same process, in turns; the ratio of the two is the
figure, since absolute times say more about the machine than about the program.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from fmpy.ssp.simulation import simulate_ssp

from cosim.export import Kind, export_units
from cosim.master import simulate
from cosim.scenario import build_system, load_scenario
from ihc_fmu.start_values import default_design

STEP = 1e-3


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=3000, help="communication steps per run (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each, in turns (default: %(default)s)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        fmus = Path(folder)
        ssp = export_units(default_design(), output=fmus, kind=Kind.python)[-1]
        scenario, _ = load_scenario("swing_up")
        system = build_system(scenario.changed({"run.seed": None}), fmus)
        duration = arguments.steps * STEP
        runs: dict[str, Callable[[], object]] = {
            "qube-ihc master": lambda: simulate(system, STEP, duration),
            "FMPy simulate_ssp": lambda: simulate_ssp(str(ssp), stop_time=duration, step_size=STEP),
        }
        times: dict[str, list[float]] = {name: [] for name in runs}
        for run in runs.values():
            run()  # imports, unpacking
        for done in range(arguments.rounds):
            for name, run in runs.items():
                start = time.perf_counter()
                run()
                times[name].append(time.perf_counter() - start)
            print(f"\rround {done + 1} of {arguments.rounds}", end="", file=sys.stderr)
        print(file=sys.stderr)
    print(f"closed loop of the Python FMUs, {arguments.steps} steps, medians of {arguments.rounds} runs in turns")
    print("| master | steps per second | time per step [us] |\n|---|---|---|")
    for name, samples in times.items():
        median = statistics.median(samples)
        print(f"| {name} | {arguments.steps / median:.0f} | {1e6 * median / arguments.steps:.0f} |")
    ratios = [b / a for a, b in zip(*times.values(), strict=True)]
    print(f"ratio simulate_ssp / master, by round: median {statistics.median(ratios):.2f}, ", end="")
    print(f"from {min(ratios):.2f} to {max(ratios):.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
