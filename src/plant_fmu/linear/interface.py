"""The compiled variables of the unit `LinearPlant`: one table of the largest size, with neutral names, for every model.

An export shows the variables that its model has, under the model's own names: see `start_values.shown_interface`.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

import sys

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


def _each(
    stem: str, count: int, causality: str, description: str, start: Value | None = None, **rest: object
) -> list[Variable]:
    fixed = {"variability": "fixed"} if causality == "parameter" else {}
    return [Variable(name, causality, description, start=start, **fixed, **rest) for name in vector(stem, count)]  # type: ignore[arg-type]


def _size(name: str, most: int, what: str) -> Variable:
    return Variable(
        name, "parameter", f"number of {what}", type="Integer", variability="fixed", start=1, min=1, max=most
    )


def _entries(stem: str, rows: int, columns: int, description: str, first: float) -> list[Variable]:
    return [
        Variable(
            name,
            "parameter",
            description,
            variability="fixed",
            start=first if name == f"{stem}_1_1" else 0.0,
        )
        for row in matrix(stem, rows, columns)
        for name in row
    ]


INTERFACE = Interface(
    name="LinearPlant",
    description="linear plant with limited inputs and counting sensors, exact under held inputs",
    variables=(
        *_each("input", MOST_INPUTS, "input", "input, limited before it acts", 0.0),
        *_each("disturbance", MOST_INPUTS, "input", "disturbance, added to the input behind its limits", 0.0),
        *_each("output", MOST_OUTPUTS, "output", "measured output"),
        *_each("state", MOST_STATES, "output", "true state"),
        _size("state_count", MOST_STATES, "states"),
        _size("input_count", MOST_INPUTS, "inputs"),
        _size("output_count", MOST_OUTPUTS, "outputs"),
        *_entries("A", MOST_STATES, MOST_STATES, "system matrix", 0.0),
        *_entries("B", MOST_STATES, MOST_INPUTS, "input matrix", 1.0),
        *_entries("C", MOST_OUTPUTS, MOST_STATES, "output matrix", 1.0),
        *_each("state_equilibrium", MOST_STATES, "parameter", "state about which the model is linear", 0.0),
        *_each("input_equilibrium", MOST_INPUTS, "parameter", "input that holds the equilibrium", 0.0),
        *_each("output_equilibrium", MOST_OUTPUTS, "parameter", "output at the equilibrium", 0.0),
        *_each("initial_state", MOST_STATES, "parameter", "initial value", 0.0),
        *_each("lower", MOST_INPUTS, "parameter", "lower limit; -1.797...e308: none", -UNLIMITED),
        *_each("upper", MOST_INPUTS, "parameter", "upper limit; 1.797...e308: none", UNLIMITED),
        *_each("resolution", MOST_OUTPUTS, "parameter", "step of the counting sensor; 0: none", 0.0, min=0.0),
        *_each(
            "resolution_offset",
            MOST_OUTPUTS,
            "parameter",
            "where inside a step the sensor was zeroed; 0.5 rounds to the nearest",
            0.5,
            min=0.0,
            max=1.0,
        ),
        *_each("bias", MOST_OUTPUTS, "parameter", "bias of the sensor, added before it counts", 0.0),
        *_each("derivative", MOST_STATES, "local", "derivative of the state under the inputs of the last step"),
    ),
    step_size=1e-3,
    stop_time=1.0,
    variable_step=True,
)
