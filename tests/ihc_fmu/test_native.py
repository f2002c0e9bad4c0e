"""The controller in C, as an FMU, against the controller in Python: the same numbers, modes, faults and words."""

import itertools
import math
import platform
import random
import sys
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract
from fmpy.fmi1 import FMICallException

from fmu_export.errors import UserError
from fmu_export.native_fmu import export_native_fmu
from ihc_fmu.pendulum.interface import INTERFACE, LAWS
from ihc_fmu.pendulum.native_unit import NATIVE
from ihc_fmu.pendulum.start_values import design_values, kalman_values
from ihc_fmu.pendulum.supervisor import Mode
from ihc_fmu.pendulum.unit import IhcControllerUnit
from ihc_fmu.sampled_unit import Fault
from plant_fmu.native_unit import NATIVE as PLANT
from plant_fmu.unit import QubePlant
from tests.fmu_export.conftest import Host
from tests.fmu_export.parity import compare, extreme_values

EXACT = sys.platform == "linux" and platform.machine() == "x86_64"
"""Where Python and the binary call the same mathematical library, all results are equal to the last bit."""

STEP = 1e-3
INPUTS = [v.name for v in INTERFACE.of("input")]
OUTPUTS = [v.name for v in INTERFACE.calculated]
LAW, SOLVER, DISCRETIZATION, SOURCE = {law: i for i, law in enumerate(LAWS, 1)}, (1, 2), (1, 2), (1, 2, 3)
FILTER, INPUT, KALMAN = SOURCE


def agree(actual, expected):
    """NaN agrees with NaN."""
    tolerance = 0.0 if EXACT else 1e-12
    np.testing.assert_allclose(np.array(actual, float), np.array(expected, float), rtol=tolerance, atol=tolerance)


def smooth(start, end, count):
    return [end + (start - end) * (1 + math.cos(math.pi * k / count)) / 2 for k in range(count)]


def measured():
    """From hanging to upright, a while there, a fall to 1.3 rad, back to upright; velocities belong to the angles.

    The set-point changes all the while.
    """
    delta = np.concatenate([smooth(math.pi, 0.02, 250), [0.02] * 100, smooth(0.02, 1.3, 150), smooth(1.3, -0.01, 250)])
    delta = np.concatenate([delta, [-0.01] * 150])
    t = np.arange(len(delta)) * STEP
    delta = delta + 2e-3 * np.sin(20 * t)
    theta = 0.1 * np.sin(3 * t) + 1e-4 * np.sin(700 * t)
    velocities = np.gradient(theta, STEP), np.gradient(delta, STEP)
    rows = np.column_stack([theta, delta, *velocities, 0.05 * np.sign(np.sin(40 * t))])
    return [tuple(map(float, row)) for row in rows]


MEASURED = measured()
HANGING, UPRIGHT = 0, 300
"""Where in MEASURED the pendulum hangs and where it is balanced."""


def by_name(row):
    return dict(zip(INPUTS, row, strict=True))


def follow(pair, rows, step=STEP, start=0):
    """Step both through the rows, and return the native one's outputs by name, an array each."""
    native, python = pair
    outputs = []
    for k, row in enumerate(rows, start):
        python.step(k * step, step, row)
        outputs.append(native.step(k * step, step, **by_name(row)))
        agree(outputs[-1], python.outputs())
    return dict(zip(OUTPUTS, np.array(outputs, float).T, strict=True))


def phases(modes):
    """Return the modes without repetitions."""
    return [int(mode) for mode, _ in itertools.groupby(modes)]


@pytest.fixture(scope="module")
def exported(tmp_path_factory, start_values):
    """Both native FMUs, unpacked."""
    path = tmp_path_factory.mktemp("native")
    files = (
        export_native_fmu(PLANT, path / "plant.fmu"),
        export_native_fmu(NATIVE, path / "controller.fmu", start_values),
    )
    return tuple(Path(extract(str(file), str(path / file.stem))) for file in files)


