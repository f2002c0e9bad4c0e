"""The driver of the real board on the stand-in for the vendor's package: start, sampling, watchdog, errors, stop."""

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

PERIOD = 1e-3
TIMEOUT = 0.1
ZERO = np.array([0], np.uint32)
DTYPES = {"uint32_t[]": np.uint32, "int32_t[]": np.int32, "int8_t[]": np.int8, "double[]": np.float64}
STOP_CALLS = ["write", "watchdog_stop", "task_stop", "task_delete"]


@pytest.fixture
def made(stand_in):
    """Make a device on a board with the stepped clock and a configuration of its own; closed at the end."""
    devices = []

    def make(kind="qube", *, watchdog=True, identifier=None, **changes):
        stand_in.configure(clock="steps", **changes)
        device = QuanserDevice(kind, watchdog=watchdog, identifier=identifier)
        devices.append(device)
        return device

    yield make
    for device in devices:
        device.close()


@pytest.fixture
def running(made):
    """Make a device that samples with the amplifier on and -2 V."""

    def make(**changes):
        device = made(**changes)
        device.open()
        device.start(PERIOD)
        device.enable(True)
        device.read(TIMEOUT)
        device.write(-2.0, LED_IDLE)
        return device

    return make


@pytest.fixture
def names(stand_in, monkeypatch):
    """The names of the library's calls from now on, in order."""
    called = []
    count = stand_in.failure

    def failure(name):
        called.append(name)
        return count(name)

    monkeypatch.setattr(stand_in, "failure", failure)
    return called


@pytest.fixture
def breaks(stand_in):
    """Let a call fail from now on with -843: once, or for ever."""

    def plan(name, *, for_ever=False):
        stand_in.current.failures[name] = (stand_in.calls[name] + 1, -843, for_ever)

    return plan


def entries(stand_in, begin=0):
    return [(event.what, *event.values) for event in stand_in.record[begin:]]


def outputs(stand_in, identifier="0"):
    return stand_in.boards[identifier].outputs()


def leave_outputs(volts=-3.0, *, expired=False):
    """Be another program, which ends and leaves voltage and amplifier on the board."""
    card = importlib.import_module("quanser.hardware").HIL("qube_servo2_usb", "0")
    card.write_analog(ZERO, 1, np.array([volts]))
    card.write_digital(ZERO, 1, np.array([1], np.int8))
    if expired:
        card.watchdog_set_analog_expiration_state(ZERO, 1, np.zeros(1))
        card.watchdog_set_digital_expiration_state(ZERO, 1, np.zeros(1, np.int32))
        card.watchdog_start(0.02)
        let_pass(0.03)
    card.close()


def let_pass(seconds):
    """Let time pass on the board, with nobody at it."""
    board = next(iter(importlib.import_module("quanser.stand_in").boards.values()))
    board.advance(board.time + round(seconds * 1e9))


def read_on(device, samples):
    for _ in range(samples):
        device.read(TIMEOUT)


def one_sentence(text):
    return bool(text) and "\n" not in text and ". " not in text and not text.endswith(".")


# --- start


def test_start_sequence(stand_in, made, names):
    device = made()
    leave_outputs()
    begin, called = len(stand_in.record), len(names)
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
    assert names[called : called + 7] == [
        "open",
        "watchdog_stop",
        "watchdog_clear",
        "write_analog",
        "write_digital",
        "read_digital",
        "set_encoder_counts",
    ]


def test_every_buffer_has_the_type_of_the_library(made, monkeypatch):
    device = made()
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
def test_fault_reported_at_the_start_is_refused(stand_in, made, channel):
    device = made(digital_inputs=((0.0, channel, 1),))
    with pytest.raises(DeviceError, match=("amplifier", "", "motor")[channel]):
        device.open()
    device.close()
    assert outputs(stand_in) == (0.0, 0)
    assert not stand_in.boards["0"].opened


def test_rate_beyond_the_boards(made):
    device = made()
    device.open()
    with pytest.raises(DeviceError, match=r"\(error -150\); the board cannot sample this fast; lower the rate"):
        device.start(1.0 / 5000.0)
    assert device.safe_stop("") == []


def test_virtual_twin(stand_in, made):
    device = made("qlabs", identifiers=(IDENTIFIERS["qlabs"],))
    device.open()
    assert "tcpip" in device.name
    device.start(PERIOD)
    (board,) = stand_in.boards.values()
    hardware = importlib.import_module("quanser.hardware.enumerations")
    assert board.virtual
    assert [task.mode for task in board.tasks] == [hardware.BufferOverflowMode.SYNCHRONIZED]
    assert [device.read(TIMEOUT).tick for _ in range(3)] == [0, 1, 2]


