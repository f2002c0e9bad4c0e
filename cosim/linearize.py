"""A linear model out of any FMI 2.0 FMU: x' = A (x - x_eq) + B (u - u_eq), y - y_eq = C (x - x_eq) + D (u - u_eq).

For model exchange the FMU says x' and y for each x and u; their derivatives are its own directional derivatives, checked
by differences, or the differences where it has none. For co-simulation only, as PythonFMU exports, a state is an output
together with the parameter that sets it at the start. The FMU is then started beside the equilibrium and stepped to
T and 2 T: the map from x and u to x(T) has the derivatives exp(A T) and its input matrix, whose logarithm is A and B,

    [A B; 0 0] T = log [dx(T)/dx  dx(T)/du; 0 I],

and A must be the same for T and 2 T: it is not where a state is missing, and this is told.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.model_description import ScalarVariable
from scipy.linalg import LinAlgError, logm, matrix_balance

from fmu_export.errors import shown
from fmu_export.variables import did_you_mean
from ihc_fmu.system import Quantity, System

from .derivatives import EvaluationError, Jacobian, finite, jacobian, least_steps, solve
from .errors import UserError
from .fmu import FmuError, Instance, Value, describe_any
from .model_exchange import ModelInstance

Array = np.ndarray

MOST_VARIABLES = 256
"""States, inputs or outputs of a model, at most."""
LARGEST_ERROR = 1e-2
"""Relative to the largest entry of a row, in units of the variables' sizes: beyond, a model is refused."""
NOTABLE_ERROR = 1e-5
"""What is said."""
NEAR = 1e-4
"""A typed state that is so near to an equilibrium, relative to its size, is taken for it."""
REST = 1e-9
"""Largest derivative at an equilibrium, relative to what a change of one size of any variable does to it."""
ROUNDING = 1e-11
"""Numbers at an equilibrium that are so small, relative to their size, are 0."""
ANGLE = 0.2
"""How far the steps in co-simulation go: T times the norm of A."""
MOST_STEPS = 50
NOISE = 1e-8
"""Entries of a matrix found by steps that are so small, relative to the largest of their row, are 0."""
DIGITS = 9
"""Digits that entries of a matrix found by steps have."""
START = "_0"
"""The parameter that sets the output S at the start is S_0 where nothing else is said."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """The linear model of an FMU about an equilibrium; SI or whatever units the FMU has.

    A (n, n), B (n, m), C (p, n), D (p, m); `x_eq`, `u_eq`, `y_eq`; `residual` (n,): x' there. `lower`, `upper` (m,): limits
    that the FMU declares for its inputs. `error`: estimated largest error, relative to the largest entry of its row.
    `method`: how it was found, in words. `notes`: what is to be known of it.
    """

    name: str
    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    x_eq: Array
    u_eq: Array
    y_eq: Array
    residual: Array
    lower: Array
    upper: Array
    error: float
    method: str
    notes: tuple[str, ...]

    def system(self, name: str | None = None, sample_time: float = 1e-3) -> System:
        """Return the model as a System without a gain; raise UserError where an output depends on an input directly."""
        for i, j in np.argwhere(self.D != 0.0):
            raise UserError(
                f"the output {self.outputs[i].name} depends on {self.inputs[j].name} directly (D = {self.D[i, j]:.4g}), "
                "which a controller's model cannot have: leave it out"
            )
        measures_state = self.outputs == self.states
        return System(
            name=name or self.name,
            A=self.A,
            B=self.B,
            C=None if measures_state else self.C,
            states=self.states,
            inputs=self.inputs,
            outputs=() if measures_state else self.outputs,
            lower=self.lower,
            upper=self.upper,
            sample_time=sample_time,
            x_eq=self.x_eq,
            u_eq=self.u_eq,
            y_eq=self.y_eq,
        )


def linear_model(
    path: Path,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    *,
    states: Sequence[str] = (),
    at: Mapping[str, float] | None = None,
    free: Sequence[str] = (),
    start: Mapping[str, Value | str] | None = None,
    step: float | None = None,
) -> LinearModel:
    """Return the linear model of the FMU `path` from `inputs` to `outputs` about an equilibrium.

    `inputs`: none: its only real input. `outputs`: none: its states. `states`: for model exchange those to keep, none: all;
    for co-simulation "OUTPUT=PARAMETER", or "OUTPUT", whose parameter is OUTPUT_0, or itself where its start value can be
    set (initial = "exact"), none: all real outputs of which that is so. `at`: states and inputs that stay at a value [their
    unit] in the search for the equilibrium; other states begin at their start values and move, other inputs stay at theirs
    unless named in `free`. `start`: start values of the FMU. `step`: communication step [s] for co-simulation, none: the
    FMU's own, or 1 ms.

    Raises UserError for names that the FMU does not have, where there is no equilibrium, where derivatives do not settle,
    and for an FMU that does not say enough; FmuError where it fails at its start values.
    """
    plant = _open(path, tuple(inputs), tuple(outputs), tuple(states), dict(start or {}), step)
    with closing(plant), np.errstate(all="ignore"):  # numbers beyond the range end in a refusal
        z, chosen, fixed = _beginning(plant, dict(at or {}), tuple(free))
        try:
            z, notes = _equilibrium(plant, z, chosen, fixed)
            return _finite_model(plant.linear(z, notes))
        except EvaluationError as error:
            where = ", ".join(f"{name} = {value:g}" for name, value in zip(plant.names, z, strict=True))
            raise UserError(f"{path} cannot be evaluated near {where}: {error}") from None


def _finite_model(model: LinearModel) -> LinearModel:
    for M, rows in (
        (model.A, model.states),
        (model.B, model.states),
        (model.C, model.outputs),
        (model.D, model.outputs),
    ):
        for i, _ in np.argwhere(~np.isfinite(M)):
            raise UserError(f"the derivatives of {rows[i].name} are beyond the range of numbers")
    return model


# What an FMU says, by its kind


@dataclass(frozen=True, slots=True)
class _Names:
    """The variables of a plant that take part."""

    states: tuple[ScalarVariable, ...]
    inputs: tuple[ScalarVariable, ...]
    outputs: tuple[ScalarVariable, ...]


class _Plant(ABC):
    """An FMU as a function of z = (x, u)."""

    def __init__(self, path: Path, names: _Names, start: dict[str, Value]) -> None:
        self.path, self.start = path, start
        self.states, self.inputs, self.outputs = names.states, names.inputs, names.outputs
        self.n, self.m = len(self.states), len(self.inputs)
        self.names = [v.name for v in (*self.states, *self.inputs)]

    def sizes(self, z: Array) -> Array:
        """Return the magnitudes of states and inputs: nominal attributes, 1 without, or the values where larger."""
        return np.maximum([_nominal(v) for v in (*self.states, *self.inputs)], np.abs(z))

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
    def close(self) -> None:
        """Free what the FMU holds."""

    def model(self, z: Array, matrices: tuple[Array, ...], y: Array, notes: list[str], **about: Any) -> LinearModel:
        """Return the model with names, units and limits; outputs that are states have exactly their rows and values."""
        A, B, C, D = matrices
        names = self.names[: self.n]
        for i, output in enumerate(self.outputs):
            if output.name in names:
                j = names.index(output.name)
                C[i], D[i], y[i] = np.eye(self.n)[j], 0.0, z[j]
        return LinearModel(
            name=_identifier(self.path.stem),
            **{"A": A, "B": B, "C": C, "D": D, "x_eq": z[: self.n], "u_eq": z[self.n :], "y_eq": y},
            states=_quantities(self.states),
            inputs=_quantities(self.inputs),
            outputs=_quantities(self.outputs),
            residual=self.rates(z),
            notes=(*notes, *_blind(self.outputs, C)),
            lower=np.array([_bound(v, "min", -math.inf) for v in self.inputs]),
            upper=np.array([_bound(v, "max", math.inf) for v in self.inputs]),
            **about,
        )


class _ModelExchangePlant(_Plant):
    """x' and y by the FMU itself."""

    def __init__(
        self, path: Path, inputs: tuple[str, ...], outputs: tuple[str, ...], kept: tuple[str, ...], start: Any
    ):
        self._instance = ModelInstance("plant", path)
        start = self._instance.checked_start(start)
        states = self._instance.continuous_states()
        if not states:
            raise UserError(f"{path} has no continuous states")
        self.kept = [_index(name, [v.name for v in states], "state") for name in kept] or list(range(len(states)))
        names = _Names(
            tuple(states),
            _inputs(self._instance, inputs),
            _outputs(self._instance, outputs, [states[i] for i in self.kept]),
        )
        super().__init__(path, names, start)
        self._open = False
        description = self._instance.description
        self._directional = bool(getattr(description.modelExchange, "providesDirectionalDerivative", False))
        self._derivatives = [u.variable.valueReference for u in description.derivatives]  # type: ignore[union-attr]

    def begin(self) -> Array:
        self._ready()
        return np.concatenate((self._instance.states(self.n), self._instance.reals(self.inputs)))

    def rates(self, z: Array) -> Array:
        return self._values(z)[: self.n]

    def rates_jacobian(self, z: Array) -> Array:
        if self._directional:
            return self._directional_jacobian(z)[: self.n]
        return jacobian(self.rates, z, self.sizes(z)).J

    def linear(self, z: Array, notes: list[str]) -> LinearModel:
        sizes = self.sizes(z)
        rows = [*(f"{v.name}'" for v in self.states), *(v.name for v in self.outputs)]
        found = jacobian(self._values, z, sizes)
        J, error = found.J, found.error
        if self._directional:
            J = self._directional_jacobian(z)
            _check_contradiction(J, found, sizes, rows, self.names)
            error = np.where(np.isfinite(found.error), np.abs(J - found.J), 0.0)
            _check_smooth(Jacobian(J, error, found.kink), sizes, rows, self.names)
        else:
            _check_smooth(found, sizes, rows, self.names)
            J = np.where(np.abs(J) <= error, 0.0, J)
        worst = float(_relative(error, J, sizes).max(initial=0.0))
        method = "directional derivatives, checked by differences" if self._directional else "differences"
        if worst > NOTABLE_ERROR:
            notes.append(f"the derivatives are known to {worst:.1g} of the largest in a row only")
        A, B = J[: self.n, : self.n], J[: self.n, self.n :]
        y = self._values(z)[self.n :]
        C, D = J[self.n :, : self.n], J[self.n :, self.n :]
        whole = self.model(z, (A, B, C, D), y, notes, error=worst, method=f"model exchange, {method}")
        return _reduced(whole, self.kept)

    def close(self) -> None:
        self._open = False
        self._instance.close()

    def _ready(self) -> None:
        if not self._open:
            self._instance.begin(self.start)
            self._open = True

    def _set(self, z: Array) -> None:
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


