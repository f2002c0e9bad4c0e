"""What a search for a front is asked for, and what it came to: points, the chosen one, and whether the LC gains.

The names of objectives are metrics or roles: `settling` is the one metric that says when a run has settled, `rms@pushed`
the one of the steady state in the case `pushed`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fmu_export.errors import UserError

from ..metric_meanings import MetricMeaning
from .cases import AS_IT_STANDS, OF, Case, Objective
from .estimates import MeanEstimate, change_text
from .tunables import Setting, Tunable
from .tuning import ROLES, Tuning

LC, RULE, FRONT, RETUNED = "LC", "rule", "front", "retuned LC"
DOMINATED, LOST = "dominated", "infeasible"
"""What a point is: the LC, one that the paper's rule passed, one of the front, one of the front that the LC itself has with
its K and filter tuned as freely; and of those that the searches found, in the draws that they did not see: one that another
is better than in every objective, or one that is infeasible."""
LC_AT = (("a_min", 1.0), ("b_max", 1.0))
"""Ends of ranges at which the IHC is the LC: nothing lies beyond them."""
NAMED = 3
"""Entries of the LC of the comparison that a sentence names."""


@dataclass(frozen=True)
class Search:
    """How the front is looked for.

    `objectives`: what to make small, the first above all; `tunables`: the numbers that are varied; `limits`: largest
    values of objectives for the chosen point, relative to the LC's, by the objective's name, empty and without goals: 1 for
    every one but the first. `goals`: values, as relative, to which the chosen point is the nearest within the limits, and
    towards which the search goes on. `cases`: what points are run in besides the scenario as it stands. `reference`: what
    the LC of the comparison has otherwise. `held_out`: draws that judge. `linear`: whether the LC's own front is looked
    for too.
    """

    objectives: tuple[Objective, ...]
    tunables: tuple[Tunable, ...]
    limits: Mapping[str, float] = field(default_factory=dict)
    goals: Mapping[str, float] = field(default_factory=dict)
    cases: tuple[Case, ...] = ()
    reference: Mapping[str, Any] = field(default_factory=dict)
    population: int = 32
    generations: int = 20
    held_out: int = 64
    seed: int = 1
    linear: bool = False

    def __post_init__(self) -> None:
        for name, least in (("population", 4), ("generations", 1), ("held_out", 2), ("seed", 0)):
            if getattr(self, name) < least:
                raise UserError(f"{name.replace('_', '-')} must be at least {least}, found {getattr(self, name)}")
        if not self.tunables:
            raise UserError("a front needs numbers to tune, found none")
        for what, factors in (("limit", self.limits), ("goal", self.goals)):
            for name, factor in factors.items():
                if not 0.0 < factor < math.inf:
                    raise UserError(f"the {what} of {name} must be positive and finite, found {factor}")
        if self.goals and len(self.tunables) < 2:
            names = ", ".join(t.name for t in self.tunables)
            raise UserError(f"a search for goals needs two or more numbers to tune, found {names}")

    @property
    def bounds(self) -> dict[str, float]:
        """The limits of the chosen point."""
        return dict(self.limits) or ({} if self.goals else {q.name: 1.0 for q in self.objectives[1:]})

    @property
    def circumstances(self) -> tuple[Case, ...]:
        """All cases, the scenario as it stands first."""
        return (AS_IT_STANDS, *self.cases)

    def beyond(self, values: Sequence[float], linear: Sequence[float]) -> float:
        """Return the largest ratio of a value to its goal (goal attainment: the smaller the better; up to 1 all are met)."""
        ratios = zip(self.objectives, values, linear, strict=True)
        return max(
            value / (self.goals[q.name] * base) if base else math.inf
            for q, value, base in ratios
            if q.name in self.goals
        )


def objectives_of(
    names: Sequence[str], quantities: Mapping[str, MetricMeaning], cases: Sequence[Case] = ()
) -> tuple[Objective, ...]:
    """Return the metrics of these names, or of these roles where one metric has the role; NAME@CASE is one of a case.

    Raises UserError for others, for one that is named twice, and for fewer than two.
    """
    found = tuple(_objective(name.strip(), quantities, cases) for name in names)
    if len({q.name for q in found}) < max(2, len(found)):
        raise UserError(f"a front needs two or more different objectives, found {', '.join(names)}")
    return found


def _objective(name: str, quantities: Mapping[str, MetricMeaning], cases: Sequence[Case]) -> Objective:
    role, of, case = name.partition(OF)
    measured = [c.name for c in cases if not c.rest]
    if of and case not in measured:
        known = f"one of {', '.join(measured)}" if measured else "given with --case"
        raise UserError(f"the case of {name!r} must be {known}, found {case!r}")
    return Objective(metric(role, quantities), case)


def metric(name: str, quantities: Mapping[str, MetricMeaning]) -> MetricMeaning:
    """Return the metric of a name or role; raises UserError as `objectives_of`."""
    able = {q.name: q for q in quantities.values() if q.role in ROLES}
    of_role = [q for q in able.values() if q.role == name]
    if name in able or len(of_role) == 1:
        return able.get(name) or of_role[0]
    if of_role:
        raise UserError(f"several metrics are for {name}: {', '.join(q.name for q in of_role)}; name one of them")
    raise UserError(f"an objective must be one of {', '.join(ROLES)}, or of {', '.join(able)}, found {name!r}")


def factors_of(option: str, texts: Sequence[str], objectives: Sequence[Objective]) -> dict[str, float]:
    """Return numbers by the objectives' names, of an option's texts NAME=FACTOR; raises UserError for others."""
    factors: dict[str, float] = {}
    for text in texts:
        name, _, factor = text.partition("=")
        try:
            value = float(factor)
        except ValueError:
            raise UserError(f"{option} takes NAME=FACTOR, found {text!r}") from None
        q = _named(option, name.strip(), objectives)
        if q.name in factors:
            raise UserError(f"{option} names {name.strip()} twice")
        factors[q.name] = value
    return factors


def _named(option: str, name: str, objectives: Sequence[Objective]) -> Objective:
    role, _, case = name.partition(OF)
    able = [q for q in objectives if q.case == case and role in (q.quantity.name, q.quantity.role)]
    if not able:
        raise UserError(
            f"{option} {name} is none of the objectives of --pareto: {', '.join(q.name for q in objectives)}"
        )
    if len(able) > 1:
        raise UserError(
            f"{option} {name} means several objectives: {', '.join(q.name for q in able)}; name one of them"
        )
    return able[0]


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

    `chosen` None: no point keeps the limits. `random`: something was left to chance. `retuned`: the point that the same
    limits choose of the retuned LC's, or of the LC as it is, and the changes of the chosen point over it. `why_none`: why
    the nearest point to a feasible one is infeasible, where none was found.
    """

    search: Search
    points: tuple[ParetoPoint, ...]
    chosen: ParetoPoint | None
    rule: Tuning
    random: bool
    retuned: tuple[ParetoPoint, tuple[MeanEstimate, ...]] | None = None
    why_none: str = ""

    @property
    def linear(self) -> ParetoPoint:
        """The LC."""
        return next(p for p in self.points if p.kind == LC)

    def of(self, kind: str) -> list[ParetoPoint]:
        """Return the points of a kind."""
        return [p for p in self.points if p.kind == kind]

    @property
    def met(self) -> bool:
        """Whether the chosen point meets all goals in the draws that the search did not see."""
        if self.chosen is None or not self.search.goals:
            return False
        held = [[e.value for e in p.held_out] for p in (self.chosen, self.linear)]
        return self.search.beyond(held[0], held[1]) <= 1.0

    @property
    def gains(self) -> bool:
        """Whether the chosen point is decidedly better than the LC in the first objective."""
        if self.chosen is None:
            return False
        first = self.chosen.over_linear[0]
        return first.decided < 0 if self.random else first.value < 0.0

    def verdict(self) -> str:
        """Return in a sentence whether the LC gains, or the goals are met, with the numbers of the held-out draws."""
        first, *_ = self.search.objectives
        if self.search.goals and self.chosen is not None:
            return self._attained(self.chosen)
        within = " and ".join(
            f"{_symbol(self, name)} at most {x:g} times the LC's" for name, x in self.search.bounds.items()
        )
        if self.chosen is None:
            least = ", ".join(
                f"{q.symbol} {change_text(min((p.over_linear[i] for p in self.of(FRONT)), key=lambda e: e.value))}"
                for i, q in enumerate(self.search.objectives)
                if self.of(FRONT)
            )
            kept = f" keeps {within}" if within else ""
            return f"the LC does not gain: no point of the front{kept or ' is left'}" + (
                f"; the least of each alone, over the LC: {least}"
                if least
                else f"; of the nearest that was found: {self.why_none or 'it loses the plant in the draws held out'}"
            )
        changes = ", ".join(
            f"{q.symbol} {change_text(e)}" for q, e in zip(self.search.objectives, self.chosen.over_linear, strict=True)
        )
        if self.gains:
            return f"the LC gains: with {within} the chosen point has over the LC {changes}, {self._drawn}"
        return (
            f"no gain in {first.symbol} was found: with {within} no point is decidedly better; the best found has over the "
            f"LC {changes}, {self._drawn}"
        )

    @property
    def _drawn(self) -> str:
        count = self.linear.draws
        drawn = f"in {count} draws that the search did not see" if self.random else "in the one run that there is"
        named = [f"{entry} = {value}" for entry, value in self.search.reference.items()]
        more = f" and {len(named) - NAMED} others" if len(named) > NAMED else ""
        return drawn + (f" (the LC with {', '.join(named[:NAMED])}{more})" if named else "")

    def _attained(self, chosen: ParetoPoint) -> str:
        """Return in a sentence whether the goals are met, each value over the LC's with its goal or limit."""
        rows = zip(self.search.objectives, chosen.held_out, self.linear.held_out, strict=True)
        said = []
        for q, value, base in rows:
            ratio, goal, limit = value.value / base.value, self.search.goals.get(q.name), self.search.bounds.get(q.name)
            asked = [] if goal is None else [f"goal {goal:.3g}" + ("" if ratio <= goal else ", missed")]
            asked += [] if limit is None else [f"limit {limit:.3g}"]
            said.append(f"{q.symbol} {ratio:.3g}" + (f" ({', '.join(asked)})" if asked else ""))
        begin = "the goals are met" if self.met else "the goals are not met together; the nearest that was found"
        return f"{begin}: times the LC's, {self._drawn}: {'; '.join(said)}"

    def over_retuned(self) -> str:
        """Return in a sentence what the chosen point has over the LC at its own best tuning; empty where none was sought."""
        if not self.search.linear:
            return ""
        if self.retuned is None:
            return "the LC at its own best tuning keeps no such limits" if self.chosen is not None else ""
        changes = ", ".join(
            f"{q.symbol} {change_text(e)}" for q, e in zip(self.search.objectives, self.retuned[1], strict=True)
        )
        return f"over the LC at its own best tuning, K and filter as free and within the same limits: {changes}"

    def at_ends(self) -> list[str]:
        """Return which ranges the chosen point lies at the end of, in words."""
        if self.chosen is None:
            return []
        ends = [(t, t.share(self.chosen.values[t.name])) for t in self.search.tunables]
        return [
            f"{t.name} at {t.at(share):g}"
            for t, share in ends
            if share in (0.0, 1.0) and (t.name, t.at(share)) not in LC_AT
        ]


def _symbol(front: Front, name: str) -> str:
    return next(q.symbol for q in front.search.objectives if q.name == name)
