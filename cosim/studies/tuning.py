"""Tuning of the IHC in simulation as the paper describes it: start as the LC, lower a_min while the measure improves.

Section IV of the paper: step 1, a_min = b_max = 1, which is the LC; step 2, decrease a_min and, if necessary, increase
b_max as long as this improves the control. Here it is done against a measure that is named, in the measurement chain of a
scenario, on the same draws of encoder offsets (a Sobol set) and noise for every point. Any controller FMU with a law IHC,
a_min and b_max is tuned; the pendulum's also for each scale of P and each mu, since its design is solved here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fmu_export.files import FilePath
from fmu_export.variables import Value
from ihc_fmu.design import Design
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.pendulum.start_values import design_values

from ..errors import UserError
from ..metric_meanings import QUANTITIES, MetricMeaning, is_pendulum, quantities_of
from ..pendulum import is_controller
from ..scenario import Scenario
from ..scenario_system import controller_values, evaluation, plant_values
from .comparison import UNSTEADY
from .draws import Chance, chance_of, draw_changes
from .engine import Job, Workers, run_numbers
from .estimates import MeanEstimate, change, mean, rms_change, root_mean_square
from .experiments import check_outputs, laws_of
from .journal import Journal
from .numbers import Numbers

ROLES = ("integral", "rms", "settling", "energy", "variation")
"""What can be tuned by: smaller is better."""
MEASURES = tuple(q.name for role in ROLES for q in QUANTITIES.values() if q.role == role)
"""The pendulum's metrics to tune by."""


class Point(NamedTuple):
    """What is tuned: mu, the scale of P as the largest |k x| on the unit ball [V], a_min, b_max.

    None for the first two: those of the controller FMU.
    """

    mu: float | None
    u_max: float | None
    a_min: float
    b_max: float


Family = tuple[float | None, float | None]
"""mu and the scale of P, as in a Point."""


@dataclass(frozen=True)
class Grid:
    """The values that are tried. Every a_min at b_max = 1 for each mu and u_max; every b_max at the a_min found there."""

    a_min: tuple[float, ...] = tuple(round(1.0 - 0.05 * i, 2) for i in range(19))
    b_max: tuple[float, ...] = (1.0, 1.25, 1.6, 2.0)
    u_max: tuple[float, ...] = (1.5, 3.0, 10.0)
    mu: tuple[float, ...] = (0.5, 1.0)

    def __post_init__(self) -> None:
        for name, values in (("a_min", self.a_min), ("b_max", self.b_max), ("u_max", self.u_max), ("mu", self.mu)):
            if not values or not all(math.isfinite(v) and v > 0.0 for v in values) or len(set(values)) < len(values):
                raise UserError(f"{name} must be different positive numbers, found {', '.join(map(str, values))}")
        if max(self.a_min) != 1.0 or min(self.b_max) != 1.0:
            raise UserError(
                f"tuning starts at a_min = b_max = 1: a_min must not exceed 1 and b_max not fall below it, and both lists "
                f"must have it, found a_min up to {max(self.a_min)} and b_max from {min(self.b_max)}"
            )
        if max(self.mu) > 1.0:
            raise UserError(f"mu must lie in (0, 1], found {max(self.mu)}")


@dataclass(frozen=True)
class Outcome:
    """A point's means over the draws in which the law took over once and acted to the end, `kept` of `draws`.

    `measure` is infinite where fewer than half were kept, or the measure is one of a steady state that was not reached.
    A draw that never settles counts the run's duration. `over_linear`: the change of the measure over the LC's in the
    draws that both kept, with its interval. `steady`: the end of the runs is a steady state.
    """

    point: Point
    measure: float
    chattering: float
    kept: int
    draws: int
    steady: bool = True
    over_linear: MeanEstimate = field(default_factory=lambda: MeanEstimate(math.nan))


@dataclass(frozen=True)
class Tuning:
    """All outcomes, where the rule stopped for each (mu, u_max), the LC's outcome, the design of each (mu, u_max)."""

    measure: str
    outcomes: Mapping[Point, Outcome]
    stops: tuple[Point, ...]
    linear: Outcome
    designs: Mapping[Family, Design | None]
    quantities: Mapping[str, MetricMeaning] = field(default_factory=lambda: QUANTITIES)

    @property
    def chattering(self) -> MetricMeaning | None:
        """The metric of chattering; None where the system has none for all its controls."""
        return chattering_of(self.quantities)

    @property
    def best(self) -> Outcome:
        """The best of the points at which the paper's rule stopped."""
        return min((self.outcomes[point] for point in self.stops), key=lambda o: (o.measure, -o.point.a_min))