@pytest.fixture
def instance(exported):
    """Make instances of the native controller, or of the folder of another FMU; all are freed after the test."""
    made = []

    def make(folder=exported[1]):
        made.append(Host(folder))
        return made[-1]

    yield make
    for native in made:
        native.slave.freeInstance()


@pytest.fixture
def pair(instance, controller):
    """Make (native FMU, Python unit), initialized at `seen` with the same start values; equal from there."""

    def make(seen=MEASURED[0], start_time=0.0, **changes):
        native, python = instance(), controller(**changes)
        native.initialize(start_time, **changes, **by_name(seen))
        python.initialize(start_time, seen)
        agree(native.outputs(), python.outputs())
        return native, python

    return make


# Laws, estimators, modes


@pytest.mark.parametrize("source", SOURCE)
@pytest.mark.parametrize(
    ("law", "solver", "discretization"),
    [("LC", 1, 1), ("SMC", 1, 1), ("STA", 1, 1), ("STA", 1, 2), *itertools.product(["IHC"], SOLVER, DISCRETIZATION)],
)
def test_every_law_and_estimator_is_the_same_through_all_modes(law, solver, discretization, source, pair):
    both = pair(law=LAW[law], norm_solver=solver, discretization=discretization, velocity_source=source)
    outputs = follow(both, MEASURED)
    assert phases(outputs["mode"]) == [Mode.SWING_UP, Mode.STABILIZING, Mode.SWING_UP, Mode.STABILIZING]
    assert len(set(outputs["voltage"])) > 300


@pytest.mark.parametrize("mu", [0.5, 0.0])
@pytest.mark.parametrize(("solver", "discretization"), list(itertools.product(SOLVER, DISCRETIZATION)))
def test_other_degrees_of_homogeneity_are_the_same_in_both(mu, solver, discretization, pair):
    both = pair(mu=mu, norm_solver=solver, discretization=discretization, a_min=0.01, b_max=5.0)
    used = follow(both, MEASURED)["homogeneous_norm_used"]
    assert len(set(used)) > 50


def test_design_for_another_degree_is_the_same_in_both(pair, designs):
    follow(pair(**design_values(designs[0.5]), a_min=0.1, norm_solver=2, discretization=2), MEASURED)


def test_kalman_filter_is_the_same_with_and_without_compensation(pair):
    rows = [(theta, delta + 0.01, *rest) for theta, delta, *rest in MEASURED]
    on, off = (follow(pair(velocity_source=KALMAN, compensate_disturbance=flag), rows) for flag in (True, False))
    assert max(abs(on["disturbance_estimate"])) > 0.1
    assert max(abs(on["bias_estimate"])) > 1e-3
    stabilizing = on["mode"] == Mode.STABILIZING
    assert (on["voltage"] != off["voltage"])[stabilizing].mean() > 0.5


@pytest.mark.parametrize("source", SOURCE)
@pytest.mark.parametrize(
    ("sample_time", "step"),
    [(5e-3, 1e-3), (1e-3, 2.5e-4), (2e-3, 2e-3), (1 / 60, 1 / 600), (1e-3, 1e-2), (1e-3, 0.016), (1 / 600, 1 / 60)],
)
def test_samples_within_and_between_steps_are_the_same_in_both(sample_time, step, source, pair, start_values):
    gain = kalman_values(start_values, sample_time)
    both = pair(sample_time=sample_time, velocity_source=source, **gain)
    outputs = follow(both, MEASURED[::2], step)
    assert [message for _, _, message in both[0].log] == (
        []
        if step <= sample_time
        else [
            f"t = 0 s: a communication step of {step:g} s holds the inputs over several samples of sample_time = "
            f"{sample_time:g} s"
        ]
    )
    if step > sample_time:
        return
    ratio = round(sample_time / step)
    assert all(k % ratio == 0 for k in np.flatnonzero(np.diff(outputs["voltage"])) + 1)
    assert len(set(outputs["voltage"])) > 10


