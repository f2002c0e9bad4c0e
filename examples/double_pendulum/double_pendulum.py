"""Double pendulum on a cart, upright: M(q) q'' = f with q = (position, angle_1, angle_2), both angles from upright.

With d_1 = m_0 + m_1 + m_2, d_2 = (m_1/2 + m_2) L_1, d_3 = m_2 L_2 / 2, d_5 = m_2 L_1 L_2 / 2, c_i = cos(angle_i), s_i and
c, s of angle_1 - angle_2, uniform rods:

    M = [[d_1, d_2 c_1, d_3 c_2], [d_2 c_1, (m_1/3 + m_2) L_1^2, d_5 c], [d_3 c_2, d_5 c, m_2 L_2^2 / 3]]
    f = (F - b s' + d_2 s_1 w_1^2 + d_3 s_2 w_2^2,  d_2 g s_1 - d_5 s w_2^2,  d_3 g s_2 + d_5 s w_1^2)

Equations, masses and lengths: A. Bogdanov, "Optimal control of a double inverted pendulum on a cart", technical report
CSE-04-006, OGI School of Science and Engineering, 2004.
"""

from math import cos, sin
from typing import ClassVar

from rk4_plant import Quantities, Rk4Plant, solved


class DoublePendulum(Rk4Plant):
    """Cart and two rods."""

    parameters: ClassVar[Quantities] = {
        "cart_mass": (1.5, "kg", "mass of the cart"),
        "mass_1": (0.5, "kg", "mass of the lower rod"),
        "mass_2": (0.75, "kg", "mass of the upper rod"),
        "length_1": (0.5, "m", "length of the lower rod"),
        "length_2": (0.75, "m", "length of the upper rod"),
        "rail_friction": (0.0, "N.s/m", "viscous friction of the cart"),
        "gravity": (9.81, "m/s2", "gravitational acceleration"),
    }
    states: ClassVar[Quantities] = {
        "position": (0.0, "m", "position of the cart"),
        "angle_1": (0.0, "rad", "angle of the lower rod from upright"),
        "angle_2": (0.0, "rad", "angle of the upper rod from upright"),
        "velocity": (0.0, "m/s", "velocity of the cart"),
        "angular_velocity_1": (0.0, "rad/s", "angular velocity of the lower rod"),
        "angular_velocity_2": (0.0, "rad/s", "angular velocity of the upper rod"),
    }
    inputs: ClassVar[Quantities] = {"force": (0.0, "N", "force on the cart")}

    def rates(self, x, u):
        """Return x'."""
        _, a, b, v, wa, wb = x
        m_1, m_2, L_1, L_2 = self.mass_1, self.mass_2, self.length_1, self.length_2
        d_1, d_2, d_3 = self.cart_mass + m_1 + m_2, (0.5 * m_1 + m_2) * L_1, 0.5 * m_2 * L_2
        d_5 = d_3 * L_1
        M = [
            [d_1, d_2 * cos(a), d_3 * cos(b)],
            [d_2 * cos(a), (m_1 / 3.0 + m_2) * L_1**2, d_5 * cos(a - b)],
            [d_3 * cos(b), d_5 * cos(a - b), m_2 * L_2**2 / 3.0],
        ]
        f = [
            u[0] - self.rail_friction * v + d_2 * sin(a) * wa * wa + d_3 * sin(b) * wb * wb,
            d_2 * self.gravity * sin(a) - d_5 * sin(a - b) * wb * wb,
            d_3 * self.gravity * sin(b) + d_5 * sin(a - b) * wa * wa,
        ]
        return [v, wa, wb, *solved(M, f)]
