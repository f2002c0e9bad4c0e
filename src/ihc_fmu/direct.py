"""The direct design: without a linear controller, eq. (9).

The solver's word is not taken: a `Design` proves itself from its numbers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_lyapunov
from scipy.optimize import brentq

from fmu_export.errors import UserError

from .arguments import check_kind
from .arrays import QUIET, Array
from .closed_loop import problem_of
from .design import Design
from .largest_ball import FEWER_DIGITS, largest_ball
from .lmi import InfeasibleError, Problem, flatness
from .options import Options
from .system import System

FASTER, RATES = 3.0, 20
"""Factor between the rates that a direct design tries from alpha on, and their number."""
FLAT = 1e-8
"""Of P's eigenvalues, its diagonal scaled to 1: for flatter balls a direct design is made for a faster rate than alpha."""
DIRECT_MARGIN = 1.2
"""Of the closed form of a direct design: it is for this multiple of alpha."""


@QUIET
def direct_design(system: System, options: Options | None = None) -> Design:
    """Return the IHC designed without a linear controller, eq. (9): K - K_0 = Y X^-1 with X and Y free.

    The objective and the bounds are those of `inverse_design`; |(K - K_0)_i x| <= u_max_i on the unit ball is the inequality
    [[u_max_i^2, Y_i], [Y_i', X]] >= 0. The result's K is the linear controller that it equals on the unit sphere; a gain of
    `system` is not used. It begins at the solution in closed form (R. W. Bass; see D. L. Kleinman, IEEE Trans. Automatic
    Control 15(6), 1970) of

        (A_0 + a G_d) X + X (A_0 + a G_d)' = 2 gamma B B',   Y = -gamma B',   a = 1.2 alpha,

    whose X is positive definite for every controllable pair. For an alpha so slow that this unit ball, beside the system's
    own motion, is flatter than FLAT, the design is for the first faster rate at which it is not, or for one with half of
    the roundest ball's: what decreases faster decreases at alpha too.

    Parameters
    ----------
    system
        The linear model.
    options
        What is asked for, u_max above all; None: as by default.

    Returns
    -------
    Design
        With its certificate; `design.K` is the gain.

    Raises
    ------
    UserError
        For a pair that is not controllable, or options without u_max.
    InfeasibleError
        As `inverse_design`.

    Examples
    --------
    >>> from ihc_fmu import Options, System, direct_design
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], states=("position [m]", "velocity [m/s]"))
    >>> design = direct_design(cart, Options(alpha=1.0, u_max=3.0))
    >>> design.K.round(2).tolist(), design.u_max.round(3).tolist()
    ([[-4.59, -3.0]], [3.0])
    """
    check_kind("system", system, System, "a System")
    options = options or Options()
    bounds = options.bounds(system.m)
    if bounds is None:
        raise UserError("a direct design needs u_max: without it K would grow beyond bounds")
    what = f"alpha = {options.alpha:g} 1/s, mu = {options.mu:g}"
    system = system.changed(K=None)
    rate = _rate(system, options, bounds)
    return largest_ball(system, _closed_form(system, options, rate, bounds), rate, rate, options, what)


def _rate(system: System, options: Options, bounds: Array) -> float:
    """Return the smallest rate [1/s] from alpha on at which the unit ball in closed form is round enough."""

    def roundness(rate: float) -> float:
        try:
            return flatness(_closed_form(system, options, rate, bounds))
        except InfeasibleError:
            return 0.0

    rates = options.alpha * FASTER ** np.arange(RATES)
    tried = [roundness(float(rate)) for rate in rates]
    wanted = min(FLAT, max(tried) / 2)
    first = next(i for i, value in enumerate(tried) if value >= wanted)
    if first == 0:
        return options.alpha
    low, high = rates[first - 1 : first + 1]
    rate: Any = brentq(lambda rate: np.log(max(roundness(rate), 1e-300) / wanted), low, high)
    return float(rate)


def _closed_form(system: System, options: Options, rate: float, bounds: Array) -> Problem:
    """Return the nilpotent system where y' y <= 1 is the unit ball of the direct design in closed form, alpha = `rate`."""
    form = system.form.normal(rate)
    problem = problem_of(form, form.N / rate, options.beta)
    B = form.Bz / rate * bounds
    F = problem.closed + DIRECT_MARGIN * np.diag(form.weights(options.mu))
    try:
        X = solve_continuous_lyapunov(F, B @ B.T)
        size = float((B * np.linalg.solve(X, B)).sum(axis=0).max())
        # X = 2 gamma X_1 with the gamma that makes the largest Y_i X^-1 Y_i' 1, in units of the bounds
        return problem.to(np.linalg.inv(X) * size / 4.0)
    except (LinAlgError, ValueError):
        message = (
            f"alpha = {rate:g} 1/s, mu = {options.mu:g}: the direct design is beyond double precision; {FEWER_DIGITS}"
        )
        raise InfeasibleError(message, numerical=True) from None