@pytest.mark.parametrize("start_time", [12345.678, -3.5, 1e7])
def test_samples_count_from_the_same_start_time(start_time, pair):
    native, python = pair(start_time=start_time)
    for k, row in enumerate(MEASURED[:400]):
        python.step(start_time + k * STEP, STEP, row)
        agree(native.step(start_time + k * STEP, STEP, **by_name(row)), python.outputs())


@pytest.mark.parametrize("wrap", [lambda a: math.remainder(a, math.tau), lambda a: a % math.tau], ids=["pi", "two pi"])
@pytest.mark.parametrize("source", SOURCE)
def test_wrapped_sensor_is_the_same_in_both_and_as_good_as_one_that_is_not(wrap, source, pair):
    rows = [(0.1, 3.0 + 25.0 * math.sin(3 * k * STEP), 0.0, 75.0 * math.cos(3 * k * STEP), 0.0) for k in range(700)]
    wrapped = [(theta, wrap(delta), *rest) for theta, delta, *rest in rows]
    assert sum(abs(b[1] - a[1]) > math.pi for a, b in itertools.pairwise(wrapped)) > 3
    outputs = follow(pair(wrapped[0], velocity_source=source), wrapped)
    plain = follow(pair(rows[0], velocity_source=source), rows)
    np.testing.assert_allclose(outputs["delta_dot_estimate"], plain["delta_dot_estimate"], atol=1e-6)


def test_idle_controllers_are_the_same(pair):
    assert phases(follow(pair(enabled=False), MEASURED)["mode"]) == [Mode.IDLE]
    waiting = follow(pair(swing_up_enabled=False), MEASURED)
    assert phases(waiting["mode"]) == [Mode.IDLE, Mode.STABILIZING, Mode.IDLE, Mode.STABILIZING]


def test_tiny_and_zero_states_are_the_same(pair):
    sizes = (0.0, 5e-324, 1e-320, 1e-200, 1e-160, 1e-12, 1e-3, 0.0)
    rows = [(s, -s, s, s, point) for s in sizes for point in (0.0, -0.0, 0.5 * s, -s)]
    for law, solver, discretization in itertools.product(LAW.values(), SOLVER, DISCRETIZATION):
        changes = {"law": law, "norm_solver": solver, "discretization": discretization, "velocity_source": INPUT}
        follow(pair(rows[0], a_min=1e-6, **changes), rows)


# Tunable parameters


def tuned(rng):
    """Random values of some tunable parameters."""
    a_min = 10 ** rng.uniform(-3, 0)
    everything = {
        "law": rng.choice(list(LAW.values())),
        "norm_solver": rng.randint(1, 2),
        "discretization": rng.randint(1, 2),
        "j_max": rng.randint(1, 60),
        "smc_rho": rng.uniform(0, 3),
        "sta_rate": rng.uniform(0, 1000),
        "voltage_limit": rng.uniform(0, 12),
        "enabled": rng.random() < 0.9,
        "swing_up_enabled": rng.random() < 0.9,
        "swing_up_energy_gain": 10 ** rng.uniform(3, 5),
        "swing_up_acceleration_limit": rng.uniform(0, 200),
        "swing_up_arm_stiffness": rng.uniform(0, 100),
        "swing_up_arm_damping": rng.uniform(0, 20),
        "swing_up_energy_offset": rng.uniform(-0.5, 0.5),
        "swing_up_velocity_scale": 10 ** rng.uniform(-2, 1),
        "capture_level": 10 ** rng.uniform(-1, 3),
        "capture_angle": rng.uniform(0, 0.5),
        "capture_velocity": rng.uniform(0, 10),
        "fall_back_angle": rng.uniform(0.5, 2.0),
        "compensate_disturbance": rng.random() < 0.5,
    }
    some = dict(rng.sample(sorted(everything.items()), 4))
    return (
        some | {"b_max": 100.0, "a_min": a_min} | ({"b_max": a_min * rng.uniform(1, 10)} if rng.random() < 0.5 else {})
    )


