"""Matrix inequalities of a homogeneous controller, solved so that solutions that exist are found.

Everything here is in scaled block coordinates: z = T x with time in 1/omega. The inequalities

    M' P + P M < 0,  M = A_cl + a W,      W' P + P W > 2 beta P,      W = I + mu E,  E = T diag(k - i) T^-1

ask for one quadratic Lyapunov function of A_cl + a W and of beta I - W. At mu = 0, where W = I, that of A_cl + a I
serves. From there mu is raised in steps (a homotopy): while the last P passes by its eigenvalues nothing is solved; else
one small program is, in the coordinates in which the last P is the unit matrix, so that the numbers that a solver sees
stay near 1. It finds what a single program does not, whose numbers span many decades from five integrators on.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_lyapunov

from fmu_export.errors import UserError

Array = np.ndarray

Say = Callable[[str], object] | None
"""Is told how a long search goes, a sentence each time."""
SEARCH_TIME = 300.0
"""Longest time for one search of a design [s]."""
SOLVER_TIME = 120.0
"""Longest time for one semidefinite program [s]."""
RANGE = 1e3
"""Eigenvalues of P in the coordinates of the last one lie within 1/RANGE and RANGE."""
FIRST_STEP, LEAST_STEP, GROWTH = 0.25, 0.01, 1.5
"""Of the homotopy, as a share of the way."""
NOTHING = 1e-8
"""Margin, relative to the trace of P, that is none."""
DUALS, CLEAR, NARROW = 5, 1e-6, 1e-6
"""Programs for a refutation, what is a clear one, and the smallest eigenvalue of Z_1 + Z_2 that the next is scaled by."""
MARGIN = 1e-12
"""By which an inequality must hold to count as held, relative to the size of its terms: above rounding. Slow and fast
motions stand side by side in it; whether a design holds is decided by its certificate."""
STIFFEST = 1e6
"""Ratio of the largest rate in a problem to that of its slowest pole up to which the dual's margins tell anything."""


class InfeasibleError(UserError):
    """The matrix inequalities have no solution for the given numbers, or none was found.

    Parameters
    ----------
    message
        What was asked for, and what came of it.
    numerical
        Whether none was found although none is refuted either.

    Examples
    --------
    >>> from ihc_fmu import InfeasibleError, System, synthesize
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> try:
    ...     synthesize(cart, mu=1.0, alpha=2.0)
    ... except InfeasibleError as error:
    ...     print(error, error.numerical)
    alpha = 2 1/s, mu = 1: the matrix inequalities have no solution False
    """

    def __init__(self, message: str, *, numerical: bool = False) -> None:
        super().__init__(message)
        self.numerical = numerical


@dataclass(frozen=True, eq=False)
class Problem:
    """The inequalities in some coordinates y: A_cl (n, n) in scaled time, E (n, n), B (n, m), beta; x = S y, y = R x.

    R (n, n), the inverse of S, is carried along: P = R' R, where y' y serves, is right to rounding however flat it is in x.
    """

    closed: Array
    E: Array
    B: Array
    S: Array
    R: Array
    beta: float

    def to(self, P: Array) -> Problem:
        """Return the problem in coordinates in which y' P y is a sum of squares; LinAlgError unless P > 0."""
        L_t = np.linalg.cholesky((P + P.T) / 2).T
        inverse = np.linalg.inv(L_t)
        return Problem(
            L_t @ self.closed @ inverse, L_t @ self.E @ inverse, L_t @ self.B, self.S @ inverse, L_t @ self.R, self.beta
        )

    def both(self, mu: float, a: float) -> tuple[Array, Array]:
        """Return M and beta I - W, of which P is to be a common Lyapunov function."""
        W = np.eye(len(self.E)) + mu * self.E
        return self.closed + a * W, self.beta * np.eye(len(W)) - W

    def margin(self, mu: float, a: float) -> float:
        """Return by how much P = I satisfies both inequalities, relative to their matrices; negative where it does not."""
        return min(-float(np.linalg.eigvalsh(F + F.T)[-1]) / _size(F) for F in self.both(mu, a))


def flatness(problem: Problem) -> float:
    """Return lambda_min/lambda_max of P = R' R with its diagonal scaled to 1."""
    columns = problem.R / np.abs(problem.R).max(axis=0)  # whose squares stay within the range of numbers
    values = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), compute_uv=False)
    return float(values[-1] / values[0]) ** 2