class _CoSimulationPlant(_Plant):
    """x(T) and y(T) by short steps from initial values that are parameters; a fresh instance for each."""

    def __init__(
        self,
        path: Path,
        inputs: tuple[str, ...],
        outputs: tuple[str, ...],
        states: tuple[str, ...],
        start: Any,
        step: float | None,
    ):
        instance = self._instance = Instance("plant", path)
        pairs = _state_pairs(instance, states)
        kept = [instance.variables[name] for name, _ in pairs]
        names = _Names(tuple(kept), _inputs(instance, inputs), _outputs(instance, outputs, kept))
        super().__init__(path, names, instance.checked_start(start))
        self._parameters = [parameter for _, parameter in pairs]
        experiment = instance.description.defaultExperiment
        own = None if experiment is None or experiment.stepSize is None else float(experiment.stepSize)
        self.step = step if step is not None else own or 1e-3
        if not (math.isfinite(self.step) and self.step > 0.0):
            raise UserError(f"the communication step must be positive and finite, found {self.step:g} s")

    def begin(self) -> Array:
        starts = {**{v.name: _start(v) for v in self._instance.variables.values()}, **self.start}
        z = np.array([float(starts[name]) for name in (*self._parameters, *(v.name for v in self.inputs))])
        self._run(z, 1, self.step)
        return z

    def rates(self, z: Array) -> Array:
        return (self._ends(z, 1, self.step)[: self.n] - z[: self.n]) / self.step

    def rates_jacobian(self, z: Array) -> Array:
        return jacobian(self.rates, z, self.sizes(z)).J

    def linear(self, z: Array, notes: list[str]) -> LinearModel:
        A = self._logarithm(self._jacobian(z, 1, self.step), z, self.step)[0]
        norm = float(np.linalg.norm(matrix_balance(A)[0], 2))
        count = int(np.clip(round(ANGLE / (self.step * norm)) if norm > 0.0 else MOST_STEPS, 1, MOST_STEPS))
        time = count * self.step
        J = self._jacobian(z, count, self.step)
        A, B, error = self._logarithm(J, z, time)
        worst = float(error.max(initial=0.0))
        if worst > NOTABLE_ERROR:
            notes.append(
                f"after {time:g} s and {2 * time:g} s A differs by {worst:.1g}: is there a fast state besides these?"
            )
        worst = max(worst, self._step_error(z, count, np.hstack((A, B)), notes), 0.5 * 10.0 ** (1 - DIGITS))
        C, D = self._output_matrices(J, z, notes)
        y = self._ends(z, count, self.step)[self.n : self.n + len(self.outputs)]
        how = f"co-simulation, {count} and {2 * count} steps of {self.step:g} s"
        return self.model(z, (A, B, C, D), y, notes, error=worst, method=how)

    def close(self) -> None:
        self._instance.close()

    def _step_error(self, z: Array, count: int, AB: Array, notes: list[str]) -> float:
        """Return by how much A and B, relative, change with half the communication step; 0 where the FMU takes none."""
        if not getattr(self._instance.description.coSimulation, "canHandleVariableCommunicationStepSize", False):
            return 0.0
        try:
            J = self._jacobian(z, 2 * count, 0.5 * self.step)
        except EvaluationError:
            return 0.0
        finer = np.hstack(self._logarithm(J, z, count * self.step)[:2])
        worst = float(_relative(np.abs(finer - AB), AB, self.sizes(z)).max(initial=0.0))
        if worst > NOTABLE_ERROR:
            notes.append(
                f"the FMU integrates with the communication step: with half of {self.step:g} s A and B change by "
                f"{worst:.1g}; the model is that of this --step"
            )
        return worst

    def _run(self, z: Array, count: int, step: float) -> Array:
        """Return x and y after `count` steps, after twice as many, and y at the start; raises FmuError."""
        instance = Instance("plant", self.path)
        u = {v.name: float(value) for v, value in zip(self.inputs, z[self.n :], strict=True)}
        x = dict(zip(self._parameters, map(float, z[: self.n]), strict=True))
        try:
            instance.start({**self.start, **x, **u}, 0.0, None)
            instance.run()
            held, read = instance.ports(u, "Set"), instance.ports(self._read_names(), "Get")
            for port in held:
                port.values[:] = list(u.values())
            advance = instance.stepper()
            found = [self._read(instance, read)[self.n :]]
            for k in range(2 * count):
                instance.transfer(held)
                advance(k * step, step)
                if k + 1 in (count, 2 * count):
                    found.append(self._read(instance, read))
        finally:
            instance.close()
        return np.concatenate((*found[1:], found[0]))

    def _read_names(self) -> list[str]:
        return [v.name for v in (*self.states, *self.outputs)]

    @staticmethod
    def _read(instance: Instance, ports: Any) -> Array:
        instance.transfer(ports)
        return np.concatenate([np.array(port.values) for port in ports])

    def _ends(self, z: Array, count: int, step: float) -> Array:
        try:
            return self._run(z, count, step)
        except FmuError as error:
            raise EvaluationError(str(error)) from None

    def _jacobian(self, z: Array, count: int, step: float) -> Array:
        sizes, times = self.sizes(z), (count * step, 2 * count * step)
        found = jacobian(lambda at: self._ends(at, count, step), z, sizes)
        rows = [f"{name} after {time:g} s" for time in times for name in self._read_names()]
        _check_smooth(found, sizes, [*rows, *(f"{v.name} at the start" for v in self.outputs)], self.names)
        return found.J

    def _logarithm(self, J: Array, z: Array, time: float) -> tuple[Array, Array, Array]:
        """Return A, B of x(T), T = `time`, and their relative difference from those of x(2 T)."""
        n, rows = self.n, self.n + len(self.outputs)
        once, twice = J[:n], J[rows : rows + n]
        self._check_start(2.0 * once - twice, z)
        both = [self._rates_of(M, k * time) for M, k in ((once, 1), (twice, 2))]
        sizes = self.sizes(z)
        error = _relative(np.abs(both[0] - both[1]), both[0], sizes)
        if error.max(initial=0.0) > LARGEST_ERROR:
            i, j = _place(error)
            entry = f"the derivative of {self.names[i]}' by {self.names[j]}"
            raise UserError(
                f"the states {', '.join(self.names[:n])} do not describe {self.path}: {entry} is {both[0][i, j]:.4g} from "
                f"steps to {time:g} s and {both[1][i, j]:.4g} from steps to {2 * time:g} s; a state is missing (--state), "
                "the --step is too long, or dry friction is at work"
            )
        AB = _without_noise(both[0], both[1], sizes)
        return AB[:, :n], AB[:, n:], error

    def _rates_of(self, M: Array, time: float) -> Array:
        """Return [A B] of the map M = [exp(A T), ...] over T = `time`."""
        whole = np.eye(self.n + self.m)
        whole[: self.n] = M
        try:
            found = np.asarray(logm(whole))
        except (LinAlgError, ValueError):
            found = np.full_like(whole, np.nan)
        if not np.isfinite(found).all() or np.abs(np.imag(found)).max() > 1e-6 * np.abs(found).max():
            raise UserError(f"the states of {self.path} change too much within {time:g} s: take a shorter --step")
        return np.real(found)[: self.n] / time

    def _check_start(self, at_start: Array, z: Array) -> None:
        """Refuse parameters that do not set their states: the map of no step must be near the unit matrix."""
        sizes = self.sizes(z)[: self.n]
        off = (at_start[:, : self.n] - np.eye(self.n)) * sizes / sizes[:, None]
        i = int(np.argmax(np.abs(np.diag(off))))
        if abs(off[i, i]) > 0.5:
            raise UserError(
                f"the parameter {self._parameters[i]} must set {self.names[i]} at the start, in the same unit: a change of "
                f"1 of it changes {self.names[i]} by {at_start[i, i]:.4g}"
            )

    def _output_matrices(self, J: Array, z: Array, notes: list[str]) -> tuple[Array, Array]:
        """Return C, D of y(T) = C x(T) + D u; they must be the same for 2 T."""
        n, p, sizes = self.n, len(self.outputs), self.sizes(z)
        found = []
        for begin in (0, n + p):
            M, Y = J[begin : begin + n], J[begin + n : begin + n + p]
            C = np.linalg.solve(M[:, :n].T, Y[:, :n].T).T
            found.append(np.hstack((C, Y[:, n:] - C @ M[:, n:])))
        error = _relative(np.abs(found[0] - found[1]), found[0], sizes)
        if error.max(initial=0.0) > LARGEST_ERROR:
            i = int(np.argmax(error.max(axis=1)))
            raise UserError(
                f"the output {self.outputs[i].name} is no function of the states {', '.join(self.names[:n])}"
            )
        first = J[2 * (n + p) :]
        late = _relative(np.abs(first - found[0]), found[0], sizes).max(axis=1, initial=0.0)
        for i in np.flatnonzero((late > 1e-4) & first.any(axis=1)):
            notes.append(
                f"{self.outputs[i].name} depends on the state otherwise at the start than after a step: it seems to be late"
            )
        CD = _without_noise(found[0], found[1], sizes)
        return CD[:, :n], CD[:, n:]


