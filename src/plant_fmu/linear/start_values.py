"""What a system puts into the linear plant's FMU: the variables that it shows, and the values of those that it hides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fmu_export.errors import UserError
from fmu_export.units import per_second
from fmu_export.variables import Interface, Value, Variable
from ihc_fmu.arrays import Array
from ihc_fmu.quantity import Quantity
from ihc_fmu.system import System

from .interface import INTERFACE, MOST_INPUTS, MOST_OUTPUTS, MOST_STATES, UNLIMITED, matrix, vector

STOP_TIME = 10.0
"""End of the default experiment [s]."""


def check_size(system: System) -> None:
    """Raise UserError for a system that is larger than the compiled unit."""
    sizes = ((system.n, MOST_STATES, "states"), (system.m, MOST_INPUTS, "inputs"), (system.p, MOST_OUTPUTS, "outputs"))
    for count, most, what in sizes:
        if count > most:
            raise UserError(f"the plant FMU takes at most {most} {what}, found {count} of {system.name}")


def linear_plant_values(system: System) -> dict[str, Value]:
    """Return the values of what an export hides, by compiled names: sizes, A, B, C and the equilibrium.

    Raises UserError as `check_size`.
    """
    check_size(system)
    values: dict[str, Value] = {"state_count": system.n, "input_count": system.m, "output_count": system.p}
    for stem, M in (("A", system.A), ("B", system.B), ("C", np.asarray(system.C))):
        names = [name for row in matrix(stem, *M.shape) for name in row]
        values |= dict(zip(names, M.ravel().tolist(), strict=True))
    for stem, v in (("state", system.x_eq), ("input", system.u_eq), ("output", system.y_eq)):
        numbers = np.asarray(v).tolist()
        values |= dict(zip(vector(f"{stem}_equilibrium", len(numbers)), numbers, strict=True))
    return values


def shown_interface(system: System) -> Interface:
    """Return the interface of the FMU of `system`: its inputs, outputs and states by their names, with their units.

    A state that an output has the name of is shown as `<state>_true`. Raises UserError as `check_size`, and where a name of
    the system is one that the FMU gives to something else.
    """
    check_size(system)
    measured = {q.name for q in system.outputs}
    true = [q._replace(name=f"{q.name}_true") if q.name in measured else q for q in system.states]
    rates = [Quantity(f"{q.name}_derivative", per_second(q.unit)) for q in system.states]
    x_eq, lower, upper, resolutions = (
        _bounded(v) for v in (system.x_eq, system.lower, system.upper, system.resolutions)
    )
    offsets = [q._replace(unit="1") for q in system.outputs]
    groups = (
        _shown("input", system.inputs, "", "input, limited before it acts"),
        _shown("disturbance", system.inputs, "_disturbance", "disturbance, added to {} before its limits"),
        _shown("output", system.outputs, "", "measured output"),
        _shown("state", true, "", "true state"),
        _shown("initial_state", system.states, "_0", "initial value of {}", x_eq),
        _shown("lower", system.inputs, "_lower", "lower limit of {}; -1.797...e308: none", lower),
        _shown("upper", system.inputs, "_upper", "upper limit of {}; 1.797...e308: none", upper),
        _shown("resolution", system.outputs, "_resolution", "step in which {} is counted; 0: none", resolutions),
        _shown("resolution_offset", offsets, "_resolution_offset", "where inside a step the sensor of {} was zeroed"),
        _shown("bias", system.outputs, "_bias", "bias of the sensor of {}, added before it counts"),
        _shown("derivative", rates, "", "derivative of the state under the inputs of the last step"),
    )
    unused = _unused(system)
    return INTERFACE.showing(
        (
            replace(v, initial_dependencies=tuple(d for d in v.initial_dependencies if (v.compiled, d) not in unused))
            for group in groups
            for v in group
        ),
        name=f"{system.name}_linear_plant",
        description=f"linear plant of {system.name}, exact under held inputs",
        step_size=system.sample_time,
        stop_time=STOP_TIME,
    )


def _shown(
    stem: str, quantities: Sequence[Quantity], ending: str, description: str, starts: Sequence[float] | None = None
) -> list[Variable]:
    """Return the compiled variables STEM_1, ... as those of `quantities`; {} in `description` is a quantity's name."""
    made = [
        INTERFACE.by_name[name].shown_as(quantity.name + ending, description.format(quantity.name), quantity.unit)
        for name, quantity in zip(vector(stem, len(quantities)), quantities, strict=True)
    ]
    return made if starts is None else [replace(v, start=start) for v, start in zip(made, starts, strict=True)]


def _bounded(numbers: Array | None) -> list[float]:
    return [min(UNLIMITED, max(-UNLIMITED, float(number))) for number in np.asarray(numbers)]


def _unused(system: System) -> set[tuple[str, str]]:
    """Return (variable, initial state) where a matrix has 0 for their relation."""
    unused = set()
    for stem, M in (("output", system.C), ("derivative", system.A)):
        for i, j in np.argwhere(np.asarray(M) == 0.0):
            unused.add((f"{stem}_{i + 1}", f"initial_state_{j + 1}"))
    return unused
