"""The signals of a scenario on the controller's inputs: computed and checked before a run, looked up in it."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence

import numpy as np

from ..errors import UserError
from ..evaluation import ARM_SET_POINT
from ..fmu import Instance
from ..room import check_memory
from ..start_values import as_value
from ..structure import Signal
from ..wiring import CONTROLLER
from .guards import Limits

BYTES = 40
"""Memory for each value of a signal: a number, its place in a list, and in the table."""

Driven = Mapping[str, Sequence[float]]
"""The values of the controller's driven inputs by their names, one for each sample."""


def names_of(targets: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the controller's inputs among `targets`, `component.variable` each."""
    return tuple(t.removeprefix(f"{CONTROLLER}.") for t in targets if t.startswith(f"{CONTROLLER}."))


def values_of(signals: Sequence[Signal], period: float, count: int) -> Driven:
    """Return the signals' values at t_k = k `period` [s], k = 0 ... `count` - 1, the same that a simulation has.

    Raises UserError where there is no room for them.
    """
    if signals:
        check_memory("the values of the signals", BYTES * count * len(signals), "a shorter duration would do")
    tables = [signal.ahead(0.0, period, 0, count) for signal in signals]
    arrays = [array("q" if isinstance(table[0], int) else "d", table) for table in tables]
    return dict(zip(names_of([signal.target for signal in signals]), arrays, strict=True))


def notable(values: Driven) -> list[int]:
    """Return the numbers of the samples with each input's smallest and largest value; of the first one that is no number."""
    return sorted({int(find(table)) for table in values.values() for find in (np.argmin, np.argmax)})


def check(values: Driven, instance: Instance, limits: Limits, period: float) -> None:
    """Raise UserError for a value that an input may not have, and for an arm sent to where the guards warn of it."""
    for k in notable(values):
        for name, table in values.items():
            variable, value = instance.variables[name], table[k]
            try:
                as_value(variable, bool(value) if variable.type == "Boolean" and value in (0, 1) else value)
            except UserError as error:
                raise UserError(f"the signal on {CONTROLLER}.{error} at {k * period:g} s") from None
            if name == ARM_SET_POINT and abs(value) > limits.arm_warning:
                most, angle = math.degrees(limits.arm_warning), math.degrees(value)
                raise UserError(
                    f"the signal on {CONTROLLER}.{name} must stay within ±{most:.0f}°, beyond which a run warns of the arm, "
                    f"found {angle:.0f}° at {k * period:g} s"
                )
