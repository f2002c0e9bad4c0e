"""The command `region`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from filing.ownership import check_replaceable

from ..errors import UserError
from .display import console, escaped, resumable, say_notes, show_table, staged_progress
from .options import SCENARIO_HELP, ClusterOption, FmusOption, SetOption, WorkersOption, assignments, workers_at

if TYPE_CHECKING:
    from ..studies.ranges import Range


def region(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    over: Annotated[
        list[str],
        typer.Option(
            metavar="ENTRY=LOW..HIGH",
            help="An axis: a start value, such as `plant.delta_0=-1..1`, or another entry of the scenario; twice for a map, "
            "once for a line.",
        ),
    ],
    laws: Annotated[
        str | None,
        typer.Option(help="Laws, separated by commas; none: LC and IHC, as far as the controller has them."),
    ] = None,
    coarse: Annotated[
        int | None, typer.Option(min=2, help="Cells along each axis at first; none: 16, on a line 64.")
    ] = None,
    resolution: Annotated[
        int | None,
        typer.Option(
            min=2,
            help="Cells along each axis at the boundary: the coarse ones times a power of two; none: 128, on a line 4096.",
        ),
    ] = None,
    draws: Annotated[
        int,
        typer.Option(
            min=0,
            help="Encoder offsets and noise, the same for each start, which counts as attracted where it is in all of them; "
            "0: the scenario's, once.",
        ),
    ] = 0,
    supervisor: Annotated[
        bool,
        typer.Option(
            "--supervisor",
            help="Leave the pendulum's supervisor as the scenario has it, with swing-up; otherwise the law acts from the "
            "first sample on.",
        ),
    ] = False,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; none: `results/region_NAME`.")
    ] = None,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Find from which start values each law brings the plant to rest, and how soon: a map over two of them, or a line.

    Starts are added where the answer changes. Writes every run as a table, the maps as a picture with the certified ball,
    the areas with their bounds as JSON. Finished runs are kept: the same command, or a finer one, goes on from there.
    """
    from ..remarks import remarks_before
    from ..scenario import load_located
    from ..scenario_system import build_system
    from ..studies.journal import Journal
    from ..studies.numbers import PURPOSE
    from ..studies.region import RegionProblem
    from ..studies.region import region as find_region
    from ..studies.region_files import WRITTEN_FILES, save

    loaded_scenario, folder, fmus = load_located(scenario, fmus)
    loaded_scenario = loaded_scenario.changed(dict(assignments(change)))
    named = None if laws is None else [law.strip() for law in laws.split(",")]
    problem = RegionProblem(loaded_scenario, folder, fmus, _ranges(over), named, coarse, resolution, draws, supervisor)
    target = output or Path("results") / f"region_{loaded_scenario.name}"
    check_replaceable(*(target / name for name in WRITTEN_FILES))
    say_notes(remarks_before(build_system(loaded_scenario, fmus, folder), loaded_scenario))
    with resumable(target / "runs.sqlite") as finished:
        with (
            workers_at(workers, cluster) as where,
            Journal(finished, PURPOSE) as journal,
            staged_progress() as report,
        ):
            found = find_region(problem, journal, where, report)
        paths = save(found, target)
        show_table(*found.table())
        for remark in found.remarks():
            console.print(escaped(remark))
        for path in paths:
            console.print(f"wrote {escaped(path)}")


def _ranges(over: list[str]) -> dict[str, Range]:
    """Return the range of each axis by its name; raise UserError for another text, and for a name given twice."""
    from ..studies.ranges import range_of

    ranges: dict[str, Range] = {}
    for text in over:
        name, equals, ends = text.partition("=")
        if not equals or not name.strip():
            raise UserError(f"--over takes ENTRY=LOW..HIGH, found {text!r}")
        if name.strip() in ranges:
            raise UserError(f"--over takes different entries, found {name.strip()} twice")
        ranges[name.strip()] = range_of(ends, f"--over {name.strip()}")
    return ranges
