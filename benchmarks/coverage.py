"""How often the confidence intervals of `identify` hold the truth, in logs of simulated runs whose plant is known.

    python benchmarks/coverage.py --draws 12

Each draw is a swing-up and balance with its own encoder offsets, dampings within 50 % and dry friction of 0.1 to 0.5 mN.m,
for the gentle swing-up of the scenario `device` and the fast one of `swing_up`, at 1 kHz.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from cosim.hil.identify import identify
from cosim.pendulum_export import export_units
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from ihc_fmu.pendulum.start_values import default_design
from plant_fmu.parameters import PARAMETER_SETS

NAMES: tuple[str, ...] = ("D_r", "D_p", "T_r")
SIGNALS = ("plant.theta_encoder", "plant.delta_encoder", "controller.voltage")


def main() -> None:
    """Print, for each scenario and parameter, how many of the draws' intervals hold the truth, and the worst error."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--duration", type=float, default=8.0, help="length of each log [s]")
    given = parser.parse_args()
    ident = PARAMETER_SETS["ident"]
    with tempfile.TemporaryDirectory() as folder:
        export_units(default_design(), output=Path(folder))
        for name in ("device", "swing_up"):
            held, errors, disturbed = dict.fromkeys(NAMES, 0), dict.fromkeys(NAMES, 0.0), 0
            for seed in range(1, given.draws + 1):
                rng = np.random.default_rng([seed, 5])
                p = ident.parameters
                truth = {n: getattr(p, n) * rng.uniform(0.5, 1.5) for n in ("D_r", "D_p")} | {
                    "T_r": rng.uniform(1e-4, 5e-4)
                }
                scenario, beside = load_scenario(name)
                changes = {f"plant.start.{n}": float(value) for n, value in truth.items()}
                changes |= {"run.seed": seed, "run.duration": given.duration, "record.outputs": SIGNALS}
                found = identify(run_scenario(scenario.changed(changes), Path(folder), beside), ident, NAMES)
                disturbed += found.disturbed
                for n, e in found.estimates.items():
                    held[n] += e.low <= truth[n] <= e.high
                    errors[n] = max(errors[n], abs(e.value / truth[n] - 1.0))
            numbers = ", ".join(f"{n} {held[n]} of {given.draws} (error up to {100 * errors[n]:.1f} %)" for n in NAMES)
            print(f"{name}, {given.duration:g} s: {numbers}; taken for disturbed: {disturbed}", flush=True)


if __name__ == "__main__":
    main()
