"""Transitions between the laws: all of them, with hysteresis and a latched fault."""

from itertools import product

import pytest

from ihc_fmu.pendulum.supervisor import Capture, Mode, next_mode
from ihc_fmu.sampled_unit import Fault

CAPTURE = Capture(level=2.0, angle=0.5, velocity=6.0, fall_back_angle=0.8)
INSIDE = (1.0, 0.1, 0.5)  # x' P x, delta, delta'
BETWEEN = (5.0, 0.7, 9.0)  # beyond the capture, within the fall-back
OUTSIDE = (5.0, 0.9, 0.5)
I, U, S, F = Mode.IDLE, Mode.SWING_UP, Mode.STABILIZING, Mode.FAULT


def decide(mode, where, *, enabled=True, swing_up=True):
    return next_mode(mode, CAPTURE, *where, enabled=enabled, swing_up=swing_up)


@pytest.mark.parametrize(
    ("mode", "inside", "between", "outside"),
    [(I, S, U, U), (U, S, U, U), (S, S, S, U), (F, F, F, F)],
)
def test_transitions_with_swing_up(mode, inside, between, outside):
    assert [decide(mode, where) for where in (INSIDE, BETWEEN, OUTSIDE)] == [inside, between, outside]


@pytest.mark.parametrize(
    ("mode", "inside", "between", "outside"),
    [(I, S, I, I), (U, S, I, I), (S, S, S, I), (F, F, F, F)],
)
def test_transitions_without_swing_up(mode, inside, between, outside):
    modes = [decide(mode, where, swing_up=False) for where in (INSIDE, BETWEEN, OUTSIDE)]
    assert modes == [inside, between, outside]


def test_disabled_is_idle_whatever_the_state_but_a_fault_stays():
    for where, swing_up in product((INSIDE, BETWEEN, OUTSIDE), (True, False)):
        assert {decide(m, where, enabled=False, swing_up=swing_up) for m in (I, U, S)} == {I}
        assert decide(F, where, enabled=False, swing_up=swing_up) == F


@pytest.mark.parametrize(
    "where",
    [(2.0, 0.1, 0.5), (1.0, 0.5, 0.5), (1.0, -0.5, 0.5), (1.0, 0.1, 6.0), (1.0, 0.1, -6.0), (float("nan"), 0.1, 0.5)],
)
def test_capture_needs_level_angle_and_velocity(where):
    """On the border of any one of the three conditions the swing-up goes on; just inside all it ends."""
    assert decide(U, where) == U
    assert decide(U, (1.999, -0.499, -5.999)) == S


@pytest.mark.parametrize("sign", [1, -1])
def test_stabilizing_lasts_up_to_the_fall_back_angle(sign):
    assert decide(S, (99.0, sign * 0.8, 99.0)) == S
    assert decide(S, (0.0, sign * 0.8000001, 0.0)) == U


def test_codes_of_the_outputs_are_those_of_the_interface():
    assert {m.name: int(m) for m in Mode} == {"IDLE": 1, "SWING_UP": 2, "STABILIZING": 3, "FAULT": 4}
    assert {f.name: int(f) for f in Fault} == {"NONE": 1, "NON_FINITE_INPUT": 2, "NON_FINITE_CONTROL": 3}
