"""A plant's FMU as a function of z = (x, u), its states and inputs; for model exchange the FMU itself is that function."""

from __future__ import annotations

import math
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.model_description import ScalarVariable

from .derivative_checks import NOTABLE_ERROR, check_contradiction, check_smooth, relative
from .derivatives import EvaluationError, Jacobian, differences, jacobian
from .errors import UserError
from .fmu import FmuError
from .fmu_files import describe
from .model_exchange import ModelInstance
from .plant_model import LinearModel, reduced
from .plant_variables import bound_of, index_of, nominal_of, quantities, real_inputs, real_outputs, start_of
from .start_values import StartValue

Array = np.ndarray


@dataclass(frozen=True, slots=True)
class Taking:
    """The variables of a plant that take part."""

    states: tuple[ScalarVariable, ...]
    inputs: tuple[ScalarVariable, ...]
    outputs: tuple[ScalarVariable, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CoarseModel:
    """x' = rates + A x + B u, y = C x + D u for deviations x, u as large as the `widths` that it was found with.

    A (n, n), B (n, m), C (p, n), D (p, m), `rates` (n,) where x = 0 and u = 0. `smooth` (p,): whether an output changes by
    about as much to both sides, which a sensor that counts coarsely does not.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    rates: Array
    smooth: Array


UNEVEN = 0.3
"""By which part of its largest change an output may change otherwise to the other side and be called smooth."""


def outputs_told(J: Array, skew: Array, widths: Array) -> tuple[Array, Array]:
    """Return rows of `differences`, with 0 for changes that are no more than uneven sides, and which rows are smooth."""
    changes, uneven = np.abs(J) * widths, (skew * widths).max(axis=1, keepdims=True, initial=0.0)
    smooth = uneven[:, 0] <= UNEVEN * changes.max(axis=1, initial=0.0)
    return np.where(changes <= 2.0 * uneven, 0.0, J), smooth


class Plant(ABC):
    """An FMU as a function of z = (x, u)."""

    def __init__(self, path: Path, names: Taking, start: dict[str, StartValue]) -> None:
        self.path, self.start = path, start
        self.variables = {v.name: v for v in describe(path).modelVariables}
        self.states, self.inputs, self.outputs = names.states, names.inputs, names.outputs
        self.n, self.m = len(self.states), len(self.inputs)
        self.names = [v.name for v in (*self.states, *self.inputs)]
        self.interrupt: list[int] = []
        self.deadline = math.inf

    def sizes(self, z: Array) -> Array:
        """Return the magnitudes of states and inputs: nominal attributes, 1 without, or the values where larger."""
        return np.maximum([nominal_of(v) for v in (*self.states, *self.inputs)], np.abs(z))

    def look(self) -> None:
        """Raise KeyboardInterrupt where Ctrl-C has been collected in `interrupt`: between an FMU's calls, not in them.

        Raises EvaluationError after the `deadline` [s, of time.monotonic].
        """
        if self.interrupt:
            raise KeyboardInterrupt
        if time.monotonic() > self.deadline:
            raise EvaluationError("it takes too long")

    @abstractmethod
    def begin(self) -> Array:
        """Return z of the start values; raises FmuError where the FMU fails."""

    @abstractmethod
    def rates(self, z: Array) -> Array:
        """Return x' for the search for an equilibrium; raises EvaluationError."""

    @abstractmethod
    def rates_jacobian(self, z: Array) -> Array:
        """Return the derivatives of `rates`, shape (n, n + m)."""

    @abstractmethod
    def linear(self, z: Array, notes: list[str]) -> LinearModel:
        """Return the linear model about z."""

    @abstractmethod
    def coarse(self, z: Array, widths: Array, span: float) -> CoarseModel:
        """Return the model about z from one pair of differences for each entry, as far from z as `widths`.

        `span` [s]: in which the states change by a small part, for co-simulation. Raises EvaluationError, and UserError
        where the states do not describe the FMU.
        """

    @abstractmethod
    def close(self) -> None:
        """Free what the FMU holds."""

    def _counting(self, C: Array) -> list[str]:
        """Return what to do about outputs that do not change because they are counted, as the linear plants name it."""
        advice = []
        for output, row in zip(self.outputs, C, strict=True):
            resolution = self.variables.get(f"{output.name}_resolution")
            if row.any() or resolution is None or resolution.causality != "parameter":
                continue
            value = self.start.get(resolution.name, start_of(resolution))
            true = f"{output.name}_true"
            other = f", or take --output {true}" if true in self.variables else ""
            if value:
                advice.append(
                    f"{output.name} is counted ({resolution.name} = {value:g}): --set {resolution.name}=0{other}"
                )
        return advice

    def model(self, z: Array, matrices: tuple[Array, ...], y: Array, notes: list[str], **rest: Any) -> LinearModel:
        """Return the model with names, units and limits; outputs that are states have exactly their rows and values."""
        A, B, C, D = matrices
        names = self.names[: self.n]
        for i, output in enumerate(self.outputs):
            if output.name in names:
                j = names.index(output.name)
                C[i], D[i], y[i] = np.eye(self.n)[j], 0.0, z[j]
        return LinearModel(
            name=identifier(self.path.stem),
            **{"A": A, "B": B, "C": C, "D": D, "x_eq": z[: self.n], "u_eq": z[self.n :], "y_eq": y},
            states=quantities(self.states),
            inputs=quantities(self.inputs),
            outputs=quantities(self.outputs),
            residual=self.rates(z),
            notes=(*notes, *_blind(self.outputs, C), *self._counting(C)),
            lower=np.array([bound_of(v, "min", -math.inf) for v in self.inputs]),
            upper=np.array([bound_of(v, "max", math.inf) for v in self.inputs]),
            **rest,
        )


class ModelExchangePlant(Plant):
    """x' and y by the FMU itself."""

    def __init__(
        self, path: Path, inputs: tuple[str, ...], outputs: tuple[str, ...], kept: tuple[str, ...], start: Any
    ):
        self._instance = ModelInstance("plant", path)
        start = self._instance.checked_start(start)
        states = self._instance.continuous_states()
        if not states:
            raise UserError(f"{path} has no continuous states")
        self.kept = [index_of(name, [v.name for v in states], "state") for name in kept] or list(range(len(states)))
        names = Taking(
            tuple(states),
            real_inputs(self._instance, inputs),
            real_outputs(self._instance, outputs, [states[i] for i in self.kept]),
        )
        super().__init__(path, names, start)
        self._open = False
        description = self._instance.description
        self._directional = bool(getattr(description.modelExchange, "providesDirectionalDerivative", False))
        self._derivatives = [u.variable.valueReference for u in description.derivatives]  # type: ignore[union-attr]

    def begin(self) -> Array:
        """Return z of the start values; raises FmuError where the FMU fails."""
        self._ready()
        return np.concatenate((self._instance.states(self.n), self._instance.reals(self.inputs)))

    def rates(self, z: Array) -> Array:
        """Return x'; raises EvaluationError."""
        return self._values(z)[: self.n]

    def rates_jacobian(self, z: Array) -> Array:
        """Return the derivatives of `rates`, shape (n, n + m)."""
        if self._directional:
            return self._directional_jacobian(z)[: self.n]
        return jacobian(self.rates, z, self.sizes(z)).J

    def linear(self, z: Array, notes: list[str]) -> LinearModel:
        """Return the linear model about z; `notes` are added to its own."""
        sizes = self.sizes(z)
        rows = [*(f"{v.name}'" for v in self.states), *(v.name for v in self.outputs)]
        numeric = jacobian(self._values, z, sizes)
        J, error = numeric.J, numeric.error
        if self._directional:
            J = self._directional_jacobian(z)
            check_contradiction(J, numeric, sizes, rows, self.names, self._counting(J[self.n :, : self.n]))
            error = np.where(np.isfinite(numeric.error), np.abs(J - numeric.J), 0.0)
            check_smooth(Jacobian(J, error, numeric.kink), sizes, rows, self.names)
        else:
            check_smooth(numeric, sizes, rows, self.names)
            J = np.where(np.abs(J) <= error, 0.0, J)
        worst = float(relative(error, J, sizes).max(initial=0.0))
        method = "directional derivatives, checked by differences" if self._directional else "differences"
        if worst > NOTABLE_ERROR:
            notes.append(f"the derivatives are known to {worst:.1g} of the largest in a row only")
        A, B = J[: self.n, : self.n], J[: self.n, self.n :]
        y = self._values(z)[self.n :]
        C, D = J[self.n :, : self.n], J[self.n :, self.n :]
        whole = self.model(z, (A, B, C, D), y, notes, error=worst, method=f"model exchange, {method}")
        return reduced(whole, self.kept)

    def coarse(self, z: Array, widths: Array, span: float) -> CoarseModel:
        """Return the model about z, see `Plant.coarse`; all states are in it."""
        n = self.n
        f0, J, skew = differences(self._values, z, widths)
        CD, smooth = outputs_told(J[n:], skew[n:], widths)
        return CoarseModel(J[:n, :n], J[:n, n:], CD[:, :n], CD[:, n:], f0[:n], smooth)

    def close(self) -> None:
        """Free what the FMU holds."""
        self._open = False
        self._instance.close()

    def _ready(self) -> None:
        if not self._open:
            self._instance.begin(self.start)
            self._open = True

    def _set(self, z: Array) -> None:
        self.look()
        self._ready()
        self._instance.set_inputs(self.inputs, z[self.n :])
        self._instance.set_states(z[: self.n])

    def _values(self, z: Array) -> Array:
        """Return (x', y); an FMU that fails is begun anew at the next point."""
        try:
            self._set(z)
            return np.concatenate((self._instance.derivatives(self.n), self._instance.reals(self.outputs)))
        except FmuError as error:
            self.close()
            raise EvaluationError(str(error)) from None

    def _directional_jacobian(self, z: Array) -> Array:
        try:
            self._set(z)
            unknowns = [*self._derivatives, *(v.valueReference for v in self.outputs)]
            J = self._instance.directional(unknowns, [v.valueReference for v in (*self.states, *self.inputs)])
        except FmuError as error:
            self.close()
            raise EvaluationError(str(error)) from None
        if not np.isfinite(J).all():
            raise EvaluationError("a directional derivative is not finite")
        return J


def _blind(outputs: Sequence[ScalarVariable], C: Array) -> list[str]:
    return [
        f"the output {v.name} does not change with the states there, and measures nothing"
        for v, row in zip(outputs, C, strict=True)
        if not row.any()
    ]


def identifier(text: str) -> str:
    """Return the text as a C identifier."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)[:80]
    return name if name[:1].isalpha() else f"plant_{name}"
