"""Tuning for several objectives at once: the front of what can be had, found on some draws and judged on others.

NSGA-II searches from the LC's neighbourhood, the stops of the paper's rule and a Sobol set. Every point is run in the same
draws of encoder offsets and noise; its front is run again in draws that the search did not see, and these are the numbers
that are told. A point that loses the plant in more draws than the LC, ends without the steady state that an objective
needs, has no proven design, or an objective beyond REACH, is infeasible: whatever its objectives, it is behind every
feasible one. The search spreads its points evenly in the objectives' logarithms.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fmu_export.errors import UserError

from .draw_means import change_over, kept, mean_over
from .engine import Workers, run_numbers
from .estimates import MeanEstimate
from .experiments import laws_of
from .journal import Journal
from .nsga import check_installed, nondominated
from .numbers import Numbers
from .pareto_front import DOMINATED, FRONT, LC, LOST, RETUNED, RULE, Front, ParetoPoint, Search
from .tunables import Setting, TunedController
from .tuning import Grid, Point, Tuning, TuningProblem, tune

Array = np.ndarray
Say = Callable[[str, int, int], None]

WORST = 2.0
"""Violation of a point that has no design: that of losing every draw."""
LEAST = 1e-300
"""Of what a logarithm is taken."""
REACH = 4.0
"""Of an objective, times the LC's, and times its limit where that is above 1: the search does not go beyond."""
SHARE = 4
"""Part of the population, one in so many, of how many points within the limits are judged besides the last generation's."""


class _Judge:
    """Runs points, or takes them from the journal, and says what they come to."""

    def __init__(
        self, problem: TuningProblem, search: Search, controller: TunedController, journal: Journal, workers: Workers
    ) -> None:
        self.problem, self.search, self.controller = problem, search, controller
        self.journal, self.workers = journal, workers
        self.linear: Sequence[Numbers] = ()
        self.reach: list[float] = []

    def begin(self, progress: Callable[[int, int], None]) -> None:
        """Run the LC in the search's draws; raise UserError where it lacks an objective."""
        (self.linear,) = self.runs([self.controller.linear()], self.problem.numbers, progress)
        for q, estimate in zip(self.search.objectives, self.objectives(self.linear), strict=True):
            if math.isnan(estimate.value):
                raise UserError(
                    f"a front starts from the LC, which in this scenario has no {q.name} yet at the end of a run"
                )
            factor = REACH * max(1.0, self.search.bounds.get(q.name, 1.0))
            self.reach.append(factor * estimate.value if estimate.value > 0.0 else math.inf)

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

    def searched(self, draws: Sequence[Numbers]) -> tuple[Array, float]:
        """Return the logarithms of the objectives (n,), and by how much the point is infeasible to the search."""
        values = np.array([estimate.value for estimate in self.objectives(draws)])
        violation = self.violation(draws, self.linear)
        if violation:
            return np.zeros_like(values), violation
        logs = np.log(np.maximum(values, LEAST))
        beyond = float(np.maximum(logs - np.log(np.maximum(self.reach, LEAST)), 0.0).sum())
        return logs, beyond / (1.0 + beyond)


def pareto(
    problem: TuningProblem,
    search: Search,
    controller: TunedController,
    grid: Grid,
    journal: Journal,
    workers: Workers = None,
    progress: Say | None = None,
    say: Callable[[str], None] | None = None,
) -> Front:
    """Look for the front; finished runs come from and go to `journal`: a repetition goes on, and finds the same front.

    The paper's rule is followed on `grid` for `problem.measure`. `say` is told what the rest will take. Raises UserError
    where the controller has no law LC, where the LC does not keep the plant or has no number for an objective, and as
    `tune`.
    """
    report = progress or (lambda _what, _done, _total: None)
    check_installed()  # before anything runs
    if LC not in laws_of(problem.scenario, problem.fmus, problem.folder):
        raise UserError("a front is held against the law LC, which the controller does not have")
    rule = tune(problem, grid, journal, workers, report)
    judge = _Judge(problem, search, controller, journal, workers)
    judge.begin(lambda done, total: report("the LC", done, total))
    tell = say or (lambda _sentence: None)
    known: list[Mapping[str, float]] = [controller.start, {**controller.start, "a_min": 1.0, "b_max": 1.0}]
    known += [{**controller.start, **values_of(point)} for point in rule.stops]
    found = _Explorer(judge, search, controller.setting, report, tell).found(_first(search, known))
    retuned: list[_Found] = []
    if search.linear:
        linear = replace(search, tunables=tuple(controller.of_linear()))
        what = "the LC's own front, "
        explorer = _Explorer(judge, linear, controller.linear_setting, report, tell, what)
        retuned = explorer.found(_first(linear, [controller.start]))
    return _judged(judge, rule, found, retuned, report)


