"""The simulated device that reads its board in this process: in lockstep and by the clock."""

import math
import time

import numpy as np
import pytest

from cosim.hil.device import (
    LED_IDLE,
    VOLTAGE_CUT,
    DeviceError,
    LinkLostError,
)
from cosim.hil.scaling import RESOLUTION
from cosim.hil.simulated import HOLD, SimulatedDevice
from tests.cosim.hil.rig import at_rest, board_of, lockstep, one_sentence

MS = 1e-3


@pytest.fixture
def device(fmus):
    """Make a device in lockstep that is open and started, with its amplifier on; all are closed at the end."""
    devices = []

    def make(faults="", **changes):
        device = lockstep(fmus, faults, **changes)
        devices.append(device)
        device.open()
        device.start(MS)
        device.enable(True)
        return device

    yield make
    for device in devices:
        device.board.close()


# In lockstep


def test_lockstep_reads_one_period_after_the_other(device):
    d = device()
    ticks = []
    for _ in range(15):
        ticks.append(d.read(0.1).tick)
        d.write(0.0, LED_IDLE)
    assert ticks == list(range(15))


def test_lockstep_without_writing_is_cut_after_the_hold_time(device):
    d = device()
    d.read(0.1)
    d.write(1.0, LED_IDLE)
    bits = [d.read(0.1).digital for _ in range(25)]
    assert bits == [0] * 20 + [VOLTAGE_CUT] * 5
    d.write(1.0, LED_IDLE)
    assert d.read(0.1).digital == VOLTAGE_CUT


@pytest.mark.parametrize("periods", [1, 4])
def test_late_samples_skip_periods(device, periods):
    d = device(f"late@0.005={periods}")
    ticks = [d.read(0.1).tick for _ in range(10)]
    assert np.diff(ticks).tolist() == [1] * 5 + [1 + periods] + [1] * 3


def test_silence_is_a_lost_link_after_the_timeout(device):
    d = device("silent@0.002")
    for _ in range(3):
        d.read(0.1)
    with pytest.raises(LinkLostError, match=r"0\.1 s") as caught:
        d.read(0.1)
    one_sentence(caught.value)
    assert d.board.sample.tick == 102
    assert d.board.cut


def test_a_short_silence_is_missed_periods(device):
    d = device("silent@0.002=1:0.01")
    ticks = []
    for _ in range(5):
        ticks.append(d.read(0.1).tick)
        d.write(0.0, LED_IDLE)
    assert ticks[:3] == [0, 1, 2]
    assert ticks[3] in (12, 13)
    assert not d.board.cut


def test_reading_fails_where_the_script_says_so(device):
    d = device("read-error@0.002")
    for _ in range(3):
        d.read(0.1)
    with pytest.raises(DeviceError):
        d.read(0.1)


def test_a_plant_that_fails_is_a_device_error(device):
    d = device("push@0.002=1e300")
    for _ in range(3):
        d.read(0.1)
    with pytest.raises(DeviceError, match="doStep") as caught:
        d.read(0.1)
    one_sentence(caught.value)
    assert d.safe_stop("failed") == []
    d.close()
    at_rest(d.board)


def test_writing_after_the_stop_is_refused(device):
    d = device()
    d.read(0.1)
    d.safe_stop("enough")
    with pytest.raises(DeviceError) as caught:
        d.write(0.0, LED_IDLE)
    one_sentence(caught.value)


@pytest.mark.parametrize("until", ["made", "open", "start", "read", "write", "moving", "stopped", "closed"])
def test_stop_and_close_may_come_at_any_time_and_again(fmus, until):
    d = lockstep(fmus)
    steps = {
        "made": lambda: None,
        "open": d.open,
        "start": lambda: d.start(MS),
        "read": lambda: d.read(0.1),
        "write": lambda: (d.enable(True), d.write(5.0, LED_IDLE)),
        "moving": lambda: d.read(0.1),
        "stopped": lambda: d.safe_stop("first"),
        "closed": d.close,
    }
    for name, step in steps.items():
        step()
        if name == until:
            break
    for _ in range(3):
        assert d.safe_stop("again") == []
    at_rest(d.board)
    for _ in range(3):
        d.close()
    at_rest(d.board)


def test_a_stop_that_does_not_get_through_is_told_and_the_board_cuts_by_itself(device):
    d = device("silent@0.01")
    for _ in range(11):
        d.read(0.1)
        d.write(5.0, LED_IDLE)
    (failure,) = d.safe_stop("no use")
    assert "by itself" in one_sentence(failure)
    assert d.board.record[-1].voltage == 5.0
    d.close()
    at_rest(d.board)
    cut = next(e for e in d.board.record if e.what.startswith("cut:"))
    assert cut.time <= 0.01 + HOLD + MS


def test_a_second_close_in_a_silence_leaves_the_plant_alone(device, monkeypatch):
    d = device("silent@0.01")
    for _ in range(11):
        d.read(0.1)
        d.write(5.0, LED_IDLE)
    d.safe_stop("no use")
    d.close()
    ticks = []
    monkeypatch.setattr(d.board, "tick", lambda count=1: ticks.append(count))
    d.close()
    assert not ticks


def test_two_devices_do_not_know_of_each_other(device):
    a, b = device(), device()
    for _ in range(30):
        a.read(0.1)
        a.write(3.0, LED_IDLE)
        b.read(0.1)
        b.write(0.0, LED_IDLE)
    assert a.board.sample.arm > 0
    assert b.board.sample.arm == 0


# Real time


def test_real_time_waits_for_the_period(fmus):
    d = SimulatedDevice(board_of(fmus), real_time=True)
    d.open()
    period = 5 * MS
    d.start(period)
    before = time.perf_counter()
    last = -1
    for _ in range(20):
        sample = d.read(0.1)
        assert sample.tick > last
        last = sample.tick
        assert sample.due <= time.perf_counter_ns()
        d.write(0.0, LED_IDLE)
    assert time.perf_counter() - before >= 19 * period - 1e-3
    d.close()


def test_who_reads_late_finds_that_time_has_passed(fmus):
    d = SimulatedDevice(board_of(fmus), real_time=True)
    d.open()
    period = 2 * MS
    d.start(period)
    d.enable(True)
    first = d.read(0.1).due
    d.write(1.0, LED_IDLE)
    time.sleep(0.06)
    sample = d.read(0.1)
    assert sample.tick >= 29
    assert sample.due == first + sample.tick * round(period * 1e9)
    assert sample.due <= time.perf_counter_ns()
    assert sample.digital == 0  # who shares the device's process cannot be unheard by it
    assert sample.arm > 0  # the voltage was held
    d.close()


def test_counts_are_whole_and_stay_so(device):
    d = device()
    sample = d.read(0.1)
    for _ in range(200):
        d.write(2.0 * math.sin(0.1 * sample.tick), LED_IDLE)
        sample = d.read(0.1)
        assert isinstance(sample.arm, int)
        assert isinstance(sample.pendulum, int)
    assert abs(sample.arm) * RESOLUTION < 1.0


# Stalls of the machine, and what the controller is given after them


def test_periods_in_which_the_device_cannot_hear_are_no_silence(fmus):
    for deaf, cut in ((0, True), (24, False)):
        board = board_of(fmus)
        board.open()
        board.start(1e-3)
        board.command(1.0, enabled=True, led=LED_IDLE)
        board.tick(25, deaf)
        assert bool(board.cut) is cut
        board.tick(30)
        assert board.cut
        board.close()
