"""Searches in the unit cube: NSGA-II for several objectives at once in pymoo, CMA-ES for one number in pycma.

K. Deb, A. Pratap, S. Agarwal and T. Meyarivan, IEEE Trans. Evolutionary Computation 6(2), 2002, 182-197;
N. Hansen and A. Ostermeier, Evolutionary Computation 9(2), 2001, 159-195.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from fmu_export.errors import UserError

Array = np.ndarray

STEP = 0.1
"""First standard deviation of CMA-ES, of an edge of the cube."""


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


def descended(evaluate: Callable[[int, int, Array], Array], start: Array, points: int, seed: int) -> None:
    """Look for the least value from `start` (n,) on, with some `points` evaluations.

    `evaluate(generation, generations, points)` takes points (k, n) and returns their values (k,), whatever is worse being
    larger; it keeps what it wants of them. The same evaluations and seed lead to the same points. It ends sooner where
    CMA-ES finds nothing more to gain.
    """
    import cma  # noqa: PLC0415 - an extra

    size = 2 * (4 + int(3 * math.log(len(start))))  # twice the usual: values are means of few draws
    generator = np.random.default_rng(seed)
    options = {"bounds": [0.0, 1.0], "popsize": size, "seed": math.nan, "verbose": -9}
    options["randn"] = lambda *shape: generator.standard_normal(shape)
    search = cma.CMAEvolutionStrategy(np.clip(start, 0.0, 1.0), STEP, options)
    generations = -(-points // size)
    for generation in range(1, generations + 1):
        if search.stop():
            return
        asked = search.ask()
        search.tell(asked, evaluate(generation, generations, np.clip(np.array(asked), 0.0, 1.0)).tolist())
