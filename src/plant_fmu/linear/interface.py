"""The compiled variables of the unit `LinearPlant`: one table of the largest size, with neutral names, for every model.

An export shows the variables that its model has, under the model's own names: see `start_values.shown_interface`.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

import sys
from typing import Any

from fmu_export.variables import Interface, Value, Variable

MOST_STATES, MOST_INPUTS, MOST_OUTPUTS = 16, 8, 16

UNLIMITED = sys.float_info.max
"""An input's limit of this size, or minus it, is none."""


def vector(stem: str, count: int) -> list[str]:
    """Return STEM_1, ..., STEM_count."""
    return [f"{stem}_{i}" for i in range(1, count + 1)]


def matrix(stem: str, rows: int, columns: int) -> list[list[str]]:
    """Return the names STEM_i_j of a matrix's entries, row by row."""
    return [vector(f"{stem}_{i}", columns) for i in range(1, rows + 1)]


_STATES = vector("initial_state", MOST_STATES)


def _inputs(stem: str, description: str) -> list[Variable]:
    return [Variable(name, "input", description, start=0.0) for name in vector(stem, MOST_INPUTS)]


def _outputs() -> list[Variable]:
    known = ("state_count", "output_count", *_STATES, *vector("state_equilibrium", MOST_STATES))
    own = ("output_equilibrium", "resolution", "resolution_offset", "bias")
    return [
        Variable(
            f"output_{i}",
            "output",
            "measured output",
            initial_dependencies=(*known, *row, *(f"{stem}_{i}" for stem in own)),
        )
        for i, row in enumerate(matrix("C", MOST_OUTPUTS, MOST_STATES), start=1)
    ]


def _states() -> list[Variable]:
    return [
        Variable(f"state_{i}", "output", "true state", initial_dependencies=("state_count", f"initial_state_{i}"))
        for i in range(1, MOST_STATES + 1)
    ]


def _derivatives() -> list[Variable]:
    known = ("state_count", *_STATES, *vector("state_equilibrium", MOST_STATES))
    return [
        Variable(
            f"derivative_{i}",
            "local",
            "derivative of the state under the inputs of the last step",
            initial_dependencies=(*known, *row),
        )
        for i, row in enumerate(matrix("A", MOST_STATES, MOST_STATES), start=1)
    ]


def _fixed(name: str, description: str, start: Value, **rest: Any) -> Variable:
    return Variable(name, "parameter", description, variability="fixed", start=start, **rest)


def _size(name: str, most: int, what: str) -> Variable:
    return _fixed(name, f"number of {what}", 1, type="Integer", min=1, max=most)


def _each(stem: str, count: int, description: str, start: Value, **rest: Any) -> list[Variable]:
    return [_fixed(name, description, start, **rest) for name in vector(stem, count)]


def _entries(stem: str, rows: int, columns: int, description: str, first: float) -> list[Variable]:
    names = [name for row in matrix(stem, rows, columns) for name in row]
    return [_fixed(name, description, first if i == 0 else 0.0) for i, name in enumerate(names)]


INTERFACE = Interface(
    name="LinearPlant",
    description="linear plant with limited inputs and counting sensors, exact under held inputs",
    variables=(
        *_inputs("input", "input, limited before it acts"),
        *_inputs("disturbance", "disturbance, added to the input before its limits"),
        *_outputs(),
        *_states(),
        _size("state_count", MOST_STATES, "states"),
        _size("input_count", MOST_INPUTS, "inputs"),
        _size("output_count", MOST_OUTPUTS, "outputs"),
        *_entries("A", MOST_STATES, MOST_STATES, "system matrix", 0.0),
        *_entries("B", MOST_STATES, MOST_INPUTS, "input matrix", 1.0),
        *_entries("C", MOST_OUTPUTS, MOST_STATES, "output matrix", 1.0),
        *_each("state_equilibrium", MOST_STATES, "state about which the model is linear", 0.0),
        *_each("input_equilibrium", MOST_INPUTS, "input that holds the equilibrium", 0.0),
        *_each("output_equilibrium", MOST_OUTPUTS, "output at the equilibrium", 0.0),
        *_each("initial_state", MOST_STATES, "initial value", 0.0),
        *_each("lower", MOST_INPUTS, "lower limit; -1.797...e308: none", -UNLIMITED),
        *_each("upper", MOST_INPUTS, "upper limit; 1.797...e308: none", UNLIMITED),
        *_each("resolution", MOST_OUTPUTS, "step of the counting sensor; 0: none", 0.0, min=0.0),
        *_each(
            "resolution_offset",
            MOST_OUTPUTS,
            "where inside a step the sensor was zeroed; 0.5 rounds to the nearest",
            0.5,
            min=0.0,
            max=1.0,
        ),
        *_each("bias", MOST_OUTPUTS, "bias of the sensor, added before it counts", 0.0),
        *_derivatives(),
    ),
    step_size=1e-3,
    stop_time=1.0,
    variable_step=True,
)
