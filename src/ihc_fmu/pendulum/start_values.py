"""What a design, a nominal model and a sliding mode design put into the controller FMU: start values, nothing else."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from fmu_export.errors import UserError
from fmu_export.variables import Value
from plant_fmu.dynamics import motor
from plant_fmu.parameters import ParameterSet, QubeParameters, parameter_set

from ..companion import chain_form
from ..design import Design
from ..linear_algebra import dot, solve
from ..sliding_mode import SlidingMode, fitted_smc, tuned_sta
from ..system import PENDULUM
from .default_design import default_design as default_design  # noqa: PLC0414 - also from here
from .interface import INTERFACE, ORDER, kalman_gains, matrix, upper_triangle, vector
from .kalman import KalmanOptions, kalman_gain, linearize
from .nominal_model import nominal_model

CAPTURE_FRACTION = 0.85
"""Of the square of the voltage limit: capture where the homogeneous control |k x| needs at most 92 % of the limit."""


def nominal_values(p: QubeParameters) -> dict[str, Value]:
    """Return the lumped coefficients of the controller's nominal model for the pendulum `p`."""
    c, m = p.coefficients, motor(p)
    numbers = {
        "arm_inertia": c.J_11,
        "pendulum_inertia": c.J_22,
        "swing_inertia": c.zeta_4,
        "coupling": c.varpi_2,
        "gravity_torque": c.gravity,
        "arm_damping": c.D_r,
        "pendulum_damping": c.D_p,
        "torque_per_volt": m.k_m / m.R_m,
        "motor_damping": m.k_m * m.k_e / m.R_m,
    }
    return {f"nominal_{name}": value for name, value in numbers.items()}


def check_order(design: Design) -> None:
    """Raise UserError for a design of another order than the FMU's four states, or of several inputs.

    Where it is the system's name that brought it here, the sentence says so.
    """
    n, m = design.n, design.system.m
    if (n, m) != (ORDER, 1):
        name = design.system.name
        why = f"; without the name {PENDULUM} the system is exported for itself" if name == PENDULUM else ""
        raise UserError(
            f"the rotary pendulum's controller takes designs of {ORDER} states and 1 input, found {n} and {m}{why}"
        )


def design_values(design: Design, smc: SlidingMode | None = None, voltage_limit: float = 10.0) -> dict[str, Value]:
    """Return the start values that a design decides, the capture level for a voltage limit [V]; raises as `check_order`."""
    check_order(design)
    form = chain_form(design.A, design.b)
    smc = smc or fitted_smc(design.A, design.b)
    sta, rate = tuned_sta(design.A, design.b)
    values: dict[str, Value] = {"mu": design.mu, "smc_rho": smc.rho, "sta_rate": rate}
    rows = {
        "k_lin": design.k_lin,
        "row": form.row,
        "smc_c": smc.c,
        "smc_k": smc.k_eq,
        "sta_c": sta.c,
        "sta_k": sta.k_eq,
    }
    for name, numbers in rows.items():
        values |= zip_names(vector(name), numbers)
    values |= zip_names(matrix("Phi"), form.Phi.ravel())
    values |= zip_names(upper_triangle("P"), design.P[np.triu_indices(ORDER)])
    k = (design.k_lin + form.row).tolist()
    largest = dot(
        k, [entry for (entry,) in solve(design.P.tolist(), [[entry] for entry in k])]
    )  # u_max^2, in plain arithmetic
    values["capture_level"] = CAPTURE_FRACTION * (voltage_limit * voltage_limit / largest)
    return values


def kalman_values(
    nominal: Mapping[str, Value], sample_time: float, options: KalmanOptions | None = None
) -> dict[str, Value]:
    """Return the Kalman filter's gain for the nominal model with the start values `nominal_...` and a sample time [s].

    `options` are its noises; None: the usual ones.
    """
    A, b = linearize(nominal_model(nominal))
    M = kalman_gain(A, b, sample_time, options)
    return {**zip_names(kalman_gains(), M.ravel()), "kalman_sample_time": sample_time}


def zip_names(names: Iterable[str], numbers: Iterable[float]) -> dict[str, Value]:
    """Return the numbers as plain floats by their names."""
    return {name: float(number) for name, number in zip(names, numbers, strict=True)}


def controller_start_values(
    design: Design,
    nominal: str | ParameterSet = "ident",
    smc: SlidingMode | None = None,
    changes: Mapping[str, Value] | None = None,
) -> dict[str, Value]:
    """Return the start values of the controller FMU for a design and a parameter set, given or named, as nominal model.

    `changes` replace values and decide what follows from them: the Kalman filter's gain, the capture level. The nominal
    model has no dry friction.
    """
    changes = changes or {}
    known = INTERFACE.start_values(changes)
    model = nominal_values(parameter_set(nominal).parameters)
    model = {name: known[name] if name in changes else value for name, value in model.items()}
    values = design_values(design, smc, float(known["voltage_limit"])) | model
    return {**values, **kalman_values(model, float(known["sample_time"])), **changes}
