"""The command `sweep`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from filing.ownership import check_replaceable

from ..errors import UserError
from .display import console, escaped, resumable, say_notes, show_table, staged_progress
from .options import SCENARIO_HELP, ClusterOption, FmusOption, SetOption, WorkersOption, assignments, workers_at


class Method(StrEnum):
    """How draws are taken."""

    sobol = "sobol"
    latin = "latin"
    grid = "grid"


def sweep(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENTRY=SPEC",
            help="What is varied, e.g. `plant.m_p=normal(0.024,5%)`, `controller.a_min=0.2..1`, `plant.T_r=±50%`, "
            "`run.step=0.001,0.002`; also `uniform`, `lognormal`, `loguniform`; may be repeated.",
        ),
    ] = None,
    draws: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Draws, best a power of two; none: 256; of a grid: draws of the offsets for each point, none: 1.",
        ),
    ] = None,
    laws: Annotated[
        str | None,
        typer.Option(
            help="Laws side by side on the same draws, separated by commas; none: those of this project that the "
            "controller has."
        ),
    ] = None,
    sampling: Annotated[
        Method | None,
        typer.Option(
            help="sobol: more draws continue the same set; none: grid where only lists are varied, else sobol."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws.")] = 1,
    metric: Annotated[
        list[str] | None,
        typer.Option(
            help="Metric that is told of, by its name in the tables that are written; may be repeated, and the first ranks "
            "the worst draws; none: all, and the integral of the squared error."
        ),
    ] = None,
    worst: Annotated[int, typer.Option(min=0, help="Worst draws of each law that are written as scenarios.")] = 3,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; none: `results/sweep_NAME`.")
    ] = None,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Vary anything in a scenario, with the laws side by side on the same draws: who is better, how often, what decides.

    Writes a table of all runs (CSV, Parquet), pictures, and the worst draws as scenarios. Finished runs are kept: the same
    command, or one with more draws, goes on from there.
    """
    from ihc_fmu.arguments import check_among

    from ..remarks import remarks_before
    from ..scenario import load_located
    from ..scenario_system import build_system
    from ..studies.journal import Journal
    from ..studies.numbers import PURPOSE
    from ..studies.sweep import run_sweep
    from ..studies.sweep_files import check_parquet, save, written_files
    from ..studies.sweep_plan import plan_sweep
    from ..studies.sweep_tables import remarks, tables

    check_parquet()
    loaded_scenario, folder, fmus = load_located(scenario, fmus)
    loaded_scenario = loaded_scenario.changed(dict(assignments(change)))
    names = None if laws is None else [law.strip() for law in laws.split(",")]
    method = None if sampling is None else sampling.value
    plan = plan_sweep(loaded_scenario, _varied(vary), fmus, folder, names, draws, method, seed)
    for name in metric or []:
        check_among("metric", name, plan.quantities)
    target = output or Path("results") / f"sweep_{loaded_scenario.name}"
    check_replaceable(*(target / name for name in written_files(plan.laws, worst)))
    say_notes(remarks_before(build_system(loaded_scenario, fmus, folder), loaded_scenario))
    with resumable(target / "runs.sqlite") as finished:
        with (
            workers_at(workers, cluster) as where,
            Journal(finished, PURPOSE) as journal,
            staged_progress() as report,
        ):
            found = run_sweep(plan, journal, where, lambda done, total: report("co-simulation", done, total))
        paths = save(found, target, metric[0] if metric else None, worst)
        for title, headings, rows in tables(found, metric):
            show_table(title, headings, rows)
        for remark in remarks(found):
            console.print(escaped(remark))
        for path in paths:
            console.print(f"wrote {escaped(path)}")


def _varied(items: list[str] | None) -> dict[str, str]:
    """Return the specifications by names of entries, of each ENTRY=SPEC."""
    found: dict[str, str] = {}
    for item in items or []:
        name, equals, spec = item.partition("=")
        name = name.strip()
        if not equals or not name or not spec.strip():
            raise UserError(f"--vary takes ENTRY=SPEC, such as plant.m_p=±10%, found {item!r}")
        if name in found:
            raise UserError(f"--vary names {name} twice")
        found[name] = spec
    return found
