"""The inverse design: from a linear controller, eqs. (10) and (11).

The solver's word is not taken: a `Design` proves itself from its numbers.
"""

from __future__ import annotations

from dataclasses import replace

from .arguments import check_kind
from .arrays import QUIET
from .closed_loop import check_gain, closed_loop
from .design import Design
from .largest_ball import largest_ball
from .lmi import MARGIN, SEARCH_TIME, InfeasibleError, Limit, Problem, Say, is_refuted, search
from .options import Options
from .system import System


@QUIET
def inverse_design(
    system: System, options: Options | None = None, say: Say = None, start: Problem | None = None
) -> Design:
    """Return the IHC that equals the stabilizing LC u = K x of `system` on its unit sphere, eqs. (10) and (11).

    With X = P^-1 and A_cl = A + B K = A_0 + B (K - K_0): maximize log det X, the largest unit ball, subject to

        A_cl X + X A_cl' + alpha (G_d X + X G_d') + disturbance terms <= 0,   G_d X + X G_d' >= 2 beta X,
        (K - K_0)_i X (K - K_0)_i' <= u_max_i^2   and/or   X_ii <= delta_max^2,

    from a P that satisfies the inequalities: that of `start`, which a `Choice` has, or one found by `search`. The units of
    states, inputs and time change nothing but by rounding: P relative to itself by 1e-6, or by 1e-16 over
    `Certificate.positive` where that is more.

    Parameters
    ----------
    system
        The linear model with the gain K of the linear controller.
    options
        What is asked for; None: as by default, `chosen_options` fits them to the system.
    say
        Is told how a long search goes, a sentence each time.
    start
        Where P = I serves, of a `Choice`; None: it is searched.

    Returns
    -------
    Design
        With its certificate.

    Raises
    ------
    UserError
        For a pair that is not controllable, or a K that does not stabilize it.
    InfeasibleError
        Where no P is found for alpha, `numerical` where none is refuted either.

    Examples
    --------
    >>> from ihc_fmu import Options, System, inverse_design
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> design = inverse_design(cart, Options(alpha=0.4, u_max=3.0))
    >>> design.u_max.round(3).tolist(), design.K.tolist()
    ([3.0], [[-4.0, -4.0]])
    """
    check_kind("system", system, System, "a System")
    options = options or Options()
    options.bounds(system.m)
    check_gain(system)
    problem, omega = closed_loop(system, options.beta)
    a = options.alpha / omega
    what = f"alpha = {options.alpha:g} 1/s, mu = {options.mu:g}"
    if start is not None and replace(start, beta=options.beta).margin(options.mu, a) > MARGIN:
        return largest_ball(system, start, omega, options.alpha, options, what)
    reached = search(problem, options.mu, a, Limit(SEARCH_TIME, say))
    if not reached.complete:
        if is_refuted(reached.problem, options.mu, a):
            raise InfeasibleError(f"{what}: the matrix inequalities have no solution")
        raise InfeasibleError(f"{what}: no solution of the matrix inequalities was found", numerical=True)
    return largest_ball(system, reached.problem, omega, options.alpha, options, what)