def _open(
    path: Path,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    states: tuple[str, ...],
    start: Any,
    step: float | None,
) -> _Plant:
    """Return the plant, for model exchange where the FMU is and no state names its parameter."""
    _, description = describe_any(path)
    paired = any("=" in name for name in states)
    if description.modelExchange is not None and not paired:
        if step is not None:
            raise UserError("--step is for FMUs that are for co-simulation only, or with --state OUTPUT=PARAMETER")
        return _ModelExchangePlant(path, inputs, outputs, states, start)
    return _CoSimulationPlant(path, inputs, outputs, states, start, step)


# The equilibrium


def _beginning(plant: _Plant, at: dict[str, float], free: tuple[str, ...]) -> tuple[Array, list[int], dict[int, float]]:
    """Return z that the search begins at, the indices of what it may change, and the values of what stays."""
    z = plant.begin()
    fixed = {_index(name, plant.names, "state or input"): value for name, value in at.items()}
    for name in free:
        if _index(name, plant.names, "state or input") in fixed:
            raise UserError(f"{name} cannot be free and stay at {at[name]:g}")
    for j, value in fixed.items():
        z[j] = _finite_number(plant.names[j], value)
    moved = {*range(plant.n), *(plant.names.index(name) for name in free)} - fixed.keys()
    return z, sorted(moved), fixed


