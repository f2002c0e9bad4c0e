"""Tuning for several objectives at once: the front of what can be had, found on some draws and judged on others.

NSGA-II searches from the LC's neighbourhood, the stops of the paper's rule and a Sobol set. Every point is run in the same
draws of encoder offsets and noise, in the scenario and in each case; its front is run again in draws that the search did not
see, and these are the numbers that are told. An infeasible point, see `pareto_judge`, is behind every feasible one whatever
its objectives. The search spreads its points evenly in the objectives' logarithms. With goals, CMA-ES goes on from the point
that is nearest to them, with as many runs again, and makes the largest ratio of an objective to its goal small (goal
attainment: F. W. Gembicki and Y. Y. Haimes, IEEE Trans. Automatic Control 20(6), 1975, 769-771).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fmu_export.errors import UserError

from .cases import AS_IT_STANDS
from .draw_means import kept
from .engine import Workers
from .experiments import laws_of
from .journal import Journal
from .optimizers import check_installed, descended, nondominated
from .pareto_front import DOMINATED, FRONT, LC, LOST, RETUNED, RULE, Front, ParetoPoint, Search
from .pareto_judge import WORST, PointJudge
from .tunables import Setting, TunedController
from .tuning import Grid, Point, Tuning, TuningProblem, tune

Array = np.ndarray
Say = Callable[[str, int, int], None]

UNFEASIBLE = 100.0
"""Of what the search for goals makes small: that of an infeasible point, beyond every feasible one's."""
SHARE = 4
"""Part of the population, one in so many, of how many points within the limits are judged besides the last generation's."""


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
    judge = PointJudge(problem, search, controller, journal, workers)
    judge.begin(lambda done, total: report("the LC", done, total))
    tell = say or (lambda _sentence: None)
    known: list[Mapping[str, float]] = [controller.start, {**controller.start, "a_min": 1.0, "b_max": 1.0}]
    known += [{**controller.start, **values_of(point)} for point in rule.stops]
    explorer = _Explorer(judge, search, controller.setting, report, tell)
    found = explorer.found(_first(search, known))
    if reason := explorer.why_not(controller.start):
        tell(f"the scenario as it stands was left out of the search: {reason}")
    retuned: list[_Found] = []
    if search.linear:
        linear = replace(search, tunables=tuple(controller.of_linear()))
        what = "the LC's own front, "
        own = _Explorer(judge, linear, controller.linear_setting, report, tell, what)
        retuned = own.found(_first(linear, [controller.start]))
    nearest = explorer.least[1]
    why = explorer.why_not(nearest) if nearest and not explorer.feasible else ""
    return replace(_judged(judge, rule, found, retuned, report), why_none=why)


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
    """Evaluates the points of a search, generation by generation; remembers the feasible ones and the least infeasible."""

    def __init__(
        self,
        judge: PointJudge,
        search: Search,
        setting: Callable[[Mapping[str, float]], Setting],
        report: Say,
        say: Callable[[str], None],
        what: str = "",
    ) -> None:
        self.judge, self.search, self.setting = judge, search, setting
        self.report, self.say, self.what = report, say, what
        self.feasible: dict[tuple[float, ...], Array] = {}
        self.least: tuple[float, dict[str, float]] = (math.inf, {})
        self.told = False

    def found(self, first: Array) -> list[_Found]:
        """Return the values, and what they change, of the last generation's front and of the best within the limits."""
        search = self.search
        last = nondominated(self._generation, first, len(search.objectives), search.generations, search.seed)
        points = [self._values(shares) for shares in last]
        if search.goals and (self.feasible or self.least[1]):
            nearest = self._named(min(self.feasible, key=self._beyond)) if self.feasible else self.least[1]
            start = np.array([t.share(nearest[t.name]) for t in search.tunables])
            descended(self._descent, start, search.population * search.generations, search.seed)
        points += [self._named(values) for values in self._preferred()]
        return [(v, self.setting(v)) for v in {tuple(v.values()): v for v in points}.values()]

    def why_not(self, values: Mapping[str, float]) -> str:
        """Return in words why a point is infeasible to the search; empty for one that is not."""
        named = self._values([t.share(values[t.name]) for t in self.search.tunables])  # as they are searched
        try:
            setting = self.setting(named)
        except UserError as error:
            return str(error)
        (runs,) = self.judge.runs([setting.changes], self.judge.problem.numbers, lambda _done, _total: None)
        return self.judge.why_not(runs, self.judge.linear)

    def _generation(self, generation: int, points: Array) -> tuple[Array, Array]:
        search = self.search
        left = (search.generations - generation + (search.generations if search.goals else 0)) * search.population
        return self._evaluated(f"generation {generation} of {search.generations}", points, left)

    def _descent(self, generation: int, generations: int, points: Array) -> Array:
        left = (generations - generation) * len(points)
        F, G = self._evaluated(f"towards the goals, generation {generation} of {generations}", points, left)
        near = [UNFEASIBLE + g if g else self.judge.towards_goals(f) for f, g in zip(F, G.ravel(), strict=True)]
        return np.array(near)

    def _evaluated(self, stage: str, points: Array, left: int) -> tuple[Array, Array]:
        """Return the logarithms of the objectives (k, n) and the violations (k, 1) of points in the unit cube.

        `left`: so many points follow at most.
        """
        begin, counts = time.monotonic(), []

        def count(done: int, total: int) -> None:
            counts.append(done)
            self.report(f"{self.what}{stage}", done, total)

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
            self.least = min(self.least, (float(G[i, 0]), values), key=lambda one: one[0])
        if counts:
            self._predict(left, time.monotonic() - begin, counts[-1] - counts[0])
        return F, G

    def _values(self, shares: Sequence[float]) -> dict[str, float]:
        return {t.name: t.at(float(share)) for t, share in zip(self.search.tunables, shares, strict=True)}

    def _named(self, values: Sequence[float]) -> dict[str, float]:
        return dict(zip([t.name for t in self.search.tunables], values, strict=True))

    def _beyond(self, values: tuple[float, ...]) -> float:
        return self.judge.towards_goals(self.feasible[values])

    def _preferred(self) -> list[tuple[float, ...]]:
        """Return the values of feasible points: nearest to the goals, or within the limits best in the first objective."""
        most = self.search.population // SHARE
        if self.search.goals:
            return sorted(self.feasible, key=self._beyond)[:most]
        names, bounds = [q.name for q in self.search.objectives], self.search.bounds
        limits = {names.index(name): factor * self.judge.level[names.index(name)] for name, factor in bounds.items()}
        able = [v for v, F in self.feasible.items() if all(math.exp(F[i]) <= limit for i, limit in limits.items())]
        return sorted(able, key=lambda v: tuple(self.feasible[v]))[:most]

    def _predict(self, left: int, seconds: float, runs: int) -> None:
        """Say, after the first generation that ran anything, what the others will take, of `left` points."""
        if self.told or not runs:
            return
        left *= len(self.judge.problem.numbers) * len(self.search.circumstances)
        rest = f"the generations that follow are up to {left} runs, about {left * seconds / runs:.0f} s"
        self.say(f"{runs} runs in {seconds:.1f} s; {rest}")
        self.told = True


