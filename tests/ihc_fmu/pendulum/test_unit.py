"""The controller as it is stepped: sampling, swing-up and capture, faults, state, and what the IHC gains."""

import json
import math
import random
from typing import Any

import numpy as np
import pytest

from ihc_fmu import homogeneity, laws
from ihc_fmu.pendulum.interface import INTERFACE, LAWS
from ihc_fmu.pendulum.supervisor import Mode
from ihc_fmu.sampled_unit import Fault
from ihc_fmu.sliding_mode import fitted_smc, tuned_sta
from tests.ihc_fmu.conftest import chain_of

INPUTS = [v.name for v in INTERFACE.of("input")]
OUTPUTS = [v.name for v in INTERFACE.of("output")]
STATE_INPUT = {"velocity_source": "inputs"}


def outputs(unit):
    return dict(zip(OUTPUTS, unit.outputs(), strict=True))


def given(seen, set_point=0.0):
    """Return the unit's inputs from (theta, delta, theta', delta')."""
    return (*map(float, seen), set_point)


def feed(unit, measurements, h=1e-3, start=0):
    """Step the unit through (theta, delta, theta', delta') and return its outputs, a row for each step."""
    rows = []
    for k, seen in enumerate(measurements, start):
        unit.step(k * h, h, given(seen))
        rows.append(unit.outputs())
    return np.array(rows, float)


def started(unit, seen):
    unit.initialize(0.0, given(seen))
    return unit


def swinging(duration=2.0, h=1e-3):
    """Measured angles and their derivatives of a pendulum that swings through upright, some noise on top."""
    t = np.arange(round(duration / h)) * h
    theta, delta = 0.3 * np.sin(4 * t), 3.0 * np.cos(2.5 * t)
    velocities = 1.2 * np.cos(4 * t), -7.5 * np.sin(2.5 * t)
    ripple = 1e-3 * np.sin(700 * t)
    return np.column_stack([theta + ripple, delta - ripple, *velocities])


@pytest.fixture(scope="module")
def recorded(controller, closed_loop):
    """The measurements of a default run from hanging, swing-up, capture and balance."""
    run = closed_loop(controller(), 2.5)
    return np.column_stack([run[n] for n in ("theta_encoder", "delta_encoder", "theta_dot", "delta_dot")])


# The laws


@pytest.mark.parametrize("delta", [0.05, -0.2])
def test_commands_are_those_of_the_laws_for_the_measured_state(controller, design, delta):
    """Each law with its norm solver and discretization, against the library functions at one sample."""
    x: Any = np.array([0.1, delta, -0.3, 0.5])
    z = chain_of(design).Phi @ x
    law = laws.chain_design(
        chain_of(design).Phi.tolist(),
        chain_of(design).row.tolist(),
        design.k_lin.tolist(),
        design.P.tolist(),
        design.mu,
    )
    c = homogeneity.norm_polynomial(law.Pz, z.tolist(), law.exponents, 1.0)
    exact = min(2.0, max(0.1, homogeneity.homogeneous_norm(c, 1.0)))
    _, estimate = homogeneity.bisection_update(c, 1.0, (0.1, 2.0), 0.1, 2.0, 3)
    assert 0.1 < exact < 2.0
    assert abs(estimate / exact - 1) > 1e-3
    smc: Any = fitted_smc(design.A, design.b)
    sta: Any = tuned_sta(design.A, design.b)[0]
    cases = [
        ({"law": "LC"}, design.k_lin @ x, 1.0),
        ({"law": "SMC"}, laws.sliding_mode(smc.c, smc.k_eq, smc.rho, x), 1.0),
        *(
            (
                {"law": "STA", "discretization": discretization, "sta_rate": 7.0},
                sta.k_eq @ x + laws.super_twisting(sta.c @ x, 0.0, 7.0, 1e-3, discretization == "semi_implicit")[0],
                1.0,
            )
            for discretization in ("explicit", "semi_implicit")
        ),
        ({}, laws.implicit_homogeneous(law, estimate, x, z)[0], estimate),
        (
            {"norm_solver": "exact"},
            laws.implicit_homogeneous(law, exact, x, z)[0],
            exact,
        ),
        (
            {"norm_solver": "exact", "discretization": "semi_implicit"},
            laws.implicit_homogeneous_semi(law, exact, 1e-3, z)[0],
            exact,
        ),
    ]
    for changes, command, used in cases:
        unit = controller(**STATE_INPUT, a_min=0.1, b_max=2.0, voltage_limit=1e3, capture_level=1e3, **changes)
        started(unit, x).step(0.0, 1e-3, given(x))
        values = outputs(unit)
        assert values["mode"] == Mode.STABILIZING
        assert values["voltage"] == pytest.approx(command, rel=1e-9)
        assert values["homogeneous_norm_used"] == pytest.approx(used, rel=1e-9)
        assert values["homogeneous_norm"] == pytest.approx(homogeneity.homogeneous_norm(c, 1.0), rel=1e-9)
        assert (values["theta_dot_estimate"], values["delta_dot_estimate"]) == (-0.3, 0.5)


