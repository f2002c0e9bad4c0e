"""How surely the device's swing-up captures within its cable's range.

    python -m benchmarks.device_swing_up [--draws N] [--seed SEED] [--scenario NAME] [--fmus FOLDER] [--journal FILE]

Every draw is a run of a scenario from hanging, on several parameter sets and at several rates: both dampings within 20 % of
the set's, encoder offsets anywhere in a count; every other draw begins with a small swing instead of at rest. Finished runs
are kept: after Ctrl-C the same command, or one with more draws, goes on from there.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.errors import UserError
from cosim.judged_signals import kept_upright, takeovers, wrapped
from cosim.results import Result
from cosim.scenario import load_scenario
from cosim.studies.engine import Job, run_numbers
from cosim.studies.journal import Journal
from cosim.studies.numbers import Numbers
from plant_fmu.parameters import PARAMETER_SETS

SETS = ("ident", "matrices", "hcs")
STEPS = (1e-3, 2e-3)

DAMPING = 0.2
"""Relative range of both dampings."""
SWING = {"theta_0": 0.1, "delta_0": 0.15, "delta_dot_0": 1.0}
"""Ranges of the initial angles [rad] about their values and of the pendulum's velocity [rad/s]."""

CABLE = math.radians(105.0)
"""Where the arm should stay [rad]."""
LATEST = 5.0
"""When the first capture should have come [s]."""
UPRIGHT = 0.1
"""Where the pendulum should be at the end [rad]."""


PURPOSE = "device swing-up 1"
"""Named in the journal; to be changed with `judged`."""


class Key(NamedTuple):
    """A run: parameter set, step [s], draw."""

    parameters: str
    step: float
    draw: int


@dataclass(frozen=True)
class Outcome:
    """First capture [s] (infinite without one), largest angle of the arm [rad], and whether all was as it should be.

    Of a run that an FMU ends with an error: no capture, an angle that is not known, and not good.
    """

    capture: float = math.inf
    arm: float = math.nan
    good: float = 0.0


def judged(result: Result) -> Numbers:
    """Return the outcome of a run: captured in time, within the cable's range, never lost again, upright at the end."""
    captures = takeovers(result["controller.mode"])
    capture = float(result.time[captures[0]]) if captures.size else math.inf
    arm = float(np.max(np.abs(result["plant.theta"])))
    tilt = abs(float(wrapped(result["plant.delta"][-1:])[0]))
    good = capture <= LATEST and arm <= CABLE and kept_upright(result) and tilt < UPRIGHT
    return {"capture": capture, "arm": arm, "good": float(good)}


def outcomes(of: Sequence[Job[Key]], fmus: Path, journal: Path) -> dict[Key, Outcome]:
    """Return the outcome of each run, from the journal or by a run."""
    with Journal(journal, PURPOSE) as kept:
        return {key: Outcome(**values) for key, values in run_numbers(of, fmus, kept, judged).items()}


def jobs(draws: int, seed: int, name: str = "device") -> list[Job[Key]]:
    """Return a run for each set, step and draw; a draw is the same at all steps."""
    scenario, folder = load_scenario(name)
    hanging = float(scenario.plant.start.get("delta_0", -math.pi))
    rng = np.random.default_rng(seed)
    drawn = []
    for draw in range(draws):
        for parameters in SETS:
            numbers = PARAMETER_SETS[parameters].parameters
            changes: dict[str, object] = {
                "plant.parameters": parameters,
                "run.seed": int(rng.integers(2**31)),
            }
            for damping in ("D_r", "D_p"):
                changes[f"plant.start.{damping}"] = getattr(numbers, damping) * float(
                    rng.uniform(1 - DAMPING, 1 + DAMPING)
                )
            for variable, most in SWING.items():
                swing = float(rng.uniform(-most, most)) if draw % 2 else 0.0
                changes[f"plant.start.{variable}"] = swing + (hanging if variable == "delta_0" else 0.0)
            drawn += [
                Job(Key(parameters, step, draw), scenario, folder, {**changes, "run.step": step}) for step in STEPS
            ]
    return drawn


def table(of_runs: Mapping[Key, Outcome]) -> str:
    """Return a row for each set and step: draws that went well, latest and median capture, largest angle of the arm."""
    lines = [f"{'set':9} {'step':>5} {'good':>9} {'latest capture':>15} {'median':>8} {'largest arm angle':>18}"]
    for parameters in SETS:
        for step in STEPS:
            ours = [o for key, o in of_runs.items() if key[:2] == (parameters, step)]
            captures = [o.capture for o in ours]
            cells = (
                f"{parameters:9} {1e3 * step:2.0f} ms",
                f"{f'{sum(o.good for o in ours):g}/{len(ours)}':>9}",
                f"{max(captures):13.2f} s",
                f"{np.median(captures):6.2f} s",
                f"{max(o.arm for o in ours):14.2f} rad",
            )
            lines.append(" ".join(cells))
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run and print; 1 where a draw did not go well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=100, help="draws of each set (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the draws (%(default)s)")
    parser.add_argument("--scenario", default="device", help="scenario (%(default)s)")
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), help="folder with the FMUs (%(default)s)")
    journal = Path("results/device_swing_up.sqlite")
    parser.add_argument("--journal", type=Path, default=journal, help="file of finished runs (%(default)s)")
    given = parser.parse_args(arguments)
    found = outcomes(jobs(given.draws, given.seed, given.scenario), given.fmus, given.journal)
    print(table(found))
    return 0 if all(o.good for o in found.values()) else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except UserError as error:
        sys.exit(f"error: {error}")
