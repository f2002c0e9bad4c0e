"""Regions of attraction: from which start values does a law bring the plant to rest, and how soon?

A scenario is run from the points of one or two axes, each an entry with a range, with each law, in its own measurement
chain, with its sampling and its limits. Where the answer changes between neighbouring points, and nowhere else, points are
added (`refinement`); so each law's boundary has points of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from fmu_export.files import FilePath

from .. import pendulum
from ..errors import UserError
from ..evaluation import NO_UNIT
from ..integration import opened
from ..metric_meanings import QUANTITIES, quantities_of
from ..metrics import LEAST
from ..scenario import Scenario
from ..scenario_run import run_scenario, with_tolerances
from ..scenario_system import build_system, controller_values, evaluation, plant_values
from ..unit_definitions import unit_of
from .cases import FIRST, without_supervisor
from .certified_section import certified
from .draws import Chance, chance_of, draw_changes
from .engine import Workers, run_numbers
from .entries import entry_of, variable_of
from .experiments import LAW, check_outputs, known_laws
from .jobs import Job
from .journal import Journal
from .numbers import Numbers, numbers
from .ranges import Range
from .refinement import Point, Refinement
from .region_map import Axis, Judge, LawRegion, Region

COARSE, FINEST = {1: 64, 2: 16}, {1: 4096, 2: 128}
"""Cells along an axis that a law begins with, and those at its boundary in the end, by the number of axes."""
USUAL_LAWS = ("LC", "IHC")
"""Laws that are looked at unless others are named, those of them that the controller has."""
AS_IT_STANDS = "controller"
"""What stands for the law of a controller that has no choice of laws."""


@dataclass(frozen=True)
class RegionProblem:
    """What is asked.

    Parameters
    ----------
    scenario, folder, fmus
        The scenario, and the folders of its files and of its FMUs.
    over
        The range of each axis, one or two, by the entry's name, see `entries.entry_of`.
    laws
        Values of the controller's `law`; None: LC and IHC as far as it has them.
    coarse, finest
        Cells along each axis: at first, and where the boundary is; None: COARSE, FINEST.
    draws
        Encoder offsets and noise, the same for all laws and points; 0: the scenario as it stands.
    supervisor
        Of the pendulum: whether its supervisor stays as the scenario has it, with swing-up. Otherwise the law acts from the
        first sample on wherever the pendulum is within `fall_back_angle`.

    Raises
    ------
    UserError
        For what cannot be asked.
    """

    scenario: Scenario
    folder: FilePath | None
    fmus: FilePath
    over: Mapping[str, Range]
    laws: Sequence[str] | None = None
    coarse: int | None = None
    finest: int | None = None
    draws: int = 0
    supervisor: bool = False

    def __post_init__(self) -> None:
        if not 1 <= len(self.over) <= 2:
            raise UserError(f"a region is over one or two entries, found {', '.join(self.over) or 'none'}")
        if self.draws < 0:
            raise UserError(f"the number of draws must not be negative, found {self.draws}")
        self.refinement()  # refuses numbers of cells

    def refinement(self) -> Refinement:
        """Return the division of the axes that a law begins with."""
        axes = len(self.over)
        coarse, finest = COARSE[axes] if self.coarse is None else self.coarse, self.finest
        return Refinement(axes, coarse, max(FINEST[axes], coarse) if finest is None else finest)

    @cached_property
    def choices(self) -> dict[str, dict[str, Any]]:
        """What each law changes in the scenario, by its name."""
        known = known_laws(self.scenario, self.fmus, self.folder)
        if not known and self.laws is None:
            return {AS_IT_STANDS: {}}
        names = [law for law in USUAL_LAWS if law in known] or known[:1] if self.laws is None else list(self.laws)
        if not names or not set(names) <= set(known) or len(set(names)) < len(names):
            there = f"different ones of {', '.join(known)}" if known else "left out, since the controller has no `law`"
            raise UserError(f"the laws must be {there}, found {', '.join(names) or 'none'}")
        return {law: {LAW: law} for law in names}

    @cached_property
    def opened_scenario(self) -> Scenario:
        """The scenario with the pendulum's supervisor open, unless it stays, and every row recorded.

        Whether the controller is one for the plant is asked of the scenario as it stands, not where an axis changes it.
        """
        free = {} if self.supervisor else without_supervisor(self.scenario, self.fmus, self.folder)
        return self.scenario.changed({"record.every": 1, "controller.other_model": True, **free})

    @cached_property
    def from_first(self) -> bool:
        """Whether a law must act from the first sample on: for a controller whose supervisor chooses, unless it stays."""
        return not self.supervisor and pendulum.is_controller(controller_values(self.scenario, self.fmus, self.folder))

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        """The axes in the order in which they were named."""
        place = self.scenario, self.fmus, self.folder
        entries = {name: entry_of(name, *place) for name in self.over}
        if len(set(entries.values())) < len(entries):
            raise UserError(f"a region is over two different entries, found {' and '.join(entries)}")
        self.scenario.changed({entry: self.over[name].low for name, entry in entries.items()})  # refuses other names
        rests = certified(*place).rests
        axes = []
        for name, entry in entries.items():
            variable = variable_of(entry, *place)
            if variable is not None and variable.type != "Real":
                raise UserError(f"a region is over real numbers, found {name}, which is of the type {variable.type}")
            unit = NO_UNIT if variable is None else unit_of(variable)
            rest = rests[entry] if entry in rests else _value(entry, *place)
            axes.append(Axis(name, entry, self.over[name], "" if unit == NO_UNIT else unit, rest))
        return tuple(axes)

    @cached_property
    def chance(self) -> Chance:
        """What of the plant is drawn."""
        return chance_of(plant_values(self.scenario, self.fmus, self.folder))

    @property
    def numbers(self) -> Sequence[int | None]:
        """The draws' numbers; None: the scenario as it stands."""
        return range(1, self.draws + 1) if self.draws and self.chance else [None]

    def changes(self, law: str, point: Point, draw: int | None, finest: int) -> dict[str, Any]:
        """Return what a run changes in the scenario."""
        drawn = {} if draw is None else draw_changes(self.scenario, draw, self.chance)
        values = {axis.entry: axis.value(number, finest) for axis, number in zip(self.axes, point, strict=True)}
        return {**drawn, **self.choices[law], **values}


