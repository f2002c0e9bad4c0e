"""The plant as a unit that is stepped: eq. (5), motor and sensors under zero-order hold of the inputs.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from fmu_export.errors import UserError
from rotary_pendulum.equation import energy
from rotary_pendulum.runge_kutta import rk4_step

from . import dynamics, sensors
from .integrator import flushed, substeps
from .interface import MAX_DELAY_STEPS, MAX_SUBSTEPS, MOTOR_MODELS
from .parameters import QubeParameters

STEPS_PER_TIME_CONSTANT = 2
"""Runge-Kutta steps within the motor's time constant L_m/R_m, at least; one step of 2.8 time constants is unstable."""

Measurement = tuple[float, float]


class QubePlant:
    """The rotary pendulum between two communication points.

    `values` maps every parameter of the interface to its value. Raises UserError where they contradict each other.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        physical = QubeParameters(**{f.name: values[f.name] for f in fields(QubeParameters)})
        self.coefficients = physical.coefficients
        self.motor = dynamics.motor(physical, back_emf=values["back_emf"])
        self.inductance = MOTOR_MODELS[values["motor_model"] - 1] == "inductance"
        self.voltage_limit: float = values["voltage_limit"]
        self.solver_step: float = values["solver_step"]
        self.counts: int = values["encoder_counts"]
        self.offsets: Measurement = (values["theta_encoder_offset"], values["delta_encoder_offset"])
        self.noise_std: float = values["noise_std"]
        self.delay: float = values["measurement_delay"]
        start = tuple(values[name] for name in ("theta_0", "delta_0", "theta_dot_0", "delta_dot_0"))
        self.x: dynamics.State = (*start, 0.0) if self.inductance else start
        self.applied_voltage = 0.0
        self.applied_torque = 0.0
        self.derivative = dynamics.derivative_inductance if self.inductance else dynamics.derivative_static
        self.random_state: int = values["noise_seed"]
        self.longest_step = self.solver_step
        if self.inductance:
            self.longest_step = min(self.solver_step, physical.L_m / physical.R_m / STEPS_PER_TIME_CONSTANT)
        self.delay_steps = 0
        self.delayed_step = 0.0  # communication step that the delay is counted in [s]
        self.delay_line: deque[Measurement] = deque([self._measure()])

    def initialize(self, time: float, inputs: tuple[float, ...]) -> list[str]:
        """Check the outputs; nothing depends on the first inputs. Raises ArithmeticError for numbers beyond reason."""
        try:
            finite = math.isfinite(sum(self.outputs()))
        except (OverflowError, ValueError):
            finite = False
        if not finite:
            start = ", ".join(f"{value:g}" for value in self.x[:4])
            raise ArithmeticError(f"start values must give finite outputs, found x = ({start})")
        return []

    def step(self, time: float, step: float, inputs: tuple[float, ...]) -> list[str]:
        """Advance from `time` by `step` [s] with `inputs` (voltage, disturbance_voltage, pendulum_torque) held.

        Returns messages for the log (none). Raises UserError for a step that cannot work or inputs that are not finite,
        and ArithmeticError where the state stops being finite; the unit is then as it was.
        """
        voltage, disturbance, tau_p = inputs
        if not math.isfinite(voltage + disturbance + tau_p):
            values = ", ".join(f"{value:.17g}" for value in inputs)
            raise UserError(f"inputs must be finite, found voltage, disturbance_voltage, pendulum_torque = ({values})")
        limit = self.voltage_limit
        applied, tau_p = flushed(min(limit, max(-limit, voltage + disturbance))), flushed(tau_p)
        count = substeps(step, self.longest_step)
        if count > MAX_SUBSTEPS:
            raise UserError(
                f"a communication step must not exceed {MAX_SUBSTEPS} internal steps of {self.solver_step:g} s, found "
                f"{step:g} s"
            )
        h = step / count
        delay_steps = self._delay_steps(step) if self.delay else 0
        derivative, c, motor = self.derivative, self.coefficients, self.motor

        def f(x: Sequence[float]) -> dynamics.State:
            return derivative(c, motor, x, applied, tau_p)

        x = self.x
        try:
            for _ in range(count):
                x = rk4_step(f, x, h)
            finite = math.isfinite(sum([value * value for value in x]))  # as in the energy
        except (OverflowError, ValueError):  # sin and cos refuse infinity
            finite = False
        if not finite:
            before = ", ".join(f"{value:.9g}" for value in (*self.x, 0.0)[:5])
            raise ArithmeticError(f"the state left the range of numbers, x = ({before}) before the step")
        self.x, self.applied_voltage, self.applied_torque = tuple(map(flushed, x)), applied, tau_p
        if self.delay:
            self.delay_steps, self.delayed_step = delay_steps, step
        self.delay_line.append(self._measure())
        while len(self.delay_line) > self.delay_steps + 1:
            self.delay_line.popleft()
        return []

    def outputs(self) -> tuple[float, ...]:
        """Return outputs and local variables in the order of the interface."""
        theta, delta, theta_dot, delta_dot = self.x[:4]
        c, motor = self.coefficients, self.motor
        rates = self.derivative(c, motor, self.x, self.applied_voltage, self.applied_torque)
        current = self.x[4] if self.inductance else dynamics.static_current(motor, self.applied_voltage, theta_dot)
        return (
            theta,
            delta,
            theta_dot,
            delta_dot,
            *self.delay_line[0],
            current,
            motor.k_m * current,
            energy(c, delta, theta_dot, delta_dot),
            rates[2],
            rates[3],
            rates[4] if self.inductance else 0.0,
        )

    def get_state(self) -> dict[str, Any]:
        """Return everything that changes during a run, as JSON types."""
        return {
            "x": list(self.x),
            "applied_voltage": self.applied_voltage,
            "applied_torque": self.applied_torque,
            "random_state": self.random_state,
            "delay_steps": self.delay_steps,
            "delayed_step": self.delayed_step,
            "delay_line": [list(pair) for pair in self.delay_line],
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore what `get_state` returned."""
        self.x = tuple(state["x"])
        self.applied_voltage = state["applied_voltage"]
        self.applied_torque = state["applied_torque"]
        self.random_state = state["random_state"]
        self.delay_steps = state["delay_steps"]
        self.delayed_step = state["delayed_step"]
        self.delay_line = deque((pair[0], pair[1]) for pair in state["delay_line"])

    def _delay_steps(self, step: float) -> int:
        """Return the delay as a number of communication steps, which may not change once one has been taken."""
        if self.delayed_step and abs(step - self.delayed_step) > 1e-6 * step:
            raise UserError(
                f"the communication step must stay the same with a measurement_delay, found {step:g} s after "
                f"{self.delayed_step:g} s"
            )
        if self.delay / step > MAX_DELAY_STEPS + 0.5:
            raise UserError(
                f"measurement_delay must not exceed {MAX_DELAY_STEPS} communication steps, found {self.delay:g} s with a "
                f"step of {step:g} s"
            )
        return sensors.delay_in_steps(self.delay, step)

    def _measure(self) -> Measurement:
        return self._measure_angle(self.x[0], self.offsets[0]), self._measure_angle(self.x[1], self.offsets[1])

    def _measure_angle(self, angle: float, offset: float) -> float:
        if self.noise_std:
            self.random_state, number = sensors.next_gaussian(self.random_state)
            angle += self.noise_std * number
        return sensors.quantize(angle, self.counts, offset)
