"""The master: what it refuses before anything runs, its time, its order, and that it adds nothing to the two units."""

import gc
import math
import sys
from dataclasses import replace
from fractions import Fraction
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from cosim import master
from cosim.errors import UserError
from cosim.fmu import Instance
from cosim.fmu_files import describe
from cosim.master import simulate
from cosim.results import Interrupted, SimulationError
from cosim.rig import PROGRESS_EVERY
from cosim.scenario import load_scenario
from cosim.scenario_system import build_system
from cosim.structure import Component, Signal, SystemStructure, Wire
from ihc_fmu.pendulum.interface import INTERFACE as CONTROLLER
from ihc_fmu.pendulum.start_values import controller_start_values
from ihc_fmu.pendulum.unit import IhcControllerUnit
from plant_fmu.interface import INTERFACE as PLANT
from plant_fmu.interface import start_values as plant_start_values
from plant_fmu.unit import QubePlant

DISTURBED = {"disturbance.sines": [{"amplitude": 0.5, "frequency": 40.0, "phase": 1.0}]}


@pytest.fixture(autouse=True, params=["native", "fmpy"])
def engine(request, monkeypatch):
    """Every test of this file holds for both loops, whatever the FMUs are."""
    monkeypatch.setattr(master, "needs_python", lambda _: request.param == "fmpy")
    return request.param


def run(system, steps=50, step=1e-3, **options):
    return simulate(system, step, steps * step, **options)


# Refused before anything runs


@pytest.fixture
def nothing_starts(monkeypatch):
    def started(*_):
        raise AssertionError("an FMU was started")

    monkeypatch.setattr(Instance, "start", started)


@pytest.mark.usefixtures("nothing_starts")
@pytest.mark.parametrize(
    ("wire", "sentence"),
    [
        (("plnt.theta", "controller.theta"), "'plnt.theta' names no instance's variable; did you mean plant"),
        (("theta", "controller.theta"), "'theta' names no instance's variable"),
        (("plant.thetta", "controller.theta"), "plant has no variable named 'thetta'; did you mean theta"),
        (("plant.theta", "controller.tetha"), "controller has no variable named 'tetha'; did you mean theta"),
        (("plant.voltage", "controller.theta"), "plant.voltage must be an output, found input"),
        (("plant.theta_0", "controller.theta"), "plant.theta_0 must be an output, found parameter"),
        (("plant.theta", "controller.voltage"), "controller.voltage must be an input, found output"),
        (("plant.theta", "controller.a_min"), "controller.a_min must be an input, found parameter"),
        (
            ("plant.theta", "controller.theta_dot"),
            "the wire plant.theta -> controller.theta_dot must join equal units, found rad and rad/s",
        ),
        (
            ("controller.mode", "plant.disturbance_voltage"),
            "the wire controller.mode -> plant.disturbance_voltage must join equal types, found Enumeration and Real",
        ),
        (("plant.delta", "controller.delta"), "the input controller.delta must have one source, found 2"),
    ],
)
def test_a_wire_that_cannot_be_is_refused(pair, wire, sentence):
    system = pair()
    with pytest.raises(UserError) as refusal:
        run(SystemStructure(system.components, [*system.wires, Wire(*wire)]))
    assert str(refusal.value).startswith(sentence)


@pytest.mark.usefixtures("nothing_starts")
def test_signals_are_checked_as_wires(tiny):
    wired = SystemStructure([tiny("a"), tiny("b")], [Wire("a.y", "b.u")], [Signal("b.u", math.sin)])
    with pytest.raises(UserError, match=r"the input b\.u must have one source, found 2"):
        run(wired)
    with pytest.raises(UserError, match=r"a\.y must be an input, found output"):
        run(SystemStructure([tiny("a")], signals=[Signal("a.y", math.sin)]))


@pytest.mark.usefixtures("nothing_starts")
@pytest.mark.parametrize("names", [("a", "a"), ("a.b", "c"), ("", "a"), ("a b", "c")])
def test_instance_names_are_unique_identifiers(tiny, names):
    with pytest.raises(UserError, match="instances need unique names"):
        run(SystemStructure([tiny(name) for name in names]))


