"""The controller's own model of the rotary pendulum: eq. (5) and the static motor in nine lumped numbers.

It serves the swing-up law and the observer; the plant FMU need not have the same numbers.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from fmu_export.errors import UserError
from rotary_pendulum.equation import Coefficients, arm_torque, is_regular
from rotary_pendulum.equation import accelerations as accelerations_of
from rotary_pendulum.runge_kutta import rk4_step


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

    @property
    def pendulum(self) -> Coefficients:
        """The coefficients of eq. (5), the motor's damping among the arm's; without dry friction."""
        return Coefficients(
            J_11=self.arm_inertia,
            J_22=self.pendulum_inertia,
            zeta_4=self.swing_inertia,
            varpi_2=self.coupling,
            gravity=self.gravity_torque,
            D_r=self.arm_damping + self.motor_damping,
            T_r=0.0,
            D_p=self.pendulum_damping,
        )


def nominal_model(values: Mapping[str, Any]) -> NominalModel:
    """Return the model from the controller's parameters `nominal_...`.

    Raises UserError where the determinant of its inertia matrix upright, where it is smallest, is lost in rounding.
    """
    m = NominalModel(*[values[f"nominal_{name}"] for name in NominalModel._fields])
    if not is_regular(m.pendulum):
        raise UserError(
            f"the square of nominal_coupling must be below nominal_arm_inertia times nominal_pendulum_inertia, found "
            f"{m.coupling:g}, {m.arm_inertia:g} and {m.pendulum_inertia:g} kg.m2"
        )
    return m


def accelerations(
    m: NominalModel, delta: float, theta_dot: float, delta_dot: float, voltage: float
) -> tuple[float, float]:
    """Return (theta'', delta'') [rad/s^2] of eq. (5) under `voltage` [V]."""
    return accelerations_of(m.pendulum, delta, theta_dot, delta_dot, m.torque_per_volt * voltage, 0.0)


def voltage_for(m: NominalModel, delta: float, theta_dot: float, delta_dot: float, theta_ddot: float) -> float:
    """Return the voltage [V] under which the arm accelerates by `theta_ddot` [rad/s^2]: inverse dynamics of eq. (5)."""
    return arm_torque(m.pendulum, delta, theta_dot, delta_dot, theta_ddot) / m.torque_per_volt


def predict(
    m: NominalModel, theta: float, delta: float, theta_dot: float, delta_dot: float, voltage: float, h: float
) -> tuple[float, float, float, float]:
    """Return the state after `h` [s] under a held `voltage`: one step of the classical Runge-Kutta method."""
    c, torque = m.pendulum, m.torque_per_volt * voltage

    def rate(x: Sequence[float]) -> tuple[float, ...]:
        _, delta, theta_dot, delta_dot = x
        return theta_dot, delta_dot, *accelerations_of(c, delta, theta_dot, delta_dot, torque, 0.0)

    theta, delta, theta_dot, delta_dot = rk4_step(rate, (theta, delta, theta_dot, delta_dot), h)
    return theta, delta, theta_dot, delta_dot
