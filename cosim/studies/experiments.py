"""Experiments: a scenario run with each law of its controller, or other choices, over draws of what is left to chance."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from fmu_export.errors import UserError
from fmu_export.files import FilePath

from ..coupling import Coupling
from ..fmu import Instance
from ..judged_signals import check_judged, kept_upright
from ..metric_meanings import measure_of
from ..metrics import Metrics, evaluate
from ..names import is_plain
from ..results import Result
from ..scenario import Scenario
from ..scenario_files import files
from ..scenario_run import run_scenario, with_tolerances
from ..scenario_system import build_system, evaluation, plant_values
from ..wiring import CONTROLLER
from .comparison import Comparison, Draw
from .draws import PENDULUM, Chance, chance_of, draw_changes
from .engine import Job, Workers, judge_all

LAWS = ("LC", "SMC", "IHC")
"""What a comparison takes of a controller's laws unless it is told others, and their order: the paper's."""

LAW = "controller.start.law"
"""The entry that a comparison varies unless it is told another."""


@dataclass(frozen=True)
class Experiment:
    """A scenario, the folder of its file, the number of draws (0: once, as it stands), and what is varied in it.

    `entry` is what is varied, and `values` its values by the names that they have in tables; None: names are the values.
    """

    scenario: Scenario
    folder: FilePath
    draws: int = 0
    entry: str = LAW
    values: Mapping[str, Any] | None = None
    chance: Chance = PENDULUM

    @property
    def numbers(self) -> Sequence[int | None]:
        """The draws' numbers."""
        return range(1, self.draws + 1) if self.draws and self.chance else [None]

    def at(self, law: str, number: int | None) -> Scenario:
        """Return the scenario of a law, or another choice, and draw."""
        return self.scenario.changed(self.changes(law, number))

    def changes(self, law: str, number: int | None) -> dict[str, Any]:
        """Return what a law, or another choice, and a draw change in the scenario."""
        drawn = {} if number is None else draw_changes(self.scenario, number, self.chance)
        return {**drawn, self.scenario.entry(self.entry): law if self.values is None else self.values[law]}


def known_laws(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> list[str]:
    """Return the laws that the scenario's controller has: the values of its enumeration `law`, in the order of LAWS.

    None where it has no such variable.
    """
    path = files(scenario, fmus, folder).fmus.get(CONTROLLER)
    controller = None if path is None else Instance(CONTROLLER, path)
    law = None if controller is None else controller.variables.get("law")
    items = [item.name for item in getattr(getattr(law, "declaredType", None), "items", None) or ()]
    return [law for law in LAWS if law in items] + [item for item in items if item not in LAWS]


def laws_of(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> list[str]:
    """Return the laws of the scenario's controller as `known_laws`; raise UserError where it has none to choose."""
    laws = known_laws(scenario, fmus, folder)
    if not laws:
        raise UserError("the controller has no enumeration `law` to compare; --vary ENTRY=VALUE,VALUE compares others")
    return laws


def check_names(names: Sequence[str]) -> None:
    """Raise UserError for names of choices that are not different, or cannot be names of files."""
    if len(set(names)) < len(names) or not names:
        raise UserError(f"what is compared must be different values, found {', '.join(names)}")
    for name in names:
        if not is_plain(name) or name == "comparison":
            raise UserError(f"a value that is compared names a file, which {name!r} cannot")


def check_outputs(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> None:
    """Raise UserError for a system that cannot be coupled, or whose FMUs lack outputs that the metrics need."""
    system, judged = build_system(scenario, fmus, folder), evaluation(scenario, fmus, folder)
    check_judged(Coupling(system).checked_outputs(scenario.record.outputs), judged, fmus)


def _judged(result: Result) -> tuple[bool, Metrics]:
    return kept_upright(result), evaluate(result)


def run_experiments(
    experiments: Sequence[Experiment],
    fmus: FilePath,
    laws: Sequence[str] = LAWS,
    workers: Workers = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Comparison]:
    """Run every law in every experiment with every draw, in `workers` threads (None: one per core) or on a cluster.

    All laws of an experiment see the same encoder offsets and noise; a plant that has neither is run once. `laws` are the
    names of the choices of each experiment. `progress(done, total)` counts runs. Raises what a run
    raises; on that, and on Ctrl-C, runs that have not begun are dropped and running ones stopped.
    """
    check_names(laws)
    for experiment in experiments:  # says what cannot work before anything runs
        for law in laws:
            check_outputs(experiment.at(law, None), fmus, experiment.folder)
    experiments = [
        replace(
            experiment,
            scenario=with_tolerances(experiment.scenario, fmus, experiment.folder),
            chance=chance_of(plant_values(experiment.scenario, fmus, experiment.folder)),
        )
        for experiment in experiments
    ]
    jobs = [
        Job((s, law, number), experiment.scenario, experiment.folder, experiment.changes(law, number))
        for s, experiment in enumerate(experiments)
        for number in experiment.numbers
        for law in laws
    ]
    judged = judge_all(jobs, fmus, _judged, workers, progress)
    comparisons = []
    for s, experiment in enumerate(experiments):
        draws = tuple(Draw(law, n, *judged[s, law, n]) for law in laws for n in experiment.numbers)
        if len({tuple(draw.metrics.quantities) for draw in draws}) > 1:
            raise UserError(
                f"runs of different {experiment.entry} are judged by different signals; evaluate says which"
            )
        rms = measure_of(draws[0].metrics.quantities, "rms").name
        ranked = sorted((d for d in draws if d.law == laws[0]), key=lambda d: d.metrics.values[rms])
        typical = ranked[len(ranked) // 2].number
        results = {law: run_scenario(experiment.at(law, typical), fmus, experiment.folder) for law in laws}
        comparisons.append(Comparison(experiment.scenario, draws, results, experiment.chance))
    return comparisons
