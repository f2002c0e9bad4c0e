"""What an instance of a native FMU holds: its variables, parameters, steps and outputs."""

import ctypes
import math

import pytest

from tests.fmu_export.calls import (
    BORN,
    CONTINUOUS,
    ENDED,
    ERROR,
    EVENT,
    EVERYWHERE,
    INFINITY,
    INITIALIZING,
    NAN,
    OK,
    PHASES,
    READY,
    STATES,
    STEPPED,
    bring,
    real,
    references,
)
from tests.fmu_export.conftest import CONTROLLER, PLANT, STEP, inputs_at, run, step_silently

# Values

PHASES_OF_ROLE = {
    "input": {BORN, INITIALIZING, READY, EVENT, CONTINUOUS},
    "tunable": {BORN, INITIALIZING, READY, EVENT},
    "fixed": {BORN, INITIALIZING},
    "output": set(),
    "local": set(),
}


def role(variable):
    return variable.variability if variable.causality == "parameter" else variable.causality


@pytest.mark.parametrize(("name", "kind", "phase"), EVERYWHERE)
def test_every_variable_can_be_set_in_its_states_only(name, kind, phase, native):
    instance = bring(native(name, kind), phase)
    before = instance.everything()
    for variable in instance.variables.values():
        is_output, is_real = role(variable) in ("output", "local"), variable.type == "Real"
        is_state = variable.name in STATES and phase == CONTINUOUS
        call = instance.setting(**{variable.name: 0 if is_output and not is_state else instance.get(variable.name)[0]})
        if (phase in PHASES_OF_ROLE[role(variable)] and (is_real or phase != CONTINUOUS)) or is_state:
            instance.done(*call)
        else:
            message = instance.refused(*call)
            if phase == ENDED or (phase == CONTINUOUS and not is_real):
                assert f"is not allowed in the state '{phase}'" in message
            elif is_output:
                assert message == f"{variable.name} is an output and cannot be set"
            else:
                assert f"{variable.name} is a {role(variable)} parameter" in message
    assert instance.everything() == before


def test_outputs_cannot_be_read_before_initialization(name, native):
    instance = native(name)
    for output in instance.output_names:
        one, number = references(instance.reference(output)), real(0.0)
        message = instance.refused(f"Get{instance.type(output)}", one, 1, number)
        assert message == f"outputs are defined from initialization on, asked for {output} before it"


def just_outside(variable):
    """Values next to the limits of a parameter, and the limits."""
    if variable.type == "Enumeration":
        items = len(variable.declaredType.items)
        return [0, items + 1, -(2**31), 2**31 - 1], [1, items]
    limits = [(float(limit), away) for limit, away in ((variable.min, -1), (variable.max, 1)) if limit is not None]
    if variable.type == "Integer":
        return [int(limit) + away for limit, away in limits], [int(limit) for limit, _ in limits]
    return [math.nextafter(limit, away * INFINITY) for limit, away in limits], [limit for limit, _ in limits]


def test_every_parameter_is_held_within_its_limits(name, native):
    instance, limited = native(name), 0
    for variable in instance.variables.values():
        if variable.causality != "parameter" or variable.type == "Boolean":
            continue
        outside, edges = just_outside(variable)
        limited += bool(outside)
        for value in edges:
            instance.set(**{variable.name: value})
        before = instance.everything()
        for value in outside:
            message = instance.refused(*instance.setting(**{variable.name: value}))
            assert message.startswith(f"{variable.name} must lie in [")
            assert f"found {value:g}" in message
        assert instance.everything() == before
    assert limited >= 20


@pytest.mark.parametrize("phase", PHASES[STEPPED][:3])
@pytest.mark.parametrize("bad", [NAN, INFINITY, -INFINITY])
def test_non_finite_numbers_are_refused(bad, phase, name, native):
    instance = bring(native(name), phase)
    before = instance.everything()
    for variable in instance.variables.values():
        if variable.type == "Real" and phase in PHASES_OF_ROLE[role(variable)]:
            if name == CONTROLLER and variable.causality == "input":
                continue
            message = instance.refused(*instance.setting(**{variable.name: bad}))
            assert f"{variable.name} must be finite, found {bad}" in message.replace("-nan", "nan")
    assert instance.everything() == before


