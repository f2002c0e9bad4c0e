"""Each rule at, just inside and just outside its limit."""

import math
from dataclasses import fields

import pytest

from cosim.hil.device import AMPLIFIER_FAULT, STALL_DETECTED, STALL_ERROR, VOLTAGE_CUT, Sample
from cosim.hil.guards import STALL_VOLTAGE, Action, Guard, Limits, digital_reason
from cosim.hil.scaling import delta_of, theta_of

MS = 1e-3
HANGING = -math.pi


class Bench:
    """A guard that is fed samples; ticks count on by themselves."""

    def __init__(self, period=MS, **options):
        self.guard = Guard(Limits(), period, **options)
        self.tick = -1
        self.reason = ""

    def feed(self, *, skip=0, theta=None, delta=None, stabilizing=False, **sample):
        self.tick += 1 + skip
        s = Sample(tick=self.tick, **sample)
        action, self.reason = self.guard.check(
            s,
            theta_of(s.arm) if theta is None else theta,
            delta_of(s.pendulum) if delta is None else delta,
            stabilizing=stabilizing,
        )
        assert bool(self.reason) == (action is Action.STOP)
        return action


@pytest.fixture
def bench():
    bench = Bench()
    assert bench.feed() is Action.GO
    return bench


def test_the_limits_are_those_of_the_documented_table():
    limits = Limits()
    assert (math.degrees(limits.arm_warning), math.degrees(limits.arm)) == pytest.approx((90.0, 120.0))
    assert (limits.peak_current, limits.continuous_current, limits.continuous_time) == (2.0, 0.5, 3.0)
    assert (limits.missed_in_a_row, limits.missed_share) == (5, 0.01)
    assert math.degrees(limits.fall) == pytest.approx(20.0)
    assert limits.encoder_speed * MS > 78.0
    assert STALL_VOLTAGE == 5.0
    assert limits.longest_gap == 1.0
    assert len(fields(limits)) == 10


@pytest.mark.parametrize("allowed", [True, False])
@pytest.mark.parametrize("jump", [10**6, 1002, 0, -1, -(10**9)])
def test_a_clock_that_jumps_is_a_fault_even_where_misses_are_allowed(jump, allowed):
    """Also where the jump is to the end of the run, which it must not complete."""
    guard = Guard(Limits(), MS, stop_on_misses=not allowed)
    guard.check(Sample(tick=5), 0.0, math.pi, stabilizing=False)
    action, reason = guard.check(Sample(tick=5 + jump), 0.0, math.pi, stabilizing=False)
    assert (action, reason) == (
        Action.STOP,
        f"the device's clock is not to be believed: from period 5 to {5 + jump} at once",
    )


# Missed periods


@pytest.mark.parametrize(("missed", "action"), [(1, Action.GO), (4, Action.GO), (5, Action.STOP), (500, Action.STOP)])
def test_missed_periods_in_a_row(bench, missed, action):
    assert bench.feed(skip=missed) is action
    assert bench.guard.missed == missed
    if action is Action.STOP:
        assert f"{missed} periods missed in a row" in bench.reason


def test_gaps_with_only_one_sample_between_are_in_a_row(bench):
    assert bench.feed(skip=2) is Action.GO
    assert bench.feed(skip=2) is Action.GO
    assert bench.feed(skip=1) is Action.STOP
    assert "5 periods missed in a row" in bench.reason


def test_a_sample_in_time_ends_the_row(bench):
    for _ in range(2):
        assert bench.feed(skip=4) is Action.GO
        assert bench.feed() is Action.GO
    assert bench.guard.missed == 8


def test_one_percent_within_a_second_is_allowed_and_more_is_not(bench):
    for _ in range(10):
        assert bench.feed(skip=1) is Action.GO
        for _ in range(9):
            assert bench.feed() is Action.GO
    assert bench.feed(skip=1) is Action.STOP
    assert "11 of 1000 periods missed within a second" in bench.reason


def test_what_was_missed_a_second_ago_is_forgotten(bench):
    for _ in range(10):
        bench.feed(skip=1)
        bench.feed()
    while bench.tick < 1030:
        assert bench.feed() is Action.GO
    for _ in range(10):
        assert bench.feed(skip=1) is Action.GO
        assert bench.feed() is Action.GO
    assert bench.guard.missed == 20


@pytest.mark.parametrize(("later", "action"), [(999, Action.STOP), (1000, Action.GO)])
def test_a_second_has_as_many_periods_as_the_rate(bench, later, action):
    bench.feed(skip=2)
    first = bench.tick
    for _ in range(4):
        bench.feed()
        bench.feed(skip=2)
    while bench.tick < first + later - 2:
        assert bench.feed() is Action.GO
    assert bench.feed(skip=1) is action