def _equilibrium(plant: _Plant, z: Array, chosen: Sequence[int], fixed: Mapping[int, float]) -> tuple[Array, list[str]]:
    """Return z of the equilibrium and what is to be said of it; raises UserError where there is none."""
    found = _searched(plant, z, chosen)
    J = plant.rates_jacobian(found)
    if _at_rest(plant, found, J):
        return found, []
    near = _searched(plant, z, range(plant.n))
    if _at_rest(plant, near, plant.rates_jacobian(near)) and (np.abs(near - z) <= NEAR * plant.sizes(z)).all():
        return near, _moved(plant, z, near, fixed)
    raise UserError(_no_equilibrium(plant, z if fixed else found, J, fixed))


def _searched(plant: _Plant, z: Array, chosen: Sequence[int]) -> Array:
    """Return what the search ends at, with zeros for numbers that are zero but for rounding."""
    found = solve(plant.rates, plant.rates_jacobian, z, chosen, plant.sizes(z))
    rounded = np.where(np.abs(found) <= ROUNDING * plant.sizes(z), 0.0, found)
    return rounded if _at_rest(plant, rounded, plant.rates_jacobian(rounded)) else found


def _at_rest(plant: _Plant, z: Array, J: Array) -> bool:
    return bool((np.abs(finite(plant.rates, z)) <= _allowed(plant, z, J)).all())


