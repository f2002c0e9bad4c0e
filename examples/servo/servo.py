"""Position servo: motor, gear and a load on an elastic shaft; encoders on both sides, no measured velocity.

    J_L w_L' = k (theta_M / rho - theta_L) - b_L w_L
    J_M w_M' = k_M (V - k_M w_M) / R - b_M w_M + k / rho (theta_L - theta_M / rho)

Equations and numbers: position servomechanism of the Model Predictive Control Toolbox (The MathWorks, "Design MPC Controller
for Position Servomechanism"), there after Bemporad and Mosca; its poles are 0, -9.79 and -0.705 +- 7.31i 1/s. The encoders
are added.
"""

from math import floor, pi
from typing import ClassVar

from rk4_plant import Quantities, Rk4Plant


class Servo(Rk4Plant):
    """Motor, gear, shaft, load, encoders."""

    parameters: ClassVar[Quantities] = {
        "stiffness": (1280.2, "N.m/rad", "torsional rigidity of the shaft"),
        "motor_constant": (10.0, "V.s/rad", "torque constant, equal to that of the back-EMF"),
        "motor_inertia": (0.5, "kg.m2", "inertia of the motor"),
        "load_inertia": (25.0, "kg.m2", "inertia of the load"),
        "ratio": (20.0, "1", "turns of the motor for one of the load"),
        "motor_friction": (0.1, "N.m.s/rad", "viscous friction of the motor"),
        "load_friction": (25.0, "N.m.s/rad", "viscous friction of the load"),
        "resistance": (20.0, "Ohm", "resistance of the armature"),
        "encoder_counts": (10000.0, "1", "counts of both encoders per turn; 0: they measure exactly"),
    }
    states: ClassVar[Quantities] = {
        "load_angle": (0.0, "rad", "angle of the load"),
        "motor_angle": (0.0, "rad", "angle of the motor"),
        "load_velocity": (0.0, "rad/s", "angular velocity of the load"),
        "motor_velocity": (0.0, "rad/s", "angular velocity of the motor"),
    }
    inputs: ClassVar[Quantities] = {"voltage": (0.0, "V", "voltage of the armature")}
    sensors: ClassVar[Quantities] = {
        "load_encoder": (0.0, "rad", "counted angle of the load"),
        "motor_encoder": (0.0, "rad", "counted angle of the motor"),
    }

    def rates(self, x, u):
        """Return x'."""
        load, motor, w_load, w_motor = x
        twist = motor / self.ratio - load
        current = (u[0] - self.motor_constant * w_motor) / self.resistance
        torque = self.motor_constant * current - self.motor_friction * w_motor - self.stiffness * twist / self.ratio
        load_torque = self.stiffness * twist - self.load_friction * w_load
        return [w_load, w_motor, load_torque / self.load_inertia, torque / self.motor_inertia]

    def load_encoder(self):
        """Return the counted angle of the load [rad]."""
        return self._counted(self.load_angle)

    def motor_encoder(self):
        """Return the counted angle of the motor [rad]."""
        return self._counted(self.motor_angle)

    def _counted(self, angle):
        if self.encoder_counts == 0.0:
            return angle
        count = 2.0 * pi / self.encoder_counts
        return count * floor(angle / count)
