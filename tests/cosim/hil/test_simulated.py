"""The board of a simulated device in its own time, and its faults."""

import csv
import math

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil.device import (
    AMPLIFIER_FAULT,
    LED_BALANCE,
    LED_IDLE,
    STALL_DETECTED,
    STALL_ERROR,
    VOLTAGE_CUT,
    DeviceError,
)
from cosim.hil.simulated import HARD_LIMIT, HOLD
from tests.cosim.hil.rig import at_rest, board_of, one_sentence

MS = 1e-3


@pytest.fixture
def started(fmus):
    """Make an open board that samples; all are closed at the end."""
    boards = []

    def make(faults="", period=MS, **changes):
        board = board_of(fmus, faults, **changes)
        boards.append(board)
        board.open()
        board.start(period)
        return board

    yield make
    for board in boards:
        board.close()


def drive(board, voltage, ticks, *, enabled=True):
    for _ in range(ticks):
        board.command(voltage, enabled=enabled, led=LED_IDLE)
        board.tick()


def raw(sample):
    return sample.tick, sample.arm, sample.pendulum, sample.current, sample.digital


# The board


@pytest.mark.parametrize("delta_0", [-math.pi, 0.3, 5.0])
@pytest.mark.parametrize("theta_0", [0.0, -1.0])
def test_encoders_are_zero_at_open(started, theta_0, delta_0):
    board = started(plant__start__delta_0=delta_0, plant__start__theta_0=theta_0)
    assert raw(board.sample) == (0, 0, 0, 0.0, 0)


def test_a_positive_hardware_voltage_turns_the_arms_counts_up_and_draws_a_positive_current(started):
    board = started()
    drive(board, 1.0, 40)
    sample = board.sample
    assert sample.arm > 4
    assert sample.pendulum > 4  # the model's: theta goes down, the hanging pendulum's delta up
    assert sample.current > 0.0
    assert sample.tachometer > 0.0


def test_the_tachometer_is_the_rate_of_the_arms_counts(started):
    board = started()
    drive(board, 2.0, 60)
    before = board.sample.arm
    drive(board, 2.0, 10)
    assert (board.sample.arm - before) / (10 * MS) == pytest.approx(board.sample.tachometer, rel=0.2)


def test_the_current_is_what_the_winding_draws_where_the_arm_stands(started):
    board = started(plant__start__J_r=10.0, controller__other_model=True)
    drive(board, 4.2, 10)
    assert board.sample.current == pytest.approx(4.2 / 8.4, rel=1e-3)


def test_the_amplifier_off_is_no_voltage(started):
    board = started()
    drive(board, 8.0, 50, enabled=False)
    assert board.sample.arm == 0
    assert board.sample.current == pytest.approx(0.0, abs=1e-12)
    assert all(event.voltage == 0.0 for event in board.record)


def test_the_voltage_is_kept_within_the_hardwares_range(started):
    board = started()
    drive(board, 1e6, 1)
    assert board.record[-1].voltage == HARD_LIMIT
    drive(board, -1e6, 1)
    assert board.record[-1].voltage == -HARD_LIMIT


@pytest.mark.parametrize("period", [MS, 2 * MS, 5e-4])
def test_silence_for_the_hold_time_cuts_the_voltage_for_good(started, period):
    board = started(period=period)
    board.command(1.0, enabled=True, led=LED_IDLE)
    held = round(HOLD / period)
    board.tick(held)
    assert not board.cut
    assert board.sample.digital == 0
    board.tick()
    assert board.sample.digital == VOLTAGE_CUT
    cut = board.record[-1]
    assert (cut.voltage, cut.time) == (0.0, pytest.approx(HOLD))
    drive(board, 5.0, 5)
    assert board.sample.digital == VOLTAGE_CUT
    assert board.record[-1].voltage == 0.0


def test_a_command_within_the_hold_time_keeps_the_voltage(started):
    board = started()
    for _ in range(5):
        board.command(0.5, enabled=True, led=LED_IDLE)
        board.tick(20)
    assert not board.cut


def test_only_opening_takes_back_a_cut(started):
    board = started()
    board.tick(30)
    assert board.cut
    board.start(MS)
    assert board.sample.digital == VOLTAGE_CUT
    board.open()
    board.start(MS)
    assert raw(board.sample) == (0, 0, 0, 0.0, 0)
    drive(board, 1.0, 5)
    assert board.record[-1].voltage == 1.0


@pytest.mark.parametrize("voltage", [math.nan, math.inf, -math.inf])
def test_a_voltage_that_is_not_finite_cuts(started, voltage):
    board = started()
    drive(board, 3.0, 2)
    drive(board, voltage, 1)
    assert board.record[-1].what == "cut: a voltage that is not finite"
    assert board.sample.digital == VOLTAGE_CUT
    drive(board, 3.0, 2)
    assert board.record[-1].voltage == 0.0


def test_only_the_last_command_before_a_period_counts(started):
    board, other = started(), started()
    board.command(9.0, enabled=True, led=LED_IDLE)
    board.command(1.0, enabled=True, led=LED_BALANCE)
    board.tick()
    drive(other, 1.0, 1)
    assert raw(board.sample) == raw(other.sample)
    assert all(event.voltage != 9.0 for event in board.record)


def test_many_periods_at_once_are_the_same_as_one_by_one(started):
    a, b = started(), started()
    for board, ticks in ((a, [13]), (b, [1] * 13)):
        board.command(2.0, enabled=True, led=LED_IDLE)
        for n in ticks:
            board.tick(n)
    assert raw(a.sample) == raw(b.sample)