def test_identifier_of_the_user(stand_in, made):
    device = made(identifier="7", identifiers=("7",))
    device.open()
    assert list(stand_in.boards) == ["7"]
    assert "7" in device.name


# --- sampling


def test_sample_has_what_the_board_measures(stand_in, running):
    device = running(currents=((0.05, 1.0, -0.25),))
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
def test_digital_inputs_are_bits(running, channel, bit):
    device = running(digital_inputs=((0.004, channel, 1), (0.006, channel, 0)))
    assert [device.read(TIMEOUT).digital for _ in range(4)] == [0, bit, bit, 0]


def test_missed_periods_are_counted(made):
    device = made(late={3: 4, 5: 2})
    device.open()
    device.start(PERIOD)
    assert [device.read(TIMEOUT).tick for _ in range(6)] == [0, 1, 5, 6, 8, 9]
    assert device.counters["buffer overflows"] == 4


def test_newest_sample_is_read_after_a_pause(stand_in, running):
    device = running(late={2: 30})
    sample = device.read(TIMEOUT)
    assert [sample.arm, sample.pendulum] == stand_in.boards["0"].encoders()
    assert sample.tick == 30


def test_light_is_written_only_where_it_changes(stand_in, running):
    device = running()
    for led in (LED_IDLE, LED_BALANCE, LED_BALANCE, LED_IDLE):
        device.write(1.0, led)
    assert stand_in.calls["write_other"] == 3
    assert [tuple(event.values) for event in stand_in.history("LED")] == [LED_IDLE, LED_BALANCE, LED_IDLE]


@pytest.mark.parametrize("voltage", [math.nan, math.inf])
def test_voltage_that_is_not_finite_is_not_written(stand_in, running, voltage):
    device = running()
    with pytest.raises(DeviceError, match="finite"):
        device.write(voltage, LED_IDLE)
    assert outputs(stand_in) == (-2.0, 1)


@pytest.mark.parametrize("name", ["write_analog", "watchdog_reload", "write_other"])
def test_refused_voltage(running, breaks, name):
    device = running()
    breaks(name)
    with pytest.raises(DeviceError, match=r"setting the voltage: .* \(error -843\); .* check the USB cable"):
        device.write(1.0, LED_BALANCE)


def test_task_that_stops_by_itself(running):
    device = running(task_stops_at=0.01)
    with pytest.raises(DeviceError, match="stopped sampling"):
        read_on(device, 20)
    assert device.safe_stop("") == []


def test_unplugged_board(stand_in, running):
    device = running(unplugged_at=0.01)
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


# --- watchdog


def test_watchdog_is_reloaded_with_each_voltage(stand_in, running):
    device = running()
    for _ in range(200):
        device.read(TIMEOUT)
        device.write(-1.0, LED_IDLE)
    assert stand_in.calls["watchdog_reload"] == stand_in.calls["write_analog"] - 1 == 201
    assert ("watchdog", "expired") not in entries(stand_in)


def expire(device):
    """Read without an answer until the watchdog has expired."""
    read_on(device, round(WATCHDOG / PERIOD) + 5)


def test_expired_watchdog_is_noticed_by_reading(stand_in, running):
    device = running()
    with pytest.raises(DeviceError, match="watchdog expired"):
        expire(device)
    assert outputs(stand_in) == (0.0, 0)
    (expiry,) = (event for event in stand_in.history("watchdog") if event.values == ["expired"])
    assert expiry.t == pytest.approx(2e-3 + WATCHDOG)


def test_expired_watchdog_is_noticed_by_writing(stand_in, running):
    device = running(expired_refuses_reads=False)
    expire(device)
    with pytest.raises(DeviceError, match="watchdog expired"):
        device.write(-1.0, LED_IDLE)
    assert outputs(stand_in) == (0.0, 0)


def test_expired_watchdog_is_noticed_where_the_board_accepts_voltages(stand_in, running, monkeypatch):
    device = running(expired_refuses_reads=False)
    expire(device)
    monkeypatch.setattr(stand_in.boards["0"], "refuse", lambda io: None)
    with pytest.raises(DeviceError, match="watchdog expired"):
        device.write(-1.0, LED_IDLE)
    assert device.safe_stop("") == []
    assert outputs(stand_in) == (0.0, 0)


@pytest.mark.parametrize("refuses_reads", [True, False])
def test_expired_watchdog_is_named(running, refuses_reads):
    device = running(expired_refuses_reads=refuses_reads)
    if not refuses_reads:
        expire(device)
    with pytest.raises(DeviceError, match="watchdog"):
        expire(device) if refuses_reads else device.write(-1.0, LED_IDLE)