def _allowed(plant: _Plant, z: Array, J: Array) -> Array:
    sizes = plant.sizes(z)
    return np.maximum(REST * _rows(J, sizes)[:, 0], 1e-12 * sizes[: plant.n])


def _moved(plant: _Plant, z: Array, near: Array, fixed: Iterable[int]) -> list[str]:
    return [
        f"{plant.names[j]} = {z[j]:.10g} is {abs(near[j] - z[j]):.2g} beside the equilibrium, which is taken"
        for j in fixed
        if near[j] != z[j]
    ]


def _no_equilibrium(plant: _Plant, z: Array, J: Array, fixed: Mapping[int, float]) -> str:
    rates = plant.rates(z)
    worst = int(np.argmax(np.abs(rates) / _allowed(plant, z, J)))
    given = [f"{plant.names[j]} = {value:g}" for j, value in fixed.items()]
    stays = [f"{v.name} = {z[plant.n + j]:g}" for j, v in enumerate(plant.inputs) if plant.n + j not in fixed]
    missing = least_steps(J * plant.sizes(z), rates)
    j = int(np.argmax(np.abs(missing)))
    hint = f"; {plant.names[j]} is what would have to change" if np.abs(missing[j]) > NEAR else ""
    unit = _unit(plant.states[worst])
    return (
        f"there is no equilibrium near {', '.join((*given, *stays)) or 'the start values'}: {plant.names[worst]}' "
        f"is {rates[worst]:.4g}{'' if unit == '1' else f' {unit}'}/s{hint}; free an input (--free), or hold other values "
        "(--at)"
    )


