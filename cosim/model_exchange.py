"""One instance of an FMI 2.0 FMU for model exchange, held in continuous-time mode and asked for its derivatives."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import fmpy.fmi2
import numpy as np
from fmpy.model_description import ModelDescription, ScalarVariable

from .errors import UserError
from .fmu import FmuError, Instance, Strict, Value, describe_any

Array = np.ndarray

_MOST_ITERATIONS = 100


class FMU2StrictModel(Strict, fmpy.fmi2.FMU2Model):
    """FMPy's model, strict; FMPy takes the standard from the class's name."""


@dataclass(eq=False)
class ModelInstance(Instance):
    """A model x' = f(x, u), y = g(x, u): `begin`, then set states and inputs and ask for what follows from them."""

    _library: ClassVar[type[Strict]] = FMU2StrictModel

    def _described(self) -> tuple[str, ModelDescription, str]:
        folder, description = describe_any(self.path)
        if description.modelExchange is None:
            raise UserError(f"{self.path} must be an FMI 2.0 FMU for model exchange, found one for co-simulation only")
        return folder, description, description.modelExchange.modelIdentifier or ""

    def continuous_states(self) -> list[ScalarVariable]:
        """Return the state variables in the order of ModelStructure's derivatives.

        Raises UserError where the structure names what is no derivative of a variable.
        """
        states = []
        for unknown in self.description.derivatives:
            state = None if unknown.variable is None else unknown.variable.derivative
            if state is None or state.type != "Real":
                raise UserError(
                    f"{self.path} is not a valid FMU: its ModelStructure has a derivative of no real variable"
                )
            states.append(state)
        return states

    def begin(self, start: Mapping[str, Value]) -> None:
        """Initialize at t = 0 with start values and enter continuous-time mode."""
        self.start(start, 0.0, None)
        self.run()
        self._settle()

    def states(self, count: int) -> Array:
        """Return the continuous states, shape (count,)."""
        values = (ctypes.c_double * count)()
        self._call("getContinuousStates", self._fmu.getContinuousStates, values, count)
        return np.array(values)

    def set_states(self, x: Array) -> None:
        """Set the continuous states, shape (n,)."""
        values = (ctypes.c_double * len(x))(*x)
        self._call("setContinuousStates", self._fmu.setContinuousStates, values, len(x))

    def set_inputs(self, variables: Sequence[ScalarVariable], u: Array) -> None:
        """Set real inputs; those that are discrete, and only they, make an event."""
        event = any(v.variability != "continuous" for v in variables)
        if event:
            self._call("enterEventMode", self._fmu.enterEventMode)
        self._call("setReal", self._fmu.setReal, [v.valueReference for v in variables], list(map(float, u)))
        if event:
            self._settle()

    def derivatives(self, count: int) -> Array:
        """Return x', shape (count,)."""
        values = (ctypes.c_double * count)()
        self._call("getDerivatives", self._fmu.getDerivatives, values, count)
        return np.array(values)

    def reals(self, variables: Sequence[ScalarVariable]) -> Array:
        """Return the values of real variables."""
        found: list[float] = []
        self._call("getReal", lambda: found.extend(self._fmu.getReal([v.valueReference for v in variables])))
        return np.array(found)

    def directional(self, unknowns: Sequence[int], knowns: Sequence[int]) -> Array:
        """Return the partial derivatives of unknowns by knowns, both value references: a column for each known."""
        J = np.zeros((len(unknowns), len(knowns)))
        for j, known in enumerate(knowns):
            found: list[float] = []
            self._call(
                "getDirectionalDerivative",
                lambda k=known, f=found: f.extend(self._fmu.getDirectionalDerivative(list(unknowns), [k], [1.0])),
            )
            J[:, j] = found
        return J

    def _settle(self) -> None:
        """Iterate events until nothing changes, then enter continuous-time mode."""
        again = [True]
        for _ in range(_MOST_ITERATIONS):
            if not again[0]:
                break
            self._call("newDiscreteStates", lambda: again.__setitem__(slice(None), self._fmu.newDiscreteStates()))
            if again[1]:
                raise FmuError(f"{self.name}: the FMU asks for the end of the simulation at t = 0{self.cause()}")
        else:
            raise FmuError(f"{self.name}: {_MOST_ITERATIONS} event iterations at t = 0 do not come to an end")
        self._call("enterContinuousTimeMode", self._fmu.enterContinuousTimeMode)
