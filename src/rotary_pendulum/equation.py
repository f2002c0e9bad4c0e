"""The equation of motion of the rotary pendulum, eq. (5): pure functions of numbers.

    J(q) q'' + C(q, q') q' + w(q) = [tau, tau_p]',   q = [theta, delta]',   delta = 0 upright,

    J = [ J_r + psi + zeta/4 sin^2 delta    -varpi/2 cos delta ]    zeta  = m_p L_p^2
        [ -varpi/2 cos delta                J_p + zeta/4       ]    psi   = m_p L_r^2
    C = [ zeta/2 sin delta cos delta delta' + D_r    varpi/2 sin delta delta' ]
        [ -zeta/4 sin delta cos delta theta'         D_p                      ]
    w = [ 0, -m_p g_p L_p/2 sin delta ]'                            varpi = m_p L_p L_r

Beyond the paper the arm has dry friction, smoothed about rest: C_11 holds D_r + T_r/(|theta'| + v_s) in place of D_r, a
torque -T_r theta'/(|theta'| + v_s). T_r = 0 is the paper's equation to the last bit.

Its twin in C is `native/rotary_pendulum.h`. Standard library only: this module travels inside the Python FMUs.
"""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

FRICTION_SPEED = 0.05
"""v_s [rad/s]: at this speed dry friction is half of T_r. Slow enough not to be seen: an encoder of 2048 counts then takes
61 ms for a count."""


class Coefficients(NamedTuple):
    """The combinations of constants that eq. (5) consists of."""

    J_11: float  # J_r + psi, arm inertia with the pendulum's mass at its joint [kg.m2]
    J_22: float  # J_p + zeta/4, pendulum about its joint [kg.m2]
    zeta_4: float  # zeta/4 [kg.m2]
    varpi_2: float  # varpi/2 [kg.m2]
    gravity: float  # m_p g_p L_p / 2, gravity torque with the pendulum level [N.m]
    D_r: float  # viscous damping of the arm [N.m.s/rad]
    T_r: float  # dry friction of the arm [N.m]
    D_p: float  # viscous damping of the pendulum [N.m.s/rad]


def lumped(
    *,
    m_p: float,
    L_p: float,
    J_p: float,
    D_p: float,
    L_r: float,
    J_r: float,
    D_r: float,
    T_r: float,
    g_p: float,
) -> Coefficients:
    """Return the coefficients of eq. (5) for the constants of a pendulum [SI units]: see `plant_fmu.parameters`."""
    zeta = m_p * (L_p * L_p)
    return Coefficients(
        J_11=J_r + m_p * (L_r * L_r),
        J_22=J_p + zeta / 4,
        zeta_4=zeta / 4,
        varpi_2=m_p * L_p * L_r / 2,
        gravity=m_p * g_p * L_p / 2,
        D_r=D_r,
        T_r=T_r,
        D_p=D_p,
    )


def is_regular(c: Coefficients) -> bool:
    """Return whether the determinant of J upright, where it is smallest, is more than rounding: 1e-9 of its diagonal's."""
    diagonal = c.J_11 * c.J_22
    return diagonal - c.varpi_2 * c.varpi_2 > 1e-9 * diagonal


def accelerations(
    c: Coefficients, delta: float, theta_dot: float, delta_dot: float, tau: float, tau_p: float
) -> tuple[float, float]:
    """Solve eq. (5) for (theta'', delta'') [rad/s^2].

    `tau` is the motor's torque on the arm, `tau_p` a torque on the pendulum joint [N.m]. The solution exists where the
    coefficients are regular.
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


def arm_torque(c: Coefficients, delta: float, theta_dot: float, delta_dot: float, theta_ddot: float) -> float:
    """Return the torque tau [N.m] under which the arm accelerates by `theta_ddot` [rad/s^2], tau_p = 0: eq. (5) inverted."""
    s, k = sin(delta), cos(delta)
    damping = c.D_r + c.T_r / (abs(theta_dot) + FRICTION_SPEED)
    j_12 = -c.varpi_2 * k
    sk = c.zeta_4 * s * k
    r_2 = sk * theta_dot * theta_dot - c.D_p * delta_dot + c.gravity * s
    delta_ddot = (r_2 - j_12 * theta_ddot) / c.J_22
    tau = (c.J_11 + c.zeta_4 * s * s) * theta_ddot + j_12 * delta_ddot
    return tau + (2.0 * sk * delta_dot + damping) * theta_dot + c.varpi_2 * s * delta_dot * delta_dot


def energy(c: Coefficients, delta: float, theta_dot: float, delta_dot: float) -> float:
    """Return the mechanical energy q'J(q)q'/2 + m_p g_p L_p (cos delta - 1)/2 [J]; 0 at rest upright."""
    s, k = sin(delta), cos(delta)
    kinetic = 0.5 * (c.J_11 + c.zeta_4 * s * s) * theta_dot * theta_dot
    kinetic += 0.5 * c.J_22 * delta_dot * delta_dot - c.varpi_2 * k * theta_dot * delta_dot
    return kinetic + c.gravity * (k - 1.0)