# Checks of derivatives


def _rows(J: Array, sizes: Array) -> Array:
    """Return the largest |J_ij| size_j of each row, shape (r, 1)."""
    return (np.abs(J) * sizes).max(axis=1, keepdims=True, initial=0.0)


def _place(M: Array) -> tuple[int, int]:
    """Return row and column of the largest entry."""
    i, j = divmod(int(np.argmax(M)), M.shape[1])
    return i, j


def _relative(error: Array, J: Array, sizes: Array) -> Array:
    """Return errors relative to the largest entry of their row; 0 in rows of zeros whose error is rounding."""
    rows = _rows(J, sizes)
    scaled = error * sizes
    return np.divide(scaled, rows, out=np.where(scaled > 1e-9, np.inf, 0.0), where=rows > 0.0)


def _blind(outputs: Sequence[ScalarVariable], C: Array) -> list[str]:
    return [
        f"the output {v.name} does not change with the states there, and measures nothing"
        for v, row in zip(outputs, C, strict=True)
        if not row.any()
    ]


def _without_noise(M: Array, again: Array, sizes: Array) -> Array:
    """Return M with zeros below what two ways to it differ by in its row, and DIGITS digits in the others."""
    least = np.maximum((np.abs(M - again) * sizes).max(axis=1, keepdims=True, initial=0.0), NOISE * _rows(M, sizes))
    kept = np.where(np.abs(M) * sizes <= least, 0.0, M)
    return np.vectorize(lambda value: float(f"{value:.{DIGITS}g}"), otypes=[float])(kept)