def test_bounds_of_one_run_the_linear_controller_to_the_last_bit(controller, closed_loop):
    """Swing-up, capture and balance with encoders: LC, and IHC with a_min = b_max = 1, by either norm solver."""
    linear = closed_loop(controller(law="LC"), 2.0)
    assert linear["mode"][-1] == Mode.STABILIZING
    for solver in ("algorithm1", "exact"):
        ours = closed_loop(controller(a_min=1.0, b_max=1.0, norm_solver=solver), 2.0)
        np.testing.assert_array_equal(ours["voltage"], linear["voltage"])
    different = closed_loop(controller(), 2.0)
    assert (different["voltage"] != linear["voltage"]).any()


def test_norm_in_the_law_stays_within_bounds_that_shrink_during_the_run(controller):
    """The interval of Algorithm 1 outlives a tuning of its bounds, as the FMU does it: a new unit with the old state."""
    x = (0.1, 0.1, 0.0, 0.0)
    unit = started(controller(**STATE_INPUT, a_min=0.5, b_max=4.0), x)
    assert 0.5 <= feed(unit, [x] * 20)[-1, 2] <= 4.0
    tuned = controller(**STATE_INPUT, a_min=0.2, b_max=0.3)
    tuned.set_state(unit.get_state())
    assert (feed(tuned, [x] * 20, start=20)[:, 2] <= 0.3).all()


# Sampling


def test_voltage_is_held_between_samples_however_fine_the_communication_step(controller):
    """Four communication steps a sample: the same commands at the samples, constant in between."""
    fine = swinging(h=2.5e-4)
    slow = feed(started(controller(), fine[0]), fine[::4])
    quick = feed(started(controller(), fine[0]), fine, h=2.5e-4)
    assert len(set(slow[:, 0])) > 100
    for offset in range(4):
        np.testing.assert_array_equal(quick[offset::4], slow)


def test_samples_count_from_the_start_time(controller):
    measurements = swinging(duration=0.2)
    early = feed(started(controller(), measurements[0]), measurements)
    unit, start, rows = controller(), 12345.678, []
    unit.initialize(start, given(measurements[0]))
    for k, seen in enumerate(measurements):
        unit.step(start + k * 1e-3, 1e-3, given(seen))
        rows.append(unit.outputs())
    np.testing.assert_array_equal(rows, early)


@pytest.mark.parametrize("ratio", [2, 10, 16])
def test_a_longer_step_runs_the_samples_that_fall_into_it_on_held_inputs_and_says_so_once(controller, ratio):
    measurements = swinging(duration=0.32)[: 320 // ratio * ratio : ratio]
    held = feed(started(controller(), measurements[0]), np.repeat(measurements, ratio, axis=0))
    unit, said = started(controller(), measurements[0]), []
    for k, seen in enumerate(measurements):
        said += unit.step(k * ratio * 1e-3, ratio * 1e-3, given(seen))
        np.testing.assert_array_equal(unit.outputs(), held[(k + 1) * ratio - 1])
    (message,) = said
    assert f"a communication step of {ratio * 1e-3:g} s holds the inputs over several samples" in message


def test_steps_long_and_short_leave_out_no_sample_and_repeat_none(controller):
    unit, rng, time = started(controller(sample_time=1e-3), (0, 3, 0, 0)), random.Random(4), 0.0
    for _ in range(300):
        step = rng.choice([2.5e-4, 5e-4, 1e-3, 3e-3])
        unit.step(time, step, (0.0, 3.0, 0.0, 0.0, 0.0))
        time += step
        assert abs(unit.state.next_sample - time / 1e-3) <= 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"a_min": 1.1, "b_max": 1.0}, "a_min must not exceed b_max, found a_min = 1.1 and b_max = 1"),
        ({"capture_angle": 0.9}, "capture_angle must not exceed fall_back_angle, found 0.9 and 0.8 rad"),
        ({"Phi_11": 0.0, "Phi_12": 0.0, "Phi_13": 0.0, "Phi_14": 0.0}, "Phi must be regular"),
    ],
)
def test_contradictory_parameters_are_refused(controller, changes, message):
    with pytest.raises(ValueError, match=message):
        controller(**changes)


