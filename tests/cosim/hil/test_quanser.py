"""The driver of the real board on the stand-in for the vendor's package: start, sampling, errors."""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections import Counter

import numpy as np
import pytest

from cosim.hil.device import (
    AMPLIFIER_FAULT,
    LED_BALANCE,
    LED_IDLE,
    LED_STOPPED,
    STALL_DETECTED,
    STALL_ERROR,
    DeviceError,
    UnavailableError,
)
from cosim.hil.quanser import IDENTIFIERS, WATCHDOG, QuanserDevice
from tests.cosim.hil.board import entries, leave_outputs, outputs, read_on
from tests.cosim.hil.rig import one_sentence

PERIOD = 1e-3
TIMEOUT = 0.1
DTYPES = {"uint32_t[]": np.uint32, "int32_t[]": np.int32, "int8_t[]": np.int8, "double[]": np.float64}


# --- start


def test_start_sequence(stand_in, quanser, library_calls):
    device = quanser()
    leave_outputs()
    begin, called = len(stand_in.record), len(library_calls)
    device.open()
    assert outputs(stand_in) == (0.0, 0)
    device.start(PERIOD)
    device.enable(True)
    assert entries(stand_in, begin) == [
        ("open", "qube_servo2_usb", "0"),
        ("watchdog", "stopped"),
        ("AO0", 0.0),
        ("DO0", 0),
        ("counts", [0, 0], [1, 0]),
        ("watchdog", "analog", {0: 0.0}),
        ("watchdog", "digital", {0: 0}),
        ("watchdog", "other", dict(zip((11000, 11001, 11002), LED_STOPPED, strict=True))),
        ("task", "started", 1000.0),
        ("watchdog", "started", WATCHDOG),
        ("DO0", 1),
    ]
    assert library_calls[called : called + 7] == [
        "open",
        "watchdog_stop",
        "watchdog_clear",
        "write_analog",
        "write_digital",
        "read_digital",
        "set_encoder_counts",
    ]


def test_every_buffer_has_the_type_of_the_library(quanser, monkeypatch):
    device = quanser()
    module = importlib.import_module("quanser.hardware.hil")
    wrong, seen = [], Counter()

    class Memory(module._Memory):
        def __init__(self, kind, argument):
            super().__init__(kind, argument)
            if argument is not None:
                seen[kind] += 1
                if argument.dtype != DTYPES[kind]:
                    wrong.append((kind, argument))

    monkeypatch.setattr(module, "_Memory", Memory)
    device.open()
    device.start(PERIOD)
    device.enable(True)
    device.read(TIMEOUT)
    device.write(1.0, LED_BALANCE)
    device.safe_stop("")
    device.close()
    assert wrong == []
    assert set(seen) == set(DTYPES)


@pytest.mark.parametrize("channel", [0, 2])
def test_fault_reported_at_the_start_is_refused(stand_in, quanser, channel):
    device = quanser(digital_inputs=((0.0, channel, 1),))
    with pytest.raises(DeviceError, match=("amplifier", "", "motor")[channel]):
        device.open()
    device.close()
    assert outputs(stand_in) == (0.0, 0)
    assert not stand_in.boards["0"].opened


def test_rate_beyond_the_boards(quanser):
    device = quanser()
    device.open()
    with pytest.raises(DeviceError, match=r"\(error -150\); the board cannot sample this fast; lower the rate"):
        device.start(1.0 / 5000.0)
    assert device.safe_stop("") == []


def test_virtual_twin(stand_in, quanser):
    device = quanser("qlabs", identifiers=(IDENTIFIERS["qlabs"],))
    device.open()
    assert "tcpip" in device.name
    device.start(PERIOD)
    (board,) = stand_in.boards.values()
    hardware = importlib.import_module("quanser.hardware.enumerations")
    assert board.virtual
    assert [task.mode for task in board.tasks] == [hardware.BufferOverflowMode.SYNCHRONIZED]
    assert [device.read(TIMEOUT).tick for _ in range(3)] == [0, 1, 2]


def test_identifier_of_the_user(stand_in, quanser):
    device = quanser(identifier="7", identifiers=("7",))
    device.open()
    assert list(stand_in.boards) == ["7"]
    assert "7" in device.name


# --- sampling


def test_sample_has_what_the_board_measures(stand_in, sampling):
    device = sampling(currents=((0.05, 1.0, -0.25),))
    board = stand_in.boards["0"]
    sample = device.read(TIMEOUT)
    for tick in range(2, 60):
        assert device.read(TIMEOUT) is sample
        device.write(-2.0, LED_IDLE)
        assert [sample.arm, sample.pendulum] == board.encoders()
        assert (sample.tick, sample.current) == (tick, board.current())
        assert sample.tachometer == pytest.approx(-board.plant.x[2] * 2048 / math.tau)
    assert sample.current == -0.25
    assert sample.arm < -20  # -2 V at the hardware turn the arm to positive angles, which the encoder counts down
    assert sample.digital == 0


@pytest.mark.parametrize(("channel", "bit"), [(0, AMPLIFIER_FAULT), (1, STALL_DETECTED), (2, STALL_ERROR)])
def test_digital_inputs_are_bits(sampling, channel, bit):
    device = sampling(digital_inputs=((0.004, channel, 1), (0.006, channel, 0)))
    assert [device.read(TIMEOUT).digital for _ in range(4)] == [0, bit, bit, 0]


