"""Instances driven through FMPy: refusals with their cause, outputs equal to the library's, state, reset, repetition."""

import math
import random
import re

import pytest

from fmu_export.guarded_slave import code_digest

PLANT, CONTROLLER = "QubeServo2", "IhcController"
WARNING, ERROR = 1, 3
IDLE, STABILIZING, FAULT = 1, 3, 4
NON_FINITE_INPUT = 2
STEP = 1e-3

DEMANDING = {
    PLANT: {"noise_std": 1e-3, "measurement_delay": 2e-3, "motor_model": 2, "solver_step": 2.5e-4},
    CONTROLLER: {"norm_solver": 1, "discretization": 2},
}
"""Parameters under which a unit has as much state as it can have."""


def inputs_at(name, k):
    """Inputs of step k: random for the plant; from hanging to upright for the controller, with noise."""
    rng = random.Random(k)
    if name == PLANT:
        return {"voltage": rng.uniform(-12, 12), "disturbance_voltage": rng.uniform(-1, 1), "pendulum_torque": 1e-4}
    delta = math.pi * max(0.0, 1 - k / 40) + 1e-3 * rng.random()
    return {"theta": 0.1 * math.sin(0.1 * k), "delta": delta, "theta_dot": rng.random(), "delta_dot": rng.random()}


def run(instance, name, first, last):
    """Outputs of the steps first, ..., last - 1."""
    return [instance.step(k * STEP, STEP, **inputs_at(name, k)) for k in range(first, last)]


# Refusals. Each case is (unit, what precedes, the call that must fail, parts of its cause), with `h` the instance; all
# run in one process of their own, because after a failure a host must not trust its process.

HANG = "h.slave.doStep({}, {})"
INIT = "h.slave.setupExperiment(); h.slave.enterInitializationMode()"
READY = "h.initialize()"
ENDED = "h.initialize(); h.slave.terminate()"

