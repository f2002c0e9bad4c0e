"""The command `linearize`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from filing.ownership import check_replaceable
from fmu_export.errors import shown
from fmu_export.files import is_folder

from ..errors import UserError
from .display import console, escaped, interruptible, problems, say_notes, show_table
from .options import assignments

if TYPE_CHECKING:
    from ..linear_model import LinearModel


_PI = re.compile(r"([+-]?)(?:(\d+(?:\.\d*)?)\s*\*?\s*)?pi(?:\s*/\s*(\d+(?:\.\d*)?))?")


NamesOption = list[str] | None


def linearize(
    fmu: Annotated[Path, typer.Argument(help="Any FMI 2.0 FMU of a plant.", show_default=False)],
    inputs: Annotated[
        NamesOption, typer.Option("--input", help="Input that a controller moves; may be repeated. None: the only one.")
    ] = None,
    outputs: Annotated[
        NamesOption, typer.Option("--output", help="Output that is measured; may be repeated. None: the states.")
    ] = None,
    states: Annotated[
        NamesOption,
        typer.Option(
            "--state",
            metavar="OUTPUT[=PARAMETER]",
            help="For FMUs for co-simulation only: output that is a state, and the parameter that sets it at the start; "
            "none: all outputs S with a parameter S_0, or whose own start value can be set. For model exchange: state to "
            "keep; none: all.",
        ),
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="Value of a state or an input at the equilibrium, such as `angle=pi`; the other states are searched from "
            "their start values, the other inputs stay at theirs.",
        ),
    ] = None,
    free: Annotated[
        NamesOption, typer.Option(help="Input that the search for the equilibrium may change; may be repeated.")
    ] = None,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="PARAMETER=VALUE", help="Start value of the FMU; may be repeated."),
    ] = None,
    step: Annotated[
        float | None, typer.Option(help="Communication step for co-simulation [s]; none: the FMU's own, or 1 ms.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output-file", "-o", help="System file to write (TOML); none: the FMU's name in this folder."),
    ] = None,
) -> None:
    """Find a linear model of a plant's FMU about an equilibrium and write it as a system file for `design`.

    What you add to the file above its line (weights, limits, resolutions) stays when the command is repeated.
    """
    if is_folder(fmu):
        raise UserError(f"the file to linearize must be an FMU, found the folder {fmu}")
    path = output or Path(f"{fmu.stem}.toml")
    if path.suffix != ".toml":
        raise UserError(f"-o must name a .toml file, found {path}")
    check_replaceable(path)
    values = {name: _value(name, text) for name, text in _pairs("--at", at)}
    with interruptible(path):
        from ..interrupts import second_ends
        from ..linearize import linear_model
        from ..system_file import write

        with second_ends(), problems.status(f"evaluating {escaped(fmu)}"):
            model = linear_model(
                fmu,
                inputs or (),
                outputs or (),
                states=states or (),
                at=values,
                free=free or (),
                start=dict(assignments(change)),
                step=step,
            )
        write(path, model, f"From {fmu.name if fmu.name.isprintable() else 'an FMU'}: {model.method}.")
        _print(model)
        say_notes(model.notes)
    console.print(f"wrote {escaped(path)}")


def _pairs(option: str, items: list[str] | None) -> list[tuple[str, str]]:
    pairs = []
    for item in items or []:
        name, equals, text = item.rpartition("=")  # a name may hold one
        if not equals or not name:
            raise UserError(f"{option} takes NAME=VALUE, found {shown(item)}")
        if name in dict(pairs):
            raise UserError(f"{option} must have each name once, found {shown(name)} twice")
        pairs.append((name, text))
    return pairs


def _value(name: str, text: str) -> float:
    """Return a number, or a multiple of pi such as pi/2 or -0.5*pi."""
    from math import pi

    match = _PI.fullmatch(text.strip())
    if match is not None:
        sign, factor, divisor = match.groups()
        value = float(factor or 1.0) * pi / (float(divisor) if divisor and float(divisor) else 1.0)
        return -value if sign == "-" else value
    try:
        return float(text)
    except ValueError:
        raise UserError(f"--at {name} must be a number or a multiple of pi, found {shown(text)}") from None


def _print(model: LinearModel) -> None:
    import numpy as np

    said = f"{model.name}: {len(model.A)} states, {model.method}; estimated relative error {model.error:.1g}"
    rows = [
        (kind, str(quantity), f"{value:.6g}", "" if rate is None else f"{rate:.2g}")
        for kind, quantities, values, rates in (
            ("state", model.states, model.x_eq, list(model.residual)),
            ("input", model.inputs, model.u_eq, [None] * len(model.inputs)),
            ("output", model.outputs, model.y_eq, [None] * len(model.outputs)),
        )
        for quantity, value, rate in zip(quantities, values, rates, strict=True)
    ]
    show_table(said, ("", "quantity", "equilibrium", "derivative there"), rows)
    poles = sorted(np.linalg.eigvals(model.A), key=lambda p: (-p.real, -p.imag))
    console.print(f"poles [1/s]: {', '.join(_pole(p) for p in poles)}", highlight=False)


def _pole(p: complex) -> str:
    return f"{p.real:.4g}" if abs(p.imag) < 1e-9 * max(1.0, abs(p)) else f"{p.real:.4g}{p.imag:+.4g}i"
