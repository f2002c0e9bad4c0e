"""The largest convergence rate alpha of a linear controller's homogeneous one, by the inequalities (11)."""

from __future__ import annotations

import numpy as np

from .arguments import check_kind
from .arrays import QUIET
from .closed_loop import check_gain, closed_loop
from .design import Design
from .largest_ball import rejecting
from .lmi import MARGIN, SEARCH_TIME, InfeasibleError, Limit, Problem, Say, decay, faster, is_refuted, search
from .options import Options
from .system import System

FINE = 1e-5
"""Share of the way, on a logarithmic scale, to which the largest alpha of a design is found."""
SLOWEST = 1e-5
"""Of the largest alpha without a disturbance: the slowest one at which the rejection of a disturbance is tried."""


@QUIET
def largest_alpha(
    system: System, mu: float = 1.0, tolerance: float = 1e-4, say: Say = None, beta: float = 0.0
) -> float:
    """Return the largest alpha [1/s] for which a solution of (11) is found, within the relative `tolerance`, from below.

    It lies below the decay rate of the slowest pole, because every w_i is at least 1.

    Parameters
    ----------
    system
        The linear model with its gain K.
    mu
        Minus the degree of homogeneity, in (0, 1].
    tolerance
        Relative one of the result.
    say
        Is told how a long search goes.
    beta
        As in `Options`.

    Returns
    -------
    float
        The largest alpha [1/s] that was found, from below.

    Raises
    ------
    UserError
        As `inverse_design`.
    InfeasibleError
        Where no solution is found for any alpha.

    Examples
    --------
    >>> from ihc_fmu import System, largest_alpha
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> [round(largest_alpha(cart, mu, 1e-3), 2) for mu in (1.0, 0.5)]
    [0.59, 0.85]
    """
    check_kind("system", system, System, "a System")
    return fastest(system, mu, tolerance, say, beta)[0]


@QUIET
def largest_alpha_of(design: Design, options: Options, say: Say = None) -> float:
    """Return the largest alpha [1/s] for the gain and mu of a design under its `options` beside alpha, from below.

    Its P is where the search begins. psi changes nothing: a small enough ball serves for any. Raises as `largest_alpha`.
    """
    problem, omega = closed_loop(design.system, options.beta)
    problem = problem.to(problem.S.T @ design.P @ problem.S)
    first = design.alpha / omega
    if problem.margin(design.mu, first) <= MARGIN:
        most, problem = fastest(design.system, design.mu, 10 * FINE, say, options.beta)
    else:
        most = faster(problem, design.mu, (first, np.inf), Limit(SEARCH_TIME, say), FINE).a * omega
    return fastest_rejecting(design.system, problem, most, options, 10 * FINE, say) if options.d_max else most


def fastest(system: System, mu: float, tolerance: float, say: Say, beta: float) -> tuple[float, Problem]:
    """Return `largest_alpha`, and the inequalities where P = I serves up to there."""
    check_gain(system)
    problem, omega = closed_loop(system, beta)
    reached = search(problem, mu, np.inf, Limit(SEARCH_TIME, say), tolerance / 10)
    if reached.mu < mu:
        rate = decay(problem) * omega
        refuted = is_refuted(reached.problem, mu, reached.a)
        why = (
            "the matrix inequalities have no solution"
            if refuted
            else "no solution of the matrix inequalities was found"
        )
        raise InfeasibleError(f"{why} for any alpha down to {1e-5 * rate:.2g} 1/s", numerical=not refuted)
    return reached.a * omega, reached.problem


def fastest_rejecting(
    system: System, start: Problem, most: float, options: Options, tolerance: float, say: Say
) -> float:
    """Return the largest alpha [1/s] up to `most` at which |d| <= d_max is rejected, within the relative `tolerance`.

    `start` is where P = I serves without a disturbance. What serves for an alpha serves for a smaller one, with the same
    multiplier, so that this is a bisection that keeps the multipliers that served. Raises InfeasibleError where none does.
    """
    omega, limit = closed_loop(system, options.beta)[1], Limit(SEARCH_TIME, say)
    low, high = SLOWEST * most, most
    shares = rejecting(system, start, omega, low, options)
    if not shares:
        raise InfeasibleError(
            f"no P proves the rejection of |d| <= {options.d_max:g} for any alpha down to {low:.2g} 1/s", numerical=True
        )
    while high > (1.0 + tolerance) * low and not limit.reached(f"at alpha = {low:.3g} 1/s with d_max"):
        middle = float(np.sqrt(low * high))
        served = rejecting(system, start, omega, middle, options, shares)
        low, high, shares = (middle, high, served) if served else (low, middle, shares)
    return low