REFUSALS = {
    "step before initialization": (PLANT, "", HANG.format(0.0, STEP), ["doStep", "'step'", "'instantiated'"]),
    "step in initialization": (PLANT, INIT, HANG.format(0.0, STEP), ["doStep", "'step'", "'initialization'"]),
    "step after the end": (PLANT, ENDED, HANG.format(0.0, STEP), ["doStep", "'step'", "'terminated'"]),
    "step of no length": (PLANT, READY, HANG.format(0.0, 0.0), ["communication step", "positive", "0.0 s"]),
    "step backwards": (PLANT, READY, HANG.format(0.0, -STEP), ["communication step", "positive", "-0.001 s"]),
    "step of NaN": (PLANT, READY, "h.slave.doStep(0.0, float('nan'))", ["communication step", "finite", "nan"]),
    "endless step": (PLANT, READY, "h.slave.doStep(0.0, float('inf'))", ["communication step", "finite", "inf"]),
    "jump ahead": (PLANT, READY, HANG.format(0.5, STEP), ["time must not jump", "0.0 s", "0.5 s"]),
    "jump back": (PLANT, READY + "; h.slave.doStep(0.0, 1e-3)", HANG.format(0.0, STEP), ["jump", "0.001 s", "0.0 s"]),
    "time of NaN": (PLANT, READY, "h.slave.doStep(float('nan'), 1e-3)", ["time must not jump", "nan"]),
    "jump from the start time": (PLANT, "h.initialize(2.5)", HANG.format(0.0, STEP), ["jump", "2.5 s", "0.0 s"]),
    "initialization without experiment": (PLANT, "", "h.slave.enterInitializationMode()", ["setupExperiment"]),
    "initialization twice": (PLANT, READY, "h.slave.enterInitializationMode()", ["'instantiated'", "'step'"]),
    "end of initialization twice": (PLANT, READY, "h.slave.exitInitializationMode()", ["'initialization'", "'step'"]),
    "end of no initialization": (PLANT, "", "h.slave.exitInitializationMode()", ["'initialization'", "'instantiated'"]),
    "end before the start": (PLANT, "", "h.slave.terminate()", ["terminate", "'step'", "'instantiated'"]),
    "end twice": (PLANT, ENDED, "h.slave.terminate()", ["terminate", "'step'", "'terminated'"]),
    "experiment while stepping": (PLANT, READY, "h.slave.setupExperiment()", ["setupExperiment", "'instantiated'"]),
    "start time of NaN": (
        PLANT,
        "",
        "h.slave.setupExperiment(startTime=float('nan'))",
        ["start time", "finite", "nan"],
    ),
    "output before initialization": (PLANT, "", "h.get('theta')", ["outputs are defined from initialization", "theta"]),
    "fixed Real while stepping": (PLANT, READY, "h.set(m_p=0.03)", ["m_p", "fixed parameter", "'step'"]),
    "fixed Integer while stepping": (PLANT, READY, "h.set(encoder_counts=4096)", ["encoder_counts", "fixed", "'step'"]),
    "fixed Boolean while stepping": (PLANT, READY, "h.set(back_emf=False)", ["back_emf", "fixed parameter", "'step'"]),
    "fixed choice while stepping": (PLANT, READY, "h.set(motor_model=2)", ["motor_model", "fixed", "'step'"]),
    "fixed gain while stepping": (CONTROLLER, READY, "h.set(k_lin_1=2.0)", ["k_lin_1", "fixed parameter", "'step'"]),
    "input after the end": (PLANT, ENDED, "h.set(voltage=1.0)", ["voltage", "cannot be set", "'terminated'"]),
    "output set before": (PLANT, "", "h.set(theta=1.0)", ["theta is an output and cannot be set"]),
    "output set while stepping": (PLANT, READY, "h.set(theta=1.0)", ["theta is an output and cannot be set"]),
    "output choice set": (CONTROLLER, READY, "h.set(mode=2)", ["mode is an output and cannot be set"]),
    "input of NaN": (PLANT, READY, "h.set(voltage=float('nan'))", ["voltage must be finite", "nan"]),
    "infinite input": (
        PLANT,
        READY,
        "h.set(pendulum_torque=float('-inf'))",
        ["pendulum_torque must be finite", "-inf"],
    ),
    "first input of NaN": (PLANT, INIT, "h.set(voltage=float('nan'))", ["voltage must be finite", "nan"]),
    "parameter of NaN": (CONTROLLER, "", "h.set(a_min=float('nan'))", ["a_min must be finite", "nan"]),
    "Real out of range": (PLANT, "", "h.set(solver_step=0.5)", ["solver_step", "[1e-07, 0.1] s", "0.5"]),
    "Integer out of range": (PLANT, "", "h.set(encoder_counts=-1)", ["encoder_counts", "[0, inf]", "-1"]),
    "choice out of range": (PLANT, "", "h.set(motor_model=3)", ["motor_model", "[1, 2]", "3"]),
    "tunable out of range": (CONTROLLER, READY, "h.set(j_max=61)", ["j_max", "[1, 60]", "61"]),
    "massless pendulum": (
        PLANT,
        "",
        "h.set(m_p=0.0)",
        ["m_p", "[1e-12, 1e+12]", "0.0"],
    ),
    "contradiction at the start": (
        CONTROLLER,
        "h.set(a_min=2.0); " + INIT,
        "h.slave.exitInitializationMode()",
        ["a_min must not exceed b_max", "a_min = 2", "b_max = 1"],
    ),
    "contradiction by tuning": (CONTROLLER, READY, "h.set(b_max=0.5)", ["a_min must not exceed b_max", "b_max = 0.5"]),
    "Real read as Integer": (PLANT, READY, "h.slave.getInteger([h.reference('theta')])", ["no Integer variable", "3"]),
    "Real read as Boolean": (PLANT, READY, "h.slave.getBoolean([0])", ["no Boolean variable", "value reference 0"]),
    "choice read as Real": (CONTROLLER, READY, "h.slave.getReal([h.reference('mode')])", ["no Real variable"]),
    "anything read as String": (PLANT, READY, "h.slave.getString([0])", ["no String variables", "[0]"]),
    "unknown reference read": (PLANT, READY, "h.slave.getReal([9999])", ["no Real variable", "9999"]),
    "Boolean set as Real": (PLANT, "", "h.slave.setReal([h.reference('back_emf')], [1.0])", ["no Real variable"]),
    "Real set as Boolean": (PLANT, "", "h.slave.setBoolean([0], [True])", ["no Boolean variable", "value reference 0"]),
    "Real set as Integer": (PLANT, READY, "h.slave.setInteger([0], [1])", ["no Integer variable", "value reference 0"]),
    "anything set as String": (PLANT, READY, "h.slave.setString([0], ['1'])", ["no String variables", "[0]"]),
    "unknown reference set": (PLANT, READY, "h.slave.setReal([9999], [1.0])", ["no Real variable", "9999"]),
    "state without bounds": (
        PLANT,
        READY + "; h.set(pendulum_torque=1e300)",
        HANG.format(0.0, STEP),
        ["left the range of numbers", "unit.py"],
    ),
    "delay between two steps": (
        PLANT,
        "h.initialize(measurement_delay=1.5e-3)",
        HANG.format(0.0, STEP),
        ["measurement_delay must be a multiple", "0.0015 s", "0.001 s"],
    ),
    "step that the sample time does not divide": (
        CONTROLLER,
        READY,
        HANG.format(0.0, 3e-4),
        ["sample_time must be a multiple", "0.001 s", "0.0003 s"],
    ),
    "state of the other unit": (
        CONTROLLER,
        READY + """; s = h.slave.deSerializeFMUstate(b'{"format": 1, "unit_name": "QubeServo2", "values": []}')""",
        "h.slave.setFMUstate(s)",
        ["the state must be of", "'IhcController'", "'QubeServo2'"],
    ),
    "after three steps": (
        PLANT,
        READY + "; [h.step(k * 1e-3, 1e-3, voltage=1.5) for k in range(3)]",
        HANG.format(7.0, STEP),
        ["t = 0.003 s", "voltage = 1.5", "pendulum_torque = 0.0"],
    ),
}

