"""Tuning for several objectives at once: the front of what can be had, found on some draws and judged on others.

NSGA-II (K. Deb, A. Pratap, S. Agarwal and T. Meyarivan, IEEE Trans. Evolutionary Computation 6(2), 2002) in pymoo's
implementation, from the LC's neighbourhood, the paper's rule's stops and a Sobol set. Every point is run in the same draws
of encoder offsets and noise; its front is run again in draws that the search did not see, and these are the numbers that
are told. A point that loses the plant in more draws than the LC, ends without the steady state that an objective
needs, or has no proven design, is infeasible: whatever its objectives, it is behind every feasible one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fmu_export.errors import UserError

from ..metric_meanings import MetricMeaning
from .draw_means import change_over, kept, mean_over
from .engine import run_numbers
from .estimates import MeanEstimate, change_text
from .experiments import laws_of
from .journal import Journal
from .numbers import Numbers
from .tunables import Setting, Tunable, TunedController
from .tuning import ROLES, Grid, Point, Tuning, TuningProblem, tune

Array = np.ndarray
Say = Callable[[str, int, int], None]

LC, RULE, FRONT, DOMINATED, LOST = "LC", "rule", "front", "dominated", "infeasible"
"""What a point is: the LC, one that the paper's rule passed, and of those that the search found: one of the front, one
that another is better than in every objective, or one that is infeasible, in the draws that the search did not see."""
WORST = 2.0
"""Violation of a point that has no design: more than losing every draw."""


@dataclass(frozen=True)
class Search:
    """How the front is looked for.

    `objectives`: metrics to make small, the first above all; `tunables`: the numbers that are varied; `limits`: largest
    values of objectives for the chosen point, relative to the LC's, by the objective's name, empty: 1 for every one but
    the first. `held_out`: draws that judge.
    """

    objectives: tuple[MetricMeaning, ...]
    tunables: tuple[Tunable, ...]
    limits: Mapping[str, float] = field(default_factory=dict)
    population: int = 32
    generations: int = 20
    held_out: int = 64
    seed: int = 1

    def __post_init__(self) -> None:
        for name, least in (("population", 4), ("generations", 1), ("held_out", 2), ("seed", 0)):
            if getattr(self, name) < least:
                raise UserError(f"{name.replace('_', '-')} must be at least {least}, found {getattr(self, name)}")
        if not self.tunables:
            raise UserError("a front needs numbers to tune, found none")
        for name, factor in self.limits.items():
            if not 0.0 < factor < math.inf:
                raise UserError(f"the limit of {name} must be positive and finite, found {factor}")

    @property
    def bounds(self) -> dict[str, float]:
        """The limits of the chosen point."""
        return dict(self.limits) or {q.name: 1.0 for q in self.objectives[1:]}


def objectives_of(names: Sequence[str], quantities: Mapping[str, MetricMeaning]) -> tuple[MetricMeaning, ...]:
    """Return the metrics of these names, or of these roles where one metric has the role.

    Raises UserError for others, for one that is named twice, and for fewer than two.
    """
    found = tuple(metric(name.strip(), quantities) for name in names)
    if len({q.name for q in found}) < max(2, len(found)):
        raise UserError(f"a front needs two or more different objectives, found {', '.join(names)}")
    return found


def metric(name: str, quantities: Mapping[str, MetricMeaning]) -> MetricMeaning:
    """Return the metric of a name or role; raises UserError as `objectives_of`."""
    able = {q.name: q for q in quantities.values() if q.role in ROLES}
    of_role = [q for q in able.values() if q.role == name]
    if name in able or len(of_role) == 1:
        return able.get(name) or of_role[0]
    if of_role:
        raise UserError(f"several metrics are for {name}: {', '.join(q.name for q in of_role)}; name one of them")
    raise UserError(f"an objective must be one of {', '.join(ROLES)}, or of {', '.join(able)}, found {name!r}")


def limits_of(texts: Sequence[str], objectives: Sequence[MetricMeaning]) -> dict[str, float]:
    """Return the limits by the objectives' names, of texts NAME=FACTOR; raises UserError for others."""
    limits: dict[str, float] = {}
    for text in texts:
        name, _, factor = text.partition("=")
        try:
            value = float(factor)
        except ValueError:
            raise UserError(f"--limit takes NAME=FACTOR, found {text!r}") from None
        q = metric(name.strip(), {q.name: q for q in objectives})
        if q.name in limits:
            raise UserError(f"--limit names {name.strip()} twice")
        limits[q.name] = value
    return limits


