"""Tuning of the IHC in simulation as the paper describes it: start as the LC, lower a_min while the measure improves.

Section IV of the paper: step 1, a_min = b_max = 1, which is the LC; step 2, decrease a_min and, if necessary, increase
b_max as long as this improves the control. Here it is done for each scale of P and each mu, against a measure that is named,
in the measurement chain of a scenario, on the same draws of encoder offsets (a Sobol set) and noise for every point.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from filing.files import staging, write_file
from fmu_export.variables import Value
from ihc_fmu.design import Design
from ihc_fmu.pendulum.start_values import design_values
from ihc_fmu.synthesis import Options, inverse_design

from .campaign import Job, Journal, Numbers, run_numbers
from .draws import Estimate, change, drawn, mean, rms_change, root_mean_square
from .errors import UserError
from .experiments import UNSTEADY, check_outputs
from .metrics import QUANTITIES, Quantity, evaluate, kept_upright
from .plots import OTHERS, save_figure
from .results import Result
from .scenario import Scenario, files

MEASURES = ("integral_q2", "steady_rms", "settling_time", "energy", "voltage_variation")
"""Metrics to tune by: smaller is better."""

CHATTERING = "voltage_variation"

WRITTEN_FILES = ("tuning.csv", "landscape.png", "best.toml", "best.json")
"""What `save` writes."""

PURPOSE = "tuning: numbers 2"
"""Named in the journal; to be changed with `numbers`."""


class Point(NamedTuple):
    """What is tuned: mu, the scale of P as the largest |k x| on the unit ball [V], a_min, b_max."""

    mu: float
    u_max: float
    a_min: float
    b_max: float


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
    """A point's means over the draws in which it kept the pendulum upright, `kept` of `draws`.

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
    over_linear: Estimate = field(default_factory=lambda: Estimate(math.nan))


@dataclass(frozen=True)
class Tuning:
    """All outcomes, where the rule stopped for each (mu, u_max), the LC's outcome, the design of each (mu, u_max)."""

    measure: str
    outcomes: Mapping[Point, Outcome]
    stops: tuple[Point, ...]
    linear: Outcome
    designs: Mapping[tuple[float, float], Design]

    @property
    def best(self) -> Outcome:
        """The best of the points at which the paper's rule stopped."""
        return min((self.outcomes[point] for point in self.stops), key=lambda o: (o.measure, -o.point.a_min))


@dataclass(frozen=True)
class Problem:
    """What is tuned in: scenario, its folder, the FMUs, the linear controller's design, measure, limit, draws.

    `most_chattering`: largest voltage variation relative to the LC's; infinite without a limit.
    """

    scenario: Scenario
    folder: Path
    fmus: Path
    design: Design
    measure: str = "integral_q2"
    most_chattering: float = math.inf
    draws: int = 16

    def __post_init__(self) -> None:
        if self.measure not in MEASURES:
            raise UserError(f"the measure must be one of {', '.join(MEASURES)}, found {self.measure!r}")
        if not self.most_chattering > 0.0:
            raise UserError(f"the limit of chattering must be positive, found {self.most_chattering}")
        if self.draws < 1:
            raise UserError(f"tuning needs at least one draw, found {self.draws}")
        if self.design.psi or self.design.d_max:
            raise UserError(
                "tuning rescales P, which a design with the terms of Remark 3, psi and d_max, does not allow"
            )
        fixed = sorted(_design_start(self.design).keys() & self.scenario.controller.start.keys())
        if fixed:
            raise UserError(f"tuning decides controller.start.{fixed[0]} by its design; give the design with --design")

    def designs(self, grid: Grid) -> dict[tuple[float, float], Design]:
        """Return the design of each (mu, u_max), for the same A, b, k_lin and alpha."""
        d = self.design
        found = {}
        for mu in grid.mu:
            solved = inverse_design(d.system, Options(mu=mu, alpha=d.alpha, u_max=1.0))
            found |= {(mu, u_max): solved.scaled_to(u_max=u_max) for u_max in grid.u_max}
        return found

    def at(self, point: Point, design: Design) -> Scenario:
        """Return the scenario with the IHC of a point."""
        values = {"law": "IHC", **_design_start(design), "a_min": point.a_min, "b_max": point.b_max}
        changes = {f"controller.start.{name}": value for name, value in values.items()}
        return self.scenario.changed({**changes, "controller.design": None, "record.every": 1})