def test_missed_periods_are_counted(quanser):
    device = quanser(late={3: 4, 5: 2})
    device.open()
    device.start(PERIOD)
    assert [device.read(TIMEOUT).tick for _ in range(6)] == [0, 1, 5, 6, 8, 9]
    assert device.counters["buffer overflows"] == 4


def test_newest_sample_is_read_after_a_pause(stand_in, sampling):
    device = sampling(late={2: 30})
    sample = device.read(TIMEOUT)
    assert [sample.arm, sample.pendulum] == stand_in.boards["0"].encoders()
    assert sample.tick == 30


def test_light_is_written_only_where_it_changes(stand_in, sampling):
    device = sampling()
    for led in (LED_IDLE, LED_BALANCE, LED_BALANCE, LED_IDLE):
        device.write(1.0, led)
    assert stand_in.calls["write_other"] == 3
    assert [tuple(event.values) for event in stand_in.history("LED")] == [LED_IDLE, LED_BALANCE, LED_IDLE]


@pytest.mark.parametrize("voltage", [math.nan, math.inf])
def test_voltage_that_is_not_finite_is_not_written(stand_in, sampling, voltage):
    device = sampling()
    with pytest.raises(DeviceError, match="finite"):
        device.write(voltage, LED_IDLE)
    assert outputs(stand_in) == (-2.0, 1)


@pytest.mark.parametrize("name", ["write_analog", "watchdog_reload", "write_other"])
def test_refused_voltage(sampling, breaks, name):
    device = sampling()
    breaks(name)
    with pytest.raises(DeviceError, match=r"setting the voltage: .* \(error -843\); .* check the USB cable"):
        device.write(1.0, LED_BALANCE)


def test_task_that_stops_by_itself(sampling):
    device = sampling(task_stops_at=0.01)
    with pytest.raises(DeviceError, match="stopped sampling"):
        read_on(device, 20)
    assert device.safe_stop("") == []


def test_unplugged_board(stand_in, sampling):
    device = sampling(unplugged_at=0.01)
    with pytest.raises(DeviceError, match=r"\(error -1029\); .* check its USB cable"):
        read_on(device, 20)
    with pytest.raises(DeviceError, match="-1029"):
        device.write(0.0, LED_IDLE)
    failures = device.safe_stop("")
    steps = ["setting 0 V", "switching the amplifier off", "stopping the watchdog", "stopping the task"]
    assert [text.partition(":")[0] for text in failures] == [*steps, "deleting the task"]
    assert all("not connected" in text for text in failures)
    device.close()
    assert outputs(stand_in) == (-2.0, 1)  # nothing reaches it


# --- what is missing or in use


@pytest.mark.parametrize(
    ("code", "advice"),
    [
        (-107, "reinstall the Quanser software"),
        (-108, "plug in its USB cable and its power supply"),
        (-109, "close it"),
        (-111, "lower the rate"),
        (-150, "lower the rate"),
        (-843, "check the USB cable"),
        (-1029, "check its USB cable"),
        (-1073, "remove /dev/shm"),
    ],
)
def test_errors_of_open_come_with_advice(quanser, code, advice):
    device = quanser(failures={"open": (1, code)})
    with pytest.raises(UnavailableError) as caught:
        device.open()
    text = str(caught.value)
    assert text.startswith("opening the board: ")
    assert f"(error {code}); " in text
    assert advice in text
    assert one_sentence(text)


def test_error_without_advice(quanser):
    device = quanser(failures={"open": (1, -179)})
    with pytest.raises(UnavailableError, match=r"opening the board: .* \(error -179\)$"):
        device.open()


def test_package_is_missing():
    if importlib.util.find_spec("quanser"):
        pytest.skip("Quanser's package is installed here")
    with pytest.raises(UnavailableError, match=r"Python package is not installed .* install the Quanser SDK") as caught:
        QuanserDevice().open()
    assert one_sentence(str(caught.value))


def test_library_is_missing(quanser):
    device = quanser(libhil_missing=True)
    with pytest.raises(UnavailableError, match=r"its library is not \(.*libhil.*install the Quanser SDK") as caught:
        device.open()
    assert one_sentence(str(caught.value))


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"identifiers": ()}, -108),
        ({"driver": False}, -107),
        ({"opened_elsewhere": True}, -1073),
        ({"opened_elsewhere": True, "already_open": -109}, -109),
    ],
)
def test_board_that_cannot_be_had(stand_in, quanser, changes, code):
    device = quanser(**changes)
    with pytest.raises(UnavailableError, match=rf"\(error {code}\); "):
        device.open()
    assert device.safe_stop("") == []
    device.close()
    assert [event.what for event in stand_in.record] == ["error"]


def test_board_in_use_is_left_as_it_is(stand_in, sampling):
    sampling()
    other = QuanserDevice()
    with pytest.raises(UnavailableError, match="open in another program"):
        other.open()
    other.safe_stop("")
    other.close()
    assert outputs(stand_in) == (-2.0, 1)
