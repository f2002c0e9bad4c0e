"""From a linear controller to a homogeneous one: what nobody gave is chosen, with its reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fmu_export.errors import UserError

from .arguments import check_kind
from .arrays import QUIET
from .design import Design
from .integral import check_degree, largest_mu
from .inverse import inverse_design
from .largest_rate import fastest, fastest_rejecting
from .lmi import InfeasibleError, Problem, Say
from .options import SCALES, Options
from .system import System

MUS = (1.0, 0.75, 0.5, 0.25)
"""Degrees that are tried where none is given."""
SHARE_OF_ALPHA, SHARE_OF_LIMIT, ROUGH = 0.5, 0.5, 1e-2
"""What is chosen: alpha relative to the largest one, which is found to ROUGH, and u_max relative to the limits' room."""


@dataclass(frozen=True)
class Choice:
    """Options of a design, and why those that nobody gave are what they are.

    Parameters
    ----------
    options
        What `inverse_design` takes.
    reasons
        A sentence for each that was chosen.
    start
        Where P = I serves for them, if a search for the largest alpha came by: a design need not search again.

    Examples
    --------
    >>> from ihc_fmu import System, chosen_options, inverse_design
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> choice = chosen_options(cart, u_max=[3.0])
    >>> choice.reasons[0]
    'mu = 1: rejects disturbances'
    >>> design = inverse_design(cart, choice.options, start=choice.start)
    """

    options: Options
    reasons: tuple[str, ...]
    start: Problem | None = None


@QUIET
def chosen_options(
    system: System,
    mu: float | None = None,
    alpha: float | None = None,
    u_max: Sequence[float] | None = None,
    say: Say = None,
    **rest: Any,
) -> Choice:
    """Return options for an inverse design: what is not given is chosen from the system.

    Parameters
    ----------
    system
        The linear model with its gain K.
    mu
        None: 1, with integral action 1/2, or without d_max the first of MUS below at which a solution is found.
    alpha
        [1/s]; None: half of the largest one at that mu under the other options, found to about ROUGH.
    u_max
        None, and no delta_max: half of the room that the limits leave around the equilibrium, without limits 1 for each
        input.
    say
        Is told how a long search goes.
    **rest
        Other entries of `Options`.

    Returns
    -------
    Choice
        Options and reasons.

    Raises
    ------
    UserError
        As `Options` and `inverse_design`, and for a mu that integral action does not have.
    InfeasibleError
        As `largest_alpha`.

    Examples
    --------
    >>> from ihc_fmu import System, chosen_options
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> choice = chosen_options(cart.changed(lower=[-10], upper=[10]), alpha=0.25)
    >>> choice.options.mu, choice.options.u_max
    (1.0, [5.0])
    >>> for reason in choice.reasons:
    ...     print(reason)
    mu = 1: rejects disturbances
    u_max = 5: the homogeneous part of the control on the unit ball; half of the room within the limits
    """
    check_kind("system", system, System, "a System")
    reasons, of_bounds, start = [], [], None
    if mu is not None and system.integral is not None:
        check_degree(mu)
    if u_max is None and rest.get("delta_max") is None:
        u_max, reason = _bounds_from_limits(system)
        of_bounds.append(reason)
    given = {"mu": largest_mu(system) if mu is None else mu, "u_max": u_max, **rest}
    options = Options(**given if alpha is None else {**given, "alpha": alpha})
    options.bounds(system.m)
    if alpha is None or mu is None:
        highest, mus = largest_mu(system), degrees(system) if mu is None and not options.d_max else (options.mu,)
        first, largest, start = _first_mu(system, mus, alpha, options.beta, say)
        options = replace(options, mu=first)
        if mu is None:
            why = "rejects disturbances" if first == 1.0 else "the largest of those tried"
            reasons.append(f"mu = {first:g}: {'the largest for integral action' if first == highest < 1.0 else why}")
        if alpha is None:
            if options.d_max:
                largest = fastest_rejecting(system, start, largest, options, ROUGH, say)
            options = replace(options, alpha=SHARE_OF_ALPHA * largest)
            which = f" that rejects |d| <= {options.d_max:g}" if options.d_max else ""
            reasons.append(
                f"alpha = {options.alpha:.4g} 1/s: half of the largest one{which}, found to about {100 * ROUGH:g} %"
            )
    return Choice(options, (*reasons, *of_bounds), start)


def synthesize(system: System, mu: float | None = None, alpha: float | None = None, **options: Any) -> Design:
    """Return the homogeneous controller made from the gain K of a system; what is not given is chosen.

    Parameters
    ----------
    system
        The linear model with its gain K.
    mu
        Degree, 0 < mu <= 1; None: 1, or the largest of some at which a solution is found.
    alpha
        Convergence rate [1/s] of (11); None: half of the largest one for which a solution is found.
    **options
        Further entries of `Options`, such as u_max.

    Returns
    -------
    Design
        With its certificate.

    Raises
    ------
    UserError
        For a system without a gain, or a gain or an option that cannot be used.
    InfeasibleError
        Where there is no design, or none is found.

    Examples
    --------
    >>> from ihc_fmu import System, synthesize
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> design = synthesize(cart, u_max=[3.0])
    >>> design.mu, round(design.alpha, 2), design.u_max.round(3).tolist()
    (1.0, 0.29, [3.0])
    """
    return inverse_design(system, chosen_options(system, mu, alpha, **options).options)


def degrees(system: System) -> tuple[float, ...]:
    """Return the mu that are tried where none is given, in this order: MUS, with integral action those up to 1/2."""
    return tuple(mu for mu in MUS if mu <= largest_mu(system))


def _first_mu(
    system: System, mus: Sequence[float], alpha: float | None, beta: float, say: Say
) -> tuple[float, float, Problem]:
    """Return the first mu for which alpha, or any, is feasible, the largest alpha there, and where P = I serves up to it."""
    for mu in mus:
        try:
            largest, start = fastest(system, mu, ROUGH, say, beta)
        except InfeasibleError:
            if mu == mus[-1]:
                raise
            continue
        if alpha is None or alpha < largest or mu == mus[-1]:
            return mu, largest, start
    raise AssertionError


def _bounds_from_limits(system: System) -> tuple[list[float], str]:
    room = system.room
    limited = np.isfinite(room)
    least, most = (scale / SHARE_OF_LIMIT for scale in SCALES)
    for q, size in zip(system.inputs, room, strict=True):
        if np.isfinite(size) and not least <= size <= most:
            raise UserError(
                f"limits must leave a room of {least:g} to {most:g} around the inputs at the equilibrium, half of which is "
                f"u_max where none is given, found {size:g} for {q.name}"
            )
    bounds = np.where(limited, SHARE_OF_LIMIT * room, 1.0).tolist()
    shown = ", ".join(f"{bound:g}{q.suffix}" for bound, q in zip(bounds, system.inputs, strict=True))
    half = "half of the room within the limits"
    source = half if limited.all() else "1 without limits" if not limited.any() else f"{half}, without limits 1"
    return bounds, f"u_max = {shown}: the homogeneous part of the control on the unit ball; {source}"