# Swing-up, capture, fall-back


@pytest.mark.parametrize("parameters", ["ident", "matrices", "hcs"])
def test_swing_up_captures_once_and_stays(controller, closed_loop, error_norm, parameters):
    """From hanging, with encoders and the velocity filter, on three pendulums that the controller does not know apart."""
    run = closed_loop(controller(), 4.0, parameters)
    stabilizing = run["mode"] == Mode.STABILIZING
    capture = np.flatnonzero(stabilizing)[0] * 1e-3
    assert 0.3 < capture < 1.5
    assert np.count_nonzero(np.diff(stabilizing)) == 1
    assert (run["mode"][~stabilizing] == Mode.SWING_UP).all()
    assert (error_norm(run)[-1000:] < 0.2).all()
    assert (np.abs(run["delta"][-1000:] - round(run["delta"][-1] / math.tau) * math.tau) < 0.05).all()
    assert np.abs(run["theta"]).max() < math.pi


def test_voltage_stays_within_its_limit_and_uses_it(controller, closed_loop):
    for limit in (10.0, 6.0):
        voltage = closed_loop(controller(voltage_limit=limit), 1.0)["voltage"]
        assert np.abs(voltage).max() == limit
        assert {-limit, limit} <= set(voltage)


def test_disabled_controller_is_idle_at_zero_volts(controller, closed_loop):
    for start in (math.pi, 0.1):
        run = closed_loop(controller(enabled=False), 0.3, changes={"delta_0": start})
        assert (run["mode"] == Mode.IDLE).all()
        assert (run["voltage"] == 0.0).all()
        assert (run["homogeneous_norm_used"] == 1.0).all()


def test_without_swing_up_the_controller_waits_until_the_pendulum_is_lifted(controller):
    """By hand: hanging for 0.2 s, lifted in 1 s, held upright."""
    lift = np.concatenate([np.full(200, math.pi), math.pi * (1 + np.cos(np.linspace(0, math.pi, 1000))) / 2])
    delta = np.concatenate([lift, np.zeros(300)])
    measurements = np.column_stack([np.zeros_like(delta), delta, np.zeros((len(delta), 2))])
    rows = feed(started(controller(swing_up_enabled=False), measurements[0]), measurements)
    voltage, mode = rows[:, 0], rows[:, OUTPUTS.index("mode")]
    waiting = mode == Mode.IDLE
    assert set(mode) == {Mode.IDLE, Mode.STABILIZING}
    assert (voltage[waiting] == 0.0).all()
    assert (np.abs(delta[~waiting]) < 0.5).all()
    assert np.count_nonzero(np.diff(mode)) == 1


@pytest.mark.parametrize(("swing_up", "after"), [(True, Mode.SWING_UP), (False, Mode.IDLE)])
def test_law_gives_up_beyond_the_fall_back_angle_and_captures_again_only_inside(controller, swing_up, after):
    still = lambda delta: (0.0, delta, 0.0, 0.0)  # noqa: E731
    unit = started(controller(**STATE_INPUT, swing_up_enabled=swing_up), still(0.0))
    deltas = [0.0, 0.3, 0.79, -0.8, 0.81, 0.79, 0.51, 0.05]
    expected = [Mode.STABILIZING] * 4 + [after] * 3 + [Mode.STABILIZING]
    assert feed(unit, map(still, deltas))[:, OUTPUTS.index("mode")].tolist() == expected


