"""What both kinds of FMU promise, asked of both by the same calls of the C interface: refusals, values, state."""

import ctypes
import math
import re

import pytest

from tests.fmu_export.conftest import CONTROLLER, DEMANDING, NAMES, PLANT, STEP, inputs_at, run

WARNING, ERROR = 1, 3
IDLE, STABILIZING, FAULT = 1, 3, 4
NON_FINITE_INPUT = 2
NAN, INFINITY = math.nan, math.inf


def close(values):
    """Equal to the last bit on Linux x86-64, where the tests of the units ask for it."""
    return pytest.approx(values, rel=1e-12, abs=1e-15)


# Refusals: (unit, what precedes, the call that must fail, parts of its cause). All run in one process of their own, because
# after a failure of a Python FMU a host must not trust its process.

INIT, READY = "h.setup(); h.done('EnterInitializationMode')", "h.initialize()"
ENDED = READY + "; h.done('Terminate')"
STEPPED = READY + "; [h.step(k * 1e-3, 1e-3, **moved) for k in range(3)]"
LIMITED = "h.done('SetupExperiment', 0, 0.0, 0.0, 1, 0.0025); h.done('EnterInitializationMode'); "
LIMITED += "h.done('ExitInitializationMode'); [h.step(k * 1e-3, 1e-3) for k in range(2)]"
BOTH = (PLANT, CONTROLLER)


def hang(time, step):
    return f"h.call('DoStep', float('{time}'), float('{step}'), 1)"


def put(**values):
    return f"h.call(*h.setting(**{values!r}))".replace("inf", "float('inf')").replace(": nan", ": float('nan')")


def read(kind, variable):
    return f"h.call('Get{kind}', *one({variable!r}))"


def write(kind, variable):
    return f"h.call('Set{kind}', *one({variable!r}))"


SETUP = "h.call('SetupExperiment', 0, 0.0, float('{}'), {}, {})"

