"""The closed loop of the two native FMUs, 100,000 steps of 1e-4 s: this project's master against other tools.

    python benchmarks/native_pair.py [--quick] [--steps N] [--rounds N] [--only NAME ...]

Measured:

1. Microseconds per communication step, stepping alone, without loading: each tool in its own way of running a fixed step
   (tools.py), in turns. The ratios are medians over rounds of the ratios within a round, since a busy machine moves all
   figures of a round together. Each tool also has to end, after 5,000 steps, where this project's master ends in the same
   coupling order; the table has the distance.
2. A run's fixed cost: runs of 10 steps, ms per run.
3. A sample of the controller in C: IHC against LC, the whole step and the bare laws (controller_step.py); the controller
   of any linear model against it, and over the size of the design (regulator_step.py).
4. The process `qube-ihc run swing_up --set run.step=1e-4 --set run.duration=10 --no-plot` and its parts.

The other tools are optional: pip install libcosimpy ecospy tbb fmu-manipulation-toolbox. One that is missing is named and
left out. Compiling the two C programs needs ziglang.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter

from benchmarks.controller_step import ControllerStep
from benchmarks.monolithic import Monolithic
from benchmarks.regulator_step import RegulatorStep, pendulum_cases, random_cases
from benchmarks.run_costs import WholeRun, campaign, seconds, short_runs
from benchmarks.tools import MONOLITHIC, NATIVE, STEP, TOOLS, NotInstalledError, Pair, Tool, export_pair, reference
from ihc_fmu.pendulum.start_values import default_design

CHECK_STEPS = 5_000
SAMPLES = 5_000
"""Of each larger design."""
CLOSE = 1e-9
"""Largest distance after CHECK_STEPS that rounding may explain [rad]."""

NOTES = """
Ratios are to the C program and to qube-ihc's engine native; added is the time beyond that of the C program, so what the
co-simulation itself costs. The distance is that of the final angles to qube-ihc's in the
same order, for simulate_ssp to those of a loop over FMU2Slave with the same first inputs. The final modes are equal, except
that libcosim and Ecos read no enumerations. Ecos is given one thread, with which it is faster here."""

PARTS = ("steps", "runs", "controller", "campaign", "process")


def main() -> int:
    arguments = _arguments()
    with tempfile.TemporaryDirectory(prefix="qube-ihc-bench-") as name:
        folder = Path(name)
        pair = export_pair(folder)
        print(machine())
        agreed = True
        if "steps" in arguments.only:
            agreed = print_steps(pair, arguments.steps, arguments.rounds)
        if "runs" in arguments.only:
            print_short_runs(pair, arguments.runs)
        if "controller" in arguments.only:
            print_controller(pair, arguments.steps, arguments.rounds)
        if "campaign" in arguments.only:
            print_campaign(pair, arguments.processes)
        if "process" in arguments.only:
            print_process(WholeRun(pair, folder), arguments.processes)
        print("\n" + machine())
    return 0 if agreed else 1


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000, help="communication steps per run (%(default)s)")
    parser.add_argument("--rounds", type=int, default=7, help="rounds, in each of which all have a turn (%(default)s)")
    parser.add_argument("--runs", type=int, default=200, help="runs of 10 steps (%(default)s)")
    parser.add_argument("--processes", type=int, default=5, help="runs of the whole process (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="20,000 steps, 3 rounds, 20 runs, 2 processes")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="parts to measure (all)")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.steps, arguments.rounds, arguments.runs, arguments.processes = 20_000, 3, 20, 2
    if arguments.steps <= CHECK_STEPS or min(arguments.rounds, arguments.runs, arguments.processes) < 1:
        parser.error(f"--steps must exceed {CHECK_STEPS}, the other numbers be at least 1")
    return arguments


def machine() -> str:
    """Return a line on the machine and its load."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = ", ".join(f"{x:.2f}" for x in os.getloadavg()) if hasattr(os, "getloadavg") else "unknown"
    return f"{platform.platform()}, Python {platform.python_version()}, {cores} cores, load average {load}"


def say(text: str) -> None:
    """Write progress to stderr."""
    print(text, file=sys.stderr, flush=True)


