"""The rotary pendulum with its motor, eq. (5): pure functions of numbers.

    J(q) q'' + C(q, q') q' + w(q) = [tau, tau_p]',   q = [theta, delta]',   delta = 0 upright,

with zeta = m_p L_p^2, psi = m_p L_r^2, varpi = m_p L_p L_r. The motor is static, i = (V - k_e theta')/R_m, or has its
inductance, L_m i' = V - R_m i - k_e theta'; in both tau = k_m i, and k_e is k_m with back-EMF and 0 without.

Beyond the paper the arm has dry friction, smoothed about rest: C_11 holds D_r + T_r/(|theta'| + v_s) in place of D_r, a
torque -T_r theta'/(|theta'| + v_s). T_r = 0 is the paper's plant to the last bit.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import NamedTuple

from .parameters import QubeParameters

FRICTION_SPEED = 0.05
"""v_s [rad/s]: at this speed dry friction is half of T_r. Slow enough not to be seen: an encoder of 2048 counts then takes
61 ms for a count."""

State = tuple[float, ...]
"""(theta [rad], delta [rad], theta' [rad/s], delta' [rad/s]), and current [A] where the motor has inductance."""


class Coefficients(NamedTuple):
    """The combinations of parameters that eq. (5) and the motor consist of."""

    J_11: float  # J_r + psi, arm inertia with the pendulum's mass at its joint [kg.m2]
    J_22: float  # J_p + zeta/4, pendulum about its joint [kg.m2]
    zeta_4: float  # zeta/4 [kg.m2]
    varpi_2: float  # varpi/2 [kg.m2]
    gravity: float  # m_p g_p L_p / 2, gravity torque with the pendulum level [N.m]
    D_r: float  # [N.m.s/rad]
    T_r: float  # [N.m]
    D_p: float  # [N.m.s/rad]
    k_m: float  # torque constant [N.m/A]
    k_e: float  # back-EMF constant, k_m or 0 [V.s/rad]
    R_m: float  # [Ohm]
    L_m: float  # [H]


def coefficients(p: QubeParameters, *, back_emf: bool = True) -> Coefficients:
    """Return the coefficients of eq. (5) for the parameters `p`."""
    zeta = p.m_p * (p.L_p * p.L_p)
    return Coefficients(
        J_11=p.J_r + p.m_p * (p.L_r * p.L_r),
        J_22=p.J_p + zeta / 4,
        zeta_4=zeta / 4,
        varpi_2=p.m_p * p.L_p * p.L_r / 2,
        gravity=p.m_p * p.g_p * p.L_p / 2,
        D_r=p.D_r,
        T_r=p.T_r,
        D_p=p.D_p,
        k_m=p.k_m,
        k_e=p.k_m if back_emf else 0.0,
        R_m=p.R_m,
        L_m=p.L_m,
    )


def accelerations(
    c: Coefficients, delta: float, theta_dot: float, delta_dot: float, tau: float, tau_p: float
) -> tuple[float, float]:
    """Solve eq. (5) for (theta'', delta'') [rad/s^2].

    `tau` is the motor's torque on the arm, `tau_p` a torque on the pendulum joint [N.m]. J(q) is positive definite for
    every admissible parameter set, so the solution always exists.
    """
    return solve(c, sin(delta), cos(delta), theta_dot, delta_dot, tau, tau_p)


def solve(
    c: Coefficients, s: float, k: float, theta_dot: float, delta_dot: float, tau: float, tau_p: float
) -> tuple[float, float]:
    """Solve eq. (5) for (theta'', delta'') [rad/s^2], given s = sin delta and k = cos delta.

    Arithmetic only: every argument, and every coefficient, may also be a NumPy array, all of one shape.
    """
    damping = c.D_r + c.T_r / (abs(theta_dot) + FRICTION_SPEED)
    j_11 = c.J_11 + c.zeta_4 * s * s
    j_12 = -c.varpi_2 * k
    sk = c.zeta_4 * s * k
    r_1 = tau - (2.0 * sk * delta_dot + damping) * theta_dot - c.varpi_2 * s * delta_dot * delta_dot
    r_2 = tau_p + sk * theta_dot * theta_dot - c.D_p * delta_dot + c.gravity * s
    determinant = j_11 * c.J_22 - j_12 * j_12
    return (c.J_22 * r_1 - j_12 * r_2) / determinant, (j_11 * r_2 - j_12 * r_1) / determinant


def static_current(c: Coefficients, voltage: float, theta_dot: float) -> float:
    """Return the motor current (V - k_e theta')/R_m without inductance [A]."""
    return (voltage - c.k_e * theta_dot) / c.R_m


def derivative_static(c: Coefficients, x: Sequence[float], voltage: float, tau_p: float) -> State:
    """Return x' for x = (theta, delta, theta', delta') with the static motor of section III."""
    _, delta, theta_dot, delta_dot = x
    tau = c.k_m * (voltage - c.k_e * theta_dot) / c.R_m
    theta_ddot, delta_ddot = accelerations(c, delta, theta_dot, delta_dot, tau, tau_p)
    return theta_dot, delta_dot, theta_ddot, delta_ddot


def derivative_inductance(c: Coefficients, x: Sequence[float], voltage: float, tau_p: float) -> State:
    """Return x' for x = (theta, delta, theta', delta', i) with L_m i' = V - R_m i - k_e theta'."""
    _, delta, theta_dot, delta_dot, current = x
    theta_ddot, delta_ddot = accelerations(c, delta, theta_dot, delta_dot, c.k_m * current, tau_p)
    return (
        theta_dot,
        delta_dot,
        theta_ddot,
        delta_ddot,
        (voltage - c.R_m * current - c.k_e * theta_dot) / c.L_m,
    )


def energy(c: Coefficients, delta: float, theta_dot: float, delta_dot: float) -> float:
    """Return the mechanical energy q'J(q)q'/2 + m_p g_p L_p (cos delta - 1)/2 [J]; 0 at rest upright."""
    s, k = sin(delta), cos(delta)
    kinetic = 0.5 * (c.J_11 + c.zeta_4 * s * s) * theta_dot * theta_dot
    kinetic += 0.5 * c.J_22 * delta_dot * delta_dot - c.varpi_2 * k * theta_dot * delta_dot
    return kinetic + c.gravity * (k - 1.0)
