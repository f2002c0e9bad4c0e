"""The driver of the real board and the board's watchdog, on the stand-in for the vendor's package."""

from __future__ import annotations

import pytest

from cosim.hil.device import (
    LED_IDLE,
    DeviceError,
    UnavailableError,
)
from cosim.hil.quanser import WATCHDOG
from tests.cosim.hil.board import entries, leave_outputs, let_pass, outputs, read_on
from tests.cosim.hil.rig import one_sentence

PERIOD = 1e-3
TIMEOUT = 0.1


def test_watchdog_is_reloaded_with_each_voltage(stand_in, sampling):
    device = sampling()
    for _ in range(200):
        device.read(TIMEOUT)
        device.write(-1.0, LED_IDLE)
    assert stand_in.calls["watchdog_reload"] == stand_in.calls["write_analog"] - 1 == 201
    assert ("watchdog", "expired") not in entries(stand_in)


def expire(device):
    """Read without an answer until the watchdog has expired."""
    read_on(device, round(WATCHDOG / PERIOD) + 5)


def test_expired_watchdog_is_noticed_by_reading(stand_in, sampling):
    device = sampling()
    with pytest.raises(DeviceError, match="watchdog expired"):
        expire(device)
    assert outputs(stand_in) == (0.0, 0)
    (expiry,) = (event for event in stand_in.history("watchdog") if event.values == ["expired"])
    assert expiry.t == pytest.approx(2e-3 + WATCHDOG)


def test_expired_watchdog_is_noticed_by_writing(stand_in, sampling):
    device = sampling(expired_refuses_reads=False)
    expire(device)
    with pytest.raises(DeviceError, match="watchdog expired"):
        device.write(-1.0, LED_IDLE)
    assert outputs(stand_in) == (0.0, 0)


def test_expired_watchdog_is_noticed_where_the_board_accepts_voltages(stand_in, sampling, monkeypatch):
    device = sampling(expired_refuses_reads=False)
    expire(device)
    monkeypatch.setattr(stand_in.boards["0"], "refuse", lambda io: None)
    with pytest.raises(DeviceError, match="watchdog expired"):
        device.write(-1.0, LED_IDLE)
    assert device.safe_stop("") == []
    assert outputs(stand_in) == (0.0, 0)


@pytest.mark.parametrize("refuses_reads", [True, False])
def test_expired_watchdog_is_named(sampling, refuses_reads):
    device = sampling(expired_refuses_reads=refuses_reads)
    if not refuses_reads:
        expire(device)
    with pytest.raises(DeviceError, match="watchdog"):
        expire(device) if refuses_reads else device.write(-1.0, LED_IDLE)


@pytest.mark.parametrize("restores", [False, True])
def test_stop_after_expiry_leaves_the_0_volts_of_the_board(stand_in, sampling, library_calls, restores):
    device = sampling(clear_restores_outputs=restores)
    with pytest.raises(DeviceError):
        expire(device)
    library_calls.clear()
    assert device.safe_stop("") == []
    tail = ["watchdog_is_expired", "watchdog_stop", "task_stop", "task_delete"]
    assert library_calls == [*["write"] * 4, *tail]
    assert outputs(stand_in) == (0.0, 0)


@pytest.mark.parametrize("restores", [False, True])
def test_expiry_of_an_earlier_program_is_cleared(stand_in, quanser, restores):
    device = quanser(clear_restores_outputs=restores)
    leave_outputs(expired=True)
    device.open()
    assert outputs(stand_in) == (0.0, 0)
    assert not stand_in.boards["0"].watchdog.expired


def test_watchdog_of_an_earlier_program_does_not_end_this_one(quanser):
    device = quanser()
    leave_outputs(expired=True)
    device.open()
    let_pass(0.1)
    device.start(PERIOD)


def test_board_without_watchdog_is_refused_with_advice(stand_in, quanser):
    device = quanser(watchdog=True)
    stand_in.configure(clock="steps", watchdog=False)
    device.open()
    with pytest.raises(UnavailableError, match="no usable watchdog: --no-watchdog runs without it") as caught:
        device.start(PERIOD)
    assert one_sentence(str(caught.value))
    assert device.safe_stop("") == []
    assert "watchdog_start" not in stand_in.calls


def test_board_without_watchdog_runs_where_that_is_wanted(stand_in, quanser):
    device = quanser(watchdog=False)
    stand_in.configure(clock="steps", watchdog=False)
    device.open()
    device.start(PERIOD)
    device.enable(True)
    for _ in range(100):
        device.read(TIMEOUT)
    device.write(-1.0, LED_IDLE)
    assert outputs(stand_in) == (-1.0, 1)
    assert device.safe_stop("") == []
    assert [name for name in stand_in.calls if name.startswith("watchdog")] == []


@pytest.mark.parametrize("code", range(-599, -590))
@pytest.mark.parametrize("name", ["watchdog_set_digital_expiration_state", "watchdog_start"])
def test_missing_calls_of_the_watchdog(quanser, name, code):
    device = quanser(failures={name: (1, code, True)})
    device.open()
    with pytest.raises(UnavailableError, match="--no-watchdog"):
        device.start(PERIOD)
    assert device.safe_stop("") == []


def test_missing_clear_is_tolerated(stand_in, sampling):
    sampling(failures={"watchdog_clear": (1, -599, True)})
    assert ("watchdog", "started", WATCHDOG) in entries(stand_in)


def test_failing_clear_is_not(quanser):
    device = quanser(failures={"watchdog_clear": (1, -843)})
    with pytest.raises(DeviceError, match=r"clearing the watchdog: .*-843"):
        device.open()


@pytest.mark.parametrize(
    "changes",
    [
        {"expire_to_zero_only": True},
        {"failures": {"watchdog_set_other_expiration_state": (1, -594, True)}},
    ],
)
def test_light_that_cannot_expire_to_red(stand_in, sampling, changes):
    sampling(**changes)
    assert ("watchdog", "started", WATCHDOG) in entries(stand_in)
    assert ("watchdog", "analog", {0: 0.0}) in entries(stand_in)
