"""One instance of an FMI 2.0 FMU for model exchange, held in continuous-time mode and asked for its derivatives."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NoReturn

import fmpy.fmi2
import numpy as np
from fmpy.model_description import ScalarVariable

from .errors import UserError
from .fmu import FmuError, Instance, Strict
from .start_values import StartValue

Array = np.ndarray

_MOST_ITERATIONS = 100


class FMU2StrictModel(Strict, fmpy.fmi2.FMU2Model):
    """FMPy's model, strict; FMPy takes the standard from the class's name."""


@dataclass(eq=False)
class ModelInstance(Instance):
    """A model x' = f(x, u), y = g(x, u): `begin`, then set states and inputs and ask for what follows from them."""

    _library: ClassVar[type[Strict]] = FMU2StrictModel

    def _identifier(self) -> str:
        if self.description.modelExchange is None:
            raise UserError(f"{self.path} must be an FMI 2.0 FMU for model exchange, found one for co-simulation only")
        return self.description.modelExchange.modelIdentifier or ""

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

    def begin(self, start: Mapping[str, StartValue]) -> None:
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
        return np.array(self._call("getReal", self._fmu.getReal, [v.valueReference for v in variables]))

    def directional(self, unknowns: Sequence[int], knowns: Sequence[int]) -> Array:
        """Return the partial derivatives of unknowns by knowns, both value references: a column for each known."""
        J = np.zeros((len(unknowns), len(knowns)))
        for j, known in enumerate(knowns):
            derivative = self._fmu.getDirectionalDerivative
            J[:, j] = self._call("getDirectionalDerivative", derivative, list(unknowns), [known], [1.0])
        return J

    def update(self, time: float) -> float:
        """Iterate the events of the present `time` [s] until nothing changes; return the time of the next event, or inf."""
        for _ in range(_MOST_ITERATIONS):
            again, ends, _, _, defined, at = self._call("newDiscreteStates", self._fmu.newDiscreteStates)
            if ends:
                self.refuse_end(time)
            if not again:
                return at if defined else math.inf
        raise FmuError(f"{self.name}: {_MOST_ITERATIONS} event iterations at t = {time:g} s do not come to an end")

    def refuse_end(self, time: float) -> NoReturn:
        """Raise FmuError for an FMU that asks for the end of the simulation."""
        raise FmuError(f"{self.name}: the FMU asks for the end of the simulation at t = {time:g} s{self.cause()}")

    def _settle(self) -> None:
        """Make the events at t = 0, then enter continuous-time mode."""
        self.update(0.0)
        self._call("enterContinuousTimeMode", self._fmu.enterContinuousTimeMode)