def in_turns(cases: Mapping[str, Callable[[], float]], rounds: int, title: str) -> dict[str, list[float]]:
    """Return what each case gave in each round."""
    found: dict[str, list[float]] = {name: [] for name in cases}
    for k in range(rounds):
        say(f"{title}: round {k + 1} of {rounds}")
        for name, case in cases.items():
            found[name].append(case())
    return found


def ratio(values: Sequence[float], base: Sequence[float]) -> str:
    """Return the median of the ratios within rounds."""
    return f"{statistics.median(a / b for a, b in zip(values, base, strict=True)):.3g}"


def added(values: Sequence[float], base: Sequence[float]) -> str:
    """Return the median of the differences within rounds."""
    return f"{statistics.median(a - b for a, b in zip(values, base, strict=True)):.2g}"


def spread(values: Sequence[float], digits: int = 3) -> str:
    """Return 'median | min..max'."""
    return f"{statistics.median(values):.{digits}g} | {min(values):.{digits}g}..{max(values):.{digits}g}"


def print_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a Markdown table; a cell 'a | b' counts as two."""
    print()
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(row) + " |")


# ---- 1. Steps --------------------------------------------------------------------------------------------------------


def print_steps(pair: Pair, steps: int, rounds: int) -> bool:
    """Print the table of tools; return whether all ended where this project's master ends."""
    tools, missing = installed(pair)
    distances = {}
    for name, tool in tools.items():
        say(f"checking {name}")
        distances[name] = tool.run(CHECK_STEPS)[1].distance(reference(pair, tool, CHECK_STEPS))
    counts = {name: min(steps, tool.most_steps) for name, tool in tools.items()}
    cases = {name: _microseconds(tool, counts[name]) for name, tool in tools.items()}
    found = in_turns(cases, rounds, "steps")
    rows = [
        [
            name,
            tool.order + (", inputs 0 at first" if tool.first_inputs == "zeros" else ""),
            tool.records,
            str(counts[name]),
            spread(found[name]),
            ratio(found[name], found[MONOLITHIC]),
            ratio(found[name], found[NATIVE]),
            added(found[name], found[MONOLITHIC]),
            f"{distances[name]:.1e}" if distances[name] else "0",
        ]
        for name, tool in tools.items()
    ]
    print(f"\nClosed loop, steps of {STEP:g} s, medians of {rounds} rounds in turns, stepping alone")
    head = [
        "program",
        "order",
        "records",
        "steps",
        "us/step",
        "min..max",
        "ratio to C",
        "ratio to native",
        "added [us]",
    ]
    print_table([*head, f"distance after {CHECK_STEPS} steps [rad]"], rows)
    print(NOTES)
    for name, reason in missing.items():
        print(f"\n{name}: {reason}")
    astray = [name for name, distance in distances.items() if distance > CLOSE]
    for name in astray:
        print(f"\n{name}: does not run the same loop")
    return not astray


def installed(pair: Pair) -> tuple[dict[str, Tool], dict[str, str]]:
    """Return the tools that can run, and for the others why not."""
    tools: dict[str, Tool] = {}
    missing: dict[str, str] = {}
    for name, make in TOOLS.items():
        say(f"preparing {name}")
        try:
            tools[name] = make(pair)
        except NotInstalledError as error:
            missing[name] = str(error)
    return tools, missing


def _microseconds(tool: Tool, steps: int) -> Callable[[], float]:
    return lambda: 1e6 * tool.run(steps)[0] / steps


# ---- 2. Short runs ---------------------------------------------------------------------------------------------------


def print_short_runs(pair: Pair, runs: int) -> None:
    """Print the cost of runs of 10 steps."""

    def milliseconds(call: Callable[[], object]) -> Callable[[], float]:
        def measured() -> float:
            start = perf_counter()
            call()
            return 1e3 * (perf_counter() - start)

        return measured

    say(f"{runs} runs of 10 steps")
    cases = {name: milliseconds(call) for name, call in short_runs(pair).items()}
    first = {name: case() for name, case in cases.items()}
    found: dict[str, list[float]] = {name: [case() for _ in range(runs)] for name, case in cases.items()}
    base = next(iter(found.values()))
    print(f"\nRuns of 10 steps in one process, medians of {runs}")
    head = ["program", "the first [ms]", "ms per run", "min..max", "ratio of medians"]
    rows = [
        [name, f"{first[name]:.3g}", spread(v), f"{statistics.median(v) / statistics.median(base):.1f}"]
        for name, v in found.items()
    ]
    print_table(head, rows)


