"""Crane: a trolley on a rail with a hanging load; M(q) q'' = f with q = (position, angle), angle 0 hangs down.

    (M + m) s'' + m l cos(phi) phi'' = F - b s' + m l sin(phi) phi'^2
    m l cos(phi) s'' + (I + m l^2) phi'' = -m g l sin(phi) - d phi'

Numbers: the cart with pendulum of the Control Tutorials for MATLAB and Simulink (University of Michigan and others,
"Inverted Pendulum: System Modeling"), here with the pendulum hanging down; no damping of the joint.
"""

from math import cos, sin
from typing import ClassVar

from rk4_plant import Quantities, Rk4Plant, solved


class Crane(Rk4Plant):
    """Trolley and load."""

    parameters: ClassVar[Quantities] = {
        "trolley_mass": (0.5, "kg", "mass of the trolley"),
        "load_mass": (0.2, "kg", "mass of the load"),
        "length": (0.3, "m", "distance from the joint to the load's centre of mass"),
        "load_inertia": (0.006, "kg.m2", "inertia of the load about its centre of mass"),
        "rail_friction": (0.1, "N.s/m", "viscous friction of the trolley"),
        "joint_friction": (0.0, "N.m.s/rad", "viscous friction of the joint"),
        "gravity": (9.8, "m/s2", "gravitational acceleration"),
    }
    states: ClassVar[Quantities] = {
        "position": (0.0, "m", "position of the trolley"),
        "angle": (0.0, "rad", "angle of the load from hanging down"),
        "velocity": (0.0, "m/s", "velocity of the trolley"),
        "angular_velocity": (0.0, "rad/s", "angular velocity of the load"),
    }
    inputs: ClassVar[Quantities] = {"force": (0.0, "N", "force on the trolley")}

    def rates(self, x, u):
        """Return x'."""
        _, phi, v, w = x
        ml = self.load_mass * self.length
        M = [
            [self.trolley_mass + self.load_mass, ml * cos(phi)],
            [ml * cos(phi), self.load_inertia + ml * self.length],
        ]
        f = [
            u[0] - self.rail_friction * v + ml * sin(phi) * w * w,
            -ml * self.gravity * sin(phi) - self.joint_friction * w,
        ]
        return [v, w, *solved(M, f)]
