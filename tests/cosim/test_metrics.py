"""Metrics: closed forms, the definitions at their edges, and what they need."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from cosim.errors import UserError
from cosim.evaluation import TOLERANCE
from cosim.judged_signals import STABILIZING, angle_norm, wrapped
from cosim.metric_meanings import QUANTITIES, ZERO
from cosim.metrics import PARTS, TREND_T, evaluate, settling_time, trend, unsteady
from cosim.results import Result
from ihc_fmu.pendulum.interface import MODES

TIME = np.arange(10_001) * 1e-3
SMALL = ZERO * TOLERANCE
NAMES = (
    "settling_time",
    "integral_q2",
    "steady_rms",
    "steady_trend",
    "energy",
    "peak_voltage",
    "voltage_variation",
    "capture_time",
    "captures",
)
"""Of the pendulum's metrics in files, in their order; they must not change."""


def test_a_decaying_exponential_gives_its_closed_forms(made_result):
    found = evaluate(made_result(TIME, np.exp(-TIME)), tolerance=0.02, steady=3.0)
    assert found.settling_time == pytest.approx(math.log(50.0), abs=1e-3)
    assert found.integral_q2 == pytest.approx((1 - math.exp(-20.0)) / 2, rel=1e-6)
    assert found.steady_rms == pytest.approx(math.sqrt((math.exp(-14.0) - math.exp(-20.0)) / 6), rel=1e-3)


def test_both_angles_count_and_the_pendulum_is_wrapped(made_result):
    result = made_result(TIME, 0.3, plant_delta=0.4 - 4 * math.pi)
    assert angle_norm(result) == pytest.approx(0.5)
    assert evaluate(result).integral_q2 == pytest.approx(0.25 * 10.0)
    assert evaluate(made_result(TIME, 2 * math.pi)).steady_rms == pytest.approx(2 * math.pi)  # the arm is not wrapped


def test_energy_of_held_voltages_is_exact(made_result):
    """The first row's voltage was never applied; each later one over the step that ended there."""
    time = np.array([0.0, 0.5, 0.75, 2.0])
    found = evaluate(made_result(time, controller_voltage=[99.0, 2.0, -4.0, 1.0]), steady=0.1)
    assert found.energy == 4.0 * 0.5 + 16.0 * 0.25 + 1.0 * 1.25
    assert found.peak_voltage == 99.0
    assert evaluate(made_result(TIME, controller_voltage=-2.0)).energy == pytest.approx(40.0, rel=1e-12)
    assert evaluate(made_result(TIME, controller_voltage=-2.0)).peak_voltage == 2.0