def test_all_tunable_parameters_are_tuned_here():
    names = set().union(*(tuned(random.Random(seed)) for seed in range(200)))
    assert names == {v.name for v in INTERFACE.variables if v.variability == "tunable"}


@pytest.mark.parametrize("source", SOURCE)
def test_tuning_between_steps_is_the_same_in_both(source, pair, controller):
    native, python = pair(velocity_source=source)
    rng, values = random.Random(source), {"velocity_source": source}
    for k, row in enumerate(MEASURED):
        if k % 7 == 3:
            changes = tuned(rng)
            values |= changes
            native.set(b_max=100.0)
            native.set(a_min=changes["a_min"])
            native.set(**changes)
            state, python = python.get_state(), controller(**values)
            python.set_state(state)
            agree(native.outputs(), python.outputs())
        python.step(k * STEP, STEP, row)
        agree(native.step(k * STEP, STEP, **by_name(row)), python.outputs())


# Faults


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("bad", INPUTS)
def test_non_finite_input_faults_both_until_reset(bad, value, pair):
    rows = MEASURED[UPRIGHT:]
    native, python = both = pair(rows[0])
    follow(both, rows[:30])
    row = tuple((by_name(rows[30]) | {bad: value}).values())
    (message,) = python.step(0.03, STEP, row)
    agree(native.step(0.03, STEP, **by_name(row)), python.outputs())
    assert native.get("voltage", "mode", "fault") == (0.0, Mode.FAULT, Fault.NON_FINITE_INPUT)
    assert native.log == [(1, "logStatusWarning", f"t = 0.03 s: {message}")]
    latched = follow(both, [row, row, *rows[:20], MEASURED[HANGING]], start=31)
    assert set(latched["voltage"]) == {0.0}
    assert set(latched["fault"]) == {Fault.NON_FINITE_INPUT}
    assert phases(latched["mode"]) == [Mode.FAULT]
    native.set(enabled=False)
    assert native.step(0.054, STEP, **by_name(rows[0]))[OUTPUTS.index("mode")] == Mode.FAULT
    native.slave.reset()
    fresh, python = pair(rows[0])
    native.initialize(**by_name(rows[0]))
    assert phases(follow((native, python), rows[:30])["mode"]) == [Mode.STABILIZING]
    assert native.outputs() == [fresh.step(k * STEP, STEP, **by_name(row)) for k, row in enumerate(rows[:30])][-1]


def test_first_measurement_that_is_not_finite_faults_both_at_the_first_sample(pair):
    native, _ = both = pair((math.nan, 0.0, 0.0, 0.0, 0.0))
    assert native.get("voltage", "homogeneous_norm", "mode") == (0.0, 0.0, Mode.IDLE)
    assert follow(both, [(math.nan, 0.0, 0.0, 0.0, 0.0)])["fault"] == Fault.NON_FINITE_INPUT


def test_all_inputs_that_are_not_finite_are_named(pair):
    native, python = pair()
    (message,) = python.step(0.0, STEP, (math.nan, math.inf, 0.0, 0.0, -math.inf))
    native.step(0.0, STEP, theta=math.nan, delta=math.inf, theta_setpoint=-math.inf)
    words = "theta = nan, delta = inf, theta_setpoint = -inf"
    assert message == f"fault non_finite_input: {words}; the voltage is 0 V until reset"
    assert native.log[-1][2] == f"t = 0 s: {message}"


def follow_a_spike(pair, where, name, value, **changes):
    """A single measurement beyond all reason."""
    rows = MEASURED[where : where + 40]
    rows[10] = tuple((by_name(rows[10]) | {name: value}).values())
    outputs = follow(pair(rows[0], **changes), rows)
    assert np.isfinite(outputs["voltage"]).all()
    assert (abs(outputs["voltage"]) <= 10.0).all()
    assert set(outputs["voltage"][outputs["mode"] == Mode.FAULT]) <= {0.0}
    return outputs