@pytest.mark.usefixtures("nothing_starts")
def test_start_values_are_checked_with_the_instances_name(tiny):
    with pytest.raises(UserError, match="b has no variable named 'gian'; did you mean gain"):
        run(SystemStructure([tiny("a"), tiny("b", gian=1.0)]))
    with pytest.raises(UserError, match=r"b\.fail_at must lie in \[0, inf\]"):
        run(SystemStructure([tiny("a"), tiny("b", fail_at=-1)]))


@pytest.mark.usefixtures("nothing_starts")
@pytest.mark.parametrize(
    ("step", "duration", "named"),
    [
        (1e-3, 0.0105, ("0.0105 s", "0.001 s")),
        (1e-3, 1e-4, ("0.0001 s", "0.001 s")),
        (1 / 60, 0.99, ("0.99 s", "0.016666666666666666 s")),
        (0.0, 1.0, ("step", "0.0")),
        (-1e-3, 1.0, ("step", "-0.001")),
        (math.nan, 1.0, ("step", "nan")),
        (math.inf, 1.0, ("step", "inf")),
        (1e-3, -1.0, ("duration", "-1.0")),
        (1e-3, 0.0, ("duration", "0.0")),
        (1e-3, math.inf, ("duration", "inf")),
    ],
)
def test_step_and_duration_that_do_not_fit_are_named(tiny, step, duration, named):
    with pytest.raises(UserError) as refusal:
        simulate(SystemStructure([tiny()]), step, duration)
    assert all(text in str(refusal.value) for text in named)


@pytest.mark.usefixtures("nothing_starts")
@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"order": "plant-first"}, "order must be one of controller-first, parallel, found 'plant-first'"),
        ({"every": 0}, "every must be at least 1, found 0"),
        ({"record": ["a.u"]}, "a.u must be an output, found input"),
        ({"record": ["a.why"]}, "a has no variable named 'why'"),
        ({"record": ["a.y", "a.y"]}, "outputs to record must be named once each, found a.y, a.y"),
    ],
)
def test_options_that_cannot_be_are_refused(tiny, options, sentence):
    with pytest.raises(UserError) as refusal:
        run(SystemStructure([tiny()]), **options)
    assert str(refusal.value).startswith(sentence)


@pytest.mark.parametrize("step", [1e-3, 1 / 60, 0.1, 1 / 3])
def test_durations_that_are_multiples_but_for_rounding_fit(step):
    assert [master.step_count(step, count * step) for count in (1, 3, 7, 10**6 + 1)] == [1, 3, 7, 10**6 + 1]
    assert master.step_count(1e-3, 0.3) == 300


# Time


@pytest.mark.parametrize(("step", "steps"), [(1 / 60, 60_000), (1e-3, 2_000)])
def test_time_is_the_index_times_the_step(tiny, step, steps):
    result = simulate(SystemStructure([tiny()]), step, steps * step, record=["a.time_seen", "a.calls"])
    assert result.time.tolist() == [k * step for k in range(steps + 1)]
    assert result["a.time_seen"].tolist() == [-1.0, *(k * step for k in range(steps))]
    assert result["a.calls"].tolist() == list(range(steps + 1))
    assert abs(Fraction(result.time[-1]) - steps * Fraction(step)) <= Fraction(math.ulp(steps * step)) / 2


def test_time_may_start_elsewhere(tiny):
    result = run(SystemStructure([tiny()]), steps=3, step=0.25, start_time=-0.5)
    assert result.time.tolist() == [-0.5, -0.25, 0.0, 0.25]
    assert result["a.time_seen"].tolist() == [-1.0, -0.5, -0.25, 0.0]