def _check_smooth(found: Jacobian, sizes: Array, rows: Sequence[str], columns: Sequence[str]) -> None:
    """Raise UserError that names the entry whose derivative does not settle or differs from side to side."""
    error = _relative(found.error, found.J, sizes)
    if error.max(initial=0.0) > LARGEST_ERROR:
        i, j = _place(error)
        raise UserError(
            f"{rows[i]} has no derivative by {columns[j]} that differences agree on: it is not smooth there (counted or "
            "noisy sensor, dry friction, switch); turn that off with --set, or leave it out"
        )
    kink = _relative(found.kink, found.J, sizes)
    if kink.max(initial=0.0) > LARGEST_ERROR:
        i, j = _place(kink)
        raise UserError(
            f"{rows[i]} has different derivatives by {columns[j]} to both sides: a limit or dry friction is at work there; "
            "turn that off with --set, or choose another equilibrium"
        )


def _check_contradiction(J: Array, found: Jacobian, sizes: Array, rows: Sequence[str], columns: Sequence[str]) -> None:
    """Raise UserError where an FMU's directional derivative is not what good differences give."""
    sure = np.isfinite(found.error) & (_relative(found.error, found.J, sizes) < NOTABLE_ERROR)
    wrong = np.where(sure, _relative(np.abs(J - found.J), found.J, sizes), 0.0)
    if wrong.max(initial=0.0) > LARGEST_ERROR:
        i, j = _place(wrong)
        raise UserError(
            f"the FMU contradicts itself: its directional derivative of {rows[i]} by {columns[j]} is {J[i, j]:.6g}, "
            f"differences give {found.J[i, j]:.6g}"
        )


def _reduced(model: LinearModel, kept: Sequence[int]) -> LinearModel:
    """Return the model of the states `kept`; raise UserError where one of the others acts on them or on an output."""
    from dataclasses import replace  # noqa: PLC0415

    keep = list(kept)
    for dropped in sorted(set(range(len(model.A))) - set(keep)):
        for M, names in ((model.A[keep], [model.states[i] for i in keep]), (model.C, model.outputs)):
            acted = np.flatnonzero(M[:, dropped])
            if len(acted):
                raise UserError(
                    f"the state {model.states[dropped].name} acts on {names[acted[0]].name} and cannot be left out"
                )
    return replace(
        model,
        A=model.A[np.ix_(keep, keep)],
        B=model.B[keep],
        C=model.C[:, keep],
        states=tuple(model.states[i] for i in keep),
        x_eq=model.x_eq[keep],
        residual=model.residual[keep],
    )


# Names, units and attributes