@pytest.mark.parametrize("source", SOURCE)
@pytest.mark.parametrize("law", LAW)
@pytest.mark.parametrize("name", ["theta", "theta_dot", "delta_dot", "theta_setpoint"])
def test_enormous_measurement_faults_both_or_neither(name, law, source, pair):
    changes = {"law": LAW[law], "velocity_source": source}
    for where, value in itertools.product((HANGING, UPRIGHT), (1e308, -1e200, 1e155, -1e30)):
        follow_a_spike(pair, where, name, value, **changes)


def test_enormous_measurement_can_fault_both(pair):
    outputs = follow_a_spike(pair, HANGING, "theta", 1e200)
    assert (outputs["mode"][-1], outputs["fault"][-1]) == (Mode.FAULT, Fault.NON_FINITE_CONTROL)


def test_kalman_filter_that_overflows_leaves_the_same_estimates(pair):
    outputs = follow_a_spike(pair, UPRIGHT, "theta", 1e79, velocity_source=KALMAN)
    assert outputs["fault"][-1] == Fault.NON_FINITE_CONTROL


@pytest.mark.parametrize("where", [HANGING, UPRIGHT], ids=["hanging", "upright"])
@pytest.mark.parametrize("source", SOURCE)
@pytest.mark.parametrize("value", [1e9, -1e18, 1e20, -1e30, 1e200, 1e308])
def test_enormous_angle_of_the_pendulum_faults_both_or_neither(value, source, where, pair):
    follow_a_spike(pair, where, "delta", value, velocity_source=source)


@pytest.mark.parametrize(
    ("name", "value", "source"),
    [("theta", 1e100, FILTER), ("theta", 1e200, FILTER), ("theta", 1e200, INPUT), ("delta_dot", 1e308, INPUT)],
)
def test_enormous_measurement_faults_both_idle_controllers_or_neither(name, value, source, pair):
    follow_a_spike(pair, UPRIGHT, name, value, velocity_source=source, enabled=False)


def test_any_admissible_numbers_are_answered_alike(exported, start_values):
    rng, ends = random.Random(3), []
    for _ in range(300):
        changes = extreme_values(INTERFACE, rng, start_values)
        changes.pop("sample_time", None)
        where = rng.choice((HANGING, UPRIGHT))
        rows = MEASURED[where : where + 8]
        rows = [(*row[:4], rng.choice((0.0, -0.0, 0.3, -1e-310, 1e150))) for row in rows]
        if rng.random() < 0.5:
            rows[4] = tuple(value * rng.choice((0.0, 1.0, 1e-310, 1e-200, 1e150, 1e300)) for value in rows[4])
        ends.append(compare(exported[1], INTERFACE, IhcControllerUnit, start_values, changes, rows, EXACT))
    assert {end: ends.count(end) > 10 for end in ("refused", "ran")} == dict.fromkeys(ends, True)


# Refusals


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"a_min": 1.25, "b_max": 1.125}, "a_min must not exceed b_max, found a_min = 1.25 and b_max = 1.125"),
        ({"capture_angle": 0.9}, "capture_angle must not exceed fall_back_angle, found 0.9 and 0.8 rad"),
        (
            {"velocity_source": KALMAN, "sample_time": 2e-3},
            "velocity_source kalman needs a gain for the sample_time, found kalman_sample_time = 0.001 s and "
            "sample_time = 0.002 s",
        ),
        ({f"Phi_1{j}": 0.0 for j in (1, 2, 3, 4)}, "Phi must be regular, found a singular matrix"),
        ({"P_11": -1.0}, "P must be positive definite, found that its leading 1 x 1 block is not"),
        ({"P_14": 1e9}, "P must be positive definite, found that its leading 4 x 4 block is not"),
    ],
    ids=["limits", "angles", "Kalman time", "Phi", "P", "P as a whole"],
)
def test_start_values_that_contradict_each_other_are_refused_by_both_with_the_same_words(
    changes, words, instance, controller
):
    with pytest.raises(ValueError, match="found") as caught:
        controller(**changes)
    assert str(caught.value) == words
    native = instance()
    with pytest.raises(FMICallException):
        native.initialize(**changes)
    ((_, _, message),) = native.log
    assert message.startswith(words)


