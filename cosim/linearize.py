"""A linear model out of any FMI 2.0 FMU: x' = A (x - x_eq) + B (u - u_eq), y - y_eq = C (x - x_eq) + D (u - u_eq).

For model exchange the FMU says x' and y for each x and u; their derivatives are its own directional derivatives, checked
by differences, or the differences where it has none. For co-simulation only, as PythonFMU exports, a state is an output
together with the parameter that sets it at the start. The FMU is then started beside the equilibrium and stepped to
T and 2 T: the map from x and u to x(T) has the derivatives exp(A T) and its input matrix, whose logarithm is A and B,

    [A B; 0 0] T = log [dx(T)/dx  dx(T)/du; 0 I],

and A must be the same for T and 2 T: it is not where a state is missing, and this is told.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from fmu_export.files import FilePath
from ihc_fmu.arguments import as_names

from .derivative_checks import largest
from .derivatives import EvaluationError, finite, least_steps, solve
from .errors import UserError
from .fmu_files import describe
from .interrupts import deferred_interrupt
from .linear_plants import ModelExchangePlant, Plant
from .plant_model import LinearModel, finite_model
from .plant_variables import finite_number, index_of, unit_of
from .start_values import StartValue
from .stepped_plants import CoSimulationPlant

Array = np.ndarray

NEAR = 1e-4
"""A typed state that is so near to an equilibrium, relative to its size, is taken for it."""
REST = 1e-9
"""Largest derivative at an equilibrium, relative to what a change of one size of any variable does to it."""
ROUNDING = 1e-11
"""Numbers at an equilibrium that are so small, relative to their size, are 0."""


def linear_model(
    path: FilePath,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    *,
    states: Sequence[str] = (),
    at: Mapping[str, float] | None = None,
    free: Sequence[str] = (),
    start: Mapping[str, StartValue] | None = None,
    step: float | None = None,
) -> LinearModel:
    """Return the linear model of a plant's FMU about an equilibrium.

    Parameters
    ----------
    path
        The FMU.
    inputs
        Names of the inputs; none: its only real input.
    outputs
        Names of the outputs; none: its states.
    states
        For model exchange those to keep, none: all; for co-simulation "OUTPUT=PARAMETER", or "OUTPUT", whose parameter is
        OUTPUT_0, or itself where its start value can be set (initial = "exact"), none: all real outputs of which that is so.
    at
        States and inputs that stay at a value [their unit] in the search for the equilibrium; other states begin at their
        start values and move, other inputs stay at theirs.
    free
        Inputs that the search may change.
    start
        Start values of the FMU.
    step
        Communication step [s] for co-simulation; None: the FMU's own, or 1 ms.

    Returns
    -------
    LinearModel
        A, B, C, D with names, units, limits, and the equilibrium.

    Raises
    ------
    UserError
        For names that the FMU does not have, where there is no equilibrium, where derivatives do not settle, and for an FMU
        that does not say enough.
    FmuError
        Where it fails at its start values.

    Examples
    --------
    >>> import cosim
    >>> model = cosim.linear_model("fmus/arm_linear_plant.fmu", inputs=["u1"])
    >>> model.A.round(6).tolist()
    [[0.0, 1.0], [4.0, 0.0]]
    """
    free = as_names("free", free)
    plant = open_plant(
        Path(path),
        as_names("inputs", inputs),
        as_names("outputs", outputs),
        as_names("states", states),
        dict(start or {}),
        step,
    )
    quiet = np.errstate(all="ignore")  # numbers beyond the range end in a refusal
    with closing(plant), deferred_interrupt() as plant.interrupt, quiet:
        z, movable, fixed = _beginning(plant, dict(at or {}), free)
        try:
            z, notes = _equilibrium(plant, z, movable, fixed)
            model = finite_model(plant.linear(z, notes))
            plant.look()
            return model
        except EvaluationError as error:
            where = ", ".join(f"{name} = {value:g}" for name, value in zip(plant.names, z, strict=True))
            raise UserError(f"{path} cannot be evaluated near {where}: {error}") from None


def open_plant(
    path: Path,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    states: tuple[str, ...],
    start: Any,
    step: float | None,
) -> Plant:
    """Return the plant, for model exchange where the FMU is and no state names its parameter; raises as `linear_model`."""
    description = describe(path)
    paired = any("=" in name for name in states)
    if description.modelExchange is not None and not paired:
        if step is not None:
            raise UserError("--step is for FMUs that are for co-simulation only, or with --state OUTPUT=PARAMETER")
        return ModelExchangePlant(path, inputs, outputs, states, start)
    return CoSimulationPlant(path, inputs, outputs, states, start, step)


def _beginning(plant: Plant, at: dict[str, float], free: tuple[str, ...]) -> tuple[Array, list[int], dict[int, float]]:
    """Return z that the search begins at, the indices of what it may change, and the values of what stays."""
    z = plant.begin()
    fixed = {index_of(name, plant.names, "state or input"): value for name, value in at.items()}
    for name in free:
        if index_of(name, plant.names, "state or input") in fixed:
            raise UserError(f"{name} cannot be free and stay at {at[name]:g}")
    for j, value in fixed.items():
        z[j] = finite_number(plant.names[j], value)
    moved = {*range(plant.n), *(plant.names.index(name) for name in free)} - fixed.keys()
    return z, sorted(moved), fixed


def _equilibrium(plant: Plant, z: Array, movable: Sequence[int], fixed: Mapping[int, float]) -> tuple[Array, list[str]]:
    """Return z of the equilibrium and what is to be said of it; raises UserError where there is none."""
    equilibrium = _searched(plant, z, movable)
    if _at_rest(plant, equilibrium, plant.rates_jacobian(equilibrium)):
        return equilibrium, []
    near = _searched(plant, z, range(plant.n))
    if _at_rest(plant, near, plant.rates_jacobian(near)) and (np.abs(near - z) <= NEAR * plant.sizes(z)).all():
        return near, _moved(plant, z, near, fixed)
    raise UserError(_no_equilibrium(plant, z, movable, fixed))


def _searched(plant: Plant, z: Array, movable: Sequence[int]) -> Array:
    """Return what the search ends at, with zeros for numbers that are zero but for rounding."""
    solution = solve(plant.rates, plant.rates_jacobian, z, movable, plant.sizes(z))
    rounded = np.where(np.abs(solution) <= ROUNDING * plant.sizes(z), 0.0, solution)
    return rounded if _at_rest(plant, rounded, plant.rates_jacobian(rounded)) else solution


def _at_rest(plant: Plant, z: Array, J: Array) -> bool:
    return bool((np.abs(finite(plant.rates, z)) <= _allowed(plant, z, J)).all())


def _allowed(plant: Plant, z: Array, J: Array) -> Array:
    sizes = plant.sizes(z)
    return np.maximum(REST * largest(J, sizes)[:, 0], 1e-12 * sizes[: plant.n])


def _moved(plant: Plant, z: Array, near: Array, fixed: Iterable[int]) -> list[str]:
    return [
        f"{plant.names[j]} = {z[j]:.10g} is {abs(near[j] - z[j]):.2g} beside the equilibrium, which is taken"
        for j in fixed
        if near[j] != z[j]
    ]


def _no_equilibrium(plant: Plant, z: Array, movable: Sequence[int], fixed: Mapping[int, float]) -> str:
    """Return what keeps the plant from rest at z, where the search began; where it ended derivatives may mean nothing."""
    rates, J = plant.rates(z), plant.rates_jacobian(z)
    worst = int(np.argmax(np.abs(rates) / _allowed(plant, z, J)))
    given = [f"{plant.names[j]} = {value:g}" for j, value in fixed.items()]
    stays = [f"{v.name} = {z[plant.n + j]:g}" for j, v in enumerate(plant.inputs) if plant.n + j not in fixed]
    missing = least_steps(J * plant.sizes(z), rates)
    j = int(np.argmax(np.abs(missing)))
    hint = f"; {plant.names[j]} is what would have to change" if np.abs(missing[j]) > NEAR else ""
    unit = unit_of(plant.states[worst])
    held = [v.name for j, v in enumerate(plant.inputs) if plant.n + j not in {*movable, *fixed}]
    free = f"free an input (--free {shlex.quote(held[0])}), or hold" if held else "hold"
    return (
        f"there is no equilibrium near {', '.join((*given, *stays)) or 'the start values'}: {plant.names[worst]}' "
        f"is {rates[worst]:.4g}{'' if unit == '1' else f' {unit}'}/s where "
        f"the search begins{hint}; {free} other values (--at)"
    )