def _state_pairs(instance: Instance, states: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return (output, what sets it at the start) of each state of a co-simulation FMU."""
    real = [v for v in instance.variables.values() if v.type == "Real"]
    readable = [v.name for v in real if v.causality in ("output", "local")]
    own = [v.name for v in real if v.name in readable and v.initial == "exact" and v.variability != "constant"]
    settable = [*(v.name for v in real if v.causality == "parameter"), *own]

    def setter(name: str) -> str:
        return name if name in own and name + START not in settable else name + START

    if not states:
        found = [(name, setter(name)) for name in readable if setter(name) in settable]
        if found:
            return _bounded(found, "states")
        raise UserError(
            f"{instance.path} is for co-simulation only and does not say what its states are: name each with --state "
            f"OUTPUT=PARAMETER, the real output that shows it and the parameter that sets it at the start"
        )
    pairs = []
    for text in states:
        name, _, parameter = text.partition("=")
        pairs.append((name, parameter or setter(name)))
        for part, known, what in ((name, readable, "real output"), (pairs[-1][1], settable, "real parameter")):
            _index(part, known, what)
    for side, what in ((0, "state"), (1, "parameter")):
        _check_once([pair[side] for pair in pairs], what)
    return _bounded(pairs, "states")


def _inputs(instance: Instance, names: tuple[str, ...]) -> tuple[ScalarVariable, ...]:
    known = [v.name for v in instance.variables.values() if v.type == "Real" and v.causality == "input"]
    if not names and len(known) != 1:
        raise UserError(f"name the inputs with --input: {instance.path} has {', '.join(known) or 'no real input'}")
    return _chosen(instance, names or known, known, "real input")


def _outputs(
    instance: Instance, names: tuple[str, ...], states: Sequence[ScalarVariable]
) -> tuple[ScalarVariable, ...]:
    known = [v.name for v in instance.variables.values() if v.type == "Real" and v.causality == "output"]
    if names:
        return _chosen(instance, names, known, "real output")
    hidden = [v.name for v in states if v.name not in known]
    if hidden:
        raise UserError(
            f"name what is measured with --output: the state {hidden[0]} is no output of {instance.path}, which has "
            f"{', '.join(known) or 'none'}"
        )
    return tuple(_bounded(states, "outputs"))


def _chosen(instance: Instance, names: Sequence[str], known: Sequence[str], what: str) -> tuple[ScalarVariable, ...]:
    for name in names:
        _index(name, known, what)
    _check_once(names, what)
    return tuple(instance.variables[name] for name in _bounded(names, f"{what}s"))


def _bounded(found: Sequence[Any], what: str) -> list[Any]:
    if len(found) > MOST_VARIABLES:
        raise UserError(f"a model must have at most {MOST_VARIABLES} {what}, found {len(found)}")
    return list(found)


def _check_once(names: Sequence[str], what: str) -> None:
    for name in names:
        if list(names).count(name) > 1:
            raise UserError(f"each {what} must be named once, found {shown(name)} twice")


def _index(name: str, known: Sequence[str], what: str) -> int:
    if name not in known:
        raise UserError(f"the FMU has no {what} {shown(name)}{did_you_mean(name, known)}")
    return list(known).index(name)


def _quantities(variables: Sequence[ScalarVariable]) -> tuple[Quantity, ...]:
    """Return names and units; raise UserError for a name that a system file cannot hold."""
    found = tuple(Quantity(v.name, _unit(v)) for v in variables)
    for quantity in found:
        if Quantity.parse(str(quantity)) != quantity:
            raise UserError(f"a system file cannot hold the name {shown(quantity.name)} in {shown(quantity.unit)}")
    return found


def _attribute(variable: ScalarVariable, name: str) -> Any:
    own = getattr(variable, name, None)
    return own if own is not None else getattr(variable.declaredType, name, None)


def _unit(variable: ScalarVariable) -> str:
    """Return the declared unit, else the one in brackets at the end of the description, as PythonFMU has no units."""
    declared = _attribute(variable, "unit")
    if declared is not None:
        return str(declared).strip() or "1"
    match = re.search(r"\[([^\[\]]{1,40})\]\s*$", variable.description or "")
    return match[1].strip() if match else "1"


def _nominal(variable: ScalarVariable) -> float:
    value = _number(_attribute(variable, "nominal"))
    return abs(value) if value is not None and value != 0.0 else 1.0


def _bound(variable: ScalarVariable, name: str, none: float) -> float:
    value = _number(_attribute(variable, name))
    return none if value is None or abs(value) >= 1e300 else value


def _start(variable: ScalarVariable) -> Value:
    return _number(variable.start) or 0.0


def _number(text: object) -> float | None:
    try:
        value = float(str(text))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _finite_number(name: str, value: float) -> float:
    if not math.isfinite(value):
        raise UserError(f"{name} must be finite, found {value}")
    return float(value)


def _identifier(text: str) -> str:
    """Return the text as a C identifier."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)[:80]
    return name if name[:1].isalpha() else f"plant_{name}"
