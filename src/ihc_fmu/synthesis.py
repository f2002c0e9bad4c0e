"""Designs by matrix inequalities: from a linear controller (inverse), or without one (direct).

The solver's word is not taken: a `Design` proves itself from its numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_lyapunov
from scipy.optimize import brentq

from fmu_export.errors import UserError

from .block_form import BlockForm
from .design import Design
from .integral import check_degree, largest_mu
from .largest_ball import FEWER_DIGITS, largest_ball, rejecting
from .lmi import MARGIN, InfeasibleError, Limit, Problem, decay, faster, flatness, is_refuted, search
from .options import SCALES, Options
from .system import QUIET, System

Array = np.ndarray

SEARCH_TIME = 300.0
"""Longest time for one search [s]."""
FINE = 1e-5
"""Share of the way, on a logarithmic scale, to which the largest alpha of a design is found."""
FASTER, RATES = 3.0, 20
"""Factor between the rates that a direct design tries from alpha on, and their number."""
MUS = (1.0, 0.75, 0.5, 0.25)
"""Degrees that are tried where none is given."""
SLOWEST = 1e-5
"""Of the largest alpha without a disturbance: the slowest one at which the rejection of a disturbance is tried."""
SHARE_OF_ALPHA, SHARE_OF_LIMIT, ROUGH = 0.5, 0.5, 1e-2
"""What is chosen: alpha relative to the largest one, which is found to ROUGH, and u_max relative to the limits' room."""
FLAT = 1e-8
"""Of P's eigenvalues, its diagonal scaled to 1: for flatter balls a direct design is made for a faster rate than alpha."""
DIRECT_MARGIN = 1.2
"""Of the closed form of a direct design: it is for this multiple of alpha."""

MOST_ORDERED = 6
"""States up to which all orders of a gain's entries are tried for a hint."""
SIGNS = ((1.0, ""), (-1.0, " and the sign of u = -K x"))

Say = Callable[[str], object] | None


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
    """
    options = options or Options()
    options.bounds(system.m)
    _check_gain(system)
    problem, omega = _closed_loop(system, options.beta)
    a = options.alpha / omega
    what = f"alpha = {options.alpha:g} 1/s, mu = {options.mu:g}"
    if start is not None and replace(start, beta=options.beta).margin(options.mu, a) > MARGIN:
        return largest_ball(system, start, omega, options.alpha, options, what)
    found = search(problem, options.mu, a, Limit(SEARCH_TIME, say))
    if not found.complete:
        if is_refuted(found.problem, options.mu, a):
            raise InfeasibleError(f"{what}: the matrix inequalities have no solution")
        raise InfeasibleError(f"{what}: no solution of the matrix inequalities was found", numerical=True)
    return largest_ball(system, found.problem, omega, options.alpha, options, what)


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
    """
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
    found = [roundness(float(rate)) for rate in rates]
    wanted = min(FLAT, max(found) / 2)
    first = next(i for i, value in enumerate(found) if value >= wanted)
    if first == 0:
        return options.alpha
    low, high = rates[first - 1 : first + 1]
    found_rate: Any = brentq(lambda rate: np.log(max(roundness(rate), 1e-300) / wanted), low, high)
    return float(found_rate)


def _closed_form(system: System, options: Options, rate: float, bounds: Array) -> Problem:
    """Return the nilpotent system where y' y <= 1 is the unit ball of the direct design in closed form, alpha = `rate`."""
    form = system.form.normal(rate)
    problem = _problem(form, form.N / rate, options.beta)
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


def _problem(form: BlockForm, closed: Array, beta: float) -> Problem:
    E = np.diag(np.array(form.exponents, dtype=float))
    return Problem(closed, E, form.Bz, form.T_inverse, form.T, beta)


def _check_gain(system: System) -> None:
    if system.K is None:
        raise UserError("an inverse design needs a linear controller: K, k_lin or lqr in the system")
    slowest = _slowest(system, system.K)
    if slowest >= 0.0:
        _ = system.form  # refuses a pair for which no gain might
        raise UserError(
            f"K must stabilize (A, B): the largest real part of the poles is {slowest:.4g} 1/s{_hint(system)}"
        )


def _slowest(system: System, K: Array) -> float:
    return float(np.linalg.eigvals(system.A + system.B @ K).real.max())