def test_observer_takes_over_from_the_filter_when_the_pendulum_falls(controller):
    """The pendulum leaves upright at 2 rad/s; the velocity estimate does not jump at the fall-back angle."""
    delta = np.concatenate([np.zeros(300), 2e-3 * np.arange(500)])
    seen = np.column_stack([np.zeros_like(delta), delta, np.zeros((len(delta), 2))])
    rows = feed(started(controller(law="LC", k_lin_2=0.0, k_lin_4=0.0), seen[0]), seen)
    mode, estimate = rows[:, OUTPUTS.index("mode")], rows[:, OUTPUTS.index("delta_dot_estimate")]
    (fall,) = np.flatnonzero(np.diff(mode))
    assert (mode[fall], mode[fall + 1]) == (Mode.STABILIZING, Mode.SWING_UP)
    assert (np.abs(estimate[fall - 5 : fall + 5] - 2.0) < 1.0).all()


def test_capture_restarts_the_search_for_the_norm(controller):
    """Algorithm 1 begins at [a_min, b_max] again: after a fall and a capture it does what a new controller does."""
    near, far = (0.02, 0.01, 0.0, 0.0), (0.0, 2.0, 0.0, 0.0)
    changes = STATE_INPUT | {"a_min": 0.05, "b_max": 3.0}
    unit = started(controller(**changes), near)
    first, _, again = feed(unit, [near] * 9), feed(unit, [far] * 3, start=9), feed(unit, [near] * 9, start=12)
    np.testing.assert_array_equal(again[:, 2], first[:, 2])
    assert len(set(first[:, 2])) > 3


# Measurements


def test_wrapped_and_unwrapped_pendulum_angles_give_the_same_commands(controller, recorded):
    """Sensors that wrap into (-pi, pi], into [0, 2 pi), or that started some turns away."""
    expected = feed(started(controller(), recorded[0]), recorded)
    modes = expected[:, OUTPUTS.index("mode")]
    assert set(modes) == {Mode.SWING_UP, Mode.STABILIZING}
    wraps = [lambda a: math.remainder(a, math.tau), lambda a: a % math.tau, lambda a: a + 3 * math.tau]
    for wrap in wraps:
        seen = recorded.copy()
        seen[:, 1] = [wrap(a) for a in recorded[:, 1]]
        rows = feed(started(controller(), seen[0]), seen)
        np.testing.assert_allclose(rows[:, 0], expected[:, 0], atol=1e-8)
        np.testing.assert_array_equal(rows[:, OUTPUTS.index("mode")], modes)


def test_pendulum_that_turns_over_and_over_has_a_steady_velocity(controller):
    """Ten turns at 12 rad/s through a sensor that wraps: neither estimate jumps."""
    delta = 12.0 * np.arange(5000) * 1e-3
    for enabled in (True, False):
        seen = [(0.0, math.remainder(a, math.tau), 0.0, 0.0) for a in delta]
        rows = feed(started(controller(enabled=enabled, voltage_limit=0.0), seen[0]), seen)
        assert np.ptp(rows[1000:, OUTPUTS.index("delta_dot_estimate")]) < 5.0


def test_velocities_come_from_the_inputs_only_when_chosen(controller):
    seen = (0.0, 0.05, 0.7, -0.4)
    for source, expected in (("inputs", (0.7, -0.4)), ("filter", (0.0, 0.0))):
        values = outputs(feed_one(controller(velocity_source=source), seen))
        assert (values["theta_dot_estimate"], values["delta_dot_estimate"]) == expected


def feed_one(unit, seen):
    feed(started(unit, seen), [seen])
    return unit


def test_law_sees_the_manufacturers_filter(controller):
    """Stabilizing on still and then stepping angles: w (angle - lag), to the last sample."""
    theta = np.concatenate([np.zeros(5), np.full(40, 0.01)])
    seen = np.column_stack([theta, np.zeros_like(theta), np.zeros((len(theta), 2))])
    estimates = feed(started(controller(), seen[0]), seen)[:, OUTPUTS.index("theta_dot_estimate")]
    expected = np.concatenate([np.zeros(5), 0.5 * np.exp(-0.05 * np.arange(40))])
    np.testing.assert_allclose(estimates, expected, atol=1e-12)