REFUSALS = {
    "step before initialization": (BOTH, "", hang(0.0, STEP), ["oStep", "'instantiated'"]),
    "step in initialization": (BOTH, INIT, hang(0.0, STEP), ["oStep", "'initialization mode'"]),
    "step after the end": (BOTH, ENDED, hang(0.0, STEP), ["oStep", "'terminated'"]),
    "step of no length": (BOTH, STEPPED, hang(0.003, 0.0), ["communication step", "positive", "found 0 s"]),
    "step backwards": (BOTH, STEPPED, hang(0.003, -STEP), ["communication step", "positive", "-0.001 s"]),
    "step of NaN": (BOTH, STEPPED, hang(0.003, NAN), ["communication step", "finite", "nan"]),
    "endless step": (BOTH, STEPPED, hang(0.003, INFINITY), ["communication step", "finite", "inf"]),
    "jump ahead": (BOTH, STEPPED, hang(0.004, STEP), ["time must not jump", "0.003", "0.004"]),
    "a little jump": (BOTH, STEPPED, hang(0.003 + 2e-9, STEP), ["time must not jump"]),
    "jump back": (BOTH, STEPPED, hang(0.002, STEP), ["time must not jump", "0.003", "0.002"]),
    "time of NaN": (BOTH, READY, hang(NAN, STEP), ["time must not jump", "nan"]),
    "jump from the start time": (BOTH, "h.initialize(2.5)", hang(0.0, STEP), ["jump", "2.5", "0"]),
    "step beyond the stop time": (BOTH, LIMITED, hang(0.002, STEP), ["must not pass the stop time 0.0025", "0.003"]),
    "no experiment": (BOTH, "", "h.call('EnterInitializationMode')", ["etupExperiment"]),
    "initialization twice": (BOTH, READY, "h.call('EnterInitializationMode')", ["nterInitializationMode", "'step'"]),
    "end of initialization twice": (BOTH, READY, "h.call('ExitInitializationMode')", ["xitInitialization", "'step'"]),
    "end of no initialization": (BOTH, "", "h.call('ExitInitializationMode')", ["xitInitializ", "'instantiated'"]),
    "end before the start": (BOTH, "", "h.call('Terminate')", ["erminate", "'instantiated'"]),
    "end twice": (BOTH, ENDED, "h.call('Terminate')", ["erminate", "'terminated'"]),
    "experiment while stepping": (BOTH, READY, SETUP.format(0.0, 0, 0.0), ["etupExperiment", "'step'"]),
    "start time of NaN": (BOTH, "", SETUP.format(NAN, 0, 0.0), ["start time", "finite", "nan"]),
    "stop before the start": (BOTH, "", SETUP.format(1.0, 1, 0.5), ["stop time must not be before", "1", "0.5"]),
    "output before initialization": (PLANT, "", read("Real", "theta"), ["outputs are defined from", "theta"]),
    "fixed Real while stepping": (PLANT, READY, put(m_p=0.03), ["m_p is a fixed parameter"]),
    "fixed Integer while stepping": (PLANT, READY, put(encoder_counts=4096), ["encoder_counts is a fixed parameter"]),
    "fixed Boolean while stepping": (PLANT, READY, put(back_emf=False), ["back_emf is a fixed parameter"]),
    "fixed choice while stepping": (PLANT, READY, put(motor_model=2), ["motor_model is a fixed parameter"]),
    "fixed gain while stepping": (CONTROLLER, READY, put(k_lin_1=2.0), ["k_lin_1 is a fixed parameter"]),
    "input after the end": (PLANT, ENDED, put(voltage=1.0), ["'terminated'"]),
    "output set before": (PLANT, "", put(theta=1.0), ["theta is an output and cannot be set"]),
    "output set while stepping": (PLANT, READY, put(theta=1.0), ["theta is an output and cannot be set"]),
    "output choice set": (CONTROLLER, READY, put(mode=2), ["mode is an output and cannot be set"]),
    "input of NaN": (PLANT, READY, put(voltage=NAN), ["voltage must be finite", "nan"]),
    "infinite input": (PLANT, READY, put(pendulum_torque=-INFINITY), ["pendulum_torque must be finite", "-inf"]),
    "first input of NaN": (PLANT, INIT, put(voltage=NAN), ["voltage must be finite", "nan"]),
    "parameter of NaN": (CONTROLLER, "", put(a_min=NAN), ["a_min must be finite", "nan"]),
    "Real out of range": (PLANT, "", put(solver_step=0.5), ["solver_step must lie in [1e-07, 0.1]", "0.5"]),
    "Integer out of range": (PLANT, "", put(encoder_counts=-1), ["encoder_counts must lie in [0, inf]", "-1"]),
    "choice out of range": (PLANT, "", put(motor_model=3), ["motor_model must lie in [1, 2]", "3"]),
    "tunable out of range": (CONTROLLER, READY, put(j_max=61), ["j_max must lie in [1, 60]", "61"]),
    "contradiction at the start": (
        CONTROLLER,
        "h.set(a_min=2.0); " + INIT,
        "h.call('ExitInitializationMode')",
        ["a_min must not exceed b_max", "a_min = 2", "b_max = 1"],
    ),
    "contradiction by tuning": (CONTROLLER, READY, put(b_max=0.5), ["a_min must not exceed b_max", "b_max = 0.5"]),
    "Real read as Integer": (PLANT, READY, read("Integer", "theta"), ["no Integer variable", "reference 3"]),
    "Real read as Boolean": (PLANT, READY, read("Boolean", 0), ["no Boolean variable", "reference 0"]),
    "choice read as Real": (CONTROLLER, READY, read("Real", "mode"), ["no Real variable"]),
    "anything read as String": (PLANT, READY, read("String", 0), ["no String variables"]),
    "unknown reference read": (PLANT, READY, read("Real", 9999), ["no Real variable", "9999"]),
    "Boolean set as Real": (PLANT, "", write("Real", "back_emf"), ["no Real variable"]),
    "Real set as Boolean": (PLANT, "", write("Boolean", 0), ["no Boolean variable", "reference 0"]),
    "Real set as Integer": (PLANT, READY, write("Integer", 0), ["no Integer variable", "reference 0"]),
    "unknown reference set": (PLANT, READY, write("Real", 9999), ["no Real variable", "9999"]),
    "state without bounds": (
        PLANT,
        READY + "; h.set(pendulum_torque=1e300)",
        hang(0.0, STEP),
        ["left the range of numbers", "pendulum_torque = 1e+300", "t = 0"],
    ),
    "delay between two steps": (
        PLANT,
        "h.initialize(measurement_delay=1.5e-3)",
        hang(0.0, STEP),
        ["measurement_delay must be a multiple", "0.0015 s", "0.001 s"],
    ),
    "step that does not fit the sample time": (
        CONTROLLER,
        READY,
        hang(0.0, 2.5e-3),
        ["sample_time must be a multiple of the communication step, or the step of it", "0.001 s", "0.0025 s"],
    ),
}

