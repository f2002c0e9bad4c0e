"""Arm: two links held upright by a motor in each joint; M(q) q'' = f with q = (shoulder, elbow).

The shoulder is the angle of the first link from upright, the elbow that of the second link from the first. With the
inertias about the joints J_i = I_i + m_i c_i^2, k = m_2 l_1 c_2 and the angles p = shoulder, q = elbow:

    M = [[J_1 + J_2 + m_2 l_1^2 + 2 k cos q, J_2 + k cos q], [J_2 + k cos q, J_2]]
    f_1 = tau_1 - b_1 p' + k sin(q) (2 p' q' + q'^2) + g ((m_1 c_1 + m_2 l_1) sin p + m_2 c_2 sin(p + q))
    f_2 = tau_2 - b_2 q' - k sin(q) p'^2 + g m_2 c_2 sin(p + q)

Numbers: the Acrobot of M. W. Spong, "The swing up control problem for the Acrobot", IEEE Control Systems 15(1), 1995; with
a motor in both joints.
"""

from math import cos, sin
from typing import ClassVar

from rk4_plant import Quantities, Rk4Plant, solved


class Arm(Rk4Plant):
    """Two links, two motors."""

    parameters: ClassVar[Quantities] = {
        "mass_1": (1.0, "kg", "mass of the first link"),
        "mass_2": (1.0, "kg", "mass of the second link"),
        "length_1": (1.0, "m", "length of the first link"),
        "centre_1": (0.5, "m", "distance of the first link's centre of mass from its joint"),
        "centre_2": (1.0, "m", "distance of the second link's centre of mass from its joint"),
        "inertia_1": (0.083, "kg.m2", "inertia of the first link about its centre of mass"),
        "inertia_2": (0.33, "kg.m2", "inertia of the second link about its centre of mass"),
        "friction_1": (0.1, "N.m.s/rad", "viscous friction of the shoulder"),
        "friction_2": (0.1, "N.m.s/rad", "viscous friction of the elbow"),
        "gravity": (9.8, "m/s2", "gravitational acceleration"),
    }
    states: ClassVar[Quantities] = {
        "shoulder": (0.0, "rad", "angle of the first link from upright"),
        "elbow": (0.0, "rad", "angle of the second link from the first"),
        "shoulder_velocity": (0.0, "rad/s", "angular velocity of the shoulder"),
        "elbow_velocity": (0.0, "rad/s", "angular velocity of the elbow"),
    }
    inputs: ClassVar[Quantities] = {
        "shoulder_torque": (0.0, "N.m", "torque of the motor in the shoulder"),
        "elbow_torque": (0.0, "N.m", "torque of the motor in the elbow"),
    }

    def rates(self, x, u):
        """Return x'."""
        p, q, vp, vq = x
        J_1 = self.inertia_1 + self.mass_1 * self.centre_1**2
        J_2 = self.inertia_2 + self.mass_2 * self.centre_2**2
        k = self.mass_2 * self.length_1 * self.centre_2
        coupling = J_2 + k * cos(q)
        M = [[J_1 + J_2 + self.mass_2 * self.length_1**2 + 2.0 * k * cos(q), coupling], [coupling, J_2]]
        first = (self.mass_1 * self.centre_1 + self.mass_2 * self.length_1) * self.gravity * sin(p)
        second = self.mass_2 * self.centre_2 * self.gravity * sin(p + q)
        f = [
            u[0] - self.friction_1 * vp + k * sin(q) * (2.0 * vp * vq + vq * vq) + first + second,
            u[1] - self.friction_2 * vq - k * sin(q) * vp * vp + second,
        ]
        return [vp, vq, *solved(M, f)]