@pytest.mark.parametrize(("rate", "allowed"), [(500, 5), (1000, 10), (2000, 20)])
def test_the_share_is_of_the_rates_own_second(rate, allowed):
    bench = Bench(1.0 / rate)
    bench.feed()
    actions = []
    for _ in range(allowed + 1):
        actions.append(bench.feed(skip=1))
        bench.feed()
    assert actions == [Action.GO] * allowed + [Action.STOP]


def test_where_misses_do_not_stop_they_are_a_warning_at_the_time_of_the_first():
    bench = Bench(stop_on_misses=False)
    bench.tick = 99
    bench.feed()
    assert bench.feed(skip=30) is Action.GO
    bench.feed(skip=30)
    assert list(bench.guard.warnings.values()) == [pytest.approx(31 * MS)]
    assert "missed" in next(iter(bench.guard.warnings))
    assert bench.guard.missed == 60


def test_the_first_sample_may_have_any_tick():
    bench = Bench()
    bench.tick = 10_000
    assert bench.feed() is Action.GO
    assert bench.guard.missed == 0


# Jumps


@pytest.mark.parametrize("encoder", ["arm", "pendulum"])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("counts", "action"), [(99, Action.GO), (100, Action.GO), (101, Action.HOLD)])
def test_encoder_jumps(bench, encoder, sign, counts, action):
    assert bench.feed(**{encoder: sign * counts}, theta=0.0) is action
    assert bench.guard.dropped == (action is Action.HOLD)


@pytest.mark.parametrize(("counts", "action"), [(300, Action.GO), (301, Action.HOLD)])
def test_missed_periods_leave_time_for_a_larger_motion(bench, counts, action):
    assert bench.feed(skip=2, arm=counts) is action


def test_one_dropped_sample_is_a_warning_and_the_run_goes_on(bench):
    assert bench.feed(arm=5000) is Action.HOLD
    assert bench.feed(arm=1) is Action.GO
    assert bench.feed(arm=5000) is Action.HOLD
    assert bench.feed(arm=2) is Action.GO
    assert bench.guard.dropped == 2
    assert list(bench.guard.warnings.values()) == [pytest.approx(MS)]


@pytest.mark.parametrize("encoders", [("arm", "arm"), ("arm", "pendulum")])
def test_two_dropped_samples_in_a_row_end_the_run(bench, encoders):
    first, second = encoders
    assert bench.feed(**{first: 5000}, theta=0.0) is Action.HOLD
    assert bench.feed(**{second: 5000}, theta=0.0) is Action.STOP
    assert "two encoder readings in a row" in bench.reason


def test_a_real_motion_over_a_dropped_sample_is_believed(bench):
    bench.feed(arm=-5000)
    assert bench.feed(arm=200) is Action.GO  # two periods since the last believed sample
    bench.feed(arm=-5000)
    assert bench.feed(arm=401) is Action.STOP


def test_a_dropped_sample_says_nothing_of_the_arms_angle(bench):
    assert bench.feed(arm=1024) is Action.HOLD
    assert all("arm beyond" not in text for text in bench.guard.warnings)


def test_the_first_sample_is_never_a_jump():
    bench = Bench()
    assert bench.feed(arm=400, pendulum=10**6) is Action.GO
    assert bench.feed(arm=401, pendulum=10**6 - 100) is Action.GO


# The arm


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("degrees", "action", "warned"),
    [(89.99, Action.GO, 0), (90.01, Action.GO, 1), (119.99, Action.GO, 1), (120.01, Action.STOP, 0)],
)
def test_arm(bench, sign, degrees, action, warned):
    assert bench.feed(theta=sign * math.radians(degrees)) is action
    assert len(bench.guard.warnings) == warned


def test_the_arm_at_its_limit_is_inside(bench):
    assert bench.feed(theta=Limits().arm_warning) is Action.GO
    assert not bench.guard.warnings
    assert bench.feed(theta=-Limits().arm) is Action.GO
    assert bench.feed(theta=math.nextafter(Limits().arm, 4.0)) is Action.STOP


# Currents


