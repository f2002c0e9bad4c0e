"""A scenario run: its system simulated, with what it is judged by among the result's metadata."""

from __future__ import annotations

from collections.abc import Callable

from fmu_export.files import FilePath

from . import metrics
from .master import simulate
from .results import Result
from .scenario import Scenario
from .scenario_system import evaluation, system_and_evaluation


def run_scenario(
    scenario: Scenario,
    fmus: FilePath,
    folder: FilePath | None = None,
    progress: Callable[[int, int], None] | None = None,
    target: FilePath | None = None,
) -> Result:
    """Run `scenario` and return its result, whose metadata holds it; raises as `simulate`.

    `target` is the folder that the result will be written to, which must have room for it.
    """
    run, (system, judged) = scenario.run, system_and_evaluation(scenario, fmus, folder)
    return simulate(
        system,
        run.step,
        run.duration,
        run.order,
        engine=run.engine,
        record=scenario.record.outputs,
        every=scenario.record.every,
        metadata={
            "scenario": scenario.model_dump(mode="json"),
            **({} if judged is None else {"evaluation": judged.model_dump(mode="json")}),
        },
        progress=progress,
        folder=target,
    )


def with_tolerances(scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> Scenario:
    """Return the scenario with the tolerances of settling that it does not name: those of a run of it as it stands.

    So runs that are compared are held against the same ones. Raises as `run_scenario`.
    """
    judged = evaluation(scenario, fmus, folder)
    if judged is None or None not in judged.settled:
        return scenario
    tolerances = metrics.with_tolerances(run_scenario(scenario, fmus, folder), judged).settled
    return scenario.changed({"evaluate.tolerances": tolerances})
