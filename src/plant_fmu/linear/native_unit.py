"""The linear plant in C, and its structure for model exchange.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from fmu_export.model_description import ModelExchange
from fmu_export.native_unit import NativeUnit
from fmu_export.variables import Value

from .interface import INTERFACE, MOST_INPUTS, MOST_OUTPUTS, MOST_STATES, matrix, vector
from .unit import LinearPlantUnit

Pattern = list[list[bool]]
"""Which entries of a matrix are not 0."""


def _structure(n: int, m: int, p: int, A: Pattern, B: Pattern, C: Pattern) -> ModelExchange:
    states, derivatives, outputs = vector("state", n), vector("derivative", n), vector("output", p)
    inputs, disturbances = vector("input", m), vector("disturbance", m)
    lower, upper = vector("lower", m), vector("upper", m)
    of_state = {name: tuple(_where(row, states)) for name, row in zip(derivatives, A, strict=True)}
    of_input = {
        name: tuple(x for names in (inputs, disturbances) for x in _where(row, names))
        for name, row in zip(derivatives, B, strict=True)
    }
    limits = {
        name: tuple(x for names in (lower, upper) for x in _where(row, names))
        for name, row in zip(derivatives, B, strict=True)
    }
    dependencies = {name: tuple(_where(row, states)) for name, row in zip(outputs, C, strict=True)}
    dependencies |= {name: (name,) for name in states}
    dependencies |= {name: (*of_input[name], *of_state[name]) for name in derivatives}
    return ModelExchange(
        tuple(states),
        tuple(derivatives),
        dependencies,
        {name: (*of_input[name], *limits[name]) for name in derivatives},
    )


def _where(row: Iterable[bool], names: Iterable[str]) -> list[str]:
    return [name for name, there in zip(names, row, strict=True) if there]


def _full(rows: int, columns: int) -> Pattern:
    return [[True] * columns for _ in range(rows)]


def model_exchange(start: Mapping[str, Value]) -> ModelExchange:
    """Return the structure of an FMU with these start values, exact for its matrices."""
    n, m, p = (int(start[name]) for name in ("state_count", "input_count", "output_count"))
    A, B, C = (
        [[start[name] != 0.0 for name in row] for row in matrix(stem, rows, columns)]
        for stem, rows, columns in (("A", n, n), ("B", n, m), ("C", p, n))
    )
    return _structure(n, m, p, A, B, C)


NATIVE = NativeUnit(
    interface=INTERFACE,
    twin=LinearPlantUnit,
    folder=Path(__file__).parents[1] / "native",
    stem="linear_plant",
    prefix="linear",
    parts=("linear_exponential",),
    model_exchange=model_exchange,
    largest_model_exchange=_structure(
        MOST_STATES,
        MOST_INPUTS,
        MOST_OUTPUTS,
        _full(MOST_STATES, MOST_STATES),
        _full(MOST_STATES, MOST_INPUTS),
        _full(MOST_OUTPUTS, MOST_STATES),
    ),
)