@pytest.mark.parametrize("restores", [False, True])
def test_stop_after_expiry_leaves_the_0_volts_of_the_board(stand_in, running, names, restores):
    device = running(clear_restores_outputs=restores)
    with pytest.raises(DeviceError):
        expire(device)
    names.clear()
    assert device.safe_stop("") == []
    tail = ["watchdog_is_expired", "watchdog_stop", "task_stop", "task_delete"]
    assert names == [*["write"] * 4, *tail]
    assert outputs(stand_in) == (0.0, 0)


@pytest.mark.parametrize("restores", [False, True])
def test_expiry_of_an_earlier_program_is_cleared(stand_in, made, restores):
    device = made(clear_restores_outputs=restores)
    leave_outputs(expired=True)
    device.open()
    assert outputs(stand_in) == (0.0, 0)
    assert not stand_in.boards["0"].watchdog.expired


def test_watchdog_of_an_earlier_program_does_not_end_this_one(made):
    device = made()
    leave_outputs(expired=True)
    device.open()
    let_pass(0.1)
    device.start(PERIOD)


def test_board_without_watchdog_is_refused_with_advice(stand_in, made):
    device = made(watchdog=True)
    stand_in.configure(clock="steps", watchdog=False)
    device.open()
    with pytest.raises(UnavailableError, match="no usable watchdog: --no-watchdog runs without it") as caught:
        device.start(PERIOD)
    assert one_sentence(str(caught.value))
    assert device.safe_stop("") == []
    assert "watchdog_start" not in stand_in.calls


def test_board_without_watchdog_runs_where_that_is_wanted(stand_in, made):
    device = made(watchdog=False)
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
def test_missing_calls_of_the_watchdog(made, name, code):
    device = made(failures={name: (1, code, True)})
    device.open()
    with pytest.raises(UnavailableError, match="--no-watchdog"):
        device.start(PERIOD)
    assert device.safe_stop("") == []


def test_missing_clear_is_tolerated(stand_in, running):
    running(failures={"watchdog_clear": (1, -599, True)})
    assert ("watchdog", "started", WATCHDOG) in entries(stand_in)


def test_failing_clear_is_not(made):
    device = made(failures={"watchdog_clear": (1, -843)})
    with pytest.raises(DeviceError, match=r"clearing the watchdog: .*-843"):
        device.open()


@pytest.mark.parametrize(
    "changes",
    [
        {"expire_to_zero_only": True},
        {"failures": {"watchdog_set_other_expiration_state": (1, -594, True)}},
    ],
)
def test_light_that_cannot_expire_to_red(stand_in, running, changes):
    running(**changes)
    assert ("watchdog", "started", WATCHDOG) in entries(stand_in)
    assert ("watchdog", "analog", {0: 0.0}) in entries(stand_in)


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
def test_errors_of_open_come_with_advice(made, code, advice):
    device = made(failures={"open": (1, code)})
    with pytest.raises(UnavailableError) as caught:
        device.open()
    text = str(caught.value)
    assert text.startswith("opening the board: ")
    assert f"(error {code}); " in text
    assert advice in text
    assert one_sentence(text)


def test_error_without_advice(made):
    device = made(failures={"open": (1, -179)})
    with pytest.raises(UnavailableError, match=r"opening the board: .* \(error -179\)$"):
        device.open()


def test_package_is_missing():
    if importlib.util.find_spec("quanser"):
        pytest.skip("Quanser's package is installed here")
    with pytest.raises(UnavailableError, match=r"Python package is not installed .* install the Quanser SDK") as caught:
        QuanserDevice().open()
    assert one_sentence(str(caught.value))


def test_library_is_missing(made):
    device = made(libhil_missing=True)
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
def test_board_that_cannot_be_had(stand_in, made, changes, code):
    device = made(**changes)
    with pytest.raises(UnavailableError, match=rf"\(error {code}\); "):
        device.open()
    assert device.safe_stop("") == []
    device.close()
    assert [event.what for event in stand_in.record] == ["error"]


def test_board_in_use_is_left_as_it_is(stand_in, running):
    running()
    other = QuanserDevice()
    with pytest.raises(UnavailableError, match="open in another program"):
        other.open()
    other.safe_stop("")
    other.close()
    assert outputs(stand_in) == (-2.0, 1)


# --- stop