def test_integral_of_super_twisting_begins_at_0_when_the_law_takes_over_and_stands_still_at_the_limit(controller):
    unit = started(controller(**STATE_INPUT, law="STA", sta_rate=100.0, voltage_limit=1.0), (0.0, 0.1, 0.0, 0.0))
    for k in range(20):
        unit.step(k * 1e-3, 1e-3, given((0.0, 0.1, 0.0, 0.0)))
        assert (outputs(unit)["voltage"], unit.state.integral) == (-1.0, 0.0)
    for k in range(20, 40):
        unit.step(k * 1e-3, 1e-3, given((1e-4, 0.0, 0.0, 0.0)))
    assert unit.state.integral > 0.1  # s < 0, and the command is not beyond its upper limit
    unit.step(40e-3, 1e-3, given((0.0, 2.0, 0.0, 0.0)))
    assert (outputs(unit)["mode"], unit.state.integral) == (Mode.SWING_UP, 0.0)
    unit.step(41e-3, 1e-3, given((0.0, 0.0, 0.0, 0.0)))
    assert (outputs(unit)["mode"], unit.state.integral) == (Mode.STABILIZING, 0.0)


# The arm's set-point


@pytest.mark.parametrize("law", LAWS)
def test_only_the_deviation_from_the_set_point_counts(controller, law):
    """In numbers whose difference is exact, swing-up and capture included, to the last bit."""
    seen = swinging(duration=1.0)
    seen[:, 0] = np.round(seen[:, 0] * 1024) / 1024
    plain, moved = (controller(**STATE_INPUT, law=law, capture_level=1e3, capture_velocity=20.0) for _ in range(2))
    started(plain, seen[0])
    moved.initialize(0.0, (seen[0, 0] - 0.75, *seen[0, 1:], -0.75))
    assert moved.outputs() == plain.outputs()
    expected = feed(plain, seen)
    for k, (theta, *rest) in enumerate(seen.tolist()):
        moved.step(k * 1e-3, 1e-3, (theta - 0.75, *rest, -0.75))
        assert moved.outputs() == tuple(expected[k])
    assert {Mode.SWING_UP, Mode.STABILIZING} <= set(expected[:, OUTPUTS.index("mode")])


@pytest.mark.parametrize("source", ["filter", "inputs", "kalman"])
def test_set_point_of_zero_of_either_sign_or_next_to_it_is_none(controller, source):
    seen = swinging(duration=0.5)
    seen[::3, 0] = -0.0
    runs = []
    for set_point in (0.0, -0.0, 1e-310):
        unit = controller(velocity_source=source)
        unit.initialize(0.0, given(seen[0], set_point))
        for k, row in enumerate(seen):
            unit.step(k * 1e-3, 1e-3, given(row, set_point))
        runs.append(json.dumps([unit.get_state(), unit.outputs()]))
    assert len(set(runs)) == 1


@pytest.mark.parametrize(
    "changes", [{"law": "LC"}, {"law": "SMC"}, {"law": "STA"}, {}, {"velocity_source": "kalman"}], ids=str
)
def test_step_of_the_set_point_is_reached_by_balancing_and_after_a_swing_up(controller, closed_loop, changes):
    """From rest upright with a step after 1 s; from hanging with a set-point from the beginning on."""
    balanced = closed_loop(controller(**changes), 6.0, changes={"delta_0": 0.0}, set_point=lambda t: 0.3 * (t >= 1.0))
    assert (balanced["mode"] == Mode.STABILIZING).all()
    assert abs(np.mean(balanced["theta"][500:1000])) < 0.02
    swung = closed_loop(controller(**changes), 6.0, set_point=lambda t: -0.3)
    assert (swung["mode"][-2000:] == Mode.STABILIZING).all()
    for run, wanted in ((balanced, 0.3), (swung, -0.3)):
        assert abs(np.mean(run["theta"][-1000:]) - wanted) < 0.02


# Faults


@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_non_finite_input_is_a_latched_fault_at_zero_volts(controller, name, value):
    good = (0.1, 0.1, 0.2, 0.3)
    bad = tuple(value if n == name else x for n, x in zip(INPUTS, given(good), strict=True))
    unit = started(controller(), good)
    assert feed(unit, [good] * 3)[-1, 0] != 0.0
    (message,) = unit.step(3e-3, 1e-3, bad)
    assert f"fault non_finite_input: {name} = {value}" in message
    for k in range(4, 10):
        values = outputs(unit)
        assert (values["voltage"], values["mode"], values["fault"]) == (0.0, Mode.FAULT, Fault.NON_FINITE_INPUT)
        assert values["homogeneous_norm_used"] == 1.0
        assert unit.step(k * 1e-3, 1e-3, bad if k == 6 else given(good)) == []


