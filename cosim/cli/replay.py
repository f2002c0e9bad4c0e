"""The command `replay`."""

from __future__ import annotations

from pathlib import Path

import typer

from .display import console, escaped, say_notes
from .options import FAILED, OTHER_FMU, ControllerOption, FmusOption, RunArgument


def replay(run: RunArgument, controller: ControllerOption = None, fmus: FmusOption = Path("fmus")) -> None:
    """Feed a log's measurements to the controller FMU again and check that it commands the same, bit for bit."""
    from ..hil.replay import controller_of
    from ..hil.replay import replay as run_replay
    from ..results import Result

    result = Result.load(run)
    replayed = run_replay(result, controller_of(result, controller, fmus))
    if not replayed.same_fmu:
        say_notes([OTHER_FMU])
    if replayed.first is None:
        console.print(f"exact: {replayed.samples} samples replayed, every output as in the log to the last bit")
        return
    first = replayed.first
    console.print(
        f"not exact: {replayed.differing} of {replayed.samples} rows differ, the first at {first.time:g} s: "
        f"{escaped(first.name)} is {first.logged!r} in the log and {first.replayed!r} in the replay",
        soft_wrap=True,
    )
    raise typer.Exit(FAILED)
