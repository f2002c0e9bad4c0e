"""A co-simulation FMU as a function of z = (x, u): initial values are set, short steps made, and their logarithm taken."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from .derivative_checks import DIGITS, LARGEST_ERROR, NOTABLE_ERROR, check_smooth, place, relative, without_noise
from .derivatives import EvaluationError, differences, jacobian
from .errors import UserError
from .fmu import FmuError, Instance
from .linear_plants import CoarseModel, Plant, Taking, outputs_told
from .matrix_logarithm import logarithm
from .plant_model import LinearModel
from .plant_variables import real_inputs, real_outputs, start_of, state_pairs

Array = np.ndarray

ANGLE = 0.2
"""How far the steps in co-simulation go: T times the norm of A in balanced units."""
MOST_STEPS = 50
UNLIKE = 0.1
"""By which part of its largest effect a coarse model after T and after 2 T may differ."""


class CoSimulationPlant(Plant):
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
        pairs = state_pairs(instance, states)
        kept = [instance.variables[name] for name, _ in pairs]
        names = Taking(tuple(kept), real_inputs(instance, inputs), real_outputs(instance, outputs, kept))
        super().__init__(path, names, instance.checked_start(start))
        self._parameters = [parameter for _, parameter in pairs]
        experiment = instance.description.defaultExperiment
        own = None if experiment is None or experiment.stepSize is None else float(experiment.stepSize)
        self.step = step if step is not None else own or 1e-3
        if not (math.isfinite(self.step) and self.step > 0.0):
            raise UserError(f"the communication step must be positive and finite, found {self.step:g} s")

    def begin(self) -> Array:
        """Return z of the start values; raises FmuError where the FMU fails."""
        starts = {**{v.name: start_of(v) for v in self._instance.variables.values()}, **self.start}
        z = np.array([float(starts[name]) for name in (*self._parameters, *(v.name for v in self.inputs))])
        self._run(z, 1, self.step)
        return z

    def rates(self, z: Array) -> Array:
        """Return (x(h) - x)/h after a step h; raises EvaluationError."""
        return (self._ends(z, 1, self.step)[: self.n] - z[: self.n]) / self.step

    def rates_jacobian(self, z: Array) -> Array:
        """Return the derivatives of `rates`, shape (n, n + m)."""
        return jacobian(self.rates, z, self.sizes(z)).J

    def linear(self, z: Array, notes: list[str]) -> LinearModel:
        """Return the linear model about z; `notes` are added to its own."""
        from scipy.linalg import matrix_balance  # noqa: PLC0415 - heavy, and a run needs none of it

        A = self._logarithm(self._jacobian(z, 1, self.step), z, self.step)[0]
        sizes = self.sizes(z)[: self.n]
        norm = float(np.linalg.norm(matrix_balance(A * sizes / sizes[:, None])[0], 2))
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

    def coarse(self, z: Array, widths: Array, span: float) -> CoarseModel:
        """Return the model about z from steps to `span` [s], or as near as whole steps come, see `Plant.coarse`."""
        n, rows = self.n, self.n + len(self.outputs)
        count = int(np.clip(round(span / self.step), 1, MOST_STEPS))
        f0, J, skew = differences(lambda at: self._ends(at, count, self.step), z, widths)
        AB, again = self._both(J, z, count * self.step)
        scaled = [np.abs(M) * widths / widths[:n, None] for M in (AB, AB - again)]
        if not scaled[1].max(initial=0.0) <= UNLIKE * scaled[0].max(initial=0.0):
            raise UserError(f"the states {', '.join(self.names[:n])} do not describe {self.path}")
        held = np.eye(n + self.m)[n:]
        Y, smooth = outputs_told(J[2 * rows :], skew[2 * rows :], widths)
        late = np.all(Y == 0.0, axis=1)  # outputs that are computed in a step
        if late.any():
            X = np.hstack((np.vstack((J[:n], held)), np.vstack((J[rows : rows + n], held))))
            after = [outputs_told(J[part], skew[part], widths) for part in (slice(n, rows), slice(rows + n, 2 * rows))]
            fitted = np.linalg.lstsq(X.T, np.hstack([M for M, _ in after]).T, rcond=None)[0].T
            Y, smooth = np.where(late[:, None], fitted, Y), np.where(late, after[0][1] & after[1][1], smooth)
        return CoarseModel(AB[:, :n], AB[:, n:], Y[:, :n], Y[:, n:], (f0[:n] - z[:n]) / (count * self.step), smooth)

    def close(self) -> None:
        """Free what the FMU holds."""
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
        worst = float(relative(np.abs(finer - AB), AB, self.sizes(z)).max(initial=0.0))
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
            readings = [self._read(instance, read)[self.n :]]
            for k in range(2 * count):
                self.look()
                instance.transfer(held)
                advance(k * step, step)
                if k + 1 in (count, 2 * count):
                    readings.append(self._read(instance, read))
        finally:
            instance.close()
        return np.concatenate((*readings[1:], readings[0]))

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
        ends = jacobian(lambda at: self._ends(at, count, step), z, sizes)
        rows = [f"{name} after {time:g} s" for time in times for name in self._read_names()]
        check_smooth(ends, sizes, [*rows, *(f"{v.name} at the start" for v in self.outputs)], self.names)
        return ends.J

    def _logarithm(self, J: Array, z: Array, time: float) -> tuple[Array, Array, Array]:
        """Return A, B of x(T), T = `time`, and their relative difference from those of x(2 T)."""
        n, sizes, both = self.n, self.sizes(z), self._both(J, z, time)
        error = relative(np.abs(both[0] - both[1]), both[0], sizes)
        if error.max(initial=0.0) > LARGEST_ERROR:
            i, j = place(error)
            entry = f"the derivative of {self.names[i]}' by {self.names[j]}"
            raise UserError(
                f"the states {', '.join(self.names[:n])} do not describe {self.path}: {entry} is {both[0][i, j]:.4g} from "
                f"steps to {time:g} s and {both[1][i, j]:.4g} from steps to {2 * time:g} s; a state is missing (--state), "
                "the --step is too long, or dry friction is at work"
            )
        AB = without_noise(both[0], both[1], sizes)
        return AB[:, :n], AB[:, n:], error

    def _both(self, J: Array, z: Array, time: float) -> list[Array]:
        """Return [A B] of x(T), T = `time`, and of x(2 T)."""
        n, rows = self.n, self.n + len(self.outputs)
        once, twice = J[:n], J[rows : rows + n]
        self._check_start(2.0 * once - twice, z)
        return [self._rates_of(M, k * time) for M, k in ((once, 1), (twice, 2))]

    def _rates_of(self, M: Array, time: float) -> Array:
        """Return [A B] of the map M = [exp(A T), ...] over T = `time`."""
        whole = np.eye(self.n + self.m)
        whole[: self.n] = M
        rates = logarithm(whole)
        if not np.isfinite(rates).all():
            raise UserError(f"the states of {self.path} change too much within {time:g} s: take a shorter --step")
        return rates[: self.n] / time

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
        CDs = []
        for begin in (0, n + p):
            M, Y = J[begin : begin + n], J[begin + n : begin + n + p]
            C = np.linalg.solve(M[:, :n].T, Y[:, :n].T).T
            CDs.append(np.hstack((C, Y[:, n:] - C @ M[:, n:])))
        error = relative(np.abs(CDs[0] - CDs[1]), CDs[0], sizes)
        if error.max(initial=0.0) > LARGEST_ERROR:
            i = int(np.argmax(error.max(axis=1)))
            raise UserError(
                f"the output {self.outputs[i].name} is no function of the states {', '.join(self.names[:n])}"
            )
        first = J[2 * (n + p) :]
        late = relative(np.abs(first - CDs[0]), CDs[0], sizes).max(axis=1, initial=0.0)
        for i in np.flatnonzero((late > 1e-4) & first.any(axis=1)):
            notes.append(
                f"{self.outputs[i].name} depends on the state otherwise at the start than after a step: it seems to be late"
            )
        CD = without_noise(CDs[0], CDs[1], sizes)
        return CD[:, :n], CD[:, n:]