@dataclass(frozen=True)
class ParetoPoint:
    """A point: what it is, its values by name, its objectives in the draws of the search and in those held out.

    `over_linear`: the changes over the LC in the held-out draws, in which it kept the plant in `kept` of `draws`.
    """

    kind: str
    values: Mapping[str, float]
    searched: tuple[float, ...]
    held_out: tuple[MeanEstimate, ...]
    over_linear: tuple[MeanEstimate, ...]
    kept: int
    draws: int
    setting: Setting | None = None


@dataclass(frozen=True)
class Front:
    """What a search came to: the points judged on held-out draws, the chosen one, the rule's tuning.

    `chosen` None: no point keeps the limits. `random`: something was left to chance.
    """

    search: Search
    points: tuple[ParetoPoint, ...]
    chosen: ParetoPoint | None
    rule: Tuning
    random: bool

    @property
    def linear(self) -> ParetoPoint:
        """The LC."""
        return next(p for p in self.points if p.kind == LC)

    def of(self, kind: str) -> list[ParetoPoint]:
        """Return the points of a kind."""
        return [p for p in self.points if p.kind == kind]

    @property
    def gains(self) -> bool:
        """Whether the chosen point is decidedly better than the LC in the first objective."""
        if self.chosen is None:
            return False
        first = self.chosen.over_linear[0]
        return first.decided < 0 if self.random else first.value < 0.0

    def verdict(self) -> str:
        """Return in a sentence whether the LC gains, with the numbers of the held-out draws."""
        first, *_ = self.search.objectives
        within = " and ".join(
            f"{_symbol(self, name)} at most {x:g} times the LC's" for name, x in self.search.bounds.items()
        )
        if self.chosen is None:
            least = ", ".join(
                f"{q.symbol} {change_text(min((p.over_linear[i] for p in self.of(FRONT)), key=lambda e: e.value))}"
                for i, q in enumerate(self.search.objectives)
                if self.of(FRONT)
            )
            return f"the LC does not gain: no point of the front keeps {within}" + (
                f"; the least of each alone, over the LC: {least}" if least else "; all that was found loses the plant"
            )
        changes = ", ".join(
            f"{q.symbol} {change_text(e)}" for q, e in zip(self.search.objectives, self.chosen.over_linear, strict=True)
        )
        drawn = (
            f"in {self.chosen.draws} draws that the search did not see"
            if self.random
            else "in the one run that there is"
        )
        if self.gains:
            return f"the LC gains: with {within} the chosen point has over the LC {changes}, {drawn}"
        return (
            f"the LC does not gain: with {within} no point is decidedly better in {first.symbol}; the best found has over "
            f"the LC {changes}, {drawn}"
        )

    def at_ends(self) -> list[str]:
        """Return which ranges the chosen point lies at the end of, in words."""
        if self.chosen is None:
            return []
        ends = [(t, t.share(self.chosen.values[t.name])) for t in self.search.tunables]
        return [f"{t.name} at {self.chosen.values[t.name]:g}" for t, share in ends if share in (0.0, 1.0)]


def _symbol(front: Front, name: str) -> str:
    return next(q.symbol for q in front.search.objectives if q.name == name)


class _Judge:
    """Runs points, or takes them from the journal, and says what they come to."""

    def __init__(
        self, problem: TuningProblem, search: Search, controller: TunedController, journal: Journal, workers: int | None
    ) -> None:
        self.problem, self.search, self.controller = problem, search, controller
        self.journal, self.workers = journal, workers

    def runs(
        self, changes: Sequence[Mapping[str, Any]], numbers: Sequence[int], progress: Callable[[int, int], None]
    ) -> list[list[Numbers]]:
        """Return the numbers of each draw of each point; points that are equal are run once."""
        keys = [tuple(sorted(c.items())) for c in changes]
        jobs = [job for key in dict.fromkeys(keys) for job in self.problem.jobs(key, dict(key), numbers)]
        by_key = run_numbers(jobs, self.problem.fmus, self.journal, workers=self.workers, progress=progress)
        return [[by_key[key, n] for n in numbers] for key in keys]

    def objectives(self, draws: Sequence[Numbers]) -> tuple[MeanEstimate, ...]:
        """Return the means of the objectives."""
        return tuple(mean_over(draws, q) for q in self.search.objectives)

    def violation(self, draws: Sequence[Numbers], linear: Sequence[Numbers]) -> float:
        """Return by how much a point is infeasible beside the LC; 0: it is feasible.

        1 and the share of draws that it loses beyond the LC's; otherwise the share of objectives without a number.
        """
        lost = len(kept(linear)) - len(kept(draws))
        if lost > 0:
            return 1.0 + lost / len(draws)
        return float(np.mean([math.isnan(estimate.value) for estimate in self.objectives(draws)]))


