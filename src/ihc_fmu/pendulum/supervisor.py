"""When which law acts: idle, swing-up, stabilizing, fault.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from .interface import MODES


class Mode(IntEnum):
    """Values of the output `mode`."""

    IDLE = MODES.index("idle") + 1
    SWING_UP = MODES.index("swing_up") + 1
    STABILIZING = MODES.index("stabilizing") + 1
    FAULT = MODES.index("fault") + 1


class Capture(NamedTuple):
    """The region in which the stabilizing law takes over, and the wider one in which it stays."""

    level: float  # of x' P x [1]
    angle: float  # of the pendulum [rad]
    velocity: float  # of the pendulum [rad/s]
    fall_back_angle: float  # [rad]


def next_mode(
    mode: int, capture: Capture, level: float, delta: float, delta_dot: float, *, enabled: bool, swing_up: bool
) -> int:
    """Return the mode for the state with x' P x = `level`, pendulum angle `delta` in (-pi, pi] and velocity `delta_dot`.

    The faulted mode is left by a reset only. Between capture and fall-back the mode stays: hysteresis.
    """
    if mode == Mode.FAULT:
        return Mode.FAULT
    if not enabled:
        return Mode.IDLE
    if mode == Mode.STABILIZING and abs(delta) <= capture.fall_back_angle:
        return Mode.STABILIZING
    if level < capture.level and abs(delta) < capture.angle and abs(delta_dot) < capture.velocity:
        return Mode.STABILIZING
    return Mode.SWING_UP if swing_up else Mode.IDLE
