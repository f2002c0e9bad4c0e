"""Scales and signs against the manufacturer's formulas, and against what the plant's encoders report."""

import math

import numpy as np
import pytest

from cosim.hil.scaling import RESOLUTION, counts_of, delta_of, hardware_voltage, theta_of

COUNTS = np.arange(-5 * 2048, 5 * 2048 + 1)
TURN = 2.0 * math.pi


def test_the_arm_is_the_manufacturers():
    np.testing.assert_allclose(theta_of(COUNTS), -2.0 * math.pi / 2048.0 * COUNTS, rtol=1e-15, atol=0.0)


def test_the_pendulum_is_the_manufacturers_up_to_whole_turns():
    theirs = np.mod(TURN / 2048.0 * COUNTS, TURN) - math.pi
    turns = (delta_of(COUNTS) - theirs) / TURN
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    first_turn = (COUNTS >= 0) & (COUNTS < 2048)
    np.testing.assert_allclose(delta_of(COUNTS)[first_turn], theirs[first_turn], rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    ("counts", "angle"), [(0, -math.pi), (1024, 0.0), (2048, math.pi), (-1024, -TURN), (1536, math.pi / 2)]
)
def test_the_pendulums_angle_is_exact_at_quarter_turns(counts, angle):
    assert delta_of(counts) == angle


@pytest.mark.parametrize(("counts", "angle"), [(0, 0.0), (512, -math.pi / 2), (-1024, math.pi), (2048, -TURN)])
def test_the_arms_angle_is_exact_at_quarter_turns(counts, angle):
    assert theta_of(counts) == angle


def test_no_count_is_minus_zero():
    assert math.copysign(1.0, theta_of(0)) == 1.0
    assert math.copysign(1.0, delta_of(1024)) == 1.0


def test_one_number_and_an_array_are_the_same_bits():
    for function in (theta_of, delta_of):
        assert [function(int(n)) for n in COUNTS[::7]] == function(COUNTS[::7]).tolist()


def test_counts_come_back_from_the_angles_of_an_encoder():
    assert [counts_of(RESOLUTION * int(n)) for n in COUNTS] == COUNTS.tolist()
    assert [-counts_of(theta_of(int(n))) for n in COUNTS[::11]] == COUNTS[::11].tolist()
    assert [counts_of(delta_of(int(n))) + 1024 for n in COUNTS[::11]] == COUNTS[::11].tolist()


def test_counts_come_back_after_many_turns():
    for turns in (10**3, 10**6):
        assert counts_of(RESOLUTION * (2048 * turns + 3)) == 2048 * turns + 3


def test_the_hardware_turns_the_arm_against_the_angles_sign():
    assert hardware_voltage(3.25) == -3.25
    assert hardware_voltage(hardware_voltage(0.1)) == 0.1
