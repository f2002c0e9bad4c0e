"""The hardware-in-the-loop program's timing on this machine: `python -m benchmarks.hil`.

Periods missed and lateness at several rates, with and without real-time scheduling, against the simulated device in this
process and against the one in another process over UDP; and the latency from sample to command with the native controller
FMU over that with the Python one, in turns. All by the program's own loop and its own log.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from cosim.hil.device import Device
from cosim.hil.log import percentiles
from cosim.hil.loop import Loop
from cosim.hil.realtime import REFERENCE_MISSES, REFERENCE_TIME, undisturbed
from cosim.hil.settings import Settings
from cosim.hil.simulated import Board, SimulatedDevice
from cosim.hil.udp import UdpDevice
from cosim.hil.udp_messages import address_of
from cosim.judged_signals import kept_upright
from cosim.pendulum_export import Kind, export_units
from cosim.results import Result
from cosim.scenario import load_scenario
from cosim.scenario_system import build_system
from cosim.structure import Component
from ihc_fmu.pendulum.start_values import default_design

RATES = (500.0, 1000.0, 2000.0)
PERCENTILES = ("p50", "p99", "p99.9", "max")


class Bench:
    """The FMUs in a folder, and runs with them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for kind in Kind:
            export_units(default_design(), output=folder / kind, kind=kind)

    def run(
        self, device: str, rate: float, seconds: float, kind: Kind = Kind.native, *, real_time: bool = True
    ) -> Result:
        """Return the log of one run: device `sim`, or `udp` in a process of its own."""
        scenario, beside = load_scenario("device")
        changed = scenario.changed({"run.step": 1.0 / rate, "run.duration": seconds})
        controller = build_system(changed, self.folder / kind, beside).components[0]
        plant = build_system(changed, self.folder / Kind.native, beside).components[1]
        settings = Settings(rate=rate, duration=seconds, real_time=real_time, stop_on_misses=False)
        path = self.folder / "run.csv"
        if device == "sim":
            return self._logged(SimulatedDevice(Board(plant)), controller, settings, path)
        options = ["--listen", "127.0.0.1:0", "--once", "--fmus", str(self.folder / Kind.native)]
        options += [] if real_time else ["--no-real-time"]
        with subprocess.Popen(
            [sys.executable, "-m", "cosim", "device", *options], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            place = process.stdout.readline().rsplit(maxsplit=1)[-1]
            return self._logged(UdpDevice(address_of(place)), controller, settings, path)

    def _logged(self, device: Device, controller: Component, settings: Settings, path: Path) -> Result:
        loop = Loop(device, controller, settings, path)
        try:
            report = loop.run()
        finally:
            loop.log.discard()
        if report.stop != "complete":
            print(f"  the run ended early: {report.reason}")
        return report.result


def table(bench: Bench, seconds: float) -> None:
    """Print misses and lateness of each cell."""
    print(
        f"{seconds:g} s a cell; periods missed by the program, by a loop that only sleeps, and that elsewhere; lateness [us]"
    )
    headings = ("device", "rate", "real-time", "balanced", "missed", "bare loop", "elsewhere", *PERCENTILES)
    print(" ".join(f"{heading:>9}" for heading in headings))
    for device in ("sim", "udp"):
        for rate in RATES:
            for real_time in (False, True):
                result = bench.run(device, rate, seconds, real_time=real_time)
                if not len(result.time):
                    continue
                elsewhere = REFERENCE_MISSES[rate, real_time] * seconds / REFERENCE_TIME
                late = percentiles(result["hil.lateness"])
                cells = [device, f"{rate:g}", "yes" if real_time else "no", "yes" if kept_upright(result) else "no"]
                cells += [result.metadata["hil"]["missed"], bare_loop(rate, seconds, real_time=real_time)]
                cells += [f"{elsewhere:.0f}", *(f"{1e6 * late[name]:.0f}" for name in PERCENTILES)]
                print(" ".join(f"{cell:>9}" for cell in cells), flush=True)


def bare_loop(rate: float, seconds: float, *, real_time: bool) -> int:
    """Return how many periods a loop misses that only sleeps, in this process and now."""
    period = round(1e9 / rate)
    missed, k = 0, 0
    with undisturbed(real_time=real_time):
        begin = time.perf_counter_ns()
        while k < seconds * rate:
            k += 1
            ahead = begin + k * period - time.perf_counter_ns()
            if ahead > 0:
                time.sleep(ahead * 1e-9)
            behind = max(0, (time.perf_counter_ns() - begin - k * period) // period)
            missed += behind
            k += behind
    return missed


def latency_ratio(bench: Bench, seconds: float, rounds: int) -> None:
    """Print latency with both kinds of controller, and the ratio, over rounds in turn."""
    print(
        f"latency, sample to command, at 1 kHz against the simulated device, {rounds} rounds of {seconds:g} s in turn"
    )
    found: dict[Kind, list[float]] = {kind: [] for kind in Kind}
    for _ in range(rounds):
        for kind in Kind:
            result = bench.run("sim", 1000.0, seconds, kind)
            found[kind].append(percentiles(result["hil.latency"][result["hil.steps"] == 1])["p50"])
    for kind, values in found.items():
        print(f"  {kind:7} p50 {1e6 * statistics.median(values):.1f} us")
    ratios = [slow / fast for slow, fast in zip(found[Kind.python], found[Kind.native], strict=True)]
    print(
        f"  Python over native: {statistics.median(ratios):.1f} (of each round: {', '.join(f'{r:.1f}' for r in ratios)})"
    )


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of a cell's run [s] (%(default)s)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds of the latency's comparison (%(default)s)")
    parser.add_argument("--latency-only", action="store_true", help="leave the table out")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        latency_ratio(bench, min(given.seconds, 5.0), given.rounds)
        if not given.latency_only:
            table(bench, given.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
