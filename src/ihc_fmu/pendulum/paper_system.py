"""The model and the linear controller of the paper's section V."""

from __future__ import annotations

import numpy as np

from ..quantity import Quantity
from ..system import PENDULUM, System

PAPER_A = ((0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0, 149.2751, -0.0104, 0.0), (0.0, 261.6091, -0.0103, 0.0))
PAPER_B = (0.0, 0.0, 49.7275, 49.1493)
PAPER_K_LIN = (2.0, -30.0, 2.0, -2.5)
"""A [1/s, 1/s^2], b [rad/(s^2 V)] and the manufacturer's k_lin [V/rad, V s/rad] of the paper's section V."""


def paper_system() -> System:
    """Return model and controller with names and units."""
    states = zip(("theta", "delta", "theta_dot", "delta_dot"), ("rad", "rad", "rad/s", "rad/s"), strict=True)
    return System(
        name=PENDULUM,
        A=np.array(PAPER_A),
        B=np.array(PAPER_B),
        K=np.array(PAPER_K_LIN),
        states=tuple(Quantity(name, unit) for name, unit in states),
        inputs=(Quantity("voltage", "V"),),
    )