def _size(F: Array) -> float:
    """Return the norm of a matrix by which it is made one near 1; that of 0 is any."""
    return float(np.linalg.norm(F, 2)) or 1.0


def solve(problem: Any, what: str) -> None:
    """Solve with Clarabel, an interior-point method; raise InfeasibleError that says what has no solution."""
    import cvxpy as cp  # noqa: PLC0415 - slow to import, needed only here

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an inaccurate solution is judged by its certificate
        try:
            # a warm start would make the same call's result depend on the calls before it
            problem.solve(solver=cp.CLARABEL, time_limit=SOLVER_TIME, warm_start=False)
        except cp.SolverError:
            message = f"{what}: the solver failed numerically on the matrix inequalities"
            raise InfeasibleError(message, numerical=True) from None
    if problem.status == cp.USER_LIMIT:
        message = (
            f"{what}: the solver reached its limit of iterations or of {SOLVER_TIME:g} s on the matrix inequalities"
        )
        raise InfeasibleError(message, numerical=True)
    if problem.status not in {cp.OPTIMAL, cp.OPTIMAL_INACCURATE}:
        raise InfeasibleError(f"{what}: the matrix inequalities have no solution (solver: {problem.status})")


def lyapunov(problem: Problem, a: float) -> Problem | None:
    """Return the problem in the coordinates of the Lyapunov function of A_cl + a I; None where there is none."""
    n = len(problem.E)
    F = problem.closed + a * np.eye(n)
    if np.linalg.eigvals(F).real.max() >= 0.0:
        return None
    for _ in range(2):  # the second time in coordinates in which rounding has little to spoil
        try:
            problem = problem.to(solve_continuous_lyapunov(F.T, -np.eye(n) * np.linalg.norm(F, 2)))
        except (LinAlgError, ValueError):
            return None
        F = problem.closed + a * np.eye(n)
    return problem


@lru_cache(maxsize=4)
def _step_program(n: int) -> Any:
    """Return (problem, P, F_1, F_2): maximize t with -(F_i' P + P F_i) >= t I, I/RANGE <= P <= RANGE I."""
    import cvxpy as cp  # noqa: PLC0415

    P, t = cp.Variable((n, n), symmetric=True), cp.Variable()
    matrices = [cp.Parameter((n, n)) for _ in range(2)]
    held = [-(P @ F + F.T @ P) >> t * np.eye(n) for F in matrices]
    problem = cp.Problem(cp.Maximize(t), [*held, P >> np.eye(n) / RANGE, P << RANGE * np.eye(n), t <= 1.0])
    return problem, P, matrices


def improved(problem: Problem, mu: float, a: float) -> Problem | None:
    """Return the problem in the coordinates of a P that satisfies both inequalities; None where none is found."""
    program, P, matrices = _step_program(len(problem.E))
    for parameter, F in zip(matrices, problem.both(mu, a), strict=True):
        parameter.value = F / _size(F)
    try:
        solve(program, "a step")
        problem = problem.to(np.asarray(P.value))
    except (InfeasibleError, LinAlgError):
        return None
    return problem if problem.margin(mu, a) > MARGIN else None


@dataclass
class Limit:
    """How long a search may take, and who wants to know of it: called with a sentence."""

    seconds: float
    say: Say = None
    end: float = 0.0

    def __post_init__(self) -> None:
        self.end = time.monotonic() + self.seconds

    def reached(self, sentence: str) -> bool:
        """Tell `sentence` and return whether the time is over."""
        if self.say is not None:
            self.say(sentence)
        return time.monotonic() > self.end


def walk(
    start: Problem, path: Callable[[float], tuple[float, float]], limit: Limit, least: float = LEAST_STEP
) -> tuple[Problem, float]:
    """Follow the path s -> (mu, a) from s = 0, where P = I serves, towards s = 1; return the last problem and its s."""
    reached, step, problem = 0.0, FIRST_STEP, start
    while reached < 1.0 and step >= least:
        s = min(1.0, reached + step)
        mu, a = path(s)
        if limit.reached(f"at mu = {mu:.3g}, alpha = {a:.3g} in scaled time"):
            break
        following = problem if problem.margin(mu, a) > MARGIN else improved(problem, mu, a)
        if following is None:
            step /= 2.0
        else:
            problem, reached, step = following, s, step * GROWTH
    return problem, reached