REFUSE = """
import gc
from conftest import Host
gc.disable()
result = {}
for case, (name, before, call, _) in data["cases"].items():
    h = Host(data["folders"][name])
    exec(before)
    assert not h.log, h.log
    try:
        exec(call)
    except Exception as error:
        status = getattr(error, "status", None)
    else:
        status = 0
    result[case] = {"status": status, "log": h.log}
    h.slave.freeInstance()
"""


@pytest.fixture(scope="module")
def refusals(run_python, folders):
    request = {"cases": REFUSALS, "folders": {name: str(folder) for name, folder in folders.items()}}
    return run_python(REFUSE, request)


@pytest.mark.parametrize("case", REFUSALS)
def test_refusal_has_its_cause_in_the_log(case, refusals, slaves):
    name, _, _, parts = REFUSALS[case]
    assert refusals[case]["status"] >= ERROR
    status, category, message = refusals[case]["log"][0]
    assert (status, category) == (ERROR, "logStatusError")
    assert [part for part in parts if part not in message] == []
    assert "Traceback" in message
    assert "guarded_slave.py" in message
    assert re.search(r"\bt = \S+ s\b", message)
    assert [v.name for v in slaves[name].interface.of("input") if f"{v.name} = " not in message] == []


def test_every_category_in_the_log_is_declared(refusals, folders):
    declared = (folders[PLANT] / "modelDescription.xml").read_text()
    used = {category for case in refusals.values() for _, category, _ in case["log"] if category}
    assert used
    assert [category for category in used if f'<Category name="{category}"' not in declared] == []


# Not refused


def test_host_without_logging_gets_no_messages(host):
    instance = host(CONTROLLER, logging=False).initialize()
    instance.step(0.0, STEP, delta=math.nan)
    assert instance.get("fault") == (NON_FINITE_INPUT,)
    assert instance.log == []


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_controller_turns_a_bad_measurement_into_a_fault_that_stays(bad, host):
    instance = host(CONTROLLER).initialize()
    held = {"theta": 0.1, "delta": 0.05}
    for k in range(3):
        instance.step(k * STEP, STEP, **held)
    assert instance.get("voltage", "fault") != (0.0, NON_FINITE_INPUT)
    assert instance.log == []
    instance.step(3 * STEP, STEP, delta=bad)
    assert instance.get("voltage", "mode", "fault") == (0.0, FAULT, NON_FINITE_INPUT)
    ((status, category, message),) = instance.log
    assert (status, category) == (WARNING, "logStatusWarning")
    assert "t = 0.003 s" in message
    assert f"delta = {bad}" in message
    for k in range(4, 8):
        instance.step(k * STEP, STEP, **held)
    assert instance.get("voltage", "mode", "fault") == (0.0, FAULT, NON_FINITE_INPUT)
    assert len(instance.log) == 1


def test_first_measurement_may_be_missing(host):
    instance = host(CONTROLLER).initialize(theta=math.nan)
    assert instance.get("voltage", "mode", "homogeneous_norm") == (0.0, IDLE, 0.0)
    instance.step(0.0, STEP, theta=0.0)
    assert instance.get("fault") == (1,)


# Outputs


def test_outputs_in_initialization_follow_what_is_set(name, host, unit, slaves):
    first = inputs_at(name, 30)
    instance = host(name)
    instance.slave.setupExperiment(startTime=2.5)
    instance.slave.enterInitializationMode()
    assert instance.outputs() == unit(name).outputs()
    changes = {PLANT: {"theta_0": 0.25, "delta_0": 0.5, "theta_dot_0": 3.0}, CONTROLLER: {"mu": 0.5}}[name]
    instance.set(**first, **changes)
    library = unit(name, **changes)
    library.initialize(2.5, tuple(first.values()))
    assert library.outputs() != unit(name).outputs()
    assert instance.outputs() == library.outputs()
    instance.slave.exitInitializationMode()
    assert instance.outputs() == library.outputs()
    library.step(2.5, STEP, tuple(first.values()))
    assert instance.step(2.5, STEP) == library.outputs()


def test_outputs_change_with_steps_only_as_declared(name, host):
    instance = host(name).initialize(**DEMANDING[name])
    for k in range(60):
        before = run(instance, name, k, k + 1)[0]
        instance.set(**inputs_at(name, 1000 + k))
        assert instance.outputs() == before


@pytest.mark.parametrize("motor_model", [1, 2])
def test_plant_equals_the_library_under_random_voltages(motor_model, host, unit):
    changes = {**DEMANDING[PLANT], "motor_model": motor_model, "delta_0": 0.3}
    instance, library = host(PLANT).initialize(**changes), unit(PLANT, **changes)
    for k in range(500):
        inputs = inputs_at(PLANT, k)
        library.step(k * STEP, STEP, tuple(inputs.values()))
        assert instance.step(k * STEP, STEP, **inputs) == library.outputs()


def test_plant_equals_the_library_with_steps_of_any_length(host, unit):
    instance, library, rng, time = host(PLANT).initialize(delta_0=0.3), unit(PLANT, delta_0=0.3), random.Random(5), 0.0
    for _ in range(100):
        step = 10 ** rng.uniform(-5, -1)
        library.step(time, step, (2.0, 0.0, 0.0))
        assert instance.step(time, step, voltage=2.0) == library.outputs()
        time += step


WIRES = {"theta": "theta_encoder", "delta": "delta_encoder", "theta_dot": "theta_dot", "delta_dot": "delta_dot"}


@pytest.mark.parametrize(
    ("of_plant", "of_controller", "reached"),
    [
        ({}, {}, 2),
        ({"delta_0": 0.1, "noise_std": 1e-4}, {}, STABILIZING),
        ({"delta_0": 0.1, "encoder_counts": 0}, {"law": 1, "velocity_source": 2}, STABILIZING),
        ({"delta_0": -0.1, "motor_model": 2, "solver_step": 2.5e-4}, {"law": 2}, STABILIZING),
        ({"delta_0": 0.1}, {"norm_solver": 2, "discretization": 2, "sample_time": 5e-3}, STABILIZING),
    ],
    ids=["swing-up", "IHC", "LC", "SMC", "slow exact IHC"],
)
def test_closed_loop_equals_the_library_exactly(of_plant, of_controller, reached, host, unit):
    plant, controller = host(PLANT), host(CONTROLLER)
    plant.initialize(**of_plant)
    own_plant, own_controller = unit(PLANT, **of_plant), unit(CONTROLLER, **of_controller)
    measured = dict(zip(WIRES, plant.get(*WIRES.values()), strict=True))
    controller.initialize(**of_controller, **measured)
    own_controller.initialize(0.0, tuple(measured.values()))
    places = [plant.output_names.index(source) for source in WIRES.values()]
    modes = set()
    for k in range(500):
        t = k * STEP
        own_controller.step(t, STEP, tuple(own_plant.outputs()[i] for i in places))
        own_plant.step(t, STEP, (own_controller.outputs()[0], 0.0, 0.0))
        commanded = controller.step(t, STEP, **dict(zip(WIRES, plant.get(*WIRES.values()), strict=True)))
        assert commanded == own_controller.outputs()
        assert plant.step(t, STEP, voltage=commanded[0]) == own_plant.outputs()
        modes.add(commanded[controller.output_names.index("mode")])
    assert reached in modes


