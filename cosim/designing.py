"""What the command `design` does: a system, what is wished of its design, and the design, or why there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fmu_export.variables import did_you_mean
from ihc_fmu.design import Design
from ihc_fmu.direct import direct_design
from ihc_fmu.integral import largest_mu
from ihc_fmu.inverse import inverse_design
from ihc_fmu.largest_rate import largest_alpha, largest_alpha_of
from ihc_fmu.lmi import InfeasibleError
from ihc_fmu.options import Options
from ihc_fmu.pendulum.paper_system import paper_system
from ihc_fmu.pendulum.residual import residual_set as pendulum_residual
from ihc_fmu.residual import Residual, residual_set
from ihc_fmu.synthesis import SHARE_OF_LIMIT, Choice, chosen_options, degrees
from ihc_fmu.system import System

from .certified import is_pendulums
from .design_export import check_exportable
from .errors import UserError

Say = Callable[[str], object]

ROUNDING = 1e-4
"""By which what is reached on the unit ball may exceed what was asked for, relative."""


@dataclass(frozen=True)
class Wish:
    """Options of the command, None for what is to be chosen; `state` names the state that `delta_max` bounds."""

    direct: bool = False
    mu: float | None = None
    alpha: float | None = None
    u_max: str | None = None
    delta_max: float | None = None
    state: str | None = None
    beta: float = Options.beta
    psi: float = 0.0
    d_max: float = 0.0


def system_and_wish(path: Path | None, wish: Wish) -> tuple[System, Wish]:
    """Return the system of a file; for None the paper's, with the paper's options where none are given."""
    if path is not None:
        return System.load(path), wish
    mu = Options.mu if wish.mu is None else wish.mu
    alpha = Options.alpha if wish.alpha is None else wish.alpha
    u_max = str(Options.u_max) if wish.u_max is None and wish.delta_max is None else wish.u_max
    return paper_system(), replace(wish, mu=mu, alpha=alpha, u_max=u_max)


def find(system: System, wish: Wish, say: Say) -> tuple[Design, Choice]:
    """Return the design, and its options with why they are what they are; raise UserError that says what is possible."""
    rest: dict[str, Any] = {"delta_max": wish.delta_max, "beta": wish.beta, "psi": wish.psi, "d_max": wish.d_max}
    rest["index"] = _index(system, wish)
    u_max = None if wish.u_max is None else _numbers(wish.u_max)
    if wish.direct:
        if wish.alpha is None:
            raise UserError("a direct design needs --alpha, the decrease to prove [1/s]")
        mu = largest_mu(system) if wish.mu is None else wish.mu
        choice = chosen_options(system, mu, wish.alpha, u_max, say, **rest)
        return direct_design(system, choice.options), choice
    if system.K is None:
        raise UserError(
            "an inverse design needs a linear controller: K, k_lin or lqr in the system; or --method direct"
        )
    try:
        choice = chosen_options(system, wish.mu, wish.alpha, u_max, say, **rest)
        return inverse_design(system, choice.options, say, choice.start), choice
    except InfeasibleError as error:
        raise _explained(system, wish, error, say) from None


def unexportable(design: Design) -> list[str]:
    """Return the sentence with which `export` will refuse a design, found by its own checks; nothing where it will not."""
    try:
        check_exportable(design)
    except UserError as error:
        return [f"export will refuse this: {error}"]
    return []


def residual_of(design: Design, a_min: float) -> Residual:
    """Return what counting leaves under the IHC with the Kalman filter of its controller FMU; raises as `residual_set`."""
    if not is_pendulums(design):
        return residual_set(design, a_min)
    changes = {"a_min": a_min, "b_max": max(a_min, 1.0), "velocity_source": "kalman", "discretization": "semi_implicit"}
    return pendulum_residual(design, changes)


def beyond_limits(design: Design) -> list[str]:
    """Return a sentence for each input whose homogeneous part takes more of its limits on the unit ball than is chosen."""
    said = []
    for q, size, room in zip(design.system.inputs, design.u_max, design.system.room, strict=True):
        if size <= SHARE_OF_LIMIT * room * (1.0 + ROUNDING):
            continue
        half, what = ("", "it") if size > room else ("half of ", "with the linear part K_0 x it")
        said.append(
            f"the homogeneous part of {q.name} reaches {size:.4g}{q.suffix} on the unit ball, more than {half}the "
            f"{room:.4g}{q.suffix} that the limits leave around the equilibrium: {what} may be cut off inside the ball, "
            "where the proof then does not hold"
        )
    return said


def _explained(system: System, wish: Wish, error: InfeasibleError, say: Say) -> UserError:
    """Return the error, which is of the last mu tried, with what is possible instead."""
    if wish.d_max:
        smaller = "" if wish.alpha is None else " or --alpha"
        return UserError(
            f"{error}; a smaller --d-max{smaller}, a larger scale (--u-max, --delta-max) or --method direct may have a "
            "solution"
        )
    if wish.psi or wish.alpha is None:
        smaller = "" if wish.mu is None else "a smaller --mu, or "
        return UserError(f"{error}; {smaller}--method direct may have a solution")
    mus, largest, why = degrees(system) if wish.mu is None else (wish.mu,), {}, error
    for mu in mus:
        try:
            largest[mu] = largest_alpha(system, mu, say=say, beta=wish.beta)
        except InfeasibleError as none:
            why = none
    if not largest:
        smaller = "" if wish.mu is None else "; a smaller --mu may have a solution"
        return UserError(f"{error}; the largest feasible alpha was not found: {why}{smaller}")
    best = max(largest, key=lambda mu: largest[mu])
    if wish.alpha <= largest[best]:
        return UserError(f"{error}, although with mu = {best:g} a P exists up to alpha = {largest[best]:.4g} 1/s")
    tried = (
        f"mu = {best:g}" if wish.mu is not None else f"mu = {best:g}, the best of {', '.join(map('{:g}'.format, mus))}"
    )
    proven = "" if error.numerical else f"; the dual proves that there is no solution with mu = {mus[-1]:g}"
    return UserError(
        f"alpha = {wish.alpha:g} 1/s is too large for this gain, the largest feasible one is {largest[best]:.4g} 1/s "
        f"with {tried}{proven}"
    )


def prospect(design: Design, options: Options, direct: bool, say: Say) -> str:
    """Return what else is possible: the largest alpha under the other options; of a direct design what control it takes."""
    if direct:
        K, inputs = design.K, design.system.inputs
        most = np.sqrt(np.einsum("ij,ji->i", K, np.linalg.solve(design.P, K.T)))
        parts = (f"|{q.name}| <= {u:.4g}{q.suffix}" for u, q in zip(most, inputs, strict=True))
        where = "without d_max any alpha" if options.d_max else "any alpha"
        return f"on the unit ball {', '.join(parts)}; {where} has a solution, a larger one with a smaller ball"
    try:
        largest = f"{largest_alpha_of(design, options, say):.4g} 1/s"
    except InfeasibleError as error:
        largest = f"not found: {error}"
    what = "gain, mu, d_max and scale" if options.d_max else "gain and mu"
    return f"largest feasible alpha for this {what}: {largest}"


def _index(system: System, wish: Wish) -> int:
    """Return the index of the state that `delta_max` bounds, the second one by default."""
    if wish.delta_max is None:
        if wish.state is not None:
            raise UserError("--state goes with --delta-max")
        return 0
    names = [q.name for q in system.states]
    if wish.state is None:
        return min(1, len(names) - 1)
    if wish.state not in names:
        raise UserError(
            f"--state must be one of {', '.join(names)}, found {wish.state!r}{did_you_mean(wish.state, names)}"
        )
    return names.index(wish.state)


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise UserError(f"--u-max takes numbers separated by commas, found {text!r}") from None
