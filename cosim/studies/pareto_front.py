"""What a search for a front is asked for, and what it came to: points, the chosen one, and whether the LC gains.

The names of objectives are metrics or roles: `settling` is the one metric that says when a run has settled.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from fmu_export.errors import UserError

from ..metric_meanings import MetricMeaning
from .estimates import MeanEstimate, change_text
from .tunables import Setting, Tunable
from .tuning import ROLES, Tuning

LC, RULE, FRONT, RETUNED = "LC", "rule", "front", "retuned LC"
DOMINATED, LOST = "dominated", "infeasible"
"""What a point is: the LC, one that the paper's rule passed, one of the front, one of the front that the LC itself has with
its K and filter tuned as freely; and of those that the searches found, in the draws that they did not see: one that another
is better than in every objective, or one that is infeasible."""


@dataclass(frozen=True)
class Search:
    """How the front is looked for.

    `objectives`: metrics to make small, the first above all; `tunables`: the numbers that are varied; `limits`: largest
    values of objectives for the chosen point, relative to the LC's, by the objective's name, empty: 1 for every one but
    the first. `held_out`: draws that judge. `linear`: whether the LC's own front is looked for too.
    """

    objectives: tuple[MetricMeaning, ...]
    tunables: tuple[Tunable, ...]
    limits: Mapping[str, float] = field(default_factory=dict)
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

    `chosen` None: no point keeps the limits. `random`: something was left to chance. `retuned`: the point that the same
    limits choose of the retuned LC's, and the changes of the chosen point over it.
    """

    search: Search
    points: tuple[ParetoPoint, ...]
    chosen: ParetoPoint | None
    rule: Tuning
    random: bool
    retuned: tuple[ParetoPoint, tuple[MeanEstimate, ...]] | None = None

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
        return [f"{t.name} at {self.chosen.values[t.name]:g}" for t, share in ends if share in (0.0, 1.0)]


def _symbol(front: Front, name: str) -> str:
    return next(q.symbol for q in front.search.objectives if q.name == name)
