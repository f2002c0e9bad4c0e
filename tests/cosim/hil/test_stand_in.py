"""The stand-in for `quanser` keeps the rules of the real package, as far as they are known."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import threading
import time
from array import array
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
ZERO = np.array([0], dtype=np.uint32)
BOTH = np.array([0, 1], dtype=np.uint32)
LED = np.array([11000, 11001, 11002], dtype=np.uint32)


@pytest.fixture
def hardware(stand_in):
    """The package `quanser.hardware`, with the clock that does not wait."""
    stand_in.configure(clock="steps")
    return importlib.import_module("quanser.hardware")


@pytest.fixture
def card(hardware):
    return hardware.HIL("qube_servo2_usb")


@pytest.fixture
def fails(hardware):
    """Assert that a call raises HILError with a code."""

    def check(code, call, *arguments):
        with pytest.raises(hardware.HILError) as caught:
            call(*arguments)
        assert caught.value.error_code == code
        assert caught.value.get_error_message()

    return check


def write(card, volts=0.0, enable=0):
    card.write_analog(ZERO, 1, np.array([volts]))
    card.write_digital(ZERO, 1, np.array([enable], dtype=np.int8))


def reader(card, *, room=10, hz=1000.0, mode=None, samples=0x7FFFFFFF):
    task = card.task_create_encoder_reader(room, BOTH, 2)
    if mode is not None:
        card.task_set_buffer_overflow_mode(task, mode)
    card.task_start(task, 0, hz, samples)
    return task


def read(card, task, n=1):
    """Return how many samples came, and the encoders as a row for each."""
    buffer = np.full((n, 2), -99999, dtype=np.int32)
    return card.task_read_encoder(task, n, buffer), buffer


def kinds(stand_in):
    return [event.what for event in stand_in.record]


# --- opening


def test_open_is_exclusive_until_close(stand_in, hardware, card, fails):
    assert card.is_valid()
    fails(-1073, hardware.HIL, "qube_servo2_usb", "0")
    card.close()
    card.close()
    assert not card.is_valid()
    hardware.HIL("qube_servo2_usb", "0").close()
    assert kinds(stand_in) == ["open", "error", "close", "open", "close"]


@pytest.mark.parametrize(
    ("changes", "card_type", "code"),
    [
        ({}, "q8_usb", -179),
        ({"driver": False}, "qube_servo2_usb", -107),
        ({"identifiers": ()}, "qube_servo2_usb", -108),
        ({"opened_elsewhere": True}, "qube_servo2_usb", -1073),
        ({"opened_elsewhere": True, "already_open": -109}, "qube_servo2_usb", -109),
    ],
)
def test_what_open_can_find(stand_in, hardware, fails, changes, card_type, code):
    stand_in.configure(**changes)
    fails(code, hardware.HIL, card_type, "0")
    assert not hardware.HIL().is_valid()


def test_library_missing_is_an_os_error_at_import(stand_in):
    stand_in.configure(libhil_missing=True)
    with pytest.raises(OSError, match="hil"):
        importlib.import_module("quanser.hardware")


def test_outputs_hold_over_close(stand_in, hardware, card):
    write(card, -3.0, 1)
    card.close()
    assert stand_in.history("close")[-1].values == [-3.0, 1]
    again = hardware.HIL("qube_servo2_usb")
    assert stand_in.boards["0"].outputs() == (-3.0, 1)
    again.close()


def test_handles_that_are_no_longer_valid(hardware, card, fails):
    task = reader(card)
    card.task_delete(task)
    fails(-105, card.task_stop, task)
    fails(-105, card.task_stop, None)
    task = reader(card)
    card.close()
    fails(-105, card.task_stop, task)
    fails(-88, card.read_encoder, BOTH, 2, np.zeros(2, np.int32))


# --- arguments


def test_buffers_are_memory(card):
    with pytest.raises(TypeError):
        card.read_encoder([0, 1], 2, np.zeros(2, np.int32))
    with pytest.raises(TypeError):
        card.write_analog(ZERO, 1, 0.0)
    with pytest.raises(TypeError):
        card.write_analog(ZERO, 1.0, np.zeros(1))
    with pytest.raises(ValueError, match="contiguous"):
        card.read_encoder(BOTH, 2, np.zeros(4, np.int32)[::2])
    with pytest.raises(ValueError, match="must hold 2"):
        card.read_encoder(BOTH, 2, np.zeros(1, np.int32))
    with pytest.raises(ValueError, match="writable"):
        card.read_encoder(BOTH, 2, b"12345678")
    counts = array("i", [0, 0])
    card.read_encoder(array("I", [1, 0]), 2, counts)
    assert counts.tolist() == [-52, 137]


def test_a_wrong_dtype_is_read_byte_by_byte(stand_in, card):
    card.write_analog(ZERO, 1, np.array([1], dtype=np.int64))
    assert stand_in.history("AO0")[-1].values == [5e-324]
    counts = np.zeros(2)
    card.read_encoder(BOTH, 2, counts)
    assert counts.view(np.int32).tolist() == [137, -52, 0, 0]


def test_states_of_the_watchdog_are_four_bytes_wide(hardware, card, fails):
    with pytest.raises(ValueError, match="must hold 1"):
        card.watchdog_set_digital_expiration_state(ZERO, 1, np.array([0], dtype=np.int8))
    fails(-797, card.watchdog_set_digital_expiration_state, ZERO, 1, np.array([2], dtype=np.int32))
    card.watchdog_set_digital_expiration_state(ZERO, 1, np.array([hardware.DigitalState.LOW], dtype=np.int32))


def test_groups_are_skipped_with_none(stand_in, card, fails):
    off = np.array([0], dtype=np.int8)
    card.write(ZERO, 1, None, 0, ZERO, 1, LED, 3, np.array([2.0]), None, off + 1, np.array([1.0, 0.0, 0.0]))
    card.write(ZERO, 1, None, 0, None, 0, None, 0, np.array([0.0]), None, None, None)
    assert [event[1:] for event in stand_in.record[1:]] == [
        ("AO0", [2.0]),
        ("DO0", [1]),
        ("LED", [1.0, 0.0, 0.0]),
        ("AO0", [0.0]),
    ]
    counts = np.zeros(2, np.int32)
    card.read(None, 0, BOTH, 2, None, 0, None, 0, None, counts, None, None)
    assert counts.tolist() == [137, -52]
    fails(-164, card.write_analog, ZERO, 1, None)
    fails(-161, card.read_encoder, BOTH, 2, None)
    fails(-134, card.write, None, 0, ZERO, 1, None, 0, None, 0, None, np.array([0.0]), None, None)


@pytest.mark.parametrize(
    ("call", "dtype", "code"),
    [
        ("read_analog", np.float64, -121),
        ("read_encoder", np.int32, -124),
        ("read_digital", np.int8, -127),
        ("read_other", np.float64, -130),
        ("write_analog", np.float64, -133),
        ("write_digital", np.int8, -139),
        ("write_other", np.float64, -142),
    ],
)
def test_channels_that_do_not_exist(card, fails, call, dtype, code):
    fails(code, getattr(card, call), np.array([7], dtype=np.uint32), 1, np.zeros(1, dtype))


def test_directions_and_properties(hardware, card, fails):
    card.set_digital_directions(np.array([0, 1, 2], dtype=np.uint32), 3, ZERO, 1)
    fails(-139, card.set_digital_directions, None, 0, BOTH, 2)
    assert card.get_string_property(hardware.StringProperty.SERIAL_NUMBER, 64) == "STAND-IN"


# --- the board


def test_negative_analog_output_turns_the_arm_to_positive_theta(stand_in, card):
    card.set_encoder_counts(BOTH, 2, np.zeros(2, np.int32))
    write(card, -1.0, 0)
    task = reader(card)
    assert read(card, task, 10)[1].tolist() == [[0, 0]] * 10  # the amplifier is off
    write(card, -1.0, 1)
    for _ in range(9):
        read(card, task, 10)
    _, counts = read(card, task, 10)
    assert counts[-1, 0] < -20
    assert stand_in.boards["0"].plant.x[0] > 20 * 2 * np.pi / 2048
    current, tachometer = np.zeros(1), np.zeros(1)
    card.read_analog(ZERO, 1, current)
    card.read_other(np.array([14000], dtype=np.uint32), 1, tachometer)
    assert -0.15 < current[0] < 0.0
    assert tachometer[0] == pytest.approx((counts[-1, 0] - counts[0, 0]) / 9e-3, rel=0.3)


def test_a_turned_pendulum_counts_from_hanging(stand_in, hardware):
    stand_in.configure(clock="steps", plant={"delta_0": 0.0, "theta_0": 0.5}, power_on_counts=(0, 0))
    card, counts = hardware.HIL("qube_servo2_usb"), np.zeros(2, np.int32)
    card.read_encoder(BOTH, 2, counts)
    assert counts.tolist() == [-163, 1024]  # delta = 2 pi enc1/2048 - pi is 0 upright
    card.set_encoder_counts(BOTH, 2, np.array([5, 7], dtype=np.int32))
    card.read_encoder(BOTH, 2, counts)
    assert counts.tolist() == [5, 7]


def test_faults_at_times(stand_in, hardware):
    stand_in.configure(
        clock="steps",
        digital_inputs=((0.003, 1, 1), (0.005, 1, 0), (0.005, 2, 1)),
        encoder_errors=((0.004, 0.005, 0, 500),),
        currents=((0.002, 0.003, 2.5),),
        power_on_counts=(0, 0),
    )
    card, three = hardware.HIL("qube_servo2_usb"), np.array([0, 1, 2], dtype=np.uint32)
    task = card.task_create_reader(10, ZERO, 1, BOTH, 2, three, 3, None, 0)
    card.task_start(task, hardware.Clock.HARDWARE_CLOCK_0, 1000, hardware.HIL.INFINITE)
    amperes, counts, inputs = np.zeros((5, 1)), np.zeros((5, 2), np.int32), np.ones((5, 3), np.int8)
    assert card.task_read(task, 5, amperes, counts, inputs, None) == 5
    assert amperes[:, 0].tolist() == [0, 2.5, 0, 0, 0]
    assert counts[:, 0].tolist() == [0, 0, 0, 500, 0]
    assert inputs.tolist() == [[0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1]]


def test_unplugging_refuses_everything_and_holds_the_outputs(stand_in, hardware, fails):
    stand_in.configure(clock="steps", unplugged_at=0.0035)
    card = hardware.HIL("qube_servo2_usb")
    write(card, 2.0, 1)
    task = reader(card)
    assert read(card, task, 3)[0] == 3
    fails(-1029, read, card, task)
    fails(-1029, write, card)
    fails(-1029, card.close)
    assert stand_in.history("unplugged") == [(0.0035, "unplugged", [2.0, 1])]
    assert stand_in.boards["0"].outputs() == (2.0, 1)


# --- tasks


def test_each_read_is_one_period(stand_in, card):
    task = reader(card, hz=500.0)
    for k in range(1, 4):
        assert read(card, task)[0] == 1
        assert stand_in.boards["0"].seconds == pytest.approx(2e-3 * k)


def test_numbers_of_samples_and_rates(stand_in, card, fails):
    fails(-320, card.task_create_encoder_reader, 0, BOTH, 2)
    task = card.task_create_encoder_reader(1, BOTH, 2)
    fails(-149, card.task_start, task, 0, 0.0, 1)
    fails(-150, card.task_start, task, 0, 1e5, 1)
    fails(-144, card.task_start, task, 2, 1e3, 1)
    card.task_start(task, 0, 1e3, 2)
    fails(-321, read, card, task, 0)
    fails(-159, read, card, task, 2)
    fails(-145, reader, card)
    assert [read(card, task)[0] for _ in range(4)] == [1, 1, 0, 0]


def test_a_stopped_task_gives_no_samples_and_can_start_again(card):
    task = reader(card)
    card.task_stop(task)
    assert read(card, task)[0] == 0
    card.task_flush(task)
    card.task_start(task, 0, 1000.0, 5)
    assert read(card, task, 4)[0] == 4
    assert read(card, task, 4)[0] == 1


def test_the_task_can_end_by_itself(stand_in, hardware):
    stand_in.configure(clock="steps", task_stops_at=0.0025)
    card = hardware.HIL("qube_servo2_usb")
    task = reader(card)
    assert [read(card, task)[0] for _ in range(3)] == [1, 1, 0]


@pytest.mark.parametrize(
    ("mode", "newest"), [(1, True), (2, False)], ids=["OVERWRITE_ON_OVERFLOW", "DISCARD_ON_OVERFLOW"]
)
def test_late_reader_loses_samples(stand_in, hardware, mode, newest):
    stand_in.configure(clock="steps", late={1: 10}, plant={"theta_dot_0": 20.0}, power_on_counts=(0, 0))
    card = hardware.HIL("qube_servo2_usb")
    task = reader(card, room=4, mode=mode)
    n, counts = read(card, task, 4)
    assert n == 4
    assert card.task_get_buffer_overflows(task) == 6
    steps = np.diff(np.abs(counts[:, 0]))
    assert (steps > 0).all()
    assert (abs(counts[0, 0]) > steps.max() * 4) == newest


def test_default_mode_fails_until_the_task_is_restarted(stand_in, hardware, fails):
    stand_in.configure(clock="steps", late={2: 5})
    card = hardware.HIL("qube_servo2_usb")
    task = reader(card, room=4)
    assert read(card, task)[0] == 1
    fails(-111, read, card, task)
    fails(-111, read, card, task)
    card.task_stop(task)
    card.task_start(task, 0, 1000.0, 100)
    assert read(card, task)[0] == 1


def test_waiting_modes_are_for_virtual_cards(stand_in, hardware, card, fails):
    task = card.task_create_encoder_reader(1, BOTH, 2)
    fails(-1080, card.task_set_buffer_overflow_mode, task, 4)
    twin = "0@tcpip://localhost:18921?nagle='off'"
    stand_in.configure(identifiers=(twin,))
    virtual = hardware.HIL("qube_servo2_usb", twin)
    task = reader(virtual, room=2, mode=4)
    time.sleep(0.02)
    assert read(virtual, task, 2)[0] == 2
    assert virtual.task_get_buffer_overflows(task) == 0
    assert stand_in.boards[twin].seconds < 0.01


def test_the_real_clock_paces_the_reader_and_goes_on_without_it(stand_in, hardware):
    stand_in.configure()
    card = hardware.HIL("qube_servo2_usb")
    task = reader(card, room=5, mode=1, hz=200.0)
    start = time.monotonic()
    assert read(card, task, 5)[0] == 5
    assert time.monotonic() - start > 0.024
    time.sleep(0.06)
    start = time.monotonic()
    assert read(card, task, 5)[0] == 5
    assert card.task_get_buffer_overflows(task) >= 5
    threading.Timer(0.02, card.task_stop, [task]).start()
    while (n := read(card, task)[0]) == 1:
        pass
    assert n == 0
    card.close()


# --- watchdog


def test_expiry_sets_the_outputs_and_refuses_access_until_clear(stand_in, hardware, fails):
    stand_in.configure(clock="steps", late={3: 60})
    card = hardware.HIL("qube_servo2_usb")
    card.watchdog_set_analog_expiration_state(ZERO, 1, np.array([0.0]))
    card.watchdog_set_digital_expiration_state(ZERO, 1, np.array([0], dtype=np.int32))
    card.watchdog_set_other_expiration_state(LED, 3, np.array([1.0, 0.0, 0.0]))
    task = reader(card, room=100)
    card.watchdog_start(0.05)
    write(card, 4.0, 1)
    for _ in range(2):
        read(card, task)
        assert card.watchdog_reload() is True
    fails(-854, read, card, task)
    assert card.watchdog_reload() is False
    assert card.watchdog_is_expired() is True
    card.watchdog_stop()
    fails(-854, write, card)
    expired = stand_in.record[kinds(stand_in).index("task") + 4 :][:4]
    assert [(event.what, event.values) for event in expired] == [
        ("watchdog", ["expired"]),
        ("AO0", [0.0]),
        ("DO0", [0]),
        ("LED", [1.0, 0.0, 0.0]),
    ]
    assert expired[0].t == 0.052
    card.close()
    card.open("qube_servo2_usb")
    fails(-854, write, card)
    card.watchdog_clear()
    write(card, 0.0, 0)
    assert card.watchdog_is_expired() is False


@pytest.mark.parametrize(("restored", "volts"), [(False, 0.0), (True, 4.0)])
def test_clear_may_bring_the_outputs_back(stand_in, hardware, restored, volts):
    stand_in.configure(clock="steps", clear_restores_outputs=restored)
    card = hardware.HIL("qube_servo2_usb")
    card.watchdog_set_analog_expiration_state(ZERO, 1, np.array([0.0]))
    write(card, 4.0, 1)
    task = reader(card, hz=1.0)
    card.watchdog_start(0.05)
    with pytest.raises(hardware.HILError):
        read(card, task)
    card.watchdog_clear()
    assert stand_in.boards["0"].outputs() == (volts, 1)


def test_a_board_without_watchdog(stand_in, hardware, fails):
    stand_in.configure(clock="steps", watchdog=False)
    card = hardware.HIL("qube_servo2_usb")
    low = np.array([0], dtype=np.int32)
    fails(-591, card.watchdog_set_analog_expiration_state, ZERO, 1, np.array([0.0]))
    fails(-592, card.watchdog_set_digital_expiration_state, ZERO, 1, low)
    fails(-594, card.watchdog_set_other_expiration_state, LED, 3, np.zeros(3))
    calls = ("start", "stop", "reload", "is_expired", "clear")
    for code, name in zip(range(-595, -600, -1), calls, strict=True):
        fails(code, getattr(card, f"watchdog_{name}"), *([0.1] if name == "start" else []))


def test_a_board_whose_outputs_expire_to_zero_only(stand_in, hardware, fails):
    stand_in.configure(clock="steps", expire_to_zero_only=True)
    card = hardware.HIL("qube_servo2_usb")
    fails(-601, card.watchdog_set_analog_expiration_state, ZERO, 1, np.array([1.0]))
    fails(-1051, card.watchdog_set_digital_expiration_state, ZERO, 1, np.array([1], dtype=np.int32))
    fails(-1053, card.watchdog_set_other_expiration_state, LED, 3, np.array([1.0, 0.0, 0.0]))


# --- planned failures, record, other processes


def test_failure_at_a_call(stand_in, hardware, fails):
    stand_in.configure(clock="steps", failures={"write_analog": (2, -843), "task_read_encoder": (3, -1029, True)})
    card = hardware.HIL("qube_servo2_usb")
    task = reader(card)
    write(card, 1.0, 1)
    fails(-843, write, card, 2.0, 1)
    write(card, 3.0, 1)
    assert [event.values for event in stand_in.history("AO0")] == [[1.0], [3.0]]
    assert [read(card, task)[0] for _ in range(2)] == [1, 1]
    for _ in range(3):
        fails(-1029, read, card, task)
    assert stand_in.calls["task_read_encoder"] == 5
    assert stand_in.history("error")[0].values == ["write_analog", -843]


def run(text, **variables):
    return subprocess.run(
        [sys.executable, "-c", text],
        env={**os.environ, "PYTHONPATH": str(HERE / "stand_in"), **variables},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def test_another_process_is_configured_by_a_file_and_leaves_its_log(stand_in, tmp_path):
    settings, log = tmp_path / "board.json", tmp_path / "board.jsonl"
    settings.write_text(stand_in.to_json(clock="steps", late={1: 2}, log=str(log)), encoding="utf-8")
    done = run(
        "import numpy as np; from quanser.hardware import HIL; from quanser import stand_in; "
        "zero = np.zeros(1, np.uint32); card = HIL('qube_servo2_usb', '0'); "
        "card.write_analog(zero, 1, np.array([1.5])); print(stand_in.current.late)",
        QUBE_STAND_IN=str(settings),
    )
    assert done.stdout == "{1: 2}\n", done.stderr
    events = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    assert [(event["what"], event["values"]) for event in events] == [
        ("open", ["qube_servo2_usb", "0"]),
        ("AO0", [1.5]),
        ("exit", [1.5, 0, True]),  # neither 0 V nor closed
    ]


def test_another_process_without_the_library(stand_in, tmp_path):
    settings = tmp_path / "board.json"
    settings.write_text(stand_in.to_json(libhil_missing=True), encoding="utf-8")
    assert "OSError: cannot load library 'hil'" in run("import quanser.hardware", QUBE_STAND_IN=str(settings)).stderr


def test_a_configuration_that_does_not_exist(stand_in):
    with pytest.raises(ValueError, match="clock must be monotonic or steps"):
        stand_in.configure(clock="fast")
