"""What tests see of the stand-in's board, and what other programs do to it."""

import importlib

import numpy as np

ZERO = np.array([0], np.uint32)


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
        device.read(0.1)
