"""What a run of a study costs: prepared against alone, the rest against the stepping, threads, a cluster on this machine.

    python -m benchmarks.studies [--scenario NAME] [--runs N] [--rounds N]

Runs of 10 s at 1 ms with their metrics, each with other encoder offsets. In turns, medians over rounds:

1. run by run as `qube-ihc run` does it, and prepared, as studies do; CPU time of the thread, so that a busy machine counts
   less. The numbers must be the same to the last bit.
2. of the prepared ones what the loop in C takes, and the whole against it.
3. one thread against as many as there are cores: wall time, which only means something on a quiet machine.
4. a scheduler of Dask with a worker process for each core against threads: wall time, and bytes over the loopback
   device, of whoever sends some.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.native_pair import machine, print_table, say, spread
from cosim import native_loop
from cosim.pendulum_export import export_units
from cosim.prepared import Prepared
from cosim.scenario import Scenario, load_scenario
from cosim.scenario_run import run_scenario
from cosim.studies.draws import draw_changes
from cosim.studies.engine import Job, judge_all
from cosim.studies.numbers import numbers
from ihc_fmu.pendulum.start_values import default_design

CHANGES = {"run.step": 1e-3, "run.duration": 10.0, "run.seed": None, "record.every": 1}
LOOPBACK = Path("/proc/net/dev")


class Clock:
    """CPU seconds that the loop in C takes, by thread."""

    def __init__(self) -> None:
        self.seconds = 0.0
        plain = native_loop.NativeLoop.advance

        def advance(loop: native_loop.NativeLoop, *arguments: Any, **options: Any) -> Iterator[int]:
            steps = plain(loop, *arguments, **options)
            while True:
                start = time.thread_time()
                done = next(steps, None)
                self.seconds += time.thread_time() - start
                if done is None:
                    return
                yield done

        native_loop.NativeLoop.advance = advance  # type: ignore[method-assign]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="tilt_kalman", help="built-in name (%(default)s)")
    parser.add_argument("--runs", type=int, default=100, help="in each round (%(default)s)")
    parser.add_argument("--rounds", type=int, default=5, help="(%(default)s)")
    parser.add_argument("--no-cluster", action="store_true", help="without the fourth part")
    arguments = parser.parse_args()
    print(machine())
    with tempfile.TemporaryDirectory(prefix="qube-ihc-bench-") as folder:
        fmus = Path(folder) / "fmus"
        export_units(default_design(), output=fmus)
        scenario, place = load_scenario(arguments.scenario)
        scenario = scenario.changed(CHANGES)
        in_one_thread(scenario, place, fmus, arguments.runs, arguments.rounds)
        in_many(scenario, place, fmus, 4 * arguments.runs, arguments.rounds, cluster=not arguments.no_cluster)
    print(machine())
    return 0


def in_one_thread(scenario: Scenario, place: Path, fmus: Path, runs: int, rounds: int) -> None:
    """Print what a run costs, alone and prepared, in a thread that is not the main one."""
    changes = [draw_changes(scenario, k + 1) for k in range(runs)]
    cpu: dict[str, list[float]] = {"alone": [], "prepared": [], "stepping": []}
    same = True

    def measure() -> None:
        nonlocal same
        ready, clock = Prepared(scenario, fmus, place), Clock()
        cases: dict[str, Callable[[dict[str, Any]], Any]] = {
            "alone": lambda change: numbers(run_scenario(scenario.changed(change), fmus, place)),
            "prepared": lambda change: numbers(ready.run(change)),
        }
        for k in range(rounds):
            say(f"one thread: round {k + 1} of {rounds}")
            found = {}
            for name, case in cases.items():
                case(changes[0])
                clock.seconds, start = 0.0, time.thread_time()
                found[name] = [case(change) for change in changes]
                cpu[name].append(1e3 * (time.thread_time() - start) / runs)
            cpu["stepping"].append(1e3 * clock.seconds / runs)
            same = same and repr(found["alone"]) == repr(found["prepared"])
        ready.close()

    thread = threading.Thread(target=measure)
    thread.start()
    thread.join()
    print(f"\n{scenario.name}: 10 s at 1 ms with metrics, CPU ms per run, {runs} runs, {rounds} rounds in turns")
    base = cpu["stepping"]
    rows = [
        [name, spread(values), f"{statistics.median(v / b for v, b in zip(values, base, strict=True)):.2f}"]
        for name, values in cpu.items()
    ]
    print_table(["run", "ms", "min..max", "/ stepping"], rows)
    print(f"the numbers are {'the same to the last bit' if same else 'DIFFERENT'}")


def in_many(scenario: Scenario, place: Path, fmus: Path, runs: int, rounds: int, *, cluster: bool) -> None:
    """Print what threads and a cluster gain."""
    cores = os.cpu_count() or 1
    jobs = [Job(k, scenario, place, draw_changes(scenario, k + 1)) for k in range(runs)]
    cases: dict[str, Callable[[], Any]] = {
        "one thread": lambda: judge_all(jobs, fmus, numbers, 1),
        f"{cores} threads": lambda: judge_all(jobs, fmus, numbers, cores),
    }
    sent, local, connected = 0.0, None, None
    if cluster:
        from distributed import LocalCluster  # noqa: PLC0415

        from cosim.studies.cluster import Cluster  # noqa: PLC0415

        local = LocalCluster(n_workers=cores, threads_per_worker=1, dashboard_address=":0")
        connected = Cluster(local.scheduler_address)
        cases[f"{cores} Dask workers"] = partial(judge_all, jobs, fmus, numbers, connected)
    wall: dict[str, list[float]] = {name: [] for name in cases}
    for k in range(rounds):
        say(f"many: round {k + 1} of {rounds}")
        for name, case in cases.items():
            before, start = _sent(), time.perf_counter()
            case()
            wall[name].append(1e3 * (time.perf_counter() - start) / runs)
            if "Dask" in name:
                sent = (_sent() - before) / runs
    base = wall["one thread"]
    print(f"\n{runs} runs, wall ms per run, {rounds} rounds in turns")
    rows = [
        [name, spread(values), f"{statistics.median(b / v for v, b in zip(values, base, strict=True)):.2f}"]
        for name, values in wall.items()
    ]
    print_table(["where", "ms", "min..max", "times faster"], rows)
    if local is not None and connected is not None:
        print(f"over the loopback device in the last round with Dask: {sent:.0f} bytes a run")
        connected.close()
        local.close()


def _sent() -> int:
    """Return the bytes that the loopback device has sent; 0 where that cannot be told."""
    if not LOOPBACK.is_file():
        return 0
    line = next(line for line in LOOPBACK.read_text().splitlines() if line.strip().startswith("lo:"))
    return int(line.split(":")[1].split()[8])


if __name__ == "__main__":
    raise SystemExit(main())
