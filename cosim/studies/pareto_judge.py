"""What a point of a front comes to: its runs in the scenario and in each case, and by how much it is infeasible.

A point that loses the plant in more draws than the LC, does not bring a case to rest that it must, ends without the steady
state that an objective needs, has no proven design, or an objective beyond REACH, is infeasible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fmu_export.errors import UserError

from ..wiring import CONTROLLER
from .cases import FIRST, Case, Runs, without_supervisor
from .draw_means import change_over, kept, mean_over
from .engine import Workers, run_numbers
from .estimates import MeanEstimate
from .experiments import LAW
from .journal import Journal
from .pareto_front import Search
from .region_map import Judge
from .tunables import TunedController
from .tuning import TuningProblem

Array = np.ndarray

MEASUREMENT = "plant.measurement"
WORST = 2.0
"""Violation of a point that has no design: that of losing every draw."""
LEAST = 1e-300
"""Of what a logarithm is taken."""
REACH = 4.0
"""Of an objective, times the LC's, and times its limit where that is above 1: the search does not go beyond."""
BEYOND = 10.0
"""Weight of what lies beyond a limit, in the search for goals."""
ALL = 0.1
"""Weight of the mean of all goals beside the worst, in the search for them."""


class PointJudge:
    """Runs points, or takes them from the journal, and says what they come to."""

    def __init__(
        self, problem: TuningProblem, search: Search, controller: TunedController, journal: Journal, workers: Workers
    ) -> None:
        self.problem, self.search, self.controller = problem, search, controller
        self.journal, self.workers = journal, workers
        self.linear_changes = {**controller.linear(), **search.reference}
        self.linear: Runs = {}
        self.level: Array = np.zeros(0)
        self.reach: list[float] = []
        place = problem.scenario, problem.fmus, problem.folder
        self.free = without_supervisor(*place)
        step = problem.scenario.run.step
        self.rest = Judge(problem.quantities, problem.scenario.run.duration, FIRST * step if self.free else None)

    def begin(self, progress: Callable[[int, int], None]) -> None:
        """Run the LC in the search's draws; raise UserError where it lacks an objective, or a case is not the plant's."""
        for entry in self.search.reference:
            if entry == LAW or not (entry.startswith(f"{CONTROLLER}.") or entry == MEASUREMENT):
                raise UserError(
                    "the LC of the comparison is the same law on the same plant: --reference changes the controller but "
                    f"its law, and {MEASUREMENT}, found {entry}"
                )
        decided = {*self.controller.setting(self.controller.start).changes, *self.linear_changes}
        for case in self.search.cases:
            for entry in case.changes:
                if entry in decided:
                    raise UserError(f"a case must not change what the tuning decides, found {entry}")
        (self.linear,) = self.runs([self.linear_changes], self.problem.numbers, progress)
        estimates = self.objectives(self.linear)
        self.level = np.array([estimate.value for estimate in estimates])
        for q, estimate in zip(self.search.objectives, estimates, strict=True):
            if math.isnan(estimate.value):
                where = f"the case {q.case}" if q.case else "this scenario"
                raise UserError(
                    f"a front starts from the LC, which in {where} has no {q.quantity.name} yet at the end of a run"
                )
            if not estimate.value > 0.0:
                raise UserError(
                    f"a front is relative to the LC, whose {q.name} is 0 in this scenario: nothing is asked of it there; "
                    "start it away from rest, e.g. with --set"
                )
            self.reach.append(REACH * max(1.0, self.search.bounds.get(q.name, 1.0)) * estimate.value)

    def runs(
        self, changes: Sequence[Mapping[str, Any]], numbers: Sequence[int], progress: Callable[[int, int], None]
    ) -> list[Runs]:
        """Return the numbers of each draw in each case of each point; points that are equal are run once."""
        keys = [tuple(sorted(c.items())) for c in changes]
        jobs = [
            job
            for key in dict.fromkeys(keys)
            for case in self.search.circumstances
            for job in self.problem.jobs((key, case.name), self._in_case(dict(key), case), numbers)
        ]
        by_key = run_numbers(jobs, self.problem.fmus, self.journal, workers=self.workers, progress=progress)
        names = [case.name for case in self.search.circumstances]
        return [{name: [by_key[(key, name), n] for n in numbers] for name in names} for key in keys]

    def _in_case(self, changes: Mapping[str, Any], case: Case) -> dict[str, Any]:
        return {**changes, **(self.free if case.rest else {}), **case.changes}

    def objectives(self, runs: Runs) -> tuple[MeanEstimate, ...]:
        """Return the means of the objectives."""
        return tuple(mean_over(runs[q.case], q.quantity) for q in self.search.objectives)

    def changes(self, runs: Runs, base: Runs) -> tuple[MeanEstimate, ...]:
        """Return by which part the objectives' means lie above those of `base`, in the same draws."""
        return tuple(change_over(runs[q.case], base[q.case], q.quantity) for q in self.search.objectives)

    def violation(self, runs: Runs, linear: Runs, *, found: bool = True) -> float:
        """Return by how much a point is infeasible beside the LC; 0: it is feasible.

        1 and the mean share of draws that it loses in a case, beyond the LC's where rest is not asked for; otherwise the
        share of objectives without a number. Rest is asked of points that are `found`, not of the LC and the rule's.
        """
        cases = [case for case in self.search.circumstances if found or not case.rest]
        lost = [self._lost(case, runs[case.name], linear) for case in cases]
        if any(lost):
            return 1.0 + float(np.mean(lost))
        return float(np.mean([math.isnan(estimate.value) for estimate in self.objectives(runs)]))

    def why_not(self, runs: Runs, linear: Runs) -> str:
        """Return in words why a point is infeasible to the search; empty for one that is not."""
        for case in self.search.circumstances:
            draws, lost = runs[case.name], round(self._lost(case, runs[case.name], linear) * len(runs[case.name]))
            if lost and case.rest:
                return f"it does not come to rest from {case.name} in {lost} of {len(draws)} draws"
            if lost:
                where = f"the case {case.name}" if case.name else "the scenario as it stands"
                return f"it loses the plant in {where} in {lost} draws more than the LC, of {len(draws)}"
        values = [estimate.value for estimate in self.objectives(runs)]
        for q, value, most in zip(self.search.objectives, values, self.reach, strict=True):
            if math.isnan(value):
                return f"it has no {q.name} yet at the end of a run"
            if value > most:
                return f"its {q.symbol} is more than {REACH:g} times the LC's, or its limit, beyond which nothing is sought"
        return ""

    def _lost(self, case: Case, draws: Sequence[Mapping[str, float]], linear: Runs) -> float:
        if case.rest:
            return sum(self.rest.outcome(draw) != "attracted" for draw in draws) / len(draws)
        return max(0, len(kept(linear[case.name])) - len(kept(draws))) / len(draws)

    def searched(self, runs: Runs) -> tuple[Array, float]:
        """Return the logarithms of the objectives (n,), and by how much the point is infeasible to the search."""
        values = np.array([estimate.value for estimate in self.objectives(runs)])
        violation = self.violation(runs, self.linear)
        if violation:
            return np.zeros_like(values), violation
        logs = np.log(np.maximum(values, LEAST))
        beyond = float(np.maximum(logs - np.log(self.reach), 0.0).sum())
        return logs, beyond / (1.0 + beyond)

    def towards_goals(self, logs: Array) -> float:
        """Return what the search for goals makes small: the logarithm of the largest ratio to a goal, and a little of all.

        The little is so that what is not the worst is made small too. What is beyond a limit counts BEYOND times.
        """
        goals = np.array([self.search.goals.get(q.name, 1.0) for q in self.search.objectives])
        of_goal = np.array([q.name in self.search.goals for q in self.search.objectives])
        excess = (logs - np.log(goals * self.level))[of_goal]
        limits = [math.log(self.search.bounds.get(q.name, math.inf)) for q in self.search.objectives]
        beyond = np.maximum(logs - np.log(self.level) - limits, 0.0).sum()
        return float(excess.max() + ALL * excess.mean() + BEYOND * beyond)