@pytest.mark.parametrize(("every", "rows"), [(1, [*range(11)]), (3, [0, 3, 6, 9, 10]), (5, [0, 5, 10]), (99, [0, 10])])
def test_decimation_keeps_the_first_and_the_last_row(tiny, every, rows):
    system = SystemStructure([tiny()])
    result = run(system, steps=10, step=0.1, every=every)
    assert result["a.calls"].tolist() == rows
    assert result.time.tolist() == [k * 0.1 for k in rows]


def test_progress_counts_steps_and_ends_at_the_total(tiny, engine):
    seen = []
    steps = 2 * PROGRESS_EVERY + 5
    run(SystemStructure([tiny()]), steps=steps, progress=lambda *counts: seen.append(counts))
    done = [PROGRESS_EVERY, 2 * PROGRESS_EVERY, steps] if engine == "fmpy" else sorted({done for done, _ in seen})
    assert seen == [(count, steps) for count in done]
    assert done[-1] == steps


# Coupling


@pytest.mark.parametrize(
    ("order", "names", "delay"),
    [("controller-first", "abc", 0), ("controller-first", "cba", 2), ("parallel", "abc", 2), ("parallel", "cba", 2)],
)
def test_delay_along_a_chain(tiny, order, names, delay):
    components = [tiny(name, gain=gain) for name, gain in zip("abc", (2.0, 3.0, 5.0), strict=True)]
    listed = sorted(components, key=lambda c: names.index(c.name))
    ramp = Signal("a.u", lambda t: 1.0 + t)
    result = run(
        SystemStructure(listed, [Wire("a.y", "b.u"), Wire("b.y", "c.u")], [ramp]), steps=20, step=0.5, order=order
    )
    driven = 1.0 + result.time[:-1]
    assert result["a.y"][1:].tolist() == (2.0 * driven).tolist()
    assert result["c.y"][1 + delay :].tolist() == (30.0 * driven[: len(driven) - delay]).tolist()


@pytest.mark.parametrize(("order", "delay"), [("controller-first", 0), ("parallel", 1)])
def test_the_voltage_acts_on_the_plant_with_the_delay_of_the_order(pair, order, delay):
    """The applied voltage shows in the motor current: R_m i = V - k_m theta_dot."""
    result = run(pair(), order=order)
    applied = 8.4 * result["plant.current"] + 0.042 * result["plant.theta_dot"]
    commanded = result["controller.voltage"]
    assert np.ptp(commanded) > 1.0
    np.testing.assert_allclose(applied[1 + delay :], commanded[1 : len(commanded) - delay], atol=1e-12)


def test_types_and_values_pass_unchanged(tiny):
    signals = [
        Signal("a.whole", lambda t: round(-10 * t)),
        Signal("a.flag", lambda t: t > 0.15),
        Signal("a.u", math.exp),
    ]
    wires = [Wire(f"a.{name}", f"b.{to}") for name, to in (("whole_out", "whole"), ("flag_out", "flag"), ("y", "u"))]
    result = run(SystemStructure([tiny("a"), tiny("b")], wires, signals), steps=4, step=0.1)
    assert result["b.whole_out"].tolist() == [0, 0, -1, -2, -3]
    assert result["b.flag_out"].tolist() == [0, 0, 0, 1, 1]
    assert result["b.y"][1:].tolist() == [math.exp(0.1 * k) for k in range(4)]
    assert {n: s.dtype.name for n, s in result.signals.items() if n.startswith("b")} == {
        "b.y": "float64",
        "b.time_seen": "float64",
        "b.calls": "int64",
        "b.whole_out": "int64",
        "b.flag_out": "int64",
    }


def test_signals_are_evaluated_once_at_the_start_of_each_step(tiny):
    asked = []
    result = run(
        SystemStructure([tiny()], signals=[Signal("a.u", lambda t: asked.append(t) or 3.0 * t)]), steps=4, step=0.25
    )
    assert asked == [0.0, 0.0, 0.25, 0.5, 0.75]  # once more in initialization
    assert result["a.y"].tolist() == [0.0, 0.0, 0.75, 1.5, 2.25]


def test_the_first_row_holds_outputs_of_the_initialized_system(tiny, pair):
    chain = SystemStructure(
        [tiny("a", gain=2.0), tiny("b", gain=3.0)], [Wire("a.y", "b.u")], [Signal("a.u", lambda t: 7.0)]
    )
    assert run(chain, steps=1)["a.y"][0] == 14.0
    result = run(pair(plant__start__delta_0=0.25, plant__start__encoder_counts=0), steps=1)
    assert (result["plant.delta"][0], result["plant.delta_encoder"][0], result["plant.energy"][0] < 0) == (
        0.25,
        0.25,
        True,
    )
    assert result["controller.homogeneous_norm"][0] > 0.0


def by_hand(design, order, steps, step, wires, controller_changes, plant_changes, disturbance):
    """The same loop over the library's units; returns the outputs of both at each communication point."""
    controller_values = CONTROLLER.start_values(controller_start_values(design) | controller_changes)
    controller = IhcControllerUnit(controller_values)
    plant = QubePlant(PLANT.start_values(plant_start_values("ident") | plant_changes))
    sources = {w.target: w.source.split(".")[1] for w in wires if w.target.startswith("controller")}
    names = [v.name for v in PLANT.calculated]

    def seen():
        values = dict(zip(names, plant.outputs(), strict=True))
        wires = [sources.get(f"controller.{v.name}") for v in CONTROLLER.of("input")]
        return tuple(0.0 if name is None else values[name] for name in wires)

    controller.initialize(0.0, seen())
    plant.initialize(0.0, (0.0, 0.0, 0.0))
    rows = [(*controller.outputs(), *plant.outputs())]
    for k in range(steps):
        time, earlier = k * step, controller.outputs()[0]
        assert controller.step(time, step, seen()) == []
        voltage = earlier if order == "parallel" else controller.outputs()[0]
        assert plant.step(time, step, (voltage, disturbance(time), 0.0)) == []
        rows.append((*controller.outputs(), *plant.outputs()))
    return np.array(rows)


@pytest.mark.parametrize("order", ["controller-first", "parallel"])
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("tilt", {"run.seed": 5, "plant.start.noise_std": 1e-4, **DISTURBED}),
        ("swing_up", {"run.duration": 1.3}),
        ("tilt_ideal", {"controller.start.sample_time": 2e-3}),
        ("tilt_kalman", {"run.step": 2e-3, **DISTURBED}),
    ],
)
def test_the_master_adds_nothing_to_a_loop_over_the_units(fmus, design, order, name, changes):
    scenario, folder = load_scenario(name)
    scenario = scenario.changed({"run.duration": 0.4, "run.order": order, **changes})
    system = build_system(scenario, fmus, folder)
    result = simulate(system, scenario.run.step, scenario.run.duration, order)
    controller, plant = (dict(component.start) for component in system.components)
    expected = by_hand(
        design,
        order,
        len(result.time) - 1,
        scenario.run.step,
        system.wires,
        controller,
        plant,
        scenario.disturbance.at,
    )
    variables = [
        (f"{part}.{v.name}", v) for part, i in (("controller", CONTROLLER), ("plant", PLANT)) for v in i.calculated
    ]
    columns = {name: column for column, (name, v) in enumerate(variables) if v.causality == "output"}
    assert list(result.signals) == list(columns)
    for signal, column in columns.items():
        np.testing.assert_array_equal(result[signal], expected[:, column], err_msg=signal)


@pytest.mark.parametrize("law", ["LC", "IHC"])
def test_the_result_does_not_depend_on_the_communication_step(pair, law):
    """The controller samples at the same instants; only the plant's solver steps may become shorter."""
    results = [
        run(
            pair("tilt_ideal", controller__start__sample_time=1e-3, controller__start__law=law),
            steps=500 * finer,
            step=1e-3 / finer,
            every=finer,
        )
        for finer in (1, 2, 4)
    ]
    coarse = results[0]
    for fine in results[1:]:
        np.testing.assert_allclose(fine.time, coarse.time, atol=1e-12)
        for name, tolerance in (("plant.theta", 1e-9), ("plant.delta", 1e-9), ("controller.voltage", 1e-7)):
            np.testing.assert_allclose(fine[name], coarse[name], rtol=0, atol=tolerance, err_msg=name)


# Recording and metadata


def test_what_is_recorded_does_not_change_the_run(pair):
    full = run(pair(), steps=200)
    sparse = run(pair(), steps=200, record=["plant.delta", "controller.mode"], every=7)
    rows = [*range(0, 200, 7), 200]
    assert list(sparse.signals) == ["plant.delta", "controller.mode"]
    assert sparse.time.tolist() == full.time[rows].tolist()
    for name, signal in sparse.signals.items():
        assert signal.tolist() == full[name][rows].tolist()


def test_metadata_say_how_the_result_came_about(pair, fmus):
    system = pair(controller__start__law="SMC")
    about = run(system, steps=5, order="parallel", every=2, metadata={"purpose": "test"}).metadata
    guids = {part: describe(fmus / file).guid for part, file in FILES.items()}
    assert {part: fmu["guid"] for part, fmu in about["fmus"].items()} == guids
    assert {part: fmu["file"] for part, fmu in about["fmus"].items()} == FILES
    assert about["versions"]["fmpy"] == version("fmpy")
    assert about["start_values"]["controller"] == {"sample_time": 1e-3, "law": 2}
    assert about["start_values"]["plant"]["delta_0"] == 0.1
    assert about["wires"] == [[w.source, w.target] for w in system.wires]
    found = {name: about[name] for name in ("order", "step", "every", "complete", "purpose", "messages")}
    assert found == {
        "order": "parallel",
        "step": 1e-3,
        "every": 2,
        "complete": True,
        "purpose": "test",
        "messages": {},
    }


FILES = {"controller": "IhcController.fmu", "plant": "QubeServo2.fmu"}


def test_units_are_those_of_the_fmus(pair):
    units = run(pair(), steps=1).units
    assert {n: units[n] for n in ("plant.theta_dot", "controller.voltage", "controller.mode")} == {
        "plant.theta_dot": "rad/s",
        "controller.voltage": "V",
        "controller.mode": "1",
    }


def test_messages_are_kept_by_instance(tiny):
    about = run(
        SystemStructure([tiny("a", warn_at=2, gain=2.0), tiny("b"), tiny("c", warn_at=1, gain=3.0)]), steps=3
    ).metadata
    assert set(about["messages"]) == {"a", "c"}
    assert ["gain 2" in message for message in about["messages"]["a"]] == [True]
    assert ["gain 3" in message for message in about["messages"]["c"]] == [True]


# Failures


@pytest.mark.parametrize("order", ["controller-first", "parallel"])
def test_a_failing_fmu_leaves_time_instance_cause_and_rows(tiny, order):
    system = SystemStructure([tiny("a"), tiny("b", fail_at=8)], [Wire("a.y", "b.u")])
    with pytest.raises(SimulationError, match=r"^at t = 0\.7 s: b: doStep\(.*told to fail in call 8$") as failure:
        run(system, steps=20, step=0.1, order=order)
    error = failure.value
    assert (error.time, error.instance) == (pytest.approx(0.7), "b")
    assert error.result["b.calls"].tolist() == list(range(8))
    assert error.result.metadata["complete"] is False
    assert any("Traceback" in message for message in error.result.metadata["messages"]["b"])
    assert run(SystemStructure([tiny("a"), tiny("b")]), steps=3)["b.calls"].tolist() == [0, 1, 2, 3]


def test_a_step_that_the_controller_cannot_work_with_is_named(pair):
    controller, plant = pair().components  # a scenario refuses it before
    late = replace(controller, start={**controller.start, "sample_time": 0.0015})
    with pytest.raises(
        SimulationError, match=r"controller: .*sample_time = 0\.0015 s and .* step of 0\.001 s"
    ) as failure:
        run(replace(pair(), components=(late, plant)))
    assert len(failure.value.result.time) == 1