def chattering_of(quantities: Mapping[str, MetricMeaning]) -> MetricMeaning | None:
    """Return the one metric of chattering; None where there is none, or one for each of several units."""
    variations = [q for q in quantities.values() if q.role == "variation"]
    return variations[0] if len(variations) == 1 else None


@dataclass(frozen=True)
class TuningProblem:
    """What is tuned in: scenario, its folder, the FMUs, the linear controller's design, measure, limit, draws.

    `design` is the pendulum's; None: that in the controller FMU, whose mu and scale of P stay. `measure` None: the integral
    of |e|^2. `most_chattering`: largest variation of the controls relative to the LC's; infinite without a limit.
    """

    scenario: Scenario
    folder: FilePath
    fmus: FilePath
    design: Design | None
    measure: str | None = None
    most_chattering: float = math.inf
    draws: int = 16

    def __post_init__(self) -> None:
        measures = [q.name for role in ROLES for q in self.quantities.values() if q.role == role]
        if self.measure is None and measures:
            object.__setattr__(self, "measure", measures[0])
        if self.measure not in measures:
            raise UserError(f"the measure must be one of {', '.join(measures)}, found {self.measure!r}")
        if not self.most_chattering > 0.0:
            raise UserError(f"the limit of chattering must be positive, found {self.most_chattering}")
        if math.isfinite(self.most_chattering) and chattering_of(self.quantities) is None:
            raise UserError("a limit of chattering needs controls of one unit; evaluate.controls says which count")
        if self.draws < 1:
            raise UserError(f"tuning needs at least one draw, found {self.draws}")
        if self.design is not None and (self.design.psi or self.design.d_max):
            raise UserError(
                "tuning rescales P, which a design with the terms of Remark 3, psi and d_max, does not allow"
            )
        decided = set() if self.design is None else _design_start(self.design).keys()
        fixed = sorted(decided & self.scenario.controller.start.keys())
        if fixed:
            raise UserError(f"tuning decides controller.start.{fixed[0]} by its design; give the design with --design")

    @cached_property
    def quantities(self) -> Mapping[str, MetricMeaning]:
        """The system's metrics by name."""
        if self.design is not None:
            return QUANTITIES
        judged = evaluation(self.scenario, self.fmus, self.folder)
        return QUANTITIES if judged is None else quantities_of(judged)

    @cached_property
    def chance(self) -> Chance:
        """What of the plant is drawn."""
        return chance_of(plant_values(self.scenario, self.fmus, self.folder))

    @property
    def numbers(self) -> range:
        """The draws' numbers: one where nothing is left to chance."""
        return range(1, self.draws + 1 if self.chance else 2)

    def families(self, grid: Grid) -> list[Family]:
        """Return each mu and scale of P that is tried; those of the controller FMU where it keeps its design."""
        return [(None, None)] if self.design is None else [(mu, u_max) for mu in grid.mu for u_max in grid.u_max]

    def designs(self, grid: Grid) -> dict[Family, Design | None]:
        """Return the design of each (mu, u_max), for the same A, b, k_lin and alpha; None for that in the FMU."""
        d = self.design
        if d is None:
            return {(None, None): None}
        designs: dict[Family, Design | None] = {}
        for mu in grid.mu:
            solved = inverse_design(d.system, Options(mu=mu, alpha=d.alpha, u_max=1.0))
            designs |= {(mu, u_max): solved.scaled_to(u_max=u_max) for u_max in grid.u_max}
        return designs

    def at(self, point: Point, design: Design | None) -> Scenario:
        """Return the scenario with the IHC of a point."""
        return self.scenario.changed(self.changes(point, design))

    def changes(self, point: Point, design: Design | None) -> dict[str, Any]:
        """Return what the IHC of a point changes in the scenario."""
        own = {} if design is None else _design_start(design)
        values = {"law": "IHC", **own, "a_min": point.a_min, "b_max": point.b_max}
        changes: dict[str, Any] = {f"controller.start.{name}": value for name, value in values.items()}
        if design is not None:
            changes["controller.design"] = None
        return changes

    def check_tunable(self) -> None:
        """Raise UserError for a controller without a law IHC or its bounds."""
        if "IHC" not in laws_of(self.scenario, self.fmus, self.folder):
            raise UserError("tuning needs a controller whose `law` can be IHC")
        own = controller_values(self.scenario, self.fmus, self.folder)
        missing = [name for name in ("a_min", "b_max") if name not in own]
        if missing:
            raise UserError(
                f"tuning needs a controller with the parameters a_min and b_max, found none named {missing[0]}"
            )
        if self.design is not None and not is_controller(own):
            raise UserError(
                "a design file is for the pendulum's controller; another keeps the design that it was exported with"
            )


def _design_start(design: Design) -> dict[str, Value]:
    """Return the start values by which a design makes an IHC."""
    return {name: value for name, value in design_values(design).items() if not name.startswith("smc_")}


