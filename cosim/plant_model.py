"""A linear model with names and units, as it comes out of an FMU."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ihc_fmu.quantity import Quantity
from ihc_fmu.system import System

from .errors import UserError

Array = np.ndarray

USUAL = 1e-3
"""Sample time [s] where the plant asks for no other."""
PER_TIME, PER_GROWTH = 0.02, 0.1
"""Sample time relative to the time of the plant's fastest pole, and to that in which the plant grows e-fold."""
ROUNDED = 1e-3
"""Poles below this part of the norm of A may be 0: those of four integrators are known to the fourth root of rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """The linear model of an FMU about an equilibrium; SI or whatever units the FMU has.

    Parameters
    ----------
    name
        A C identifier, from the file's name.
    A
        How the states act on their derivatives, shape (n, n).
    B
        How the inputs act on the states' derivatives, shape (n, m).
    C
        How the states act on the outputs, shape (p, n).
    D
        How the inputs act on the outputs, shape (p, m).
    states, inputs, outputs
        Names and units.
    x_eq
        The states at the equilibrium, shape (n,).
    u_eq
        The inputs there, shape (m,).
    y_eq
        The outputs there, shape (p,).
    residual
        x' there, shape (n,).
    lower, upper
        Limits that the FMU declares for its inputs, shape (m,).
    error
        Estimated largest error, relative to the largest entry of its row.
    method
        How it was found, in words.
    notes
        What is to be known of it.

    Examples
    --------
    >>> import cosim
    >>> model = cosim.linear_model("fmus/arm_linear_plant.fmu", inputs=["u1"])
    >>> [str(quantity) for quantity in model.states], model.x_eq.tolist()
    (['angle_true [rad]', 'rate_true [rad/s]'], [0.0, 0.0])
    >>> system = model.system().with_lqr([1.0, 1.0], [1.0])
    >>> system.name
    'arm_linear_plant'
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

    def system(self, name: str | None = None, sample_time: float | None = None) -> System:
        """Return the model as a System without a gain.

        Parameters
        ----------
        name
            Of the system; None: the model's.
        sample_time
            Of the controller [s]; None: by `sample_time_for`.

        Returns
        -------
        System
            `with_lqr` or `changed(K=...)` gives it a gain.

        Raises
        ------
        UserError
            Where an output depends on an input directly, or on no state.
        """
        for i in np.flatnonzero(~self.C.any(axis=1)):
            output = self.outputs[i].name
            counted = [note for note in self.notes if note.startswith(f"{output} is counted")]
            raise UserError("; ".join(counted) or f"the output {output} does not change with the states: leave it out")
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
            sample_time=sample_time_for(self.A)[0] if sample_time is None else sample_time,
            x_eq=self.x_eq,
            u_eq=self.u_eq,
            y_eq=self.y_eq,
        )


def sample_time_for(A: Array) -> tuple[float, str]:
    """Return a controller's sample time [s] for a plant x' = A x, 1, 2 or 5 times a power of 10, and why it is that.

    PER_TIME of the time 1/|p| of the plant's fastest pole p, but not below USUAL: what is so fast decays by itself, unless
    it grows; then PER_GROWTH of the time in which it does. USUAL too where the poles are 0 but for rounding.
    """
    poles = np.linalg.eigvals(A)
    fastest, growth = float(np.abs(poles).max()), float(poles.real.max())
    if fastest <= ROUNDED * float(np.linalg.norm(A, 2)):
        return USUAL, "no pole of the plant says what it needs"
    wanted = PER_TIME / fastest
    if wanted >= USUAL:
        return _round(wanted), f"{PER_TIME:g} of the time of the plant's fastest pole, {fastest:.3g} 1/s"
    if growth > PER_GROWTH / USUAL:
        return _round(PER_GROWTH / growth), f"{PER_GROWTH:g} of the time in which the plant grows, at {growth:.3g} 1/s"
    return USUAL, f"the plant's fastest pole, {fastest:.3g} 1/s, is left to itself"


def _round(time: float) -> float:
    """Return the largest of 1, 2, 5 times a power of 10 that does not exceed `time`."""
    power = math.floor(math.log10(time) + 1e-9)
    digit = max(d for d in (1, 2, 5) if d * 10.0**power <= time * (1.0 + 1e-9))
    return float(f"{digit}e{power}")


def finite_model(model: LinearModel) -> LinearModel:
    """Return the model; raise UserError where one of its numbers is not finite."""
    for M, rows in (
        (model.A, model.states),
        (model.B, model.states),
        (model.C, model.outputs),
        (model.D, model.outputs),
    ):
        for i, _ in np.argwhere(~np.isfinite(M)):
            raise UserError(f"the derivatives of {rows[i].name} are beyond the range of numbers")
    return model


def reduced(model: LinearModel, kept: Sequence[int]) -> LinearModel:
    """Return the model of the states `kept`; raise UserError where one of the others acts on them or on an output."""
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
