"""The rotary pendulum with its motor: x' = f(x, V, tau_p) as pure functions of numbers.

The pendulum follows eq. (5), see `rotary_pendulum.equation`. The motor is static, i = (V - k_e theta')/R_m, or has its
inductance, L_m i' = V - R_m i - k_e theta'; in both tau = k_m i, and k_e is k_m with back-EMF and 0 without.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rotary_pendulum.equation import Coefficients, accelerations

from .parameters import QubeParameters

State = tuple[float, ...]
"""(theta [rad], delta [rad], theta' [rad/s], delta' [rad/s]), and current [A] where the motor has inductance."""


class Motor(NamedTuple):
    """The motor's constants."""

    k_m: float  # torque constant [N.m/A]
    k_e: float  # back-EMF constant, k_m or 0 [V.s/rad]
    R_m: float  # [Ohm]
    L_m: float  # [H]


def motor(p: QubeParameters, *, back_emf: bool = True) -> Motor:
    """Return the constants of the motor of `p`."""
    return Motor(k_m=p.k_m, k_e=p.k_m if back_emf else 0.0, R_m=p.R_m, L_m=p.L_m)


def static_current(m: Motor, voltage: float, theta_dot: float) -> float:
    """Return the motor current (V - k_e theta')/R_m without inductance [A]."""
    return (voltage - m.k_e * theta_dot) / m.R_m


def derivative_static(c: Coefficients, m: Motor, x: Sequence[float], voltage: float, tau_p: float) -> State:
    """Return x' for x = (theta, delta, theta', delta') with the static motor of section III."""
    _, delta, theta_dot, delta_dot = x
    tau = m.k_m * (voltage - m.k_e * theta_dot) / m.R_m
    theta_ddot, delta_ddot = accelerations(c, delta, theta_dot, delta_dot, tau, tau_p)
    return theta_dot, delta_dot, theta_ddot, delta_ddot


def derivative_inductance(c: Coefficients, m: Motor, x: Sequence[float], voltage: float, tau_p: float) -> State:
    """Return x' for x = (theta, delta, theta', delta', i) with L_m i' = V - R_m i - k_e theta'."""
    _, delta, theta_dot, delta_dot, current = x
    theta_ddot, delta_ddot = accelerations(c, delta, theta_dot, delta_dot, m.k_m * current, tau_p)
    return (
        theta_dot,
        delta_dot,
        theta_ddot,
        delta_ddot,
        (voltage - m.R_m * current - m.k_e * theta_dot) / m.L_m,
    )
