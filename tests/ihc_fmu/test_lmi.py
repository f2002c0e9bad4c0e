"""The homotopy finds what exists, and the dual refutes what does not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag

from ihc_fmu.lmi import MARGIN, InfeasibleError, Limit, Problem, decay, is_refuted, lyapunov, search, solve, walk

SPREAD = (1.0, 10.0)
"""Magnitudes of the slowest and the fastest of the spread poles."""


def poles(n, kind):
    if kind == "equal":
        return -np.ones(n)
    if kind == "butterworth":
        return np.exp(1j * np.pi * (2 * np.arange(1, n + 1) + n - 1) / (2 * n))
    return -np.geomspace(*SPREAD, n)


def chain(n, kind, beta=0.1) -> Problem:
    """Return the problem of n integrators with a gain for these poles, in time scaled by their geometric mean."""
    values = poles(n, kind)
    values = values / np.exp(np.log(np.abs(values)).mean())
    closed = np.eye(n, k=1)
    closed[-1] = -np.poly(values).real[:0:-1]
    return Problem(closed, np.diag(np.arange(n - 1.0, -1.0, -1.0)), np.eye(n)[:, -1:], np.eye(n), np.eye(n), beta)


def check(problem, solution, mu, a):
    """The inequalities in the coordinates of the given problem, by eigenvalues of the numbers found."""
    inverse = np.linalg.inv(solution.problem.S)
    P = inverse.T @ inverse
    n = len(P)
    W = np.eye(n) + mu * problem.E
    L = np.linalg.cholesky(P)
    for F in (problem.closed + a * W, problem.beta * np.eye(n) - W):
        relative = np.linalg.solve(L, np.linalg.solve(L, (P @ F + F.T @ P)).T)
        assert np.linalg.eigvalsh((relative + relative.T) / 2)[-1] < 0.0


@pytest.mark.parametrize("kind", ["equal", "butterworth", "spread"])
@pytest.mark.parametrize("n", [4, 5, 6, 7, 8])
def test_chains_of_integrators_are_found_at_full_degree(n, kind):
    problem = chain(n, kind)
    a = 0.02 * decay(problem)
    solution = search(problem, 1.0, a, Limit(60.0))
    assert solution.complete
    check(problem, solution, 1.0, a)


@pytest.mark.parametrize("kind", ["equal", "butterworth", "spread"])
def test_what_is_infeasible_is_refuted_by_the_dual(kind):
    """Every w_i is at least 1, so that no alpha beyond the slowest pole has a solution; the dual shows it, and not more."""
    problem = chain(4, kind)
    a = 1.01 * decay(problem)
    solution = search(problem, 1.0, a, Limit(20.0))
    assert not solution.complete
    assert is_refuted(solution.problem, 1.0, a)
    feasible = search(problem, 1.0, 0.02 * decay(problem), Limit(20.0))
    assert not is_refuted(feasible.problem, 1.0, 0.02 * decay(problem))


def test_bad_coordinates_refute_nothing():
    """A chain with a solution, in coordinates of very different sizes, where the dual is within 1e-8 of refuting it."""
    problem = chain(7, "equal")
    a = 0.02 * decay(problem)
    assert not is_refuted(problem.to(np.diag(10.0 ** np.arange(7))), 1.0, a)


def test_a_part_of_a_system_is_refuted_though_another_is_feasible():
    """Two chains side by side, a slow one and a fast one, for an alpha that only the fast one allows."""
    slow, fast = chain(2, "equal"), chain(3, "equal")
    closed: Any = block_diag(slow.closed, 4.0 * fast.closed)
    E: Any = block_diag(slow.E + np.eye(2), fast.E)
    both = Problem(closed, E, np.eye(5)[:, [1, 4]], np.eye(5), np.eye(5), 0.1)
    assert search(both, 1.0, 0.02, Limit(20.0)).complete
    solution = search(both, 1.0, 0.9, Limit(20.0))
    assert not solution.complete
    assert is_refuted(solution.problem, 1.0, 0.9)


def test_largest_alpha_of_the_double_integrator_is_that_of_a_scan():
    """Poles -1, -1, mu = 1: the largest a with a W' P + a P W <= -(A_cl' P + P A_cl), by eigenvalues for each P."""
    problem = chain(2, "equal", beta=1e-6)
    solution = search(problem, 1.0, np.inf, Limit(20.0), 1e-5)
    p, q = (grid.ravel() for grid in np.meshgrid(np.linspace(0.0, 2.0, 401), np.linspace(0.0, 4.0, 401)))
    P = np.array([[np.ones_like(p), p], [p, q]]).transpose(2, 0, 1)
    W, closed = np.diag([2.0, 1.0]), problem.closed
    monotone, decrease = P @ W + W @ P, -(P @ closed + closed.T @ P)
    valid = (np.linalg.eigvalsh(monotone)[:, 0] > 1e-9) & (np.linalg.eigvalsh(decrease)[:, 0] > 0.0)
    rates = np.linalg.eigvals(np.linalg.solve(monotone[valid], decrease[valid])).real.min(axis=1)
    assert solution.a == pytest.approx(rates.max(), rel=1e-2)
    assert solution.a > rates.max() * (1 - 1e-4)


def test_coordinates_change_neither_inequality_nor_states():
    problem = chain(4, "spread")
    start = lyapunov(problem, 0.02 * decay(problem))
    assert start is not None
    assert start.margin(0.0, 0.02 * decay(problem)) > MARGIN
    np.testing.assert_allclose(start.S @ start.closed, problem.closed @ start.S, atol=1e-9)
    np.testing.assert_allclose(start.S @ start.E, problem.E @ start.S, atol=1e-9)
    np.testing.assert_allclose(start.S @ start.B, problem.B, atol=1e-9)
    np.testing.assert_allclose(start.S @ start.R, np.eye(4), atol=1e-9)
    assert lyapunov(problem, 1.01 * decay(problem)) is None


def test_search_stops_in_time_and_tells_how_it_goes():
    problem, said = chain(4, "equal"), []
    start = lyapunov(problem, 0.02)
    assert start is not None
    _, reached = walk(start, lambda s: (s, 0.02), Limit(-1.0, said.append))
    assert reached == 0.0
    assert said == ["at mu = 0.25, alpha = 0.02 in scaled time"]


def test_search_for_an_unstable_loop_finds_nothing():
    problem = chain(3, "equal")
    solution = search(replace(problem, closed=-problem.closed), 1.0, 0.1, Limit(20.0))
    assert (solution.complete, solution.mu, solution.a) == (False, 0.0, 0.0)


def test_solver_without_a_solution_is_reported_as_infeasible():
    import cvxpy as cp

    x = cp.Variable()
    with pytest.raises(
        InfeasibleError, match=r"^this: the matrix inequalities have no solution \(solver: infeasible\)$"
    ):
        solve(cp.Problem(cp.Maximize(x), [x <= 0, x >= 1]), "this")
