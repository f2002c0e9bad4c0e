"""The plant in C, and its structure for model exchange.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fmu_export.model_description import ModelExchange
from fmu_export.native_unit import NativeUnit
from fmu_export.variables import Value
from rotary_pendulum.c_header import CONSTANTS, HEADER

from .integrator import LEAST
from .interface import INTERFACE, MAX_DELAY_STEPS, MAX_SUBSTEPS, MOTOR_MODELS
from .unit import STEPS_PER_TIME_CONSTANT, QubePlant

_VOLTAGES = ("voltage", "disturbance_voltage")


def _model_exchange(inductance: bool) -> ModelExchange:
    """Return the structure of eq. (5) with the static motor (4 states) or with inductance (5)."""
    current = ("current",) if inductance else (*_VOLTAGES, "theta_dot")
    accelerations = ("pendulum_torque", "delta", "theta_dot", "delta_dot", *current)
    dependencies: dict[str, tuple[str, ...]] = {
        **{name: (name,) for name in ("theta", "delta", "theta_dot", "delta_dot")},
        "theta_encoder": ("theta",),
        "delta_encoder": ("delta",),
        "current": current,
        "motor_torque": current,
        "energy": ("delta", "theta_dot", "delta_dot"),
        "theta_ddot": tuple(dict.fromkeys(accelerations)),
        "delta_ddot": tuple(dict.fromkeys(accelerations)),
        "current_dot": (*_VOLTAGES, "theta_dot", "current"),
    }
    states = ("theta", "delta", "theta_dot", "delta_dot")
    derivatives = ("theta_dot", "delta_dot", "theta_ddot", "delta_ddot")
    if inductance:
        states, derivatives = (*states, "current"), (*derivatives, "current_dot")
    inputs = {
        name: [known for known in all_ if known in (*_VOLTAGES, "pendulum_torque")]
        for name, all_ in dependencies.items()
    }
    initial = {name: (*known, *["voltage_limit"] * ("voltage" in known)) for name, known in inputs.items()}
    return ModelExchange(states, derivatives, dependencies, initial)


def model_exchange(start: Mapping[str, Value]) -> ModelExchange:
    """Return the structure of an FMU with these start values."""
    return _model_exchange(inductance=MOTOR_MODELS[int(start["motor_model"]) - 1] == "inductance")


NATIVE = NativeUnit(
    interface=INTERFACE,
    twin=QubePlant,
    folder=Path(__file__).parent / "native",
    stem="qube_servo2",
    prefix="qube",
    common=(HEADER,),
    model_exchange=model_exchange,
    largest_model_exchange=_model_exchange(inductance=True),
    constants={
        "QUBE_MAX_DELAY": MAX_DELAY_STEPS,
        "QUBE_MAX_SUBSTEPS": MAX_SUBSTEPS,
        "QUBE_STEPS_PER_TIME_CONSTANT": STEPS_PER_TIME_CONSTANT,
        **CONSTANTS,
        "QUBE_LEAST": LEAST,
    },
)