def tune(
    problem: TuningProblem,
    grid: Grid,
    journal: Journal,
    workers: Workers = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Tuning:
    """Tune by the paper's rule for each mu and u_max of `grid`; finished runs come from and go to `journal`.

    Raises UserError where the LC itself does not keep the pendulum upright, and what a design or a run raises.
    """
    say = progress or (lambda _what, _done, _total: None)
    problem.check_tunable()
    families, chance = problem.families(grid), problem.chance
    designs = problem.designs(grid)
    outcomes: dict[Point, Outcome] = {}
    runs: dict[Point, list[Numbers]] = {}
    start = Point(*families[0], 1.0, 1.0)
    check_outputs(problem.at(start, designs[start.mu, start.u_max]), problem.fmus, problem.folder)

    def run(what: str, points: Iterable[Point]) -> None:
        jobs = [
            Job((point, draw), problem.scenario, problem.folder, changes | draw_changes(problem.scenario, draw, chance))
            for point in points
            if point not in outcomes
            for changes in [problem.changes(point, designs[point.mu, point.u_max])]
            for draw in problem.numbers
        ]
        by_key = run_numbers(
            jobs, problem.fmus, journal, workers=workers, progress=lambda done, total: say(what, done, total)
        )
        for point in dict.fromkeys(key[0] for key in by_key):
            runs[point] = [by_key[point, draw] for draw in problem.numbers]
            outcomes[point] = _outcome(point, runs[point], runs[start], problem)

    down = sorted(grid.a_min, reverse=True)
    run("lowering a_min", (Point(*family, a_min, 1.0) for family in families for a_min in down))
    linear = outcomes[start]
    if not math.isfinite(linear.measure):
        acts = "keeps the pendulum upright" if is_pendulum(problem.quantities) else "acts to the end"
        kept = f"{acts} in {linear.kept} of {linear.draws} draws"
        why = kept if 2 * linear.kept < linear.draws else f"has no {problem.measure} yet at the end of a run"
        raise UserError(f"tuning starts from the LC, which in this scenario {why}")
    if not linear.steady and math.isfinite(problem.most_chattering):
        raise UserError("tuning limits the chattering in steady state, which the LC in this scenario does not reach")
    most = problem.most_chattering * linear.chattering
    lowest = [_walk([outcomes[Point(*family, a_min, 1.0)] for a_min in down], most).point for family in families]
    up = sorted(grid.b_max)
    run("raising b_max", (point._replace(b_max=b_max) for point in lowest for b_max in up))
    stops = tuple(_walk([outcomes[p._replace(b_max=b_max)] for b_max in up], most).point for p in lowest)
    assert problem.measure is not None
    return Tuning(problem.measure, outcomes, stops, linear, designs, problem.quantities)


def _outcome(point: Point, draws: Sequence[Numbers], linear: Sequence[Numbers], problem: TuningProblem) -> Outcome:
    """Return the outcome of a point from the numbers of its draws and the LC's of the same draws."""
    q = problem.quantities[problem.measure or ""]
    kept = [draw for draw in draws if draw.get("kept")]
    both = [(a, b) for a, b in zip(draws, linear, strict=True) if a.get("kept") and b.get("kept")]
    steady = sum(not draw["steady"] for draw in kept) <= UNSTEADY * len(kept)
    if 2 * len(kept) < len(draws) or not kept or (q.of_window and not steady):
        return Outcome(point, math.inf, math.inf, len(kept), len(draws), steady)
    rms = q.over_draws == "rms"
    measured = np.array([_number(draw, q) for draw in kept])
    measure = (root_mean_square if rms else mean)(measured).value
    pairs = np.array([[_number(draw, q) for draw in pair] for pair in both]).reshape(-1, 2)
    over = (rms_change if rms else change)(pairs[:, 0], pairs[:, 1])
    never = q.never and all(math.isnan(draw[q.name]) for draw in kept)
    variation = chattering_of(problem.quantities)
    chattering = math.nan if variation is None else float(np.mean([draw[variation.name] for draw in kept]))
    return Outcome(point, math.inf if never else measure, chattering, len(kept), len(draws), steady, over)


def _number(draw: Numbers, q: MetricMeaning) -> float:
    value = draw[q.name]
    return draw["duration"] if math.isnan(value) and q.never else value


def _walk(steps: Sequence[Outcome], most_chattering: float) -> Outcome:
    """Return the last outcome before the measure stops improving, chattering exceeds its limit or a draw is lost."""
    here = steps[0]
    for step in steps[1:]:
        if step.measure >= here.measure or step.chattering > most_chattering or step.kept < here.kept:
            break
        here = step
    return here