def test_the_record_tells_the_story(started, tmp_path):
    board = started()
    drive(board, 0.0, 2, enabled=False)
    drive(board, 1.5, 2)
    drive(board, 1.5, 1, enabled=False)
    board.safe_stop("enough")
    board.close()
    told = [(round(e.time / MS), e.what, e.voltage) for e in board.record]
    assert told == [
        (0, "open", 0.0),
        (0, "start", 0.0),
        (2, "amplifier on", 0.0),
        (2, "command", 1.5),
        (4, "amplifier off", 1.5),
        (4, "command", 0.0),
        (5, "stop: enough", 0.0),
        (5, "close", 0.0),
    ]
    board.save_record(tmp_path / "record.csv")
    with (tmp_path / "record.csv").open(newline="") as file:
        names, *rows = csv.reader(file)
    assert names == ["time", "voltage", "what"]
    assert [(float(t), w, float(v)) for t, v, w in rows] == [tuple(e) for e in board.record]


def test_a_stop_and_a_close_may_be_repeated(started):
    board = started()
    drive(board, 4.0, 3)
    for _ in range(2):
        board.safe_stop("again")
    at_rest(board)
    board.close()
    board.close()
    assert [e.what for e in board.record].count("close") == 1


def test_a_second_session_begins_at_time_zero(started):
    board = started()
    drive(board, 0.0, 100)
    board.close()
    board.open()
    assert board.record[-1] == (0.0, "open", 0.0)


def test_a_fault_of_the_session_before_is_over_when_the_device_is_opened(started):
    board = started("silent@0.05")
    board.tick(100)
    board.close()
    board.open()
    assert not board.silent()


@pytest.mark.parametrize("counts", [512, 4096])
def test_a_plant_with_other_encoders_is_refused(fmus, counts):
    with pytest.raises(UserError, match="encoder_counts = 2048") as caught:
        board_of(fmus, plant__start__encoder_counts=counts)
    assert str(counts) in one_sentence(caught.value)


def test_a_plant_of_the_right_encoders_is_taken(fmus):
    assert board_of(fmus, plant__start__encoder_counts=2048).sample.tick == 0


def test_the_controller_is_no_plant(fmus):
    with pytest.raises(UserError) as caught:
        board_of(fmus, plant__fmu="IhcController.fmu", plant__parameters=None, run__seed=None)
    one_sentence(caught.value)


# Faults


@pytest.mark.parametrize(("kind", "encoder"), [("arm-jump", "arm"), ("pendulum-jump", "pendulum")])
@pytest.mark.parametrize(("duration", "samples"), [("", 1), (":0.001", 1), (":0.003", 3)])
def test_jumps(started, kind, encoder, duration, samples):
    board = started(f"{kind}@0.005=300{duration}")
    seen = []
    for _ in range(12):
        board.tick()
        seen.append(getattr(board.sample, encoder))
    assert seen == [0] * 4 + [300] * samples + [0] * (8 - samples)


@pytest.mark.parametrize(
    ("kind", "bit"), [("amplifier-fault", AMPLIFIER_FAULT), ("stall", STALL_DETECTED), ("stall-error", STALL_ERROR)]
)
def test_digital_faults_stay(started, kind, bit):
    board = started(f"{kind}@0.005")
    board.tick(4)
    assert board.sample.digital == 0
    board.tick()
    assert board.sample.digital == bit
    board.tick(10)
    assert board.sample.digital == bit


def test_digital_faults_add_up_and_may_end(started):
    board = started("stall@0.002=1:0.002,stall-error@0.003")
    bits = []
    for _ in range(5):
        board.tick()
        bits.append(board.sample.digital)
    assert bits == [0, 2, 6, 4, 4]


@pytest.mark.parametrize("value", ["2.5", "nan", "-inf"])
def test_a_reported_current(started, value):
    board = started(f"current@0.003={value}:0.002")
    seen = []
    for _ in range(6):
        board.tick()
        seen.append(board.sample.current)
    np.testing.assert_allclose(seen, [0.0, 0.0, float(value), float(value), 0.0, 0.0], atol=1e-12)


def test_a_push_moves_the_pendulum_and_ends(started):
    board = started("push@0.01=0.01:0.02")
    quiet = started()
    for b in (board, quiet):
        for _ in range(10):
            b.command(0.0, enabled=True, led=LED_IDLE)
            b.tick()
    assert raw(board.sample) == raw(quiet.sample)
    for b in (board, quiet):
        drive(b, 0.0, 30)
    assert board.sample.pendulum > 20
    assert abs(quiet.sample.pendulum) <= 1


def test_the_first_sample_may_be_faulty(started):
    assert started("arm-jump@0=7").sample.arm == 7


def test_refusals_are_device_errors(started):
    board = started("read-error@0.001,write-error@0.002")
    board.refuse_to_read()
    board.tick()
    with pytest.raises(DeviceError) as caught:
        board.refuse_to_read()
    one_sentence(caught.value)
    board.command(1.0, enabled=True, led=LED_IDLE)
    board.tick()
    with pytest.raises(DeviceError) as caught:
        board.command(2.0, enabled=True, led=LED_IDLE)
    one_sentence(caught.value)
    board.tick()
    assert board.record[-1].voltage == 1.0


def test_commands_do_not_get_through_silence(started):
    board = started("silent@0.005=1:0.01")
    drive(board, 1.0, 5)
    drive(board, 9.0, 9)
    assert board.record[-1].voltage == 1.0
    assert board.silent()
    board.tick()
    assert not board.silent()
    drive(board, 2.0, 1)
    assert board.record[-1].voltage == 2.0