_Found = tuple[dict[str, float], Setting]
"""A point that was found: its values, and what they change."""


def _first(search: Search, known: Sequence[Mapping[str, float]]) -> Array:
    """Return the first generation as shares (population, n): the `known` points, and a Sobol set."""
    from scipy.stats import qmc  # noqa: PLC0415 - heavy

    begun = [[t.share(values[t.name]) for t in search.tunables] for values in known]
    begun = [list(row) for row in dict.fromkeys(map(tuple, begun))][: search.population // 2]
    generator = np.random.default_rng(search.seed)
    sobol = qmc.Sobol(len(search.tunables), seed=generator)  # type: ignore[call-arg] # as in `draws`
    rest = sobol.random_base2(math.ceil(math.log2(search.population)))[: search.population - len(begun)]
    return np.vstack([np.array(begun), rest])


def values_of(point: Point) -> dict[str, float]:
    """Return a point of the rule by the names of what is tuned."""
    return {name: value for name, value in point._asdict().items() if value is not None}


class _Explorer:
    """Evaluates the points of a search, generation by generation, and remembers the feasible ones."""

    def __init__(
        self,
        judge: _Judge,
        search: Search,
        setting: Callable[[Mapping[str, float]], Setting],
        report: Say,
        say: Callable[[str], None],
        what: str = "",
    ) -> None:
        self.judge, self.search, self.setting = judge, search, setting
        self.report, self.say, self.what = report, say, what
        self.feasible: dict[tuple[float, ...], Array] = {}
        self.told = False

    def found(self, first: Array) -> list[_Found]:
        """Return the values, and what they change, of the last generation's front and of the best within the limits."""
        search = self.search
        last = nondominated(self.evaluated, first, len(search.objectives), search.generations, search.seed)
        points = [self._values(shares) for shares in last]
        points += [dict(zip(points[0], values, strict=True)) for values in self._within_limits()] if points else []
        return [(v, self.setting(v)) for v in {tuple(v.values()): v for v in points}.values()]

    def evaluated(self, generation: int, points: Array) -> tuple[Array, Array]:
        """Return the logarithms of the objectives (k, n) and the violations (k, 1) of points in the unit cube."""
        begin, counts = time.monotonic(), []

        def count(done: int, total: int) -> None:
            counts.append(done)
            self.report(f"{self.what}generation {generation} of {self.search.generations}", done, total)

        F, G = np.zeros((len(points), len(self.search.objectives))), np.full((len(points), 1), WORST)
        settings: dict[int, tuple[dict[str, float], Setting]] = {}
        for i, shares in enumerate(points):
            values = self._values(shares)
            try:
                settings[i] = values, self.setting(values)
            except UserError:
                continue  # no design is proven for it, or a_min > b_max
        changes = [setting.changes for _, setting in settings.values()]
        runs = self.judge.runs(changes, self.judge.problem.numbers, count)
        for (i, (values, _)), draws in zip(settings.items(), runs, strict=True):
            F[i], G[i] = self.judge.searched(draws)
            if G[i] == 0.0:
                self.feasible[tuple(values.values())] = F[i]
        self._predict(generation, time.monotonic() - begin, counts[-1] - counts[0])
        return F, G

    def _values(self, shares: Sequence[float]) -> dict[str, float]:
        return {t.name: t.at(float(share)) for t, share in zip(self.search.tunables, shares, strict=True)}

    def _within_limits(self) -> list[tuple[float, ...]]:
        """Return the values of the feasible points within the limits that are best in the first objective."""
        names = [q.name for q in self.search.objectives]
        linear = self.judge.objectives(self.judge.linear)
        most = {
            names.index(name): factor * linear[names.index(name)].value for name, factor in self.search.bounds.items()
        }
        able = [v for v, F in self.feasible.items() if all(math.exp(F[i]) <= limit for i, limit in most.items())]
        return sorted(able, key=lambda v: tuple(self.feasible[v]))[: self.search.population // SHARE]

    def _predict(self, generation: int, seconds: float, runs: int) -> None:
        """Say, after the first generation that ran anything, what the others will take."""
        if self.told or not runs:
            return
        left = (self.search.generations - generation) * self.search.population * len(self.judge.problem.numbers)
        rest = f"the generations that follow are up to {left} runs, about {left * seconds / runs:.0f} s"
        self.say(f"{runs} runs in {seconds:.1f} s; {rest}")
        self.told = True


def _judged(judge: _Judge, rule: Tuning, found: Sequence[_Found], retuned: Sequence[_Found], report: Say) -> Front:
    """Run the LC, the rule's way and the points found in the held-out draws, and choose."""
    problem, search = judge.problem, judge.search
    way = [(values_of(p), problem.changes(p, rule.designs[p.mu, p.u_max])) for p in rule.way]
    rows: list[tuple[str, Mapping[str, float], Mapping[str, Any], Setting | None]] = [
        (LC, {}, judge.controller.linear(), None),
        *((RULE, values, changes, None) for values, changes in way),
        *((FRONT, values, setting.changes, setting) for values, setting in found),
        *((RETUNED, values, setting.changes, setting) for values, setting in retuned),
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
    draws_of = dict(zip(map(id, points), held, strict=True))
    rivals = {FRONT: [p for p in points if p.kind not in (LOST, RETUNED)]}
    rivals[RETUNED] = [p for p in points if p.kind == RETUNED]
    beaten = [p for p in points if any(_better(other, p) for other in rivals.get(p.kind, ()))]
    left = [
        replace(p, kind=DOMINATED) if p in beaten and p.kind == FRONT else p for p in points if not _dropped(p, beaten)
    ]
    chosen, best = _chosen(left, search, FRONT), _chosen(left, search, RETUNED)
    over = None
    if chosen is not None and best is not None:
        pair = draws_of[id(chosen)], draws_of[id(best)]
        over = best, tuple(change_over(*pair, q) for q in search.objectives)
    return Front(search, tuple(left), chosen, rule, bool(problem.chance), over)


def _dropped(point: ParetoPoint, beaten: Sequence[ParetoPoint]) -> bool:
    """Return whether a point is left out: one of the LC's own that another of them is better than."""
    return point.kind == RETUNED and point in beaten


def _better(a: ParetoPoint, b: ParetoPoint) -> bool:
    """Return whether a is nowhere worse than b, and somewhere better."""
    pairs = [(x.value, y.value) for x, y in zip(a.held_out, b.held_out, strict=True)]
    return all(x <= y for x, y in pairs) and any(x < y for x, y in pairs)


def _chosen(points: Sequence[ParetoPoint], search: Search, kind: str) -> ParetoPoint | None:
    """Return the point of a kind that keeps the limits in all draws and has the least first objective in the search's.

    The held-out draws do not choose, so that what they say of the chosen point is not flattered.
    """
    linear, names = points[0], [q.name for q in search.objectives]
    limits = {names.index(name): factor for name, factor in search.bounds.items()}
    able = [
        p
        for p in points
        if p.kind == kind
        and all(p.searched[i] <= x * linear.searched[i] for i, x in limits.items())
        and all(p.held_out[i].value <= x * linear.held_out[i].value for i, x in limits.items())
    ]
    return min(able, key=lambda p: p.searched, default=None)
