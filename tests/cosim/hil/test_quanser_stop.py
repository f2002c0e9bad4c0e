"""The stop of the real board's driver, whatever fails in it, on the stand-in for the vendor's package."""

from __future__ import annotations

from collections import Counter

import pytest

from cosim.hil.device import (
    LED_IDLE,
    LED_STOPPED,
    DeviceError,
)
from tests.cosim.hil.board import entries, outputs

PERIOD = 1e-3
TIMEOUT = 0.1
STOP_CALLS = ["write", "watchdog_stop", "task_stop", "task_delete"]


def test_stop_sequence(stand_in, sampling, library_calls):
    device = sampling()
    begin = len(stand_in.record)
    library_calls.clear()
    assert device.safe_stop("") == []
    assert library_calls == STOP_CALLS
    device.close()
    assert entries(stand_in, begin) == [
        ("AO0", 0.0),
        ("DO0", 0),
        ("LED", *LED_STOPPED),
        ("watchdog", "stopped"),
        ("task", "stopped"),
        ("close", 0.0, 0),
    ]


def test_stop_and_close_come_once(stand_in, sampling, library_calls):
    device = sampling()
    device.safe_stop("")
    device.close()
    library_calls.clear()
    assert device.safe_stop("") == []
    device.close()
    assert library_calls == []
    assert len(stand_in.history("close")) == 1


def test_close_stops_before(stand_in, sampling):
    sampling().close()
    assert stand_in.history("close")[-1].values == [0.0, 0]


def test_nothing_is_written_after_the_stop(stand_in, sampling):
    device = sampling()
    device.safe_stop("")
    with pytest.raises(DeviceError, match="has been stopped"):
        device.write(1.0, LED_IDLE)
    assert outputs(stand_in) == (0.0, 0)


def test_stop_writes_separately_where_one_write_fails(stand_in, sampling, breaks, library_calls):
    device = sampling()
    breaks("write", for_ever=True)
    library_calls.clear()
    assert device.safe_stop("") == []
    separate = ["watchdog_is_expired", "write_analog", "write_digital", "write_other"]
    assert library_calls == [*["write"] * 4, *separate, *STOP_CALLS[1:]]
    assert outputs(stand_in) == (0.0, 0)
    assert stand_in.boards["0"].led == list(LED_STOPPED)


@pytest.mark.parametrize("name", [*STOP_CALLS, "close"])
def test_call_of_the_stop_that_fails_once_is_tried_again(stand_in, sampling, breaks, library_calls, name):
    device = sampling()
    breaks(name)
    library_calls.clear()
    assert device.safe_stop("") == []
    device.close()
    expected = [*STOP_CALLS, "close"]
    expected.insert(expected.index(name), name)
    assert library_calls == expected
    assert stand_in.history("close")[-1].values == [0.0, 0]


@pytest.mark.parametrize(
    ("name", "said", "left"),
    [
        ("write_analog", "setting 0 V", (-2.0, 0)),
        ("write_digital", "switching the amplifier off", (0.0, 1)),
        ("write_other", None, (0.0, 0)),  # the light
        ("watchdog_stop", "stopping the watchdog", (0.0, 0)),
        ("task_stop", "stopping the task", (0.0, 0)),
        ("task_delete", "deleting the task", (0.0, 0)),
    ],
)
def test_call_of_the_stop_that_fails_for_ever(stand_in, sampling, breaks, library_calls, name, said, left):
    device = sampling()
    breaks("write", for_ever=True)
    breaks(name, for_ever=True)
    library_calls.clear()
    failures = device.safe_stop("")
    assert [text.partition(":")[0] for text in failures] == ([said] if said else [])
    assert all("-843" in text for text in failures)
    everything = ["write", "watchdog_is_expired", "write_analog", "write_digital", "write_other", *STOP_CALLS[1:]]
    assert list(dict.fromkeys(library_calls)) == everything
    assert Counter(library_calls)[name] == 4
    device.close()
    assert stand_in.history("close")[-1].values == [*left]


def test_whatever_a_call_of_the_stop_raises_the_next_one_follows(stand_in, sampling, monkeypatch):
    device = sampling()
    card = device._card

    def bad(*_):
        raise ValueError("surprise")

    monkeypatch.setattr(card, "task_stop", bad)
    assert device.safe_stop("") == ["stopping the task: ValueError('surprise')"]
    device.close()
    assert stand_in.history("close")[-1].values == [0.0, 0]


def test_close_that_fails_for_ever(stand_in, sampling, breaks):
    device = sampling()
    breaks("close", for_ever=True)
    device.close()
    assert stand_in.calls["close"] == 4
    assert outputs(stand_in) == (0.0, 0)


def test_stop_before_open(library_calls, quanser):
    device = quanser()
    assert device.safe_stop("") == []
    device.close()
    assert library_calls == []


def test_stop_before_start(stand_in, quanser, library_calls):
    device = quanser()
    device.open()
    library_calls.clear()
    assert device.safe_stop("") == []
    assert library_calls == ["write"]
    device.close()
    assert stand_in.history("close")[-1].values == [0.0, 0]


@pytest.mark.parametrize("name", ["write_analog", "write_digital", "read_digital", "set_encoder_counts"])
def test_stop_after_an_open_that_failed(stand_in, quanser, name):
    device = quanser(failures={name: (1, -843)})
    with pytest.raises(DeviceError, match="-843"):
        device.open()
    assert device.safe_stop("") == []
    device.close()
    assert stand_in.history("close")[-1].values == [0.0, 0]
    assert not stand_in.boards["0"].opened


@pytest.mark.parametrize(
    "name", ["task_create_reader", "task_set_buffer_overflow_mode", "task_start", "watchdog_start"]
)
def test_stop_after_a_start_that_failed(stand_in, quanser, name):
    device = quanser(failures={name: (1, -843)})
    device.open()
    with pytest.raises(DeviceError, match="-843"):
        device.start(PERIOD)
    assert device.safe_stop("") == []
    device.close()
    assert stand_in.boards["0"].tasks == []
    assert stand_in.history("close")[-1].values == [0.0, 0]
