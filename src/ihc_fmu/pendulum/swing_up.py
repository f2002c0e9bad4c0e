"""Energy swing-up: pump the pendulum's energy to that of rest upright, and a little over.

    E = J_t delta'^2/2 + m_p g L_p (cos delta - 1)/2 - e_o m_p g L_p/2,   J_t = J_p + m_p L_p^2/4,
    a_d = sat_amax(k_e (-E) s_1) - k_th theta - k_d theta',   s_1 = sat_1(delta' cos delta / v_s),

and the voltage by inverse dynamics of the nominal model. s_1 = 1 at rest near hanging, where the law would do nothing.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos
from typing import Any, NamedTuple

from .nominal_model import NominalModel, voltage_for

REST_VELOCITY = 0.05
"""Below this |delta'| [rad/s], with the pendulum within REST_COSINE of hanging, it counts as at rest."""
REST_COSINE = -0.999


class SwingUp(NamedTuple):
    """The numbers of the law."""

    energy_gain: float  # k_e [rad/(s^2 J)]
    acceleration_limit: float  # amax [rad/s2]
    arm_stiffness: float  # k_th [1/s2]
    arm_damping: float  # k_d [1/s]
    energy_offset: float  # e_o, target energy above upright in units of m_p g L_p/2 [1]
    velocity_scale: float  # v_s [rad/s]


def swing_up(values: Mapping[str, Any]) -> SwingUp:
    """Return the law's numbers from the controller's parameters `swing_up_...`."""
    return SwingUp(*[values[f"swing_up_{name}"] for name in SwingUp._fields])


def saturate(value: float, limit: float) -> float:
    """Return `value` limited to [-limit, limit]; -limit for NaN."""
    above = value if value > -limit else -limit
    return above if above < limit else limit


def swing_up_voltage(
    p: SwingUp, m: NominalModel, theta: float, delta: float, theta_dot: float, delta_dot: float
) -> float:
    """Return the voltage [V] before the limit."""
    c = cos(delta)
    energy = 0.5 * m.pendulum_inertia * delta_dot * delta_dot + m.gravity_torque * (c - 1.0 - p.energy_offset)
    at_rest = c < REST_COSINE and abs(delta_dot) < REST_VELOCITY
    direction = 1.0 if at_rest else saturate(delta_dot * c / p.velocity_scale, 1.0)
    wanted = saturate(-p.energy_gain * energy * direction, p.acceleration_limit)
    wanted -= p.arm_stiffness * theta + p.arm_damping * theta_dot
    return voltage_for(m, delta, theta_dot, delta_dot, wanted)
