"""What a run costs besides its steps: short runs in one process, and the parts of a whole `qube-ihc run`."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from fmpy import simulate_fmu
from fmpy.ssp.simulation import simulate_ssp

from benchmarks.tools import STEP, Pair
from cosim.master import simulate
from cosim.metrics import evaluate
from cosim.scenario import Scenario, load_scenario
from cosim.scenario_run import run_scenario
from cosim.studies.engine import Job, run_all

SHORT_STEPS = 10

MODULES = "cosim.cli, cosim.master, cosim.metrics, cosim.scenario_run"
"""What `qube-ihc run` imports."""


def short_runs(pair: Pair) -> dict[str, Callable[[], object]]:
    """Return runs of 10 steps by name, each from the files to the result."""
    end = (SHORT_STEPS - 0.5) * STEP
    return {
        "qube-ihc, simulate, engine native": lambda: simulate(pair.system, STEP, SHORT_STEPS * STEP, engine="native"),
        "FMPy, simulate_ssp": lambda: simulate_ssp(str(pair.ssp), stop_time=end, step_size=STEP),
        "FMPy, simulate_fmu, the plant alone": lambda: simulate_fmu(
            str(pair.plant), stop_time=SHORT_STEPS * STEP, output_interval=STEP, fmi_type="CoSimulation"
        ),
    }


def campaign(pair: Pair, runs: int) -> dict[str, Callable[[], object]]:
    """Return `runs` runs of the scenario `paper` at 1 ms with their metrics: in one thread, and in one per core."""
    scenario, folder = load_scenario("paper")
    jobs = [Job(seed, scenario.changed({"run.step": 1e-3, "run.seed": seed}), folder) for seed in range(runs)]
    fmus = pair.plant.parent
    return {
        "one thread": lambda: run_all(jobs, fmus, evaluate, 1),
        "one thread per core": lambda: run_all(jobs, fmus, evaluate),
    }


class WholeRun:
    """`qube-ihc run swing_up`, 10 s at 10 kHz: as a process and by parts."""

    def __init__(self, pair: Pair, folder: Path) -> None:
        self.pair, self.folder, self._copies = pair, folder, 0

    def process(self) -> float:
        """Return the seconds of the whole process."""
        options = [
            "--set",
            f"run.step={STEP!r}",
            "--set",
            "run.duration=10",
            "--no-plot",
            "--fmus",
            str(self.pair.plant.parent),
        ]
        return _process(["-m", "cosim", "run", "swing_up", *options, "--output", str(self.folder / "swing_up.csv")])

    def parts(self) -> dict[str, float]:
        """Return the seconds of each part, measured once; loading is that of files not yet unpacked."""
        interpreter = _process(["-c", "pass"])
        imports = _process(["-c", f"import {MODULES}"]) - interpreter
        scenario = load_scenario("swing_up")[0].changed({"run.step": STEP, "run.duration": 10.0})
        loading, _ = self._run(scenario.changed({"run.duration": STEP}))
        whole, result = self._run(scenario)
        saving = seconds(lambda: result.save(self.folder / "parts.csv"))
        return {
            "interpreter": interpreter,
            "imports": imports,
            "loading, and a run of one step": loading,
            f"stepping, {result.time[-1]:g} s in {len(result.time) - 1} steps": whole - loading,
            "writing CSV and JSON": saving,
            "metrics": seconds(lambda: evaluate(result)),
        }

    def _run(self, scenario: Scenario):
        fmus = self.folder / f"copy{self._copies}"
        self._copies += 1
        fmus.mkdir()
        for path in (self.pair.plant, self.pair.controller):
            shutil.copy(path, fmus)
        start = time.perf_counter()
        result = run_scenario(scenario, fmus)
        return time.perf_counter() - start, result


def _process(arguments: list[str]) -> float:
    return seconds(lambda: subprocess.run([sys.executable, *arguments], check=True, capture_output=True))


def seconds(call: Callable[[], object]) -> float:
    """Return the seconds that a call takes."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start