def _design_start(design: Design) -> dict[str, Value]:
    """Return the start values by which a design makes an IHC."""
    return {name: value for name, value in design_values(design).items() if not name.startswith("smc_")}


def tune(
    problem: Problem,
    grid: Grid,
    journal: Journal,
    workers: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Tuning:
    """Tune by the paper's rule for each mu and u_max of `grid`; finished runs come from and go to `journal`.

    Raises UserError where the LC itself does not keep the pendulum upright, and what a design or a run raises.
    """
    say = progress or (lambda _what, _done, _total: None)
    families = [(mu, u_max) for mu in grid.mu for u_max in grid.u_max]
    designs = problem.designs(grid)
    outcomes: dict[Point, Outcome] = {}
    runs: dict[Point, list[Numbers]] = {}
    start = Point(*families[0], 1.0, 1.0)
    check_outputs(problem.at(start, designs[start.mu, start.u_max]), problem.fmus, problem.folder)

    def run(what: str, points: Iterable[Point]) -> None:
        jobs = [
            Job((point, draw), drawn(scenario, draw), problem.folder)
            for point in points
            if point not in outcomes
            for scenario in [problem.at(point, designs[point.mu, point.u_max])]
            for draw in range(1, problem.draws + 1)
        ]
        found = run_numbers(jobs, problem.fmus, numbers, journal, workers, lambda done, total: say(what, done, total))
        for point in dict.fromkeys(key[0] for key in found):
            runs[point] = [found[point, draw] for draw in range(1, problem.draws + 1)]
            outcomes[point] = _outcome(point, runs[point], runs[start], problem)

    down = sorted(grid.a_min, reverse=True)
    run("lowering a_min", (Point(*family, a_min, 1.0) for family in families for a_min in down))
    linear = outcomes[start]
    if not math.isfinite(linear.measure):
        kept = f"keeps the pendulum upright in {linear.kept} of {linear.draws} draws"
        why = kept if 2 * linear.kept < linear.draws else f"has no {problem.measure} yet at the end of a run"
        raise UserError(f"tuning starts from the LC, which in this scenario {why}")
    if not linear.steady and math.isfinite(problem.most_chattering):
        raise UserError("tuning limits the chattering in steady state, which the LC in this scenario does not reach")
    most = problem.most_chattering * linear.chattering
    lowest = [_walk([outcomes[Point(*family, a_min, 1.0)] for a_min in down], most).point for family in families]
    up = sorted(grid.b_max)
    run("raising b_max", (point._replace(b_max=b_max) for point in lowest for b_max in up))
    stops = tuple(_walk([outcomes[p._replace(b_max=b_max)] for b_max in up], most).point for p in lowest)
    return Tuning(problem.measure, outcomes, stops, linear, designs)


def numbers(result: Result) -> dict[str, float]:
    """Return what tuning needs of a run."""
    metrics = evaluate(result)
    values = metrics.as_dict()
    return {
        **{name: float(values[name]) for name in MEASURES},
        "kept": float(kept_upright(result)),
        "steady": float(metrics.steady),
        "duration": float(result.time[-1] - result.time[0]),
    }


def _outcome(point: Point, draws: Sequence[Numbers], linear: Sequence[Numbers], problem: Problem) -> Outcome:
    """Return the outcome of a point from the numbers of its draws and the LC's of the same draws."""
    q = QUANTITIES[problem.measure]
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
    chattering = float(np.mean([draw[CHATTERING] for draw in kept]))
    return Outcome(point, math.inf if never else measure, chattering, len(kept), len(draws), steady, over)


def _number(draw: Numbers, q: Quantity) -> float:
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


def save(tuning: Tuning, problem: Problem, folder: Path) -> list[Path]:
    """Write tuning.csv, landscape.png and the best point as best.toml (scenario) and best.json (design); return them.

    FMUs that lie beside the tuned scenario are copied beside the new one.
    """
    lines = ["mu,u_max,a_min,b_max," + f"{tuning.measure},over_lc,interval,{CHATTERING},kept,draws,stop"]
    for point, o in sorted(tuning.outcomes.items(), key=lambda item: (item[0].mu, item[0].u_max, -item[0].a_min)):
        over = (o.over_linear.value, o.over_linear.half_width)
        row = (*point, o.measure, *over, o.chattering, o.kept, o.draws, int(point in tuning.stops))
        lines.append(",".join(map(repr, row)))
    best = tuning.best.point
    design = tuning.designs[best.mu, best.u_max]
    own = {"controller.design": "best.json", "record.every": 1}
    start = {"law": "IHC", "a_min": best.a_min, "b_max": best.b_max}
    start = {f"controller.start.{name}": value for name, value in start.items()}
    scenario = problem.scenario.changed({**own, **start}).to_toml()
    used = files(problem.scenario, problem.fmus, problem.folder)[:2]
    fmus = [path for path in used if path.parent.absolute() != problem.fmus.absolute()]
    title = (
        f"{problem.scenario.name}: {QUANTITIES[tuning.measure].symbol} and chattering, means of {problem.draws} draws\n"
        "square: where the rule stops; triangle: there with b_max raised"
    )
    with staging(folder) as place:
        write_file(place / "tuning.csv", "\n".join(lines) + "\n")
        for path in fmus:
            write_file(place / path.name, path.read_bytes())
        write_file(place / "best.toml", scenario)
        design.save(place / "best.json")
        save_figure(_landscape(tuning), place / "landscape.png", title)
    return [folder / name for name in WRITTEN_FILES]


def _landscape(tuning: Tuning) -> Figure:
    mus = list(dict.fromkeys(point.mu for point in tuning.outcomes))
    figure = Figure(figsize=(4.2 * len(mus) + 1, 7), layout="constrained")
    panels = figure.subplots(2, len(mus), sharex=True, sharey="row", squeeze=False)
    stops = {(p.mu, p.u_max): p for p in tuning.stops}
    for column, mu in enumerate(mus):
        for number, u_max in enumerate(dict.fromkeys(p.u_max for p in tuning.outcomes)):
            curve = sorted(
                (o for p, o in tuning.outcomes.items() if (p.mu, p.u_max, p.b_max) == (mu, u_max, 1.0)),
                key=lambda o: -o.point.a_min,
            )
            stop, colour = tuning.outcomes[stops[mu, u_max]], OTHERS[number % len(OTHERS)]
            for row, name in enumerate(("measure", "chattering")):
                axis = panels[row, column]
                values = [getattr(o, name) if math.isfinite(getattr(o, name)) else math.nan for o in curve]
                a_mins = [o.point.a_min for o in curve]
                label = f"|k x| ≤ {u_max:g} V on the unit ball"
                axis.plot(a_mins, values, "o-", ms=3, lw=1, color=colour, label=label)
                if stop.point.b_max == 1.0:
                    axis.plot(stop.point.a_min, getattr(stop, name), "s", mfc="none", ms=9, color=colour)
                else:
                    axis.plot(stop.point.a_min, getattr(stop, name), "^", ms=8, color=colour)
        panels[0, column].set_title(f"μ = {mu:g}", fontsize="medium")
        panels[1, column].set_xlabel("$a_{min}$ (1: the LC)")
    for axis in panels.flat:
        axis.set_yscale("log")
        axis.grid(alpha=0.3, which="both")
    panels[0, 0].invert_xaxis()
    panels[0, 0].set_ylabel(QUANTITIES[tuning.measure].heading)
    panels[1, 0].set_ylabel(QUANTITIES[CHATTERING].heading)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure
