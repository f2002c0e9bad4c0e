"""The loop in C: the same result as FMPy's functions called from Python, to the last bit, and what it is for."""

import itertools
import math
import os
import signal
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from cosim import native_loop
from cosim.errors import UserError
from cosim.master import simulate
from cosim.native_loop import SECONDS_PER_CALL, SIGNAL_STEPS
from cosim.results import Interrupted, SimulationError
from cosim.rig import ORDERS
from cosim.structure import Signal, SystemStructure, Wire
from fmu_export.native_build import FLAGS, PLATFORMS, BuildError, zig_command


@pytest.fixture
def both(same):
    """Run a system with both engines, assert that the results are the same, and return that of the loop in C."""

    def run(system, step, duration, **options):
        native, fmpy = (simulate(system, step, duration, engine=e, **options) for e in ("native", "fmpy"))
        assert (native.metadata.pop("engine"), fmpy.metadata.pop("engine")) == ("native", "fmpy")
        same(native, fmpy)
        return native

    return run


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", ["swing_up", "tilt", "tilt_ideal", "tilt_kalman", "disturbed"])
def test_both_engines_give_the_same_bits(both, pair, name, order):
    result = both(pair(name), 5e-4, 2.0, order=order)
    assert len(result.time) == 4001


@pytest.mark.parametrize("discretization", ["explicit", "semi_implicit"])
def test_converged_controller_stays_converged(pair, discretization):
    """700 s: without care squares underflow after 67 s, and the norm is 0/0."""
    ideal = pair("tilt_ideal", controller__start__discretization=discretization)
    names = ["plant.theta", "plant.delta", "controller.voltage", "controller.homogeneous_norm", "controller.mode"]
    result = simulate(ideal, 1e-3, 700.0, record=names, every=100)
    values = [result[name] for name in names]
    assert np.isfinite(values).all()
    assert set(result["controller.mode"][1:]) == {3}
    after = result.time > 40.0
    assert all(abs(column[after]).max() < 1e-20 for column in values[:4])
    seen = abs(np.concatenate(values[:2]))
    assert seen[seen > 0.0].min() >= 2.0**-300  # none that would slow the processor down


@pytest.mark.parametrize(
    "options",
    [
        {"every": 7},
        {"every": 1000},
        {"record": ["plant.theta", "controller.mode"]},
        {"record": []},
        {"start_time": -3.7},
        {"start_time": 1e6},
    ],
    ids=str,
)
def test_options_mean_the_same_to_both(both, pair, options):
    both(pair(), 1e-3, 0.25, **options)


@pytest.mark.parametrize("order", ORDERS)
def test_chains_of_any_number_of_fmus_and_types_are_the_same(both, tiny, order):
    names = "abcde"
    wires = [Wire(f"{a}.y", f"{b}.u") for a, b in itertools.pairwise(names)]
    wires += [Wire("a.whole_out", "c.whole"), Wire("a.calls", "d.whole"), Wire("b.flag_out", "a.flag")]
    signals = [Signal("a.u", lambda t: math.sin(20 * t))]
    result = both(SystemStructure([tiny(name, gain=2.0) for name in names], wires, signals), 0.01, 1.0, order=order)
    delay = 0 if order == "controller-first" else 4
    np.testing.assert_array_equal(result["e.y"][1 + delay :], 2.0**4 * result["a.y"][1 : 101 - delay])


def test_signals_go_on_beyond_what_is_evaluated_ahead(both, pair):
    steps = 2 * SIGNAL_STEPS + 3
    system = pair()
    ramp = [
        Signal("plant.disturbance_voltage", lambda t: 1e-3 * t),
        Signal("plant.pendulum_torque", lambda t: -1e-6 * t),
    ]
    both(SystemStructure(system.components, system.wires, ramp), 1e-3, steps * 1e-3, every=100)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("instance", "call"), [("a", 1), ("b", 3), ("c", 77)])
def test_failures_are_the_same(tiny, order, instance, call):
    system = SystemStructure(
        [tiny(name, fail_at=call if name == instance else 0) for name in "abc"],
        [Wire("a.y", "b.u"), Wire("b.y", "c.u")],
    )
    failures = []
    for engine in ("native", "fmpy"):
        with pytest.raises(SimulationError) as failure:
            simulate(system, 0.01, 1.0, order, engine=engine)
        failures.append(failure.value)
    native, fmpy = failures
    assert str(native) == str(fmpy)
    assert f"told to fail in call {call}" in str(native)
    assert (native.instance, native.time) == (fmpy.instance, fmpy.time) == (instance, (call - 1) * 0.01)
    assert native.result.time.tolist() == fmpy.result.time.tolist() == [k * 0.01 for k in range(call)]


def test_ctrl_c_is_noticed_soon_and_keeps_the_rows(pair):
    """The signal comes while C is running; what is reported is that Python sees it when the call returns."""
    assert SECONDS_PER_CALL <= 0.1
    sent = []

    def interrupt():
        time.sleep(0.3)
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(Interrupted) as stopped:
        simulate(pair(), 1e-3, 1e5, every=1000)
    took = time.monotonic() - sent[0]
    thread.join()
    rows = stopped.value.result.time
    assert len(rows) > 1
    assert rows.tolist() == [k * 1000 * 1e-3 for k in range(len(rows))]
    assert took < 2.0  # 0.05 s on an idle machine


def test_other_threads_run_while_c_steps(pair, monkeypatch):
    monkeypatch.setattr(native_loop, "SECONDS_PER_CALL", 60.0)
    running, ticks = threading.Event(), []

    def tick():
        while running.is_set():
            ticks.append(time.monotonic())
            time.sleep(1e-3)

    running.set()
    thread = threading.Thread(target=tick)
    thread.start()
    start = time.monotonic()
    simulate(pair(), 1e-3, 500.0, every=10_000, engine="native")
    took = time.monotonic() - start
    running.clear()
    thread.join()
    assert max(np.diff(ticks)) < took / 2  # with the lock held there is one gap as long as the run


def test_runs_in_threads_are_those_in_turn(pair, same):
    systems = [pair("swing_up", run__seed=seed) for seed in range(4)]
    in_turn = [simulate(system, 1e-3, 3.0) for system in systems]
    found = {}
    threads = [
        threading.Thread(target=lambda i=i, s=system: found.update({i: simulate(s, 1e-3, 3.0)}))
        for i, system in enumerate(systems)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i, expected in enumerate(in_turn):
        same(found[i], expected)


def test_python_fmus_are_stepped_from_python_unless_asked(tiny, pair):
    assert simulate(SystemStructure([tiny()]), 0.1, 1.0).metadata["engine"] == "fmpy"
    assert simulate(SystemStructure([tiny()]), 0.1, 1.0, engine="native").metadata["engine"] == "native"
    assert simulate(pair(), 1e-3, 0.1).metadata["engine"] == "native"


def test_a_missing_loop_is_named_with_the_way_out(pair, monkeypatch):
    def missing():
        raise BuildError("the binary linux64/loop.so is missing; installing the package again builds it")

    native_loop._advance.cache_clear()
    monkeypatch.setattr(native_loop, "loop_library", missing)
    with pytest.raises(UserError, match=r"loop\.so is missing.*--engine fmpy runs without it"):
        simulate(pair(), 1e-3, 0.1)
    assert len(simulate(pair(), 1e-3, 0.1, engine="fmpy").time) == 101


def test_unknown_engines_are_refused(pair):
    with pytest.raises(UserError, match="engine must be one of auto, native, fmpy, found 'fast'"):
        simulate(pair(), 1e-3, 0.1, engine="fast")  # type: ignore[arg-type]


@pytest.mark.parametrize("platform", PLATFORMS.values(), ids=PLATFORMS)
def test_loop_compiles_for_every_platform(platform, tmp_path):
    """To an object: for a library Zig would make the whole runtime of Windows first, which `make dist` does."""
    source = Path(native_loop.__file__).with_name("native") / "loop.c"
    for target in platform.targets:
        command = [*zig_command(), "-target", target, *FLAGS, "-c", source, "-o", tmp_path / target]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        assert b"loop_advance" in (tmp_path / target).read_bytes()
