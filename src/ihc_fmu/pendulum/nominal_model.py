"""The controller's own model of the rotary pendulum: eq. (5) and the static motor in nine lumped numbers.

It serves the swing-up law and the observer; the plant FMU need not have the same numbers.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, sin
from typing import Any, NamedTuple

from fmu_export.errors import UserError


class NominalModel(NamedTuple):
    """Lumped coefficients, with the paper's zeta = m_p L_p^2, psi = m_p L_r^2, varpi = m_p L_p L_r."""

    arm_inertia: float  # J_r + psi [kg.m2]
    pendulum_inertia: float  # J_p + zeta/4 [kg.m2]
    swing_inertia: float  # zeta/4 [kg.m2]
    coupling: float  # varpi/2 [kg.m2]
    gravity_torque: float  # m_p g_p L_p / 2 [N.m]
    arm_damping: float  # D_r [N.m.s/rad]
    pendulum_damping: float  # D_p [N.m.s/rad]
    torque_per_volt: float  # k_m / R_m [N.m/V]
    motor_damping: float  # k_m^2 / R_m, 0 without back-EMF [N.m.s/rad]


def nominal_model(values: Mapping[str, Any]) -> NominalModel:
    """Return the model from the controller's parameters `nominal_...`.

    Raises UserError where the determinant of its inertia matrix upright, where it is smallest, is lost in rounding.
    """
    m = NominalModel(*[values[f"nominal_{name}"] for name in NominalModel._fields])
    diagonal = m.arm_inertia * m.pendulum_inertia
    if not diagonal - m.coupling * m.coupling > 1e-9 * diagonal:
        raise UserError(
            f"the square of nominal_coupling must be below nominal_arm_inertia times nominal_pendulum_inertia, found "
            f"{m.coupling:g}, {m.arm_inertia:g} and {m.pendulum_inertia:g} kg.m2"
        )
    return m


def accelerations(
    m: NominalModel, delta: float, theta_dot: float, delta_dot: float, voltage: float
) -> tuple[float, float]:
    """Return (theta'', delta'') [rad/s^2] of eq. (5) under `voltage` [V]."""
    s, c = sin(delta), cos(delta)
    pull = m.swing_inertia * s * c
    arm = m.torque_per_volt * voltage - (m.arm_damping + m.motor_damping + 2.0 * pull * delta_dot) * theta_dot
    arm -= m.coupling * s * delta_dot * delta_dot
    pendulum = (m.gravity_torque * s - m.pendulum_damping * delta_dot) + pull * theta_dot * theta_dot
    inertia, mixed = m.arm_inertia + m.swing_inertia * s * s, m.coupling * c
    determinant = inertia * m.pendulum_inertia - mixed * mixed
    return (
        (m.pendulum_inertia * arm + mixed * pendulum) / determinant,
        (inertia * pendulum + mixed * arm) / determinant,
    )


def voltage_for(m: NominalModel, delta: float, theta_dot: float, delta_dot: float, theta_ddot: float) -> float:
    """Return the voltage [V] under which the arm accelerates by `theta_ddot` [rad/s^2]: inverse dynamics of eq. (5)."""
    s, c = sin(delta), cos(delta)
    pull = m.swing_inertia * s * c
    pendulum = m.gravity_torque * s - m.pendulum_damping * delta_dot + pull * theta_dot * theta_dot
    delta_ddot = (pendulum + m.coupling * c * theta_ddot) / m.pendulum_inertia
    torque = (m.arm_inertia + m.swing_inertia * s * s) * theta_ddot - m.coupling * c * delta_ddot
    torque += (m.arm_damping + m.motor_damping + 2.0 * pull * delta_dot) * theta_dot
    torque += m.coupling * s * delta_dot * delta_dot
    return torque / m.torque_per_volt


def predict(
    m: NominalModel, theta: float, delta: float, theta_dot: float, delta_dot: float, voltage: float, h: float
) -> tuple[float, float, float, float]:
    """Return the state after `h` [s] under a held `voltage`: one step of the classical Runge-Kutta method."""
    a1, b1 = accelerations(m, delta, theta_dot, delta_dot, voltage)
    half = 0.5 * h
    v2, w2 = theta_dot + half * a1, delta_dot + half * b1
    a2, b2 = accelerations(m, delta + half * delta_dot, v2, w2, voltage)
    v3, w3 = theta_dot + half * a2, delta_dot + half * b2
    a3, b3 = accelerations(m, delta + half * w2, v3, w3, voltage)
    v4, w4 = theta_dot + h * a3, delta_dot + h * b3
    a4, b4 = accelerations(m, delta + h * w3, v4, w4, voltage)
    sixth = h / 6.0
    return (
        theta + sixth * (theta_dot + 2.0 * (v2 + v3) + v4),
        delta + sixth * (delta_dot + 2.0 * (w2 + w3) + w4),
        theta_dot + sixth * (a1 + 2.0 * (a2 + a3) + a4),
        delta_dot + sixth * (b1 + 2.0 * (b2 + b3) + b4),
    )