def test_stop_sequence(stand_in, running, names):
    device = running()
    begin = len(stand_in.record)
    names.clear()
    assert device.safe_stop("") == []
    assert names == STOP_CALLS
    device.close()
    assert entries(stand_in, begin) == [
        ("AO0", 0.0),
        ("DO0", 0),
        ("LED", *LED_STOPPED),
        ("watchdog", "stopped"),
        ("task", "stopped"),
        ("close", 0.0, 0),
    ]


def test_stop_and_close_come_once(stand_in, running, names):
    device = running()
    device.safe_stop("")
    device.close()
    names.clear()
    assert device.safe_stop("") == []
    device.close()
    assert names == []
    assert len(stand_in.history("close")) == 1


def test_close_stops_before(stand_in, running):
    running().close()
    assert stand_in.history("close")[-1].values == [0.0, 0]


def test_nothing_is_written_after_the_stop(stand_in, running):
    device = running()
    device.safe_stop("")
    with pytest.raises(DeviceError, match="has been stopped"):
        device.write(1.0, LED_IDLE)
    assert outputs(stand_in) == (0.0, 0)


def test_stop_writes_separately_where_one_write_fails(stand_in, running, breaks, names):
    device = running()
    breaks("write", for_ever=True)
    names.clear()
    assert device.safe_stop("") == []
    separate = ["watchdog_is_expired", "write_analog", "write_digital", "write_other"]
    assert names == [*["write"] * 4, *separate, *STOP_CALLS[1:]]
    assert outputs(stand_in) == (0.0, 0)
    assert stand_in.boards["0"].led == list(LED_STOPPED)


@pytest.mark.parametrize("name", [*STOP_CALLS, "close"])
def test_call_of_the_stop_that_fails_once_is_tried_again(stand_in, running, breaks, names, name):
    device = running()
    breaks(name)
    names.clear()
    assert device.safe_stop("") == []
    device.close()
    expected = [*STOP_CALLS, "close"]
    expected.insert(expected.index(name), name)
    assert names == expected
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
def test_call_of_the_stop_that_fails_for_ever(stand_in, running, breaks, names, name, said, left):
    device = running()
    breaks("write", for_ever=True)
    breaks(name, for_ever=True)
    names.clear()
    failures = device.safe_stop("")
    assert [text.partition(":")[0] for text in failures] == ([said] if said else [])
    assert all("-843" in text for text in failures)
    everything = ["write", "watchdog_is_expired", "write_analog", "write_digital", "write_other", *STOP_CALLS[1:]]
    assert list(dict.fromkeys(names)) == everything
    assert Counter(names)[name] == 4
    device.close()
    assert stand_in.history("close")[-1].values == [*left]


def test_whatever_a_call_of_the_stop_raises_the_next_one_follows(stand_in, running, monkeypatch):
    device = running()
    card = device._card

    def bad(*_):
        raise ValueError("surprise")

    monkeypatch.setattr(card, "task_stop", bad)
    assert device.safe_stop("") == ["stopping the task: ValueError('surprise')"]
    device.close()
    assert stand_in.history("close")[-1].values == [0.0, 0]


def test_close_that_fails_for_ever(stand_in, running, breaks):
    device = running()
    breaks("close", for_ever=True)
    device.close()
    assert stand_in.calls["close"] == 4
    assert outputs(stand_in) == (0.0, 0)


def test_stop_before_open(names, made):
    device = made()
    assert device.safe_stop("") == []
    device.close()
    assert names == []


def test_stop_before_start(stand_in, made, names):
    device = made()
    device.open()
    names.clear()
    assert device.safe_stop("") == []
    assert names == ["write"]
    device.close()
    assert stand_in.history("close")[-1].values == [0.0, 0]


@pytest.mark.parametrize("name", ["write_analog", "write_digital", "read_digital", "set_encoder_counts"])
def test_stop_after_an_open_that_failed(stand_in, made, name):
    device = made(failures={name: (1, -843)})
    with pytest.raises(DeviceError, match="-843"):
        device.open()
    assert device.safe_stop("") == []
    device.close()
    assert stand_in.history("close")[-1].values == [0.0, 0]
    assert not stand_in.boards["0"].opened


@pytest.mark.parametrize(
    "name", ["task_create_reader", "task_set_buffer_overflow_mode", "task_start", "watchdog_start"]
)
def test_stop_after_a_start_that_failed(stand_in, made, name):
    device = made(failures={name: (1, -843)})
    device.open()
    with pytest.raises(DeviceError, match="-843"):
        device.start(PERIOD)
    assert device.safe_stop("") == []
    device.close()
    assert stand_in.boards["0"].tasks == []
    assert stand_in.history("close")[-1].values == [0.0, 0]