def _hint(system: System) -> str:
    """Return what would make a gain that does not stabilize do so: its sign, or another order of its entries.

    That is a usual order, or of all orders of up to MOST_ORDERED states the only one, but for equal entries, that does.
    """
    K, n = system.K, system.n
    assert K is not None
    if _slowest(system, -K) < 0.0:
        return "; -K does: the law is u = +K x here, not u = -K x"
    # K for angle, rate, angle, rate and A for angle, angle, rate, rate, or the other way round
    for size in (n // 2, 2) if n % 2 == 0 else ():
        order = np.arange(n).reshape(-1, size).T.ravel()
        for sign, law in SIGNS:
            if _slowest(system, sign * K[:, np.argsort(order)]) < 0.0:
                return _order(system, order, law)
    if n <= MOST_ORDERED:
        orders = np.array(list(permutations(range(n))))
        gains = K[:, np.argsort(orders, axis=1)].swapaxes(0, 1)
        for sign, law in SIGNS:
            does = np.linalg.eigvals(system.A + sign * system.B @ gains).real.max(axis=1) < 0.0
            if does.any():
                only = len(np.unique(gains[does], axis=0)) == 1
                return _order(system, orders[does.argmax()], law) if only else ""
    return ""


def _order(system: System, order: Array, law: str) -> str:
    names = ", ".join(system.states[i].name for i in order)
    return f"; K seems to be in the order ({names}){law}, unlike A"


def _closed_loop(system: System, beta: float) -> tuple[Problem, float]:
    """Return the inequalities of an inverse design, and omega [1/s], in which its time is scaled.

    omega is the geometric mean of the closed loop's poles.
    """
    assert system.K is not None
    form = system.form
    closed = form.T @ (system.A + system.B @ system.K) @ form.T_inverse
    omega = float(np.exp(np.linalg.slogdet(closed)[1] / system.n))
    form = form.normal(omega)
    closed = form.T @ (system.A + system.B @ system.K) @ form.T_inverse / omega
    slowest = float(np.linalg.eigvals(closed).real.max()) * omega
    if slowest >= 0.0:
        raise UserError(
            "K must stabilize (A, B) whatever the rounding: the largest real part of the poles is "
            f"{_slowest(system, system.K):.4g} 1/s as given, but {slowest:.4g} 1/s in scaled block coordinates"
        )
    return _problem(form, closed, beta), omega


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
    """
    return _fastest(system, mu, tolerance, say, beta)[0]


@QUIET
def largest_alpha_of(design: Design, options: Options, say: Say = None) -> float:
    """Return the largest alpha [1/s] for the gain and mu of a design under its `options` beside alpha, from below.

    Its P is where the search begins. psi changes nothing: a small enough ball serves for any. Raises as `largest_alpha`.
    """
    problem, omega = _closed_loop(design.system, options.beta)
    problem = problem.to(problem.S.T @ design.P @ problem.S)
    first = design.alpha / omega
    if problem.margin(design.mu, first) <= MARGIN:
        most, problem = _fastest(design.system, design.mu, 10 * FINE, say, options.beta)
    else:
        most = faster(problem, design.mu, (first, np.inf), Limit(SEARCH_TIME, say), FINE).a * omega
    return _fastest_rejecting(design.system, problem, most, options, 10 * FINE, say) if options.d_max else most


def _fastest(system: System, mu: float, tolerance: float, say: Say, beta: float) -> tuple[float, Problem]:
    """Return `largest_alpha`, and the inequalities where P = I serves up to there."""
    _check_gain(system)
    problem, omega = _closed_loop(system, beta)
    found = search(problem, mu, np.inf, Limit(SEARCH_TIME, say), tolerance / 10)
    if found.mu < mu:
        rate = decay(problem) * omega
        refuted = is_refuted(found.problem, mu, found.a)
        why = (
            "the matrix inequalities have no solution"
            if refuted
            else "no solution of the matrix inequalities was found"
        )
        raise InfeasibleError(f"{why} for any alpha down to {1e-5 * rate:.2g} 1/s", numerical=not refuted)
    return found.a * omega, found.problem


def _fastest_rejecting(
    system: System, start: Problem, most: float, options: Options, tolerance: float, say: Say
) -> float:
    """Return the largest alpha [1/s] up to `most` at which |d| <= d_max is rejected, within the relative `tolerance`.

    `start` is where P = I serves without a disturbance. What serves for an alpha serves for a smaller one, with the same
    multiplier, so that this is a bisection that keeps the multipliers that served. Raises InfeasibleError where none does.
    """
    omega, limit = _closed_loop(system, options.beta)[1], Limit(SEARCH_TIME, say)
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
    """
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
        found, largest, start = _first_mu(system, mus, alpha, options.beta, say)
        options = replace(options, mu=found)
        if mu is None:
            why = "rejects disturbances" if found == 1.0 else "the largest of those tried"
            reasons.append(f"mu = {found:g}: {'the largest for integral action' if found == highest < 1.0 else why}")
        if alpha is None:
            if options.d_max:
                largest = _fastest_rejecting(system, start, largest, options, ROUGH, say)
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
            largest, start = _fastest(system, mu, ROUGH, say, beta)
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
