"""The command `new`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .display import console, escaped, interruptible


def new(
    name: Annotated[str, typer.Argument(help="Name of the plant: letters, digits, underscores.", show_default=False)],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; none: one of the plant's name.")
    ] = None,
) -> None:
    """Begin with a plant of your own: write a plant in Python, its system file and a scenario, which run as they are."""
    folder = Path(name) if output is None else output
    with interruptible(folder):
        from ..new import class_name
        from ..new import new as write_new

        paths = write_new(name, folder)
    for path in paths:
        console.print(f"wrote {escaped(path)}")
    commands = (
        f"pythonfmu build -f {name}.py -d {name}.fmu",
        f"qube-ihc linearize {name}.fmu --input torque",
        f"qube-ihc design --system {name}.toml -o {name}.json",
        f"qube-ihc export --design {name}.json -o .",
        f"qube-ihc run {name}_run.toml",
    )
    console.print(f"in that folder, after every change of the class {class_name(name)}:")
    for command in commands:
        console.print(f"    {escaped(command)}", highlight=False)
