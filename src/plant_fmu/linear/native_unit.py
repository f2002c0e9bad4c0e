"""The linear plant in C, and its structure for model exchange.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fmu_export.model_description import ModelExchange
from fmu_export.native_unit import NativeUnit
from fmu_export.variables import Value

from ..integrator import LEAST
from .exponential import BALANCING_SWEEPS, DEGREE, MOST_DOUBLINGS
from .interface import INTERFACE, MOST_INPUTS, MOST_OUTPUTS, MOST_STATES, matrix, vector
from .unit import LinearPlantUnit


def model_exchange(start: Mapping[str, Value]) -> ModelExchange:
    """Return the structure of an FMU with these start values, exact for its matrices."""
    n, m, p = (int(start[name]) for name in ("state_count", "input_count", "output_count"))
    states, derivatives, outputs = vector("state", n), vector("derivative", n), vector("output", p)

    def known(entries: list[str], stem: str) -> list[str]:
        """Return STEM_j for each entry of a row that is not 0."""
        return [name for entry, name in zip(entries, vector(stem, len(entries)), strict=True) if start[entry] != 0.0]

    dependencies: dict[str, tuple[str, ...]] = {v.name: () for v in INTERFACE.calculated}
    dependencies |= {name: (name,) for name in states}
    dependencies |= {name: tuple(known(row, "state")) for name, row in zip(outputs, matrix("C", p, n), strict=True)}
    initial: dict[str, tuple[str, ...]] = {}
    for name, of_state, of_input in zip(derivatives, matrix("A", n, n), matrix("B", n, m), strict=True):
        inputs = [*known(of_input, "input"), *known(of_input, "disturbance")]
        dependencies[name] = (*inputs, *known(of_state, "state"))
        initial[name] = (*inputs, *known(of_input, "lower"), *known(of_input, "upper"))
    return ModelExchange(tuple(states), tuple(derivatives), dependencies, initial)


def _largest() -> ModelExchange:
    """Return the structure of a model of the largest size in which everything depends on everything."""
    return model_exchange({v.name: v.max if v.type == "Integer" else 1.0 for v in INTERFACE.of("parameter")})  # type: ignore[misc]


NATIVE = NativeUnit(
    interface=INTERFACE,
    twin=LinearPlantUnit,
    folder=Path(__file__).parents[1] / "native",
    stem="linear_plant",
    prefix="linear",
    common=("linear_exponential.c", "linear_exponential.h"),
    model_exchange=model_exchange,
    largest_model_exchange=_largest(),
    constants={
        "LINEAR_STATES": MOST_STATES,
        "LINEAR_INPUTS": MOST_INPUTS,
        "LINEAR_OUTPUTS": MOST_OUTPUTS,
        "LINEAR_DEGREE": DEGREE,
        "LINEAR_BALANCING_SWEEPS": BALANCING_SWEEPS,
        "LINEAR_MOST_DOUBLINGS": MOST_DOUBLINGS,
        "LINEAR_LEAST": LEAST,
    },
)