@pytest.mark.parametrize(("current", "action"), [(1.99, Action.GO), (2.0, Action.GO), (2.01, Action.STOP)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_peak_current(bench, current, action, sign):
    assert bench.feed(current=sign * current) is action


@pytest.mark.parametrize("current", [math.nan, math.inf, -math.inf])
def test_a_current_that_is_not_finite(bench, current):
    assert bench.feed(current=current) is Action.STOP
    assert "not finite" in bench.reason


def test_continuous_current_for_three_seconds(bench):
    actions = [bench.feed(current=-0.51) for _ in range(2999)]
    assert set(actions) == {Action.GO}
    assert Action.STOP in [bench.feed(current=0.51) for _ in range(3)]
    assert "0.5 A for 3 s" in bench.reason


def test_the_continuous_current_itself_may_go_on_for_ever(bench):
    assert {bench.feed(current=0.5) for _ in range(5000)} == {Action.GO}


def test_a_pause_begins_the_three_seconds_anew(bench):
    for _ in range(2):
        assert {bench.feed(current=1.0) for _ in range(2990)} == {Action.GO}
        bench.feed(current=0.5)


def test_missed_periods_count_for_the_three_seconds():
    bench = Bench(stop_on_misses=False)
    bench.feed()
    actions = [bench.feed(skip=3, current=1.0) for _ in range(1000)]  # four seconds
    assert Action.STOP in actions


# Digital inputs


@pytest.mark.parametrize("bits", [AMPLIFIER_FAULT, STALL_ERROR, VOLTAGE_CUT, AMPLIFIER_FAULT | STALL_DETECTED, 15])
def test_digital_inputs_that_end_a_run(bench, bits):
    assert bench.feed(digital=bits) is Action.STOP
    assert bench.reason == digital_reason(bits) != ""


def test_they_end_it_at_the_first_sample_too():
    assert Bench().feed(digital=AMPLIFIER_FAULT) is Action.STOP


@pytest.mark.parametrize("bits", [16, -1])
def test_unknown_digital_inputs_end_a_run(bench, bits):
    assert bench.feed(digital=bits) is Action.STOP


def test_a_stalled_motor_is_limited_while_it_is_stalled(bench):
    assert bench.feed(digital=STALL_DETECTED) is Action.LIMIT
    assert bench.feed(digital=STALL_DETECTED) is Action.LIMIT
    assert bench.feed() is Action.GO
    assert list(bench.guard.warnings.values()) == [pytest.approx(MS)]


def test_other_rules_go_before_the_limit(bench):
    assert bench.feed(digital=STALL_DETECTED, theta=3.0) is Action.STOP
    assert bench.feed(digital=STALL_DETECTED, arm=5000, theta=0.0) is Action.HOLD


def test_every_reason_is_one_sentence_and_no_fault_has_none():
    assert digital_reason(0) == digital_reason(STALL_DETECTED) == ""
    for bit in (AMPLIFIER_FAULT, STALL_ERROR, VOLTAGE_CUT):
        assert "\n" not in digital_reason(bit)


# The fall

INSIDE, NEAR, OUTSIDE = (math.radians(d) for d in (9.9, 19.9, 20.1))


def balanced(**options):
    bench = Bench(stop_on_fall=True, **options)
    bench.feed(delta=HANGING)
    bench.feed(delta=INSIDE, stabilizing=True)
    return bench


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("turns", [0, 3, -2])
def test_a_balanced_pendulum_that_falls(sign, turns):
    bench = balanced()
    assert bench.feed(delta=sign * NEAR + turns * 2.0 * math.pi, stabilizing=True) is Action.GO
    assert bench.feed(delta=sign * OUTSIDE + turns * 2.0 * math.pi, stabilizing=True) is Action.STOP
    assert "fell" in bench.reason


def test_the_controllers_return_to_the_swing_up_is_a_fall():
    bench = balanced()
    assert bench.feed(delta=NEAR, stabilizing=False) is Action.STOP


def test_a_capture_that_never_came_near_upright_is_no_fall():
    bench = Bench(stop_on_fall=True)
    for delta, stabilizing in ((HANGING, False), (0.5, True), (math.radians(10.1), True), (0.5, True), (2.0, False)):
        assert bench.feed(delta=delta, stabilizing=stabilizing) is Action.GO


def test_after_a_failed_capture_the_next_balance_counts():
    bench = Bench(stop_on_fall=True)
    for delta, stabilizing in ((0.5, True), (2.0, False), (0.0, True), (NEAR, True)):
        assert bench.feed(delta=delta, stabilizing=stabilizing) is Action.GO
    assert bench.feed(delta=OUTSIDE, stabilizing=True) is Action.STOP


def test_a_fall_is_left_to_the_controller_where_it_does_not_stop():
    bench = Bench(stop_on_fall=False)
    for delta, stabilizing in ((0.0, True), (OUTSIDE, True), (2.0, False), (0.0, True)):
        assert bench.feed(delta=delta, stabilizing=stabilizing) is Action.GO
    assert not bench.guard.warnings


# The order of the rules


def test_a_warning_keeps_the_time_of_its_first_occurrence(bench):
    for _ in range(3):
        bench.feed(theta=1.6)
    (when,) = bench.guard.warnings.values()
    assert when == pytest.approx(MS)