def test_every_number_but_zero_is_true(native):
    instance = native(CONTROLLER)
    for number in (1, -1, 7, -(2**31)):
        instance.set(enabled=False)
        instance.set(enabled=number)
        assert instance.get("enabled") == (1,)


TOGETHER = {
    "one of them not finite": (PLANT, BORN, {"voltage": 1.0, "theta_0": 1.0, "pendulum_torque": NAN}),
    "one of them out of range": (PLANT, INITIALIZING, {"m_p": 0.1, "solver_step": 1.0, "L_p": 0.2}),
    "one of them an output": (PLANT, READY, {"voltage": 1.0, "theta": 1.0}),
    "one of them fixed": (PLANT, READY, {"voltage": 1.0, "m_p": 0.1}),
    "one Integer out of range": (PLANT, BORN, {"noise_seed": 7, "encoder_counts": -1}),
    "one of them fixed, one tunable": (CONTROLLER, READY, {"voltage_limit": 1.0, "theta": 1.0, "k_lin_1": 1.0}),
    "contradicting tunables": (CONTROLLER, READY, {"voltage_limit": 1.0, "a_min": 2.0, "b_max": 1.5}),
    "an input and contradicting tunables": (CONTROLLER, READY, {"theta": 1.0, "a_min": 2.0, "b_max": 1.5}),
}


@pytest.mark.parametrize("case", TOGETHER)
def test_several_variables_are_set_together_or_not_at_all(case, native):
    name, phase, values = TOGETHER[case]
    instance = bring(native(name), phase)
    before = instance.everything()
    assert instance.refused(*instance.setting(**values))
    assert instance.everything() == before


def test_an_unknown_reference_among_others_sets_nothing(name, native):
    instance = native(name).initialize()
    before = instance.everything()
    instance.refused("SetReal", references(0, 1, 9999), 3, real(0.5, 0.25, 0.125))
    assert instance.everything() == before


# Parameters that contradict each other

