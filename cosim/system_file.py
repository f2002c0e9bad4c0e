"""System files that `linearize` writes: the user's entries above a line, the model below it, which alone is replaced."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from filing.files import write_file
from filing.origin import WRITTEN
from filing.ownership import check_replaceable
from fmu_export.files import FilePath, is_file
from fmu_export.reading import parse_toml, read_text
from ihc_fmu.system import System

from .errors import UserError
from .plant_model import LinearModel, sample_time_for

LINE = "# The model: linearize replaces what stands below this line and leaves what stands above as it is."
"""Parts a file in two."""


def write(path: FilePath, model: LinearModel, comment: str = "") -> System:
    """Write the model to a system file and return the system that the file then means.

    A file that is there keeps what stands above LINE; a new one gets hints for what a controller needs besides. `comment`
    goes below. Raises UserError for a file without LINE or that another wrote, and where both parts do not fit.
    """
    path, system = Path(path), model.system()
    check_replaceable(path)
    text = "\n".join((_above(path, system), LINE, *(f"# {line}" for line in comment.splitlines()), _below(system)))
    try:
        system = System.from_dict(parse_toml(text, path))
    except UserError as error:
        raise UserError(f"what stands above the line in {path} does not fit the model: {error}") from None
    write_file(path, text)
    return system


def _above(path: Path, system: System) -> str:
    if not is_file(path) or not path.stat().st_size:
        return _hints(system)
    above, line, _ = read_text(path, "system").partition(LINE)
    if not line:
        raise UserError(f"{path} was not written by linearize and stays; choose another name or move that file")
    return above.rstrip("\n") + "\n"


def _hints(system: System) -> str:
    """Return the upper part of a new file: what is known, and as comments what the user may add."""
    assert system.lower is not None
    assert system.upper is not None
    ones = {"states": [1.0] * system.n, "inputs": [1.0] * system.m, "outputs": [0.0] * system.p}
    limits = [[float(low), float(high)] for low, high in zip(system.lower, system.upper, strict=True)]
    known = np.isfinite(limits).any()
    others = (
        [] if system.measures_state else ["# observer = {}  # a homogeneous observer in place of the Kalman filter"]
    )
    return "\n".join(
        (
            f"# {WRITTEN}",
            f'name = "{system.name}"',
            f"sample_time = {system.sample_time!r}  # of the controller [s]: {sample_time_for(system.A)[1]}",
            f"{'' if known else '# '}limits = {limits if known else ones['inputs']}  # of {_listed(system.inputs)}",
            f"# lqr = {{ Q = {ones['states']}, R = {ones['inputs']} }}  # weights of {_listed(system.states)}; or K = [...]",
            f"# resolutions = {ones['outputs']}  # steps of counting sensors of {_listed(system.outputs)}; 0: none",
            f"# deviations = {ones['outputs']}  # standard deviations of their noise; 0: none",
            f'# set_points = ["{system.outputs[0].name}"]  # outputs with a reference',
            '# integral = "direct"  # integral action, against constant disturbances; or K_i of a PI controller',
            *others,
            "",
        )
    )


def _listed(quantities: Sequence[Any]) -> str:
    return ", ".join(map(str, quantities))


def _below(system: System) -> str:
    """Return the lower part: names, matrices a row a line, and the table of the equilibrium, which must be last."""
    import tomli_w  # noqa: PLC0415

    data = system.as_dict()
    names = {kind: data[kind] for kind in ("states", "inputs", "outputs") if kind in data}
    parts = [tomli_w.dumps(names)]
    for name in ("A", "B", "C"):
        if name in data:
            rows = ",\n".join(f"    [{', '.join(map(repr, row))}]" for row in data[name])
            parts.append(f"{name} = [\n{rows},\n]\n")
    if "equilibrium" in data:
        parts.append("\n" + tomli_w.dumps({"equilibrium": data["equilibrium"]}))
    return "".join(parts)