# ---- 3. The controller -----------------------------------------------------------------------------------------------


def print_controller(pair: Pair, steps: int, rounds: int) -> None:
    """Print ns per sample of the controller, whole and bare."""
    say("compiling the controller's step")
    rows = Monolithic(pair.plant_start, pair.controller_start).run(steps, STEP)
    program = ControllerStep(pair.controller_start, rows)
    found = in_turns(program.cases(), max(rounds, 5), "controller")
    print(
        f"\nOne sample of the controller in C on {program.count} recorded measurements, {max(rounds, 5)} rounds in turns"
    )
    print(program.about)
    lines = []
    for name, values in found.items():
        base = next(v for n, v in found.items() if n.split(",")[0] == name.split(",")[0])
        lines.append([name, spread(values), ratio(values, base)])
    print_table(["what", "ns", "min..max", "/ LC"], lines)
    print_general_controller(program, max(rounds, 5))


def print_general_controller(program: ControllerStep, rounds: int) -> None:
    """Print ns per sample of HomogeneousController beside IhcController, and over the size of the design."""
    say("compiling the general controller's step")
    pendulum = RegulatorStep(pendulum_cases(default_design(), program.sample_time, program.x))
    found = in_turns(program.twins() | pendulum.cases(), rounds, "general controller")
    (measured, kalman), (general, general_kalman) = list(found)[:2], list(found)[2:]
    print(f"\nOne sample of both controllers, exact norm, semi-implicit, {rounds} rounds in turns")
    bases = {measured: measured, kalman: kalman, general: measured, general_kalman: kalman}
    rows = [[name, spread(found[name]), ratio(found[name], found[base])] for name, base in bases.items()]
    print_table(["what", "ns", "min..max", "/ IhcController"], rows)
    grown = in_turns(RegulatorStep(random_cases(SAMPLES)).cases(), rounds, "sizes")
    print(
        f"\nOne sample of HomogeneousController, states measured, by the size of the design, {rounds} rounds in turns"
    )
    base = grown["n 4, m 1"]
    print_table(
        ["design", "ns", "min..max", "/ n 4, m 1"], [[name, spread(v), ratio(v, base)] for name, v in grown.items()]
    )


# ---- 4. Many runs ----------------------------------------------------------------------------------------------------


def print_campaign(pair: Pair, rounds: int) -> None:
    """Print what threads gain in many runs."""
    runs = 50
    found = in_turns(
        {name: lambda c=call: seconds(c) for name, call in campaign(pair, runs).items()}, rounds, "campaign"
    )
    base = statistics.median(next(iter(found.values())))
    print(
        f"\n{runs} runs of the scenario paper, 10 s at 1 ms with metrics, medians of {rounds}; {os.cpu_count()} cores"
    )
    rows = [
        [name, f"{1e3 * statistics.median(v) / runs:.3g}", f"{base / statistics.median(v):.2f}"]
        for name, v in found.items()
    ]
    print_table(["runs in", "ms per run", "times faster"], rows)


# ---- 5. The whole process --------------------------------------------------------------------------------------------


def print_process(run: WholeRun, count: int) -> None:
    """Print the wall time of the command and its parts."""
    found = in_turns({"process": run.process}, count, "process")["process"]
    print(f"\n`qube-ihc run swing_up --set run.step={STEP:g} --set run.duration=10 --no-plot`, {count} processes:")
    print(f"min {min(found):.3f} s, median {statistics.median(found):.3f} s, max {max(found):.3f} s")
    say("its parts")
    parts = run.parts()
    print_table(["part, measured once", "s"], [[name, f"{seconds:.3f}"] for name, seconds in parts.items()])
    print(f"sum {sum(parts.values()):.3f} s")


if __name__ == "__main__":
    sys.exit(main())