REFUSE = """
import ctypes, gc
from conftest import Native, PLANT
gc.disable()

def one(variable):
    reference = h.reference(variable) if isinstance(variable, str) else variable
    return (ctypes.c_uint * 1)(reference), 1, (ctypes.c_double * 1)()

result = {}
for kind, folders in data["folders"].items():
    for case, (names, before, call, _) in data["cases"].items():
        for name in [names] if isinstance(names, str) else names:
            h = Native(folders[name])
            moved = {"voltage": 1.5} if name == PLANT else {"theta": 0.25}
            exec(before)
            assert not h.log, h.log
            status = eval(call)
            result[f"{kind} {case} {name}"] = {"status": status, "log": h.log}
            h.free()
"""


@pytest.fixture(scope="module")
def refusals(run_python, folders, native_folders):
    kinds = {"native": native_folders, "python": folders}
    paths = {kind: {name: str(folder) for name, folder in of.items()} for kind, of in kinds.items()}
    return run_python(REFUSE, {"cases": REFUSALS, "folders": paths})


@pytest.mark.parametrize("case", REFUSALS)
def test_refusal_has_its_cause_in_the_log(case, refusals, slaves):
    units, _, _, parts = REFUSALS[case]
    for name in [units] if isinstance(units, str) else units:
        for kind in ("native", "python"):
            refusal = refusals[f"{kind} {case} {name}"]
            assert refusal["status"] == ERROR if kind == "native" else refusal["status"] >= ERROR
            status, category, message = refusal["log"][0]
            assert (status, category) == (ERROR, "logStatusError")
            assert [part for part in parts if part not in message.replace("-nan", "nan")] == [], (kind, message)
            if kind == "native":
                assert len(refusal["log"]) == 1
            else:
                assert "Traceback" in message
                assert re.search(r"\bt = \S+ s\b", message)
                assert [v.name for v in slaves[name].interface.of("input") if f"{v.name} = " not in message] == []


# Inputs and steps


@pytest.mark.parametrize("bad", [NAN, INFINITY, -INFINITY])
def test_controller_turns_a_bad_measurement_into_a_fault_that_stays(bad, fmu):
    instance = fmu(CONTROLLER).initialize()
    held = {"theta": 0.1, "delta": 0.05, "theta_dot": 0.0, "delta_dot": 0.0}
    for k in range(3):
        instance.step(k * STEP, STEP, **held)
    assert instance.get("voltage", "fault") != (0.0, NON_FINITE_INPUT)
    assert instance.log == []
    instance.step(3 * STEP, STEP, delta=bad)
    assert instance.get("voltage", "mode", "fault") == (0.0, FAULT, NON_FINITE_INPUT)
    ((status, category, message),) = instance.log
    assert (status, category) == (WARNING, "logStatusWarning")
    assert "t = 0.003 s" in message
    assert f"delta = {bad}" in message.replace("-nan", "nan")
    for k in range(4, 8):
        instance.step(k * STEP, STEP, **held)
    assert instance.get("voltage", "mode", "fault") == (0.0, FAULT, NON_FINITE_INPUT)
    assert len(instance.log) == 1
    instance.done("Reset")
    instance.initialize().step(0.0, STEP, theta=0.0, delta=0.0)
    assert instance.get("mode", "fault") == (STABILIZING, 1)


