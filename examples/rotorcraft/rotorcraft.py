"""Planar rotorcraft: a body with two rotors, hovering; pitch 0 is level, positive counterclockwise.

    m x'' = -(F_1 + F_2) sin(pitch),   m z'' = (F_1 + F_2) cos(pitch) - m g,   I pitch'' = L (F_1 - F_2)

Equations and numbers: planar quadrotor of R. Tedrake, "Underactuated Robotics" (course notes, MIT); each rotor carries half
of the weight at hover, which is the inputs' start value.
"""

from math import cos, sin
from typing import ClassVar

from rk4_plant import Quantities, Rk4Plant

MASS, GRAVITY = 0.486, 9.81
HOVER = 0.5 * MASS * GRAVITY


class Rotorcraft(Rk4Plant):
    """Body and two rotors."""

    parameters: ClassVar[Quantities] = {
        "mass": (MASS, "kg", "mass"),
        "arm": (0.25, "m", "distance of a rotor from the centre of mass"),
        "inertia": (0.00383, "kg.m2", "inertia about the centre of mass"),
        "gravity": (GRAVITY, "m/s2", "gravitational acceleration"),
    }
    states: ClassVar[Quantities] = {
        "x": (0.0, "m", "horizontal position"),
        "z": (0.0, "m", "height"),
        "pitch": (0.0, "rad", "angle from level"),
        "x_velocity": (0.0, "m/s", "horizontal velocity"),
        "z_velocity": (0.0, "m/s", "vertical velocity"),
        "pitch_velocity": (0.0, "rad/s", "angular velocity"),
    }
    inputs: ClassVar[Quantities] = {
        "thrust_1": (HOVER, "N", "thrust of the rotor on the right"),
        "thrust_2": (HOVER, "N", "thrust of the rotor on the left"),
    }

    def rates(self, x, u):
        """Return x'."""
        _, _, pitch, vx, vz, w = x
        lift = (u[0] + u[1]) / self.mass
        return [
            vx,
            vz,
            w,
            -lift * sin(pitch),
            lift * cos(pitch) - self.gravity,
            self.arm * (u[0] - u[1]) / self.inertia,
        ]