@dataclass(frozen=True, eq=False)
class Search:
    """What a search found: the problem in the coordinates of the last P, how far it got, and whether that is the goal."""

    problem: Problem
    mu: float
    a: float
    complete: bool


def search(problem: Problem, mu: float, a: float, limit: Limit, least: float = LEAST_STEP) -> Search:
    """Return a P for (mu, a), or how far one was found: mu is raised at some small a, then a.

    For a = infinity that is the largest a, to the share `least` of its way on a logarithmic scale.
    """
    best = Search(problem, 0.0, 0.0, complete=False)
    rate = decay(problem)
    for slow in (0.02 * rate, 1e-3 * rate, 1e-5 * rate, a):
        if best is not None and (slow >= a or best.mu >= mu):
            continue
        first = min(slow, a)
        start = lyapunov(problem, first)
        if start is None:
            continue
        there, s = walk(start, lambda s, first=first: (s * mu, first), limit)
        attempt = Search(there, s * mu, first, complete=s >= 1.0)
        if attempt.complete and first < a:
            attempt = faster(there, mu, (first, a), limit, least)
        if attempt.complete:
            return attempt
        if (attempt.mu, attempt.a) > (best.mu, best.a):
            best = attempt
    return best


def faster(problem: Problem, mu: float, a: tuple[float, float], limit: Limit, least: float) -> Search:
    """Return a P for (mu, a[1]), or how far one was found, from a problem in which P = I serves for (mu, a[0])."""
    rate = decay(problem)
    first, ratio = a[0], max(1.0, min(a[1], rate) / a[0])
    there, s = walk(problem, lambda s: (mu, first * ratio**s), limit, least)
    return Search(there, mu, first * ratio**s, complete=s >= 1.0 and a[1] <= rate)


def decay(problem: Problem) -> float:
    """Return the decay rate of the slowest pole in scaled time."""
    return -float(np.linalg.eigvals(problem.closed).real.max())


def is_refuted(problem: Problem, mu: float, a: float) -> bool:
    """Return whether the dual shows that no P serves, in coordinates in which a P for less is the unit matrix.

    For any Z_1, Z_2 >= 0 of traces that sum up to 1, the smallest eigenvalue -t of F_1 Z_1 + Z_1 F_1' + F_2 Z_2 + Z_2 F_2',
    F_i relative to their norms, bounds what is to be found: a P of trace 1 satisfies both F_i' P + P F_i <= -s I for no s
    beyond t. In bad coordinates it is near 0 whether or not there is a P, so that it is computed again where Z_1 + Z_2 is
    the unit matrix, until it is clear. What would hold there by less than NOTHING cannot be told from rounding, and counts
    as refuted: where parts of a system are apart and only one of them has no P, -t is 0 at best.
    """
    if float(np.linalg.norm(problem.closed, 2)) > STIFFEST * decay(problem):
        return False
    least = -np.inf
    for _ in range(DUALS):
        matrices = [F / _size(F) for F in problem.both(mu, a)]
        try:
            Z = _dual(matrices)
        except InfeasibleError:
            break
        total = _dual_sum(matrices, Z)
        least = float(np.linalg.eigvalsh((total + total.T) / 2)[0])
        if abs(least) > CLEAR:
            break
        problem = problem.to(np.linalg.inv(Z[0] + Z[1] + NARROW * np.eye(len(total))))
    return least > -NOTHING


def _dual(matrices: Sequence[Array]) -> list[Array]:
    """Return Z_1 and Z_2 of traces that sum up to 1, with the largest -t that the solver finds; raises as `solve`."""
    import cvxpy as cp  # noqa: PLC0415

    n = len(matrices[0])
    Z = [cp.Variable((n, n), PSD=True) for _ in matrices]
    t = cp.Variable()
    size: Any = cp.trace(Z[0]) + cp.trace(Z[1])
    solve(cp.Problem(cp.Maximize(t), [_dual_sum(matrices, Z) >> t * np.eye(n), size == 1]), "the dual")
    values = [_positive_part(np.asarray(Y.value)) for Y in Z]
    whole = sum(float(np.trace(Y)) for Y in values)
    return [Y / whole for Y in values]


def _dual_sum(matrices: Sequence[Array], Z: Sequence[Any]) -> Any:
    first, second = (F @ Y + Y @ F.T for F, Y in zip(matrices, Z, strict=True))
    return first + second


def _positive_part(Y: Array) -> Array:
    values, vectors = np.linalg.eigh((Y + Y.T) / 2)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T
