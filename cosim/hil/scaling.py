"""From the hardware's raw units and signs to the model's, for every device alike.

Counter-clockwise positive, as in the manufacturer's courseware: theta = -r n_0, delta = r n_1 - pi with r = 2 pi/2048
and the counts n_0, n_1 since the zero, at which the pendulum hangs; u_hardware = -u. The courseware wraps delta to
[-pi, pi); here it goes on counting turns, as the simulated encoder does.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

Counts = int | np.ndarray

COUNTS_PER_TURN = 2048
RESOLUTION = 2.0 * math.pi / COUNTS_PER_TURN
"""r, one encoder count [rad]."""

HALF_TURN = COUNTS_PER_TURN // 2


def theta_of(arm: Counts) -> Any:
    """Return the arm's angle [rad] of its encoder's counts, one or an array."""
    return RESOLUTION * -arm


def delta_of(pendulum: Counts) -> Any:
    """Return the pendulum's angle from upright [rad] of its encoder's counts, one or an array; -pi at 0."""
    return RESOLUTION * (pendulum - HALF_TURN)


def counts_of(angle: float) -> int:
    """Return the whole number of counts [1] of an angle that an encoder reported."""
    return round(angle / RESOLUTION)


def hardware_voltage(u: float) -> float:
    """Return the hardware's voltage [V] for the model's."""
    return -u