def _value(entry: str, scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> float:
    """Return what the scenario has as an entry: of a start value what the FMU is started with."""
    system = build_system(scenario, fmus, folder)
    variable = variable_of(entry, scenario, fmus, folder)
    if variable is None:
        place: Any = scenario.model_dump()
        for part in entry.split("."):
            place = place[int(part)] if isinstance(place, tuple | list) else place[part]
        return float(place) if isinstance(place, int | float) else math.nan
    component = entry.removeprefix("components.").partition(".")[0]
    start = next(c.start for c in system.components if c.name == component)
    return float(start.get(variable.name, variable.start or 0.0))


def region(
    problem: RegionProblem,
    journal: Journal,
    workers: Workers = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Region:
    """Find each law's region; finished runs come from and go to `journal`.

    Parameters
    ----------
    problem
        What is asked.
    journal
        Of finished runs; the same question, or one with finer cells or more draws, goes on from there.
    workers
        Threads; None: one per core.
    progress
        Called with the stage, the runs done in it and their number.

    Returns
    -------
    Region
        The laws' regions in the order in which they were named.

    Raises
    ------
    UserError
        For ends of a range that cannot be run, and for a scenario whose own run says no tolerance.
    """
    _check_ends(problem)
    base, judge = _base(problem)
    cells = {law: problem.refinement() for law in problem.choices}
    found: dict[str, dict[tuple[Point, int | None], Numbers]] = {law: {} for law in cells}
    rounds = 0
    while wanted := {law: points for law, one in cells.items() if (points := one.wanted)}:
        jobs = [
            Job((law, point, draw), base, problem.folder, problem.changes(law, point, draw, cells[law].finest))
            for law, points in wanted.items()
            for point in points
            for draw in problem.numbers
        ]
        stage = f"the boundary, round {rounds}" if rounds else "coarse cells"
        rounds += 1
        finished = run_numbers(jobs, problem.fmus, journal, workers=workers, progress=_told(progress, stage))
        for (law, point, draw), values in finished.items():
            found[law][point, draw] = values
        for law, points in wanted.items():
            outcomes = {p: [judge.outcome(found[law][p, draw]) for draw in problem.numbers] for p in points}
            cells[law].tell({p: set(some) == {"attracted"} for p, some in outcomes.items()})
    volume = math.prod(axis.range.width for axis in problem.axes)
    laws = {law: LawRegion(law, cells[law], found[law], problem.numbers, volume, judge) for law in cells}
    entries = [axis.entry for axis in problem.axes]
    ball = certified(problem.scenario, problem.fmus, problem.folder, entries)
    return Region(problem.scenario, problem.axes, laws, ball, problem.from_first)


def _told(progress: Callable[[str, int, int], None] | None, stage: str) -> Callable[[int, int], None] | None:
    return None if progress is None else lambda done, total: progress(stage, done, total)


def _check_ends(problem: RegionProblem) -> None:
    """Raise UserError where the scenario cannot be run at the corners of the ranges, or with one of the laws."""
    finest = problem.refinement().finest
    ends = [(0,), (finest,)] if len(problem.axes) == 1 else [(0, 0), (0, finest), (finest, 0), (finest, finest)]
    laws = list(problem.choices)
    for law, point in [*((laws[0], point) for point in ends), *((law, ends[0]) for law in laws[1:])]:
        scenario = problem.opened_scenario.changed(problem.changes(law, point, None, finest))
        check_outputs(scenario, problem.fmus, problem.folder)
        for component in build_system(scenario, problem.fmus, problem.folder).components:
            opened(component.name, component.path, component.interface).checked_start(component.start)


def _base(problem: RegionProblem) -> tuple[Scenario, Judge]:
    """Return the scenario with the tolerances of settling, and how its runs are judged."""
    place = problem.fmus, problem.folder
    plain = problem.opened_scenario
    scenario = with_tolerances(plain, *place)
    judged = evaluation(scenario, *place)
    quantities = QUANTITIES if judged is None else quantities_of(judged)
    judge = Judge(quantities, plain.run.duration, FIRST * plain.run.step if problem.from_first else None)
    if scenario != plain:
        _check_tolerances(scenario, judge, problem)
    return scenario, judge


def _check_tolerances(scenario: Scenario, judge: Judge, problem: RegionProblem) -> None:
    """Raise UserError where a run of the scenario as it stands says no tolerance: nothing errs in it, or it goes astray."""
    tolerances = scenario.evaluate.tolerances or ()
    names = [q.symbol for q in judge.quantities.values() if q.role == "settling"]
    still = [name for name, tolerance in zip(names, tolerances, strict=True) if tolerance <= LEAST]
    advice = "give evaluate.tolerance or evaluate.tolerances, or start it elsewhere"
    if still:
        what = still[0].removeprefix("settling").strip() or "|e|"
        raise UserError(
            f"the tolerance of {what} is a share of its largest in the scenario as it stands, where it is 0; {advice}"
        )
    outcome = judge.outcome(numbers(run_scenario(scenario, problem.fmus, problem.folder)))
    if outcome != "attracted":
        raise UserError(
            f"the scenario as it stands, by whose errors settling is judged, does not settle itself; {advice}"
        )