def test_chattering_is_the_voltages_total_variation_per_second_in_steady_state(made_result):
    """A square wave of height 2a and n edges per second varies by 2 a n; what happened before does not count."""
    square = np.where((np.arange(len(TIME)) // 20) % 2, 0.3, -0.3)  # an edge every 20 ms
    found = evaluate(made_result(TIME, controller_voltage=np.where(TIME < 6.9, 5.0 * square, square)))
    assert found.voltage_variation == pytest.approx(0.6 * 50.0, rel=0.01)
    sine = evaluate(made_result(TIME, controller_voltage=0.5 * np.sin(20 * math.pi * TIME)))
    assert sine.voltage_variation == pytest.approx(4 * 0.5 * 10.0, rel=1e-3)
    assert evaluate(made_result(TIME, controller_voltage=7.0)).voltage_variation == 0.0
    assert math.isnan(evaluate(made_result([0.0, 1.0]), steady=0.1).voltage_variation)


@given(st.floats(-50, 50))
def test_wrapping_keeps_the_angle_and_ends_in_the_interval(angle):
    found = wrapped(np.array([angle]))[0]
    assert -math.pi <= found <= math.pi
    assert math.remainder(found - angle, 2 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_wrapping_takes_the_upper_end_of_the_interval():
    assert wrapped(np.array([0.0, math.pi, -math.pi, 3 * math.pi])).tolist() == pytest.approx([0.0] + [math.pi] * 3)


@pytest.mark.parametrize(
    ("q", "expected"),
    [
        ([0.0, 0.0, 0.0, 0.0], 0.0),
        ([1.0, 0.0, 0.0, 0.0], 1.0),
        ([1.0, 0.0, 1.0, 0.0], 3.0),
        ([1.0, 0.02, 0.02, 0.02], 1.0),  # the tolerance itself is settled
        ([0.0, 0.0, 0.0, 0.021], math.nan),
        ([1.0, 1.0, 1.0, 1.0], math.nan),
    ],
)
def test_settling_is_for_good(q, expected):
    assert settling_time(np.arange(4.0), np.array(q), 0.02) == pytest.approx(expected, nan_ok=True)


def test_tolerance_and_steady_state_are_parameters(made_result):
    result = made_result(TIME, np.where(TIME < 9.0, 0.1, 0.01))
    assert evaluate(result, tolerance=0.2).settling_time == 0.0
    assert evaluate(result, tolerance=0.05).settling_time == 9.0
    assert math.isnan(evaluate(result, tolerance=0.005).settling_time)
    assert evaluate(result, steady=0.5).steady_rms == pytest.approx(0.01)
    assert evaluate(result, steady=100.0).steady_rms == pytest.approx(math.sqrt(0.9 * 0.01 + 0.1 * 1e-4), rel=1e-3)


# The steady state

PHASE = 2 * math.pi * np.random.default_rng(1).random(8)
HUNTING = sum(np.sin(w * TIME + p) for w, p in zip((2.1, 3.3, 4.7, 6.1, 9.2, 13.0, 21.0, 35.0), PHASE, strict=True))


@pytest.mark.parametrize("rate", [0.1, 0.3, 1.12, 5.0, -0.3, -1.12])
def test_an_exponential_is_a_trend_of_its_closed_form(rate):
    assert trend(TIME, 0.1 * np.exp(-rate * (TIME - 8.5))) == pytest.approx(math.exp(1.5 * rate), rel=5e-3)


@pytest.mark.parametrize(
    ("e", "found"),
    [
        (0.0 * TIME, 1.0),
        (np.where(TIME < 8.4, 1.0, 0.0), math.inf),
        (np.where(TIME < 8.6, 0.0, 1.0), 0.0),
        (np.where(TIME < 8.6, 1e-120, 1e-50), 0.0),
    ],
)
def test_the_trend_of_what_is_exactly_at_rest_in_a_half_is_0_or_infinite(e, found):
    assert trend(TIME, e, zero=0.0) == pytest.approx(found, abs=1e-60)


@pytest.mark.parametrize(
    ("q", "steady"),
    [
        (np.full(len(TIME), 0.01), True),
        (0.01 * np.exp(-0.05 * TIME), True),  # 8 % from half to half: too small to matter
        (np.zeros(len(TIME)), True),
        (SMALL * np.exp(-5.0 * (TIME - 7.0)), True),  # decays where it counts as zero
        (SMALL * np.exp(-2000.0 * TIME), True),  # underflows
        (0.01 * np.abs(np.sin(3.0 * TIME)), True),
        (np.abs(HUNTING), True),
        (np.abs(HUNTING) * np.exp(-0.5 * TIME), False),
        (np.where(TIME < 7.2, 0.1, 0.01), False),  # ends inside the window
        (np.where(TIME < 9.0, 0.0, 0.1), False),
        (0.01 + 0.1 * np.exp(-(TIME - 7.0)), False),
    ],
)
def test_a_window_with_a_trend_is_no_steady_state(made_result, q, steady):
    found = evaluate(made_result(TIME, q))
    assert found.steady == steady
    assert (unsteady(found) == "") == steady


def test_noise_is_taken_for_a_trend_as_rarely_as_students_t_says():
    assert pytest.approx(stats.t.ppf(0.99, PARTS - 2), abs=5e-4) == TREND_T
    rng, time = np.random.default_rng(1), np.arange(0.0, 3.01, 0.05)
    flagged = sum(trend(time, np.abs(rng.standard_normal(len(time)))) != 1.0 for _ in range(1000))
    assert flagged < 40


@pytest.mark.parametrize(
    ("time", "q"), [(np.arange(0.0, 2.9, 0.01), 0.1), (np.arange(0.0, 9.0, 0.5), 0.1), (TIME, math.nan)]
)
def test_a_steady_state_cannot_be_told_of_too_little(made_result, time, q):
    found = evaluate(made_result(time, q))
    assert math.isnan(found.steady_trend)
    assert not found.steady
    assert unsteady(found).startswith("no steady state can be told")


def test_chattering_is_not_told_of_a_result_without_every_row(made_result):
    result = made_result(TIME[::10], controller_voltage=1.0)
    result.metadata["step"] = 1e-3
    assert math.isnan(evaluate(result).voltage_variation)
    result.metadata["step"] = 1e-2
    assert evaluate(result).voltage_variation == 0.0


def test_every_metric_has_a_symbol_of_its_own():
    assert tuple(QUANTITIES) == NAMES
    assert len({q.symbol for q in QUANTITIES.values()}) == len(NAMES)
    texts = [
        QUANTITIES[n].text(v) for n, v in (("settling_time", math.nan), ("energy", math.nan), ("steady_rms", 1e-9))
    ]
    assert texts == ["never", "–", "< 0.0002"]


@pytest.mark.parametrize(
    ("modes", "capture_time", "captures"),
    [
        ([2, 2, 2, 2, 2, 2], math.nan, 0),
        ([2, 2, 3, 3, 3, 3], 2.0, 1),
        ([3, 3, 3, 3, 3, 3], 0.0, 1),
        ([1, 3, 2, 3, 3, 4], 1.0, 2),
        ([2, 3, 2, 3, 2, 3], 1.0, 3),
    ],
)
def test_captures_are_counted_and_the_first_is_timed(made_result, modes, capture_time, captures):
    found = evaluate(made_result(np.arange(6.0), controller_mode=modes))
    assert (found.capture_time, found.captures) == (pytest.approx(capture_time, nan_ok=True), captures)
    assert MODES[STABILIZING - 1] == "stabilizing"


def test_encoders_stand_in_for_the_true_angles(made_result):
    result = made_result(TIME)
    signals = {n: s for n, s in result.signals.items() if not n.startswith("plant")}
    signals |= {"plant.theta_encoder": np.full(len(TIME), 3.0), "plant.delta_encoder": np.full(len(TIME), -4.0)}
    measured = angle_norm(Result(TIME, signals, {}, {}))
    assert measured == pytest.approx(math.hypot(3.0, 2 * math.pi - 4.0))


@pytest.mark.parametrize("missing", ["plant.theta", "controller.voltage", "controller.mode"])
def test_missing_signals_are_named(made_result, missing):
    result = made_result(TIME)
    del result.signals[missing]
    with pytest.raises(UserError, match=missing):
        evaluate(result)


@pytest.mark.parametrize("rows", [0, 1])
def test_metrics_need_two_rows(made_result, rows):
    with pytest.raises(UserError, match=f"at least two rows, found {rows}"):
        evaluate(made_result(np.arange(float(rows))))


def test_the_numbers_by_name(made_result):
    found = evaluate(made_result(TIME, 0.01))
    assert tuple(found.as_dict()) == NAMES
    assert found.as_dict()["steady_rms"] == found.steady_rms == pytest.approx(0.01)