def test_first_measurement_may_be_missing(fmu):
    instance = fmu(CONTROLLER).initialize(theta=NAN)
    assert instance.get("voltage", "mode", "homogeneous_norm") == (0.0, IDLE, 0.0)
    instance.step(0.0, STEP, theta=0.0)
    assert instance.get("fault") == (1,)


def test_a_long_step_is_as_many_samples_and_is_warned_of_once(fmu):
    long, short = fmu(CONTROLLER).initialize(), fmu(CONTROLLER).initialize()
    for k in range(5):
        held = inputs_at(CONTROLLER, 8 * k)
        outputs = long.step(k * 8e-3, 8e-3, **held)
        assert outputs == [short.step((8 * k + i) * STEP, STEP, **held) for i in range(8)][-1]
    ((status, category, message),) = long.log
    assert (status, category) == (WARNING, "logStatusWarning")
    assert "a communication step of 0.008 s holds the inputs over several samples" in message
    assert short.log == []


def test_the_stop_time_is_reached_by_steps_that_are_not_exact(name, fmu):
    instance, time = fmu(name), 0.0
    instance.done("SetupExperiment", 0, 0.0, 0.0, 1, 0.1)
    instance.done("EnterInitializationMode")
    instance.done("ExitInitializationMode")
    for _ in range(100):
        instance.step(time, STEP)
        time += STEP
    assert time > 0.1


@pytest.mark.parametrize(("step", "first"), [(1 / 60, 6_000_000), (1e-5 / 3, 30_000_000_000)])
def test_rounding_of_late_times_is_not_taken_for_a_jump(step, first, fmu):
    plant, controller = fmu(PLANT).initialize(first * step), fmu(CONTROLLER).initialize(first * step, sample_time=step)
    for k in range(first, first + 200):
        controller.step(k * step, step)
        plant.step(k * step, step)


# Outputs and parameters


def test_outputs_in_initialization_follow_what_is_set(name, fmu, unit):
    first, instance = inputs_at(name, 30), fmu(name)
    instance.setup(2.5)
    instance.done("EnterInitializationMode")
    assert instance.outputs() == close(unit(name).outputs())
    changes = {PLANT: {"theta_0": 0.25, "delta_0": 0.5, "theta_dot_0": 3.0}, CONTROLLER: {"mu": 0.5}}[name]
    instance.set(**first, **changes)
    library = unit(name, **changes)
    library.initialize(2.5, tuple(first.values()))
    assert library.outputs() != unit(name).outputs()
    initial = instance.outputs()
    assert initial == close(library.outputs())
    instance.done("ExitInitializationMode")
    assert instance.outputs() == initial
    library.step(2.5, STEP, tuple(first.values()))
    assert instance.step(2.5, STEP) == close(library.outputs())


def test_outputs_change_with_steps_only(name, fmu):
    instance = fmu(name).initialize(**DEMANDING[name])
    for k in range(60):
        before = run(instance, name, k, k + 1)[0]
        instance.set(**inputs_at(name, 1000 + k))
        assert instance.outputs() == before


def test_tunable_parameters_take_effect_at_the_next_sample(fmu, start):
    x = {"theta": 0.02, "delta": 0.01, "theta_dot": 0.1, "delta_dot": -0.05}
    k_lin = [start[CONTROLLER][f"k_lin_{i}"] for i in (1, 2, 3, 4)]
    linear = sum(k * value for k, value in zip(k_lin, x.values(), strict=True))
    instance = fmu(CONTROLLER).initialize(velocity_source=2)

    def after(k, **tuned):
        before = instance.outputs()
        instance.set(**tuned)
        assert instance.outputs() == before
        instance.step(k * STEP, STEP, **x)
        return instance.get("voltage", "mode")

    homogeneous, mode = after(0)
    assert mode == STABILIZING
    assert abs(homogeneous - linear) > 1e-3
    assert after(1, law=1) == (pytest.approx(linear, rel=1e-12), STABILIZING)
    assert after(2, voltage_limit=0.01) == (math.copysign(0.01, linear), STABILIZING)
    assert after(3, enabled=False) == (0.0, IDLE)
    assert after(4, enabled=True, voltage_limit=10.0, law=3, a_min=1.0, j_max=40) == (
        pytest.approx(linear, rel=1e-9),
        STABILIZING,
    )