@pytest.mark.parametrize(("step", "first"), [(1 / 60, 6_000_000), (1e-5 / 3, 30_000_000_000)])
def test_rounding_of_late_times_is_not_taken_for_a_jump(step, first, host):
    plant = host(PLANT).initialize(first * step)
    controller = host(CONTROLLER).initialize(first * step, sample_time=step)
    for k in range(first, first + 500):
        controller.step(k * step, step)
        plant.step(k * step, step)


# Tunable parameters


def test_tunable_parameters_take_effect_at_the_next_sample(host, start):
    x = {"theta": 0.02, "delta": 0.01, "theta_dot": 0.1, "delta_dot": -0.05}
    k_lin = [start[CONTROLLER][f"k_lin_{i}"] for i in (1, 2, 3, 4)]
    linear = sum(k * value for k, value in zip(k_lin, x.values(), strict=True))
    instance = host(CONTROLLER).initialize(velocity_source=2)

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


def test_tuning_to_the_same_values_disturbs_nothing(host, slaves):
    alone, tuned = host(CONTROLLER).initialize(), host(CONTROLLER).initialize()
    names = [v.name for v in slaves[CONTROLLER].interface.variables if v.variability == "tunable"]
    same = dict(zip(names, tuned.get(*names), strict=True))
    for k in range(60):
        tuned.set(**same)
        assert run(tuned, CONTROLLER, k, k + 1) == run(alone, CONTROLLER, k, k + 1)


# State


@pytest.mark.parametrize("taken", [0, 1, 17, 45])
def test_rollback_repeats_the_steps_bit_by_bit(name, taken, host):
    instance = host(name).initialize(**DEMANDING[name])
    run(instance, name, 0, taken)
    outputs, state = instance.outputs(), instance.slave.getFMUstate()
    first = run(instance, name, taken, taken + 20)
    assert outputs != first[-1]
    for _ in range(2):
        instance.slave.setFMUstate(state)
        assert instance.outputs() == outputs
        assert run(instance, name, taken, taken + 20) == first
    instance.slave.freeFMUstate(state)


def test_state_brings_back_parameters_and_phase(host):
    instance = host(CONTROLLER)
    fresh = instance.slave.getFMUstate()
    instance.initialize()
    running = instance.slave.getFMUstate()
    instance.set(voltage_limit=0.5)
    instance.slave.terminate()
    instance.slave.setFMUstate(running)
    assert instance.get("voltage_limit") == (10.0,)
    instance.step(0.0, STEP)
    instance.slave.setFMUstate(fresh)
    instance.initialize(k_lin_1=2.0)
    assert instance.get("k_lin_1") == (2.0,)


CONTINUE = """
from conftest import Host
h = Host(data["folder"])
h.slave.setFMUstate(h.slave.deSerializeFMUstate(bytes.fromhex(data["state"])))
result = [list(h.outputs())] + [list(h.step(time, data["step"], **inputs)) for time, inputs in data["rows"]]
"""


def test_serialized_state_continues_in_a_new_process_bit_by_bit(name, host, folders, run_python):
    instance = host(name).initialize(**DEMANDING[name])
    before = run(instance, name, 0, 45)
    state = instance.slave.getFMUstate()
    serialized = instance.slave.serializeFMUstate(state)
    rows = [(k * STEP, inputs_at(name, k)) for k in range(45, 65)]
    request = {"folder": str(folders[name]), "state": serialized.hex(), "step": STEP, "rows": rows}
    found = run_python(CONTINUE, request)
    assert [tuple(row) for row in found] == [before[-1], *run(instance, name, 45, 65)]


def test_serialized_state_comes_back_the_same(name, host):
    instance = host(name).initialize(**DEMANDING[name])
    run(instance, name, 0, 45)
    slave = instance.slave
    once = slave.serializeFMUstate(slave.getFMUstate())
    slave.setFMUstate(slave.deSerializeFMUstate(once))
    assert slave.serializeFMUstate(slave.getFMUstate()) == once


