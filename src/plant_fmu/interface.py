"""The variables of the plant FMU `QubeServo2`: the one place where they are declared.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from dataclasses import fields
from math import pi

from fmu_export.variables import Interface, Value, Variable

from .parameters import PARAMETER_SETS, ParameterSet, QubeParameters, limits, parameter_set

MOTOR_MODELS = ("static", "inductance")
MAX_DELAY_STEPS = 1000
"""Longest measurement_delay in communication steps."""
MAX_SUBSTEPS = 1_000_000
"""Most Runge-Kutta steps in one communication step."""


def _parameter(name: str, start: Value, unit: str, description: str, **rest: object) -> Variable:
    return Variable(name, "parameter", description, unit, variability="fixed", start=start, **rest)  # type: ignore[arg-type]


def _physical_parameters() -> list[Variable]:
    p = PARAMETER_SETS["ident"].parameters
    made = []
    for f in fields(QubeParameters):
        low, high = limits(f.metadata)
        made.append(
            _parameter(f.name, getattr(p, f.name), f.metadata["unit"], f.metadata["description"], min=low, max=high)
        )
    return made


_INERTIA = ("m_p", "L_p", "J_p", "L_r", "J_r")
_MOTOR = ("R_m", "k_m", "back_emf", "motor_model")
_MOTION = ("delta_0", "theta_dot_0", "delta_dot_0")
_ACCELERATION = (*_INERTIA, "g_p", "D_p", "D_r", "T_r", *_MOTOR, *_MOTION)
_NOISE = ("noise_std", "noise_seed")


def _output(name: str, unit: str, description: str, *start: str) -> Variable:
    """Return an output; `start` names the parameters that it depends on in initialization, where no voltage acts yet."""
    return Variable(name, "output", description, unit, initial_dependencies=start)


def _local(name: str, unit: str, description: str, *start: str) -> Variable:
    return Variable(name, "local", description, unit, initial_dependencies=start)


INTERFACE = Interface(
    name="QubeServo2",
    description="Quanser QUBE-Servo 2 rotary pendulum with motor and encoders; delta = 0 is upright",
    variables=(
        Variable("voltage", "input", "commanded motor voltage, limited to voltage_limit", "V", start=0.0),
        Variable(
            "disturbance_voltage", "input", "matched disturbance, added to voltage before the limit", "V", start=0.0
        ),
        Variable("pendulum_torque", "input", "disturbance torque on the pendulum joint", "N.m", start=0.0),
        _output("theta", "rad", "angle of the rotary arm", "theta_0"),
        _output("delta", "rad", "angle of the pendulum from upright, not wrapped", "delta_0"),
        _output("theta_dot", "rad/s", "angular velocity of the rotary arm", "theta_dot_0"),
        _output("delta_dot", "rad/s", "angular velocity of the pendulum", "delta_dot_0"),
        _output(
            "theta_encoder",
            "rad",
            "measured arm angle: noise, encoder counts, delay",
            "theta_0",
            "theta_encoder_offset",
            "encoder_counts",
            *_NOISE,
        ),
        _output(
            "delta_encoder",
            "rad",
            "measured pendulum angle: noise, encoder counts, delay",
            "delta_0",
            "delta_encoder_offset",
            "encoder_counts",
            *_NOISE,
        ),
        _output(
            "current", "A", "motor current under the voltage of the step that has just ended", *_MOTOR, "theta_dot_0"
        ),
        _output("motor_torque", "N.m", "motor torque on the arm, k_m times current", *_MOTOR, "theta_dot_0"),
        _output(
            "energy",
            "J",
            "mechanical energy; 0 at rest upright, -m_p g_p L_p at rest hanging",
            *_INERTIA,
            "g_p",
            *_MOTION,
        ),
        *_physical_parameters(),
        _parameter("voltage_limit", 10.0, "V", "the amplifier saturates at plus and minus this voltage", min=0.0),
        _parameter("back_emf", True, "1", "whether the turning motor induces a voltage", type="Boolean"),
        _parameter(
            "motor_model",
            1,
            "1",
            "static torque k_m i as in the paper, or with L_m",
            type="Enumeration",
            items=MOTOR_MODELS,
        ),
        _parameter("theta_0", 0.0, "rad", "initial angle of the arm"),
        _parameter("delta_0", pi, "rad", "initial angle of the pendulum; pi hangs down, 0 is upright"),
        _parameter("theta_dot_0", 0.0, "rad/s", "initial angular velocity of the arm"),
        _parameter("delta_dot_0", 0.0, "rad/s", "initial angular velocity of the pendulum"),
        _parameter("encoder_counts", 2048, "1", "encoder counts per turn; 0 is an ideal sensor", type="Integer", min=0),
        _parameter(
            "theta_encoder_offset", 0.3, "1", "where inside a count the arm's encoder was zeroed", min=0.0, max=1.0
        ),
        _parameter(
            "delta_encoder_offset", 0.8, "1", "where inside a count the pendulum's encoder was zeroed", min=0.0, max=1.0
        ),
        _parameter(
            "noise_std",
            0.0,
            "rad",
            "standard deviation of the noise on both angles before the encoder",
            min=0.0,
            max=1e6,
        ),
        _parameter("noise_seed", 1, "1", "seed of the measurement noise", type="Integer", min=0),
        _parameter(
            "measurement_delay", 0.0, "s", "age of the measured angles, a multiple of the communication step", min=0.0
        ),
        _parameter(
            "solver_step",
            5e-4,
            "s",
            "longest internal Runge-Kutta step; with inductance also at most L_m/(2 R_m)",
            min=1e-7,
            max=0.1,
        ),
        _local(
            "theta_ddot",
            "rad/s2",
            "angular acceleration of the rotary arm under the voltage of the last step",
            *_ACCELERATION,
        ),
        _local(
            "delta_ddot",
            "rad/s2",
            "angular acceleration of the pendulum under the voltage of the last step",
            *_ACCELERATION,
        ),
        _local(
            "current_dot",
            "A/s",
            "rate of the current under the voltage of the last step; 0 without inductance",
            "k_m",
            "L_m",
            "back_emf",
            "motor_model",
            "theta_dot_0",
        ),
    ),
    step_size=1e-3,
    stop_time=1.0,
    variable_step=True,
)


def start_values(parameters: str | ParameterSet) -> dict[str, Value]:
    """Return the start values that turn the plant into a parameter set, given or named.

    Raises UserError for an unknown name.
    """
    named = parameter_set(parameters)
    values: dict[str, Value] = {f.name: getattr(named.parameters, f.name) for f in fields(QubeParameters)}
    values["back_emf"] = named.back_emf
    return values