def pareto(
    problem: TuningProblem,
    search: Search,
    controller: TunedController,
    grid: Grid,
    journal: Journal,
    workers: int | None = None,
    progress: Say | None = None,
    say: Callable[[str], None] | None = None,
) -> Front:
    """Look for the front; finished runs come from and go to `journal`: a repetition goes on, and finds the same front.

    The paper's rule is followed on `grid` for `problem.measure`. `say` is told what the rest will take. Raises UserError
    where the controller has no law LC, where the LC does not keep the plant or has no number for an objective, and as
    `tune`.
    """
    report = progress or (lambda _what, _done, _total: None)
    _optimizer()  # before anything runs
    if LC not in laws_of(problem.scenario, problem.fmus, problem.folder):
        raise UserError("a front is held against the law LC, which the controller does not have")
    rule = tune(problem, grid, journal, workers, report)
    judge = _Judge(problem, search, controller, journal, workers)
    (linear,) = judge.runs([controller.linear()], problem.numbers, lambda done, total: report("the LC", done, total))
    for q, value in zip(search.objectives, judge.objectives(linear), strict=True):
        if math.isnan(value.value):
            raise UserError(
                f"a front starts from the LC, which in this scenario has no {q.name} yet at the end of a run"
            )
    found = _found(judge, linear, _first(search, controller, rule), report, say or (lambda _sentence: None))
    return _judged(judge, rule, found, report)


def _optimizer() -> Any:
    """Return pymoo's modules that are used; raise UserError where it is not installed."""
    try:
        from pymoo.algorithms.moo import nsga2  # noqa: PLC0415 - an extra
        from pymoo.core import evaluator, problem  # noqa: PLC0415
        from pymoo.problems import static  # noqa: PLC0415
    except ModuleNotFoundError:
        raise UserError('tune --pareto needs pymoo: pip install "qube-ihc[pareto]"') from None
    return nsga2.NSGA2, evaluator.Evaluator, problem.Problem, static.StaticProblem


