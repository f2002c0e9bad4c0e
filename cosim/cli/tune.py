"""The command `tune`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from filing.ownership import check_replaceable

from ..errors import UserError
from .display import console, escaped, print_tuning, say_notes, staged_progress
from .options import SCENARIO_HELP, FmusOption, SetOption, assignments, loaded_design


def tune(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    measure: Annotated[
        str | None,
        typer.Option(
            help="Metric to make small; of the pendulum integral_q2, steady_rms, settling_time, energy or "
            "voltage_variation; none: the integral of the squared error."
        ),
    ] = None,
    most_chattering: Annotated[
        float | None, typer.Option(help="Largest variation of the controls, relative to the LC's; none: no limit.")
    ] = None,
    a_min: Annotated[str | None, typer.Option(help="Values of a_min, separated by commas; none: 1 to 0.1.")] = None,
    b_max: Annotated[str | None, typer.Option(help="Values of b_max; none: 1, 1.25, 1.6, 2.")] = None,
    u_max: Annotated[
        str | None, typer.Option(help="Scales of the pendulum's P, |k x| on the unit ball [V]; none: 1.5, 3, 10.")
    ] = None,
    mu: Annotated[str | None, typer.Option(help="Values of the pendulum's mu; none: 0.5, 1.")] = None,
    draws: Annotated[
        int, typer.Option(min=1, help="Encoder offsets and noise, the same for each point; best a power of two.")
    ] = 16,
    design: Annotated[
        Path | None,
        typer.Option(
            help="The pendulum's design file with your A, b, k_lin and alpha; none: the default design. Another "
            "controller keeps the design that it was exported with."
        ),
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; none: one per core.")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; none: `results/tune_NAME`.")
    ] = None,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Tune a_min and b_max, of the pendulum the scale of P and mu too: from the LC on, as long as the measure improves.

    Writes all points as a table and a picture, and the best as a scenario and a design. Finished runs are kept: the same
    command, or one with more values, goes on from there.
    """
    from ihc_fmu.pendulum.start_values import default_design

    from ..pendulum import is_controller
    from ..remarks import remarks_before
    from ..scenario import load_located
    from ..scenario_run import with_tolerances
    from ..scenario_system import build_system, controller_values
    from ..studies.journal import Journal
    from ..studies.numbers import PURPOSE
    from ..studies.tuning import Grid, TuningProblem
    from ..studies.tuning import tune as run_tuning
    from ..studies.tuning_files import WRITTEN_FILES, save

    loaded_scenario, folder, fmus = load_located(scenario, fmus)
    loaded_scenario = loaded_scenario.changed(dict(assignments(change)))
    given = {"a_min": a_min, "b_max": b_max, "u_max": u_max, "mu": mu}
    grid = Grid(
        **{name: _numbers(f"--{name.replace('_', '-')}", text) for name, text in given.items() if text is not None}
    )
    limit = math.inf if most_chattering is None else most_chattering
    own_design = None if design is None else loaded_design(design)
    if own_design is None and is_controller(controller_values(loaded_scenario, fmus, folder)):
        own_design = default_design()
    if own_design is None and (u_max is not None or mu is not None):
        raise UserError("--u-max and --mu are for the pendulum's controller; another keeps those of its design")
    problem = TuningProblem(loaded_scenario, folder, fmus, own_design, measure, limit, draws)
    target = output or Path("results") / f"tune_{loaded_scenario.name}"
    check_replaceable(*(target / name for name in WRITTEN_FILES))
    say_notes(remarks_before(build_system(loaded_scenario, fmus, folder), loaded_scenario))
    problem = replace(problem, scenario=with_tolerances(loaded_scenario, fmus, folder))
    with Journal(target / "runs.sqlite", PURPOSE) as journal, staged_progress() as report:
        tuning = run_tuning(problem, grid, journal, workers, report)
    paths = save(tuning, problem, target)
    print_tuning(tuning)
    for path in paths:
        console.print(f"wrote {escaped(path)}")


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UserError(f"{option} takes numbers separated by commas, found {text!r}") from None