def test_tuning_to_the_same_values_disturbs_nothing(fmu, slaves):
    alone, tuned = fmu(CONTROLLER).initialize(), fmu(CONTROLLER).initialize()
    names = [v.name for v in slaves[CONTROLLER].interface.variables if v.variability == "tunable"]
    same = dict(zip(names, tuned.get(*names), strict=True))
    for k in range(0, 60, 3):
        tuned.set(**same)
        assert run(tuned, CONTROLLER, k, k + 3) == run(alone, CONTROLLER, k, k + 3)


# State


@pytest.mark.parametrize("taken", [0, 45])
def test_rollback_repeats_the_steps_bit_by_bit(name, taken, fmu):
    instance = fmu(name).initialize(**DEMANDING[name])
    run(instance, name, 0, taken)
    outputs, everything, state = instance.outputs(), instance.everything(), instance.save()
    first = run(instance, name, taken, taken + 20)
    assert outputs != first[-1]
    for source in (state, instance.deserialize(everything)):
        instance.done("SetFMUstate", source)
        assert instance.everything() == everything
        assert instance.outputs() == outputs
        assert run(instance, name, taken, taken + 20) == first
        instance.done("FreeFMUstate", ctypes.byref(source))


def test_state_brings_back_parameters_phase_and_stop_time(fmu):
    instance = fmu(CONTROLLER)
    fresh = instance.save()
    instance.initialize()
    running = instance.save()
    instance.set(voltage_limit=0.5)
    instance.done("Terminate")
    instance.done("SetFMUstate", running)
    assert instance.get("voltage_limit") == (10.0,)
    instance.step(0.0, STEP)
    instance.done("SetFMUstate", fresh)
    instance.initialize(k_lin_1=2.0)
    assert instance.get("k_lin_1") == (2.0,)


CONTINUE = """
from conftest import Native, run
result = []
for name, folder, state in data:
    h = Native(folder)
    h.done("SetFMUstate", h.deserialize(bytes.fromhex(state)))
    result.append([h.outputs(), *run(h, name, 45, 65)])
"""


def test_serialized_state_continues_in_a_new_process_bit_by_bit(fmu, run_python):
    units = {name: fmu(name).initialize(**DEMANDING[name]) for name in NAMES}
    before = {name: run(instance, name, 0, 45)[-1] for name, instance in units.items()}
    request = [(name, str(fmu.folders[name]), instance.everything().hex()) for name, instance in units.items()]
    for (name, instance), rows in zip(units.items(), run_python(CONTINUE, request), strict=True):
        assert [tuple(row) for row in rows] == [before[name], *run(instance, name, 45, 65)]


@pytest.mark.parametrize("ended", [False, True])
def test_reset_equals_a_fresh_instance(name, ended, fmu):
    instance, fresh = fmu(name), fmu(name)
    untouched = fresh.everything()
    instance.initialize(**DEMANDING[name])
    run(instance, name, 0, 45)
    if ended:
        instance.done("Terminate")
    instance.done("Reset")
    assert instance.everything() == untouched
    assert run(instance.initialize(), name, 0, 45) == run(fresh.initialize(), name, 0, 45)
    assert instance.everything() == fresh.everything()


def test_two_instances_do_not_interact(name, fmu):
    alone = run(fmu(name).initialize(**DEMANDING[name]), name, 0, 60)
    first, second = fmu(name).initialize(**DEMANDING[name]), fmu(name).initialize()
    together = []
    for k in range(60):
        together += run(first, name, k, k + 1)
        second.step(k * STEP, STEP, **inputs_at(name, 500 + k))
    assert together == alone
    assert first.outputs() != second.outputs()