def _first(search: Search, controller: TunedController, rule: Tuning) -> Array:
    """Return the first generation as shares (population, n): the present values, the LC's, the rule's stops, a Sobol set."""
    from scipy.stats import qmc  # noqa: PLC0415 - heavy

    known: list[Mapping[str, float]] = [controller.start, {**controller.start, "a_min": 1.0, "b_max": 1.0}]
    known += [{**controller.start, **values_of(point)} for point in rule.stops]
    begun = [[t.share(values[t.name]) for t in search.tunables] for values in known]
    begun = [list(row) for row in dict.fromkeys(map(tuple, begun))][: search.population // 2]
    generator = np.random.default_rng(search.seed)
    sobol = qmc.Sobol(len(search.tunables), seed=generator)  # type: ignore[call-arg] # as in `draws`
    rest = sobol.random_base2(math.ceil(math.log2(search.population)))[: search.population - len(begun)]
    return np.vstack([np.array(begun), rest])


def values_of(point: Point) -> dict[str, float]:
    """Return a point of the rule by the names of what is tuned."""
    return {name: value for name, value in point._asdict().items() if value is not None}


def _found(
    judge: _Judge, linear: Sequence[Numbers], first: Array, report: Say, say: Callable[[str], None]
) -> list[tuple[dict[str, float], Setting]]:
    """Return the feasible points of the last generation that no other of it is better than in every objective."""
    NSGA2, Evaluator, Problem, StaticProblem = _optimizer()
    search, size = judge.search, len(judge.search.tunables)
    space = Problem(n_var=size, n_obj=len(search.objectives), n_ieq_constr=1, xl=np.zeros(size), xu=np.ones(size))
    algorithm = NSGA2(pop_size=search.population, sampling=first)
    algorithm.setup(space, termination=("n_gen", search.generations), seed=search.seed, verbose=False)
    generation, told = 0, False
    while algorithm.has_next():
        generation += 1
        begin, counts = time.monotonic(), []
        asked = algorithm.ask()

        def count(done: int, total: int, generation: int = generation, counts: list[int] = counts) -> None:
            counts.append(done)
            report(f"generation {generation} of {search.generations}", done, total)

        F, G = _evaluated(judge, linear, [_values(search, x) for x in asked.get("X")], count)
        Evaluator().eval(StaticProblem(space, F=F, G=G), asked)
        algorithm.tell(infills=asked)
        if counts[-1] > counts[0] and not told:
            left = (search.generations - generation) * search.population * len(judge.problem.numbers)
            say(_prediction(time.monotonic() - begin, counts[-1] - counts[0], left))
            told = True
    best = algorithm.opt
    values = [_values(search, x) for x, ok in zip(best.get("X"), best.get("FEAS").ravel(), strict=True) if ok]
    return [(v, judge.controller.setting(v)) for v in {tuple(v.values()): v for v in values}.values()]


def _prediction(seconds: float, runs: int, left: int) -> str:
    rest = f"the generations that follow are up to {left} runs, about {left * seconds / runs:.0f} s"
    return f"{runs} runs in {seconds:.1f} s; {rest}"


def _values(search: Search, shares: Sequence[float]) -> dict[str, float]:
    return {t.name: t.at(float(share)) for t, share in zip(search.tunables, shares, strict=True)}


def _evaluated(
    judge: _Judge, linear: Sequence[Numbers], values: Sequence[Mapping[str, float]], count: Callable[[int, int], None]
) -> tuple[Array, Array]:
    """Return objectives (k, n) and violations (k, 1) of points; the objectives of infeasible ones mean nothing."""
    settings: dict[int, Setting] = {}
    for i, chosen in enumerate(values):
        try:
            settings[i] = judge.controller.setting(chosen)
        except UserError:
            continue  # no design is proven for it, or a_min > b_max
    draws = judge.runs([s.changes for s in settings.values()], judge.problem.numbers, count)
    F, G = np.zeros((len(values), len(judge.search.objectives))), np.full((len(values), 1), WORST)
    for i, of_point in zip(settings, draws, strict=True):
        G[i] = judge.violation(of_point, linear)
        F[i] = np.nan_to_num([estimate.value for estimate in judge.objectives(of_point)])
    return F, G


def _judged(judge: _Judge, rule: Tuning, found: Sequence[tuple[dict[str, float], Setting]], report: Say) -> Front:
    """Run the LC, the rule's way and the points found in the held-out draws, and choose."""
    problem, search = judge.problem, judge.search
    way = [(values_of(p), problem.changes(p, rule.designs[p.mu, p.u_max])) for p in rule.way]
    rows: list[tuple[str, Mapping[str, float], Mapping[str, Any], Setting | None]] = [
        (LC, {}, judge.controller.linear(), None),
        *((RULE, values, changes, None) for values, changes in way),
        *((FRONT, values, setting.changes, setting) for values, setting in found),
    ]
    changes = [row[2] for row in rows]
    searched = judge.runs(changes, problem.numbers, lambda done, total: report("the search's draws", done, total))
    unseen = problem.held_out(search.held_out)
    held = judge.runs(changes, unseen, lambda done, total: report("draws held out", done, total))
    points = [
        ParetoPoint(
            LOST if judge.violation(draws, held[0]) else kind,
            values,
            tuple(e.value for e in judge.objectives(seen)),
            judge.objectives(draws),
            tuple(change_over(draws, held[0], q) for q in search.objectives),
            len(kept(draws)),
            len(draws),
            setting,
        )
        for (kind, values, _, setting), seen, draws in zip(rows, searched, held, strict=True)
    ]
    feasible = [p for p in points if p.kind != LOST]
    points = [
        replace(p, kind=DOMINATED) if p.kind == FRONT and any(_better(other, p) for other in feasible) else p
        for p in points
    ]
    return Front(search, tuple(points), _chosen(points, search), rule, bool(problem.chance))


def _better(a: ParetoPoint, b: ParetoPoint) -> bool:
    """Return whether a is nowhere worse than b, and somewhere better."""
    pairs = [(x.value, y.value) for x, y in zip(a.held_out, b.held_out, strict=True)]
    return all(x <= y for x, y in pairs) and any(x < y for x, y in pairs)


def _chosen(points: Sequence[ParetoPoint], search: Search) -> ParetoPoint | None:
    """Return the point of the front that keeps the limits in all draws and has the least first objective in the search's.

    The held-out draws do not choose, so that what they say of the chosen point is not flattered.
    """
    linear, names = points[0], [q.name for q in search.objectives]
    limits = {names.index(name): factor for name, factor in search.bounds.items()}
    able = [
        p
        for p in points
        if p.kind == FRONT
        and all(p.searched[i] <= x * linear.searched[i] for i, x in limits.items())
        and all(p.held_out[i].value <= x * linear.held_out[i].value for i, x in limits.items())
    ]
    return min(able, key=lambda p: p.searched, default=None)