def _judged(judge: PointJudge, rule: Tuning, found: Sequence[_Found], retuned: Sequence[_Found], report: Say) -> Front:
    """Run the LC, the rule's way and the points found in the held-out draws, and choose."""
    problem, search = judge.problem, judge.search
    way = [(values_of(p), problem.changes(p, rule.designs[p.mu, p.u_max])) for p in rule.way]
    rows: list[tuple[str, Mapping[str, float], Mapping[str, Any], Setting | None]] = [
        (LC, {}, judge.linear_changes, None),
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
            LOST if judge.violation(draws, held[0], found=kind in (FRONT, RETUNED)) else kind,
            values,
            tuple(e.value for e in judge.objectives(seen)),
            judge.objectives(draws),
            judge.changes(draws, held[0]),
            len(kept(draws[AS_IT_STANDS.name])),
            len(unseen),
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
    chosen, best = _chosen(left, search, FRONT), _chosen(left, search, RETUNED, LC) if search.linear else None
    over = None
    if chosen is not None and best is not None:
        pair = draws_of[id(chosen)], draws_of[id(best)]
        over = best, judge.changes(*pair)
    return Front(search, tuple(left), chosen, rule, bool(problem.chance), over)


def _dropped(point: ParetoPoint, beaten: Sequence[ParetoPoint]) -> bool:
    """Return whether a point is left out: one of the LC's own that another of them is better than."""
    return point.kind == RETUNED and point in beaten


def _better(a: ParetoPoint, b: ParetoPoint) -> bool:
    """Return whether a is nowhere worse than b, and somewhere better."""
    pairs = [(x.value, y.value) for x, y in zip(a.held_out, b.held_out, strict=True)]
    return all(x <= y for x, y in pairs) and any(x < y for x, y in pairs)


def _chosen(points: Sequence[ParetoPoint], search: Search, *kinds: str) -> ParetoPoint | None:
    """Return the point of these kinds that keeps the limits in all draws and is best in the search's: nearest to the goals.

    Without goals, the one with the least first objective. The held-out draws do not choose, so that what they say of the
    chosen point is not flattered.
    """
    linear, names = points[0], [q.name for q in search.objectives]
    limits = {names.index(name): factor for name, factor in search.bounds.items()}
    able = [
        p
        for p in points
        if p.kind in kinds
        and all(p.searched[i] <= x * linear.searched[i] for i, x in limits.items())
        and all(p.held_out[i].value <= x * linear.held_out[i].value for i, x in limits.items())
    ]
    if search.goals:
        return min(able, key=lambda p: search.beyond(p.searched, linear.searched), default=None)
    return min(able, key=lambda p: p.searched, default=None)
