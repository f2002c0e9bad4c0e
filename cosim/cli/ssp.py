"""The command `ssp`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ..errors import UserError
from .display import console, escaped, interruptible, say_notes
from .options import SCENARIO_HELP, FmusOption, SetOption, assignments


def ssp(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write; none: `NAME.ssp`.")] = None,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Write a scenario as one SSP file: FMUs, wires, start values, step and duration; `run` runs it, other tools too.

    Signals and disturbances have no place in it.
    """
    from ..coupling import Coupling
    from ..scenario import load_located
    from ..scenario_system import build_system
    from ..ssp import SUFFIX, write

    loaded_scenario, folder, fmus = load_located(scenario, fmus)
    loaded_scenario = loaded_scenario.changed(dict(assignments(change)))
    path = output or Path(f"{loaded_scenario.name}{SUFFIX}")
    if path.suffix != SUFFIX:
        raise UserError(f"--output must name a {SUFFIX} file, found {path}")
    system = build_system(loaded_scenario, fmus, folder)
    start = Coupling(system).start
    system = replace(system, components=[replace(c, start=start[c.name]) for c in system.components])
    say_notes(f"an SSP has no signals: {s.target} keeps its start value there" for s in system.signals)
    with interruptible(path):
        written = write(path, loaded_scenario.name, system, loaded_scenario.run.duration, loaded_scenario.run.step)
        console.print(f"wrote {escaped(written)}")