def test_start_values_that_contradict_each_other_fail_without_rows(pair):
    with pytest.raises(SimulationError, match="a_min must not exceed b_max, found a_min = 2") as failure:
        run(pair(controller__start__a_min=2.0))
    assert (failure.value.instance, len(failure.value.result.time)) == ("controller", 0)


def test_a_signal_that_is_not_finite_is_named_with_its_time(tiny):
    system = SystemStructure([tiny()], signals=[Signal("a.u", lambda t: math.nan if t > 0.25 else t)])
    with pytest.raises(SimulationError, match=r"at t = 0\.3 s: a: .*u must be finite, found nan") as failure:
        run(system, steps=20, step=0.1)
    assert len(failure.value.result.time) == 4


def test_an_interrupt_leaves_the_rows(tiny):
    seen = []

    def interrupt(done, total):
        seen.append(done)
        if done >= 2 * PROGRESS_EVERY:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as stopped:
        run(SystemStructure([tiny()]), steps=50_000, progress=interrupt)
    assert isinstance(stopped.value, KeyboardInterrupt)
    assert stopped.value.result["a.calls"].tolist() == list(range(seen[-1] + 1))
    assert stopped.value.result.metadata["complete"] is False


def test_an_error_of_a_signal_is_passed_on_and_the_instances_are_freed(tiny):
    with pytest.raises(ZeroDivisionError):
        run(SystemStructure([tiny()], signals=[Signal("a.u", lambda t: 1.0 / (t - 0.002))]))
    assert run(SystemStructure([tiny()]), steps=2)["a.calls"].tolist() == [0, 1, 2]


# Many systems in one process


def test_runs_do_not_remember_each_other(pair, same):
    first = run(pair(), steps=300)
    other = run(pair("swing_up", plant__parameters="hcs", controller__start__law="LC"), steps=300)
    again = run(pair(), steps=300)
    same(first, again)
    assert abs(other["plant.delta"] - first["plant.delta"]).max() > 1.0


def test_two_systems_side_by_side_do_not_interact(pair):
    systems = {"1": pair(), "2": pair("swing_up", plant__parameters="hcs")}
    alone = {key: run(system, steps=300) for key, system in systems.items()}
    components = [Component(c.name + key, c.path, c.start) for key, s in systems.items() for c in s.components]
    wires = [Wire(_numbered(w.source, key), _numbered(w.target, key)) for key, s in systems.items() for w in s.wires]
    together = run(SystemStructure(components, wires), steps=300)
    for key, result in alone.items():
        for name, signal in result.signals.items():
            assert together[_numbered(name, key)].tolist() == signal.tolist(), name


def _numbered(name, key):
    instance, variable = name.split(".")
    return f"{instance}{key}.{variable}"


def living_slaves():
    gc.collect()
    return sum(type(thing).__name__ == "Tiny" for thing in gc.get_objects())


def test_instances_are_freed_with_the_run_also_with_one_that_is_interrupted(tiny):
    before, seen = living_slaves(), []

    def look(done, total):
        seen.append(living_slaves() - before)
        if done < total:
            raise KeyboardInterrupt

    run(SystemStructure([tiny("a"), tiny("b")]), steps=2, progress=look)
    assert (seen, living_slaves()) == ([2], before)
    with pytest.raises(Interrupted):
        run(SystemStructure([tiny("a"), tiny("b")]), steps=50_000, progress=look)
    assert (seen, living_slaves()) == ([2, 2], before)


def open_files():
    return len(list(Path("/proc/self/fd").iterdir()))


def test_many_runs_leave_nothing_behind(pair, tiny):
    run(pair(), steps=1)
    run(SystemStructure([tiny()]), steps=1)
    path, files = list(sys.path), open_files()
    for _ in range(50):
        run(pair(), steps=1)
    for _ in range(150):
        run(SystemStructure([tiny()]), steps=1)
    assert sys.path == path
    assert open_files() == files