def test_bad_input_between_samples_is_no_fault(controller):
    unit = started(controller(), (0, 0.1, 0, 0))
    unit.step(0.0, 5e-4, (0.0, 0.1, 0.0, 0.0, 0.0))
    unit.step(5e-4, 5e-4, (math.nan, 0.1, 0.0, 0.0, 0.0))
    assert outputs(unit)["fault"] == Fault.NONE


def test_bad_input_at_initialization_waits_for_the_first_sample(controller):
    """Estimators start from the first finite measurement, wherever it is."""
    unit, seen = started(controller(), (math.nan,) * 4), (0.3, 0.2, 0.0, 0.0)
    assert outputs(unit)["fault"] == Fault.NONE
    assert unit.step(0.0, 1e-3, given(seen)) == []
    assert abs(outputs(unit)["theta_dot_estimate"]) < 1.0


def test_command_that_overflows_is_a_fault_of_the_control(controller):
    """Finite numbers whose product is none: 1e304 V/rad at 1e5 rad."""
    unit = started(controller(**STATE_INPUT, law="LC", k_lin_1=1e304), (0.0, 0.0, 0.0, 0.0))
    assert unit.step(0.0, 1e-3, given((0.0, 0.0, 0.0, 0.0))) == []
    assert unit.step(1e-3, 1e-3, given((1e5, 0.0, 0.0, 0.0))) == [
        "fault non_finite_control: the command is not finite; the voltage is 0 V until reset"
    ]
    values = outputs(unit)
    assert (values["voltage"], values["mode"], values["fault"]) == (0.0, Mode.FAULT, Fault.NON_FINITE_CONTROL)


# State


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("at", [0, 300, 2000])
def test_state_through_json_continues_to_the_last_bit(controller, recorded, law, at):
    unit = started(controller(law=law), recorded[0])
    feed(unit, recorded[:at])
    copy = controller(law=law)
    copy.set_state(json.loads(json.dumps(unit.get_state())))
    assert copy.get_state() == unit.get_state()
    rest = recorded[at : at + 500]
    np.testing.assert_array_equal(feed(copy, rest, start=at), feed(unit, rest, start=at))


def test_saved_state_is_not_changed_by_the_run_and_can_be_restored_twice(controller, recorded):
    unit = started(controller(), recorded[0])
    feed(unit, recorded[:100])
    saved = unit.get_state()
    frozen = json.dumps(saved)
    first = feed(unit, recorded[100:400], start=100)
    assert json.dumps(saved) == frozen
    unit.set_state(saved)
    np.testing.assert_array_equal(feed(unit, recorded[100:400], start=100), first)


def test_fault_survives_the_saved_state(controller):
    unit = started(controller(), (0, 0.1, 0, 0))
    unit.step(0.0, 1e-3, given((math.nan, 0.0, 0.0, 0.0)))
    copy = controller()
    copy.set_state(json.loads(json.dumps(unit.get_state())))
    assert feed(copy, [(0, 0.1, 0, 0)], start=1)[-1].tolist() == [0.0, *unit.outputs()[1:]]


def test_norm_at_capture_is_that_of_the_state_in_the_law(controller, closed_loop, design):
    """The observer decides on the capture, the law sees the filter: its norm must be of the same state."""
    run = closed_loop(controller(norm_solver="exact", a_min=1e-3, b_max=20.0), 1.5)
    k = np.flatnonzero(run["mode"] == Mode.STABILIZING)[0]
    delta = math.remainder(run["delta_encoder"][k], math.tau)
    x: Any = [run["theta_encoder"][k], delta, run["theta_dot_estimate"][k], run["delta_dot_estimate"][k]]
    Pz = homogeneity.to_blocks(chain_of(design).Phi.tolist(), design.P.tolist())
    c = homogeneity.norm_polynomial(Pz, (chain_of(design).Phi @ x).tolist(), homogeneity.chain(4), 1.0)
    expected = homogeneity.homogeneous_norm(c, 1.0)
    assert run["homogeneous_norm_used"][k] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("seen", [(0.0, 3.0, 0.0, 1e160), (0.0, 0.1, 1e308, 1e308), (1e308, 3.0, 1e308, 0.0)])
def test_measurements_beyond_the_range_of_numbers_are_a_fault(controller, seen):
    unit = started(controller(**STATE_INPUT), (0.0, 3.0, 0.0, 0.0))
    feed(unit, [(0.0, 3.0, 0.0, 0.0), seen])
    assert outputs(unit)["mode"] == Mode.FAULT
    assert outputs(unit)["voltage"] == 0.0