@pytest.mark.parametrize("ended", [False, True])
def test_reset_equals_a_fresh_instance(name, ended, host):
    instance, fresh = host(name).initialize(**DEMANDING[name]), host(name).initialize()
    run(instance, name, 0, 45)
    if ended:
        instance.slave.terminate()
    instance.slave.reset()
    instance.initialize()
    assert instance.outputs() == fresh.outputs()
    assert run(instance, name, 0, 45) == run(fresh, name, 0, 45)


def test_faulted_controller_recovers_by_reset(host):
    instance = host(CONTROLLER).initialize()
    instance.step(0.0, STEP, theta=math.nan)
    assert instance.get("mode") == (FAULT,)
    instance.slave.reset()
    instance.initialize().step(0.0, STEP, theta=0.0, delta=0.0)
    assert instance.get("mode", "fault") == (STABILIZING, 1)


# Several instances


def test_two_instances_do_not_interact(name, host):
    alone = run(host(name).initialize(**DEMANDING[name]), name, 0, 60)
    first, second = host(name).initialize(**DEMANDING[name]), host(name).initialize()
    together = []
    for k in range(60):
        together += run(first, name, k, k + 1)
        second.step(k * STEP, STEP, **inputs_at(name, 500 + k))
    assert together == alone
    assert first.outputs() != second.outputs()


REPEAT = """
from conftest import Host
rows, modules = [], []
for _ in range(data["times"]):
    h = Host(data["folder"]).initialize()
    rows.append([list(h.step(k * 1e-3, 1e-3)) for k in range(3)])
    h.slave.terminate()
    h.slave.freeInstance()
    modules.append(len(sys.modules))
result = {"same": all(row == rows[0] for row in rows), "row": rows[0], "modules": [modules[0], modules[-1]]}
"""


def test_two_hundred_runs_in_one_process_are_the_same_and_load_no_more_modules(name, folders, host, run_python):
    found = run_python(REPEAT, {"folder": str(folders[name]), "times": 200})
    instance = host(name).initialize()
    assert found["same"]
    assert [tuple(row) for row in found["row"]] == [instance.step(k * STEP, STEP) for k in range(3)]
    assert found["modules"][0] == found["modules"][1]


# The digest of the bundled code


def test_digest_depends_on_the_names_and_contents_of_the_files_only():
    def digest(**files):
        return code_digest({f"{file.replace('__', '/')}.py": text.encode() for file, text in files.items()})

    one = digest(a="x = 1", sub__b="y = 2")
    assert digest(sub__b="y = 2", a="x = 1") == one
    others = [digest(a="x = 2", sub__b="y = 2"), digest(a="x = 1", sub__c="y = 2"), digest(a="x = 1", b="y = 2")]
    assert len({one, *others, digest(a="x = 1"), digest(a="y = 2", sub__b="x = 1")}) == 6


FREED = """
import gc
from conftest import Host
failing = [lambda h: h.slave.doStep(0.0, 1e-3), lambda h: h.slave.terminate(), lambda h: h.slave.setReal([9999], [0.0])]
failing += [lambda h: h.slave.getString([0]), lambda h: h.slave.setupExperiment(startTime=float("nan"))]
good = Host(data).initialize()
refused = 0
for _ in range(8):
    for fail in failing:
        h = Host(data)
        try:
            fail(h)
        except Exception:
            refused += 1
        h.slave.freeInstance()
        gc.collect()
result = [refused, list(good.step(0.0, 1e-3))]
"""


def test_failed_instances_can_be_freed_and_leave_the_process_sound(name, folders, unit, slaves, run_python):
    library = unit(name)
    library.initialize(0.0, inputs := tuple(0.0 for _ in slaves[name].interface.of("input")))
    library.step(0.0, 1e-3, inputs)
    assert run_python(FREED, str(folders[name])) == [40, list(library.outputs())]


BROKEN = """
from conftest import Host
refused = 0
for state in (b"not json", b"[1, 2]", b"{}", b"\\xff\\xfe"):
    h = Host(data).initialize()
    try:
        h.slave.setFMUstate(h.slave.deSerializeFMUstate(state))
    except Exception:
        refused += "the state must be of" in h.log[-2][2] + h.log[-1][2]
    h.slave.freeInstance()
result = refused
"""


def test_broken_states_are_refused_and_leave_the_process_sound(name, folders, run_python):
    assert run_python(BROKEN, str(folders[name])) == 4