CONTRADICTIONS = {
    "limits": (CONTROLLER, {"a_min": 2.0}, {"b_max": 2.0}, ["a_min must not exceed b_max", "a_min = 2 ", "b_max = 1"]),
    "angles": (CONTROLLER, {"capture_angle": 0.9}, {"capture_angle": 0.5}, ["capture_angle", "fall_back_angle", "0.9"]),
    "singular Phi": (
        CONTROLLER,
        {f"Phi_1{j}": 0.0 for j in (1, 2, 3, 4)},
        {"Phi_11": 1.0, "Phi_12": 0.5, "Phi_13": 0.25, "Phi_14": 0.125},
        ["Phi must be regular"],
    ),
    "Kalman gain": (
        CONTROLLER,
        {"velocity_source": 3, "sample_time": 2e-3},
        {"velocity_source": 1, "sample_time": 1e-3},
        ["kalman_sample_time", "sample_time = 0.002 s"],
    ),
    "inertia": (
        PLANT,
        {"J_p": 1e-12, "J_r": 1e-12, "m_p": 1.0},
        {"J_p": 3e-5, "J_r": 6e-5, "m_p": 0.024},
        ["J_p and J_r must not vanish beside", "J_r = 1e-12"],
    ),
    "nominal inertia": (
        CONTROLLER,
        {"nominal_coupling": 1.0},
        {"nominal_coupling": 0.0},
        ["the square of nominal_coupling must be below"],
    ),
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_contradiction_at_the_end_of_initialization_can_be_put_right(case, native):
    name, wrong, right, parts = CONTRADICTIONS[case]
    instance = bring(native(name), INITIALIZING)
    instance.set(**wrong)
    for _ in range(2):
        message = instance.refused("ExitInitializationMode")
        assert [part for part in parts if part not in message] == []
    output = instance.output_names[0]
    message = instance.refused("GetReal", references(instance.reference(output)), 1, real(0.0))
    assert [part for part in parts if part not in message] == []
    instance.set(**right)
    instance.done("ExitInitializationMode")
    assert run(instance, name, 0, 5) == run(native(name).initialize(**{**wrong, **right}), name, 0, 5)


@pytest.mark.parametrize("case", ["limits", "angles"])
def test_contradiction_by_tuning_leaves_the_old_values_in_force(case, native):
    _, wrong, _, parts = CONTRADICTIONS[case]
    instance, other = native(CONTROLLER).initialize(), native(CONTROLLER).initialize()
    run(instance, CONTROLLER, 0, 45)
    run(other, CONTROLLER, 0, 45)
    message = instance.refused(*instance.setting(**wrong))
    assert [part for part in parts if part not in message] == []
    assert "t = 0.045 s" in message
    assert instance.everything() == other.everything()
    assert run(instance, CONTROLLER, 45, 60) == run(other, CONTROLLER, 45, 60)


def test_tunables_are_judged_together(native):
    instance = native(CONTROLLER).initialize()
    instance.done(*instance.setting(a_min=2.0, b_max=3.0))
    assert instance.get("a_min", "b_max") == (2.0, 3.0)


# Steps

JUMP = "time must not jump"
LENGTH = "the communication step must be positive and finite"

STEPS = {  # unit, parameters, inputs, the step that is refused, the right one, parts of the cause
    "of no length": (PLANT, {}, {}, (3e-3, 0.0), STEP, [LENGTH, "found 0 s"]),
    "backwards": (PLANT, {}, {}, (3e-3, -STEP), STEP, [LENGTH, "-0.001 s"]),
    "of NaN": (PLANT, {}, {}, (3e-3, NAN), STEP, [LENGTH, "nan"]),
    "endless": (CONTROLLER, {}, {}, (3e-3, INFINITY), STEP, [LENGTH, "inf"]),
    "ahead": (PLANT, {}, {}, (4e-3, STEP), STEP, [JUMP, "0.003", "0.004"]),
    "back": (CONTROLLER, {}, {}, (2e-3, STEP), STEP, [JUMP, "0.003", "0.002"]),
    "a little ahead": (PLANT, {}, {}, (3e-3 + 2e-9, STEP), STEP, [JUMP]),
    "at NaN": (CONTROLLER, {}, {}, (NAN, STEP), STEP, [JUMP, "nan"]),
    "at infinity": (PLANT, {}, {}, (INFINITY, STEP), STEP, [JUMP, "inf"]),
    "too long": (PLANT, {}, {}, (3e-3, 1e6), STEP, ["must not exceed 1000000 internal steps", "1e+06 s"]),
    "longest of all": (PLANT, {}, {}, (3e-3, 1.7e308), STEP, ["must not exceed 1000000 internal steps"]),
    "delay between two steps": (
        PLANT,
        {"measurement_delay": 2e-3},
        {},
        (3e-3, 1.5e-3),
        STEP,
        ["the communication step must stay the same", "0.0015 s after 0.001 s"],
    ),
    "state without bounds": (
        PLANT,
        {},
        {"pendulum_torque": 1e300},
        (3e-3, STEP),
        STEP,
        ["the state left the range of numbers", "before the step", "pendulum_torque = 1e+300"],
    ),
    "not a part of the sample time": (
        CONTROLLER,
        {},
        {},
        (3e-3, 3e-4),
        STEP,
        ["sample_time must be a multiple", "0.001 s", "0.0003 s"],
    ),
    "too many samples": (CONTROLLER, {}, {}, (3e-3, 1e4), STEP, ["must not exceed 1000000 samples", "10000 s"]),
    "of almost no length": (CONTROLLER, {}, {}, (3e-3, 1e-320), STEP, ["sample_time must be a multiple"]),
}


@pytest.mark.parametrize("case", STEPS)
def test_a_refused_step_changes_nothing_and_a_right_one_follows(case, native):
    name, parameters, inputs, wrong, right, parts = STEPS[case]
    instance, other = native(name).initialize(**parameters), native(name).initialize(**parameters)
    run(instance, name, 0, 3)
    run(other, name, 0, 3)
    usual = dict(zip(inputs, instance.get(*inputs), strict=True))
    instance.set(**inputs)
    message = instance.refused("DoStep", *wrong, 0)
    assert [part for part in parts if part not in message] == []
    status = ctypes.c_int()
    instance.done("GetStatus", 0, ctypes.byref(status))
    assert status.value == ERROR
    instance.set(**usual)
    assert instance.outputs() == other.outputs()
    assert instance.step(3e-3, right) == other.step(3e-3, right)
    assert instance.everything() == other.everything()
    assert run(instance, name, 4, 20) == run(other, name, 4, 20)


@pytest.mark.parametrize(
    ("delay", "step", "part"),
    [(1.5e-3, 1e-3, "must be a multiple of"), (2.0, 1e-3, "must not exceed 1000 communication")],
)
def test_a_delay_that_the_step_does_not_fit_is_refused(delay, step, part, native):
    instance = native(PLANT).initialize(measurement_delay=delay)
    message = instance.refused("DoStep", 0.0, step, 0)
    assert part in message
    assert f"{delay:g} s with a step of {step:g} s" in message
    instance.step(0.0, delay / 2)


@pytest.mark.parametrize("bad", [NAN, INFINITY, -INFINITY])
def test_the_experiment_must_begin_at_a_number_and_not_end_before(bad, name, native):
    instance = native(name)
    before = instance.everything()
    assert "the start time must be finite" in instance.refused("SetupExperiment", 0, 0.0, bad, 0, 0.0)
    assert "the stop time must not be before" in instance.refused("SetupExperiment", 0, 0.0, 1.0, 1, 0.5)
    assert "the stop time must not be before" in instance.refused("SetupExperiment", 0, 0.0, 1.0, 1, NAN)
    assert instance.everything() == before
    instance.done("SetupExperiment", 1, NAN, 1.0, 1, 1.0)


# Outputs


def test_values_at_the_start(native):
    plant = native(PLANT).initialize(voltage=5.0, theta_0=0.5, delta_0=0.0, delta_dot_0=2.0, encoder_counts=0)
    assert plant.get("theta", "delta", "theta_dot", "delta_dot") == (0.5, 0.0, 0.0, 2.0)
    assert plant.get("theta_encoder", "delta_encoder") == (0.5, 0.0)
    assert plant.get("voltage", "current") == (5.0, 0.0)
    controller = native(CONTROLLER).initialize(delta=0.05)
    assert controller.get("voltage", "mode", "fault", "homogeneous_norm_used") == (0.0, 1, 1, 1.0)
    assert controller.get("homogeneous_norm")[0] > 0.0


@pytest.mark.parametrize("changes", [{"theta_dot_0": 1e200}, {"m_p": 1e12, "J_r": 1e12}], ids=["velocity", "mass"])
def test_outputs_of_the_plant_are_finite_or_the_call_fails(changes, native):
    instance = native(PLANT)
    instance.set(**changes)
    bring(instance, INITIALIZING)
    assert instance.call("ExitInitializationMode") != OK or all(map(math.isfinite, instance.outputs()))


def test_terminated_instance_keeps_its_outputs_until_reset(name, native):
    instance = native(name).initialize()
    last = run(instance, name, 0, 45)[-1]
    instance.done("Terminate")
    assert instance.outputs() == last
    assert "'terminated'" in instance.refused("DoStep", 0.045, STEP, 0)
    assert "'terminated'" in instance.refused("Terminate")
    instance.done("Reset")
    step_silently(instance.initialize(), name, 0, 45)
    instance.set(**inputs_at(name, 45))
    instance.done("Terminate")
    assert instance.outputs() == last
