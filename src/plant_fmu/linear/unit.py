"""The linear plant as a unit that is stepped, exact under held inputs.

Standard library only: the unit's step code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

from fmu_export.errors import UserError
from fmu_export.variables import Value

from ..integrator import flushed
from ..sensors import counted
from .exponential import Matrix, held_input
from .interface import MOST_INPUTS, MOST_OUTPUTS, MOST_STATES, matrix, vector

Vector = tuple[float, ...]


class LinearPlantUnit:
    """x' = A (x - x_eq) + B w, y = y_eq + C (x - x_eq), between two communication points.

    w = min(upper, max(lower, u + d)) - u_eq is held over a step: u are the inputs, d the disturbances. Measured is
    r floor((y + bias)/r + offset), r the resolution, or y + bias where r is 0. At the start w is 0.

    `values` maps every parameter of the compiled interface to its value. Raises UserError where they contradict each other.
    """

    def __init__(self, values: Mapping[str, Value]) -> None:
        n, m, p = (int(values[name]) for name in ("state_count", "input_count", "output_count"))

        def row(names: Sequence[str]) -> Vector:
            return tuple(float(values[name]) for name in names)

        self.A = [row(names) for names in matrix("A", n, n)]
        self.B = [row(names) for names in matrix("B", n, m)]
        self.C = [row(names) for names in matrix("C", p, n)]
        self.x_eq, self.x = row(vector("state_equilibrium", n)), row(vector("initial_state", n))
        self.u_eq, self.y_eq = row(vector("input_equilibrium", m)), row(vector("output_equilibrium", p))
        self.lower, self.upper = row(vector("lower", m)), row(vector("upper", m))
        self.resolution, self.offset = row(vector("resolution", p)), row(vector("resolution_offset", p))
        self.bias = row(vector("bias", p))
        self.w: Vector = (0.0,) * m
        self.held_step = 0.0  # [s], of which E and G are
        self.E: Matrix = []
        self.G: Matrix = []
        for j, (lower, upper) in enumerate(zip(self.lower, self.upper, strict=True), start=1):
            if lower > upper:
                raise UserError(f"lower_{j} must not exceed upper_{j}, found {lower:g} and {upper:g}")

    def initialize(self, time: float, inputs: tuple[float, ...]) -> list[str]:
        """Check the outputs; nothing depends on the first inputs. Raises ArithmeticError for numbers beyond reason."""
        if not all(map(isfinite, self.outputs())):
            raise ArithmeticError(f"start values must give finite outputs, found x = ({_list(self.x)})")
        return []

    def step(self, time: float, step: float, inputs: tuple[float, ...]) -> list[str]:
        """Advance from `time` by `step` [s] with `inputs`, all the interface's inputs and disturbances, held.

        Returns messages for the log (none). Raises UserError for inputs that are not finite and for a step that is too long
        to be computed, and ArithmeticError where states or outputs stop being finite; the unit is then as it was.
        """
        w = self._acting(inputs)
        E, G = (self.E, self.G) if step == self.held_step else held_input(self.A, self.B, step)
        deviation = self._deviation(self.x)
        x = tuple([flushed(x + _change(row, held, deviation, w)) for x, row, held in zip(self.x, E, G, strict=True)])
        if not all(map(isfinite, self._outputs(x, w))):
            raise ArithmeticError(f"the state left the range of numbers, x = ({_list(self.x)}) before the step")
        self.x, self.w, self.held_step, self.E, self.G = x, w, step, E, G
        return []

    def outputs(self) -> tuple[float, ...]:
        """Return outputs and local variables in the order of the compiled interface, 0 for those that the model has not."""
        return self._outputs(self.x, self.w)

    def get_state(self) -> dict[str, Any]:
        """Return everything that changes during a run, as JSON types; E and G follow from the next step's length."""
        return {"x": list(self.x), "w": list(self.w)}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore what `get_state` returned."""
        self.x, self.w = tuple(state["x"]), tuple(state["w"])

    def _acting(self, inputs: Sequence[float]) -> Vector:
        """Return w for the inputs and disturbances."""
        made = []
        for j, (lower, upper, u_eq) in enumerate(zip(self.lower, self.upper, self.u_eq, strict=True)):
            u, d = inputs[j], inputs[MOST_INPUTS + j]
            w = min(upper, max(lower, u + d)) - u_eq
            if not (isfinite(u + d) and isfinite(w)):
                raise UserError(
                    f"inputs must be finite, found input_{j + 1}, disturbance_{j + 1} = ({u:.17g}, {d:.17g})"
                )
            made.append(flushed(w))
        return tuple(made)

    def _deviation(self, x: Vector) -> Vector:
        return tuple([x - x_eq for x, x_eq in zip(x, self.x_eq, strict=True)])

    def _outputs(self, x: Vector, w: Vector) -> Vector:
        deviation = self._deviation(x)
        measured = [
            counted(y_eq + _change(row, (), deviation, ()) + bias, resolution, offset)
            for y_eq, row, bias, resolution, offset in zip(
                self.y_eq, self.C, self.bias, self.resolution, self.offset, strict=True
            )
        ]
        rates = [_change(row, held, deviation, w) for row, held in zip(self.A, self.B, strict=True)]
        return (*_padded(measured, MOST_OUTPUTS), *_padded(x, MOST_STATES), *_padded(rates, MOST_STATES))


def _change(row: Sequence[float], held: Sequence[float], deviation: Vector, w: Vector) -> float:
    """Return row' deviation + held' w, added from the first to the last term."""
    total = 0.0
    for factor, entry in zip(row, deviation, strict=True):
        total += factor * entry
    for factor, entry in zip(held, w, strict=True):
        total += factor * entry
    return total


def _padded(values: Sequence[float], count: int) -> Vector:
    return (*values, *(0.0,) * (count - len(values)))


def _list(x: Vector) -> str:
    return ", ".join(f"{value:.9g}" for value in x)
