"""Multi-objective search by NSGA-II, in pymoo's implementation.

K. Deb, A. Pratap, S. Agarwal and T. Meyarivan, IEEE Trans. Evolutionary Computation 6(2), 2002, 182-197.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fmu_export.errors import UserError

Array = np.ndarray


def check_installed() -> None:
    """Raise UserError where pymoo is not installed, which is an extra."""
    _pymoo()


def _pymoo() -> tuple[Any, Any, Any, Any]:
    try:
        from pymoo.algorithms.moo.nsga2 import NSGA2  # noqa: PLC0415 - an extra
        from pymoo.core.evaluator import Evaluator  # noqa: PLC0415
        from pymoo.core.problem import Problem  # noqa: PLC0415
        from pymoo.problems.static import StaticProblem  # noqa: PLC0415
    except ModuleNotFoundError:
        raise UserError('tune --pareto needs pymoo: pip install "qube-ihc[pareto]"') from None
    return NSGA2, Evaluator, Problem, StaticProblem


def nondominated(
    evaluate: Callable[[int, Array], tuple[Array, Array]], first: Array, objectives: int, generations: int, seed: int
) -> Array:
    """Return the feasible points (k, n) of the last generation that no other of it is better than in every objective.

    Points are in the unit cube. `first` (population, n) is the first generation. `evaluate(generation, points)` returns
    what is to be small (k, objectives), and by how much each point is infeasible (k, 1), 0: it is feasible; every feasible
    point is before every infeasible one. The same evaluations and seed lead to the same points.
    """
    NSGA2, Evaluator, Problem, StaticProblem = _pymoo()
    population, size = first.shape
    space = Problem(n_var=size, n_obj=objectives, n_ieq_constr=1, xl=np.zeros(size), xu=np.ones(size))
    algorithm = NSGA2(pop_size=population, sampling=first)
    algorithm.setup(space, termination=("n_gen", generations), seed=seed, verbose=False)
    generation = 0
    while algorithm.has_next():
        generation += 1
        asked = algorithm.ask()
        F, G = evaluate(generation, asked.get("X"))
        Evaluator().eval(StaticProblem(space, F=F, G=G), asked)
        algorithm.tell(infills=asked)
    best = algorithm.opt
    return best.get("X")[best.get("FEAS").ravel()]