@pytest.mark.parametrize(
    ("step", "rule"),
    [
        *[
            (step, f"or the step of it, found sample_time = 0.001 s and a communication step of {step:g} s")
            for step in (2.5e-3, 3e-4, 7e-4, 1.001e-3, 1.6e-3, 1e-320)
        ],
        (1e4, "must not exceed 1000000 samples of sample_time = 0.001 s, found 10000 s"),
    ],
)
def test_step_that_does_not_fit_the_sample_time_is_refused_by_both_with_the_same_words(step, rule, pair):
    native, python = both = pair()
    follow(both, MEASURED[:5])
    before = native.outputs()
    with pytest.raises(UserError, match=rule) as caught:
        python.step(5e-3, step, MEASURED[5])
    with pytest.raises(FMICallException):
        native.step(5e-3, step, **by_name(MEASURED[5]))
    ((_, _, message),) = native.log
    assert message.startswith(str(caught.value))
    assert native.outputs() == before
    follow(both, MEASURED[5:10], start=5)


# Closed loop


@pytest.mark.parametrize(
    ("of_plant", "of_controller", "ends"),
    [
        ({}, {}, Mode.STABILIZING),
        ({"noise_std": 1e-4}, {"velocity_source": KALMAN, "discretization": 2, "norm_solver": 2, "a_min": 0.5}, None),
        ({"delta_0": 0.1}, {"velocity_source": KALMAN, "kalman_count_weight": 0.6}, Mode.STABILIZING),
        ({"delta_0": 0.1, "encoder_counts": 0}, {"velocity_source": INPUT, "a_min": 0.2}, Mode.STABILIZING),
        ({"delta_0": -0.1, "motor_model": 2}, {"law": LAW["SMC"]}, Mode.STABILIZING),
        ({"delta_0": 0.1, "measurement_delay": 2e-3}, {"law": LAW["LC"]}, Mode.STABILIZING),
    ],
    ids=["from hanging", "from hanging with Kalman filter", "part of a count", "ideal", "SMC", "LC with delay"],
)
def test_closed_loop_of_the_native_fmus_equals_that_of_the_python_units(
    of_plant, of_controller, ends, exported, instance, controller
):
    """The arm's set-point changes while the pendulum swings up and while it is balanced."""

    def set_point(k):
        return 0.1 * (k // 90 % 3 - 1)

    plant, native = instance(exported[0]), instance()
    own_plant, python = QubePlant(PLANT.interface.start_values(of_plant)), controller(**of_controller)
    plant.initialize(**of_plant)
    places = [plant.output_names.index(n) for n in ("theta_encoder", "delta_encoder", "theta_dot", "delta_dot")]
    seen, own_seen = plant.outputs(), own_plant.outputs()
    native.initialize(**of_controller, **by_name([*[seen[i] for i in places], set_point(0)]))
    python.initialize(0.0, (*[own_seen[i] for i in places], set_point(0)))
    modes = []
    for k in range(2000 if "delta_0" not in of_plant else 500):
        commanded = native.step(k * STEP, STEP, **by_name([*[seen[i] for i in places], set_point(k)]))
        python.step(k * STEP, STEP, (*[own_seen[i] for i in places], set_point(k)))
        agree(commanded, python.outputs())
        seen = plant.step(k * STEP, STEP, voltage=commanded[0])
        own_plant.step(k * STEP, STEP, (python.outputs()[0], 0.0, 0.0))
        own_seen = own_plant.outputs()
        agree(seen, own_seen)
        modes.append(commanded[OUTPUTS.index("mode")])
    assert modes[0] == (Mode.STABILIZING if "delta_0" in of_plant else Mode.SWING_UP)
    assert modes[-1] == (ends or Mode.STABILIZING)
