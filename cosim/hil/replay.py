"""A log fed to the controller FMU again: does it command the same, to the last bit?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..master import Component
from ..results import Result
from .loop import Controller

MEASURED = ("plant.theta_encoder", "plant.delta_encoder")


@dataclass(frozen=True)
class Difference:
    """The first output that differs: time of its row [s], its name, the value in the log and that of the replay."""

    time: float
    name: str
    logged: float
    replayed: float


@dataclass(frozen=True)
class Replay:
    """What a replay found: samples replayed, rows that differ, the first difference, and whether the FMU is the log's."""

    samples: int
    differing: int
    first: Difference | None
    same_fmu: bool


def replay(result: Result, fmu: Path) -> Replay:
    """Feed the measured angles of `result` to the controller `fmu` with the log's start values and compare all outputs.

    The log is one of a device, or a simulation's with encoders, the order controller-first and every row. Raises
    UserError for a log that lacks what is needed.
    """
    about = result.metadata
    try:
        start, step = about["start_values"]["controller"], about["step"]
        guid = about["fmus"]["controller"]["guid"]
    except (KeyError, TypeError):
        raise UserError("the log does not say with which controller and start values it was made") from None
    wires = about.get("wires")
    if about.get("order") != "controller-first" or about.get("every") != 1:
        raise UserError("a replay needs every row of a run in the order controller-first")
    if wires is not None and ["plant.theta_encoder", "controller.theta"] not in wires:
        raise UserError("a replay needs a run whose controller got the encoders' angles and nothing else")
    theta, delta = (result[name] for name in MEASURED)
    controller = Controller(Component("controller", fmu, start), step)
    names = controller.layout.names[-len(controller.layout.reals + controller.layout.integers) :]
    logged = [result[f"controller.{name}"].tolist() for name in names]
    rows = len(result.time)
    steps = result["hil.steps"].tolist() if "hil.steps" in result.signals else [1] * rows
    if rows:
        steps[-1] = 0  # the outputs after the last row were never in force
    replayed = np.empty((rows, len(names)))
    controller.prepare()
    try:
        earlier = (float(theta[0]), float(delta[0])) if rows else (0.0, 0.0)
        outputs = controller.begin(*earlier) if rows else ()
        for row in range(rows):
            replayed[row] = outputs
            if steps[row]:
                angles = float(theta[row]), float(delta[row])
                controller.catch_up(earlier, *angles, steps[row])
                controller.command(*angles)
                outputs, earlier = controller.outputs(), angles
    finally:
        controller.close()
    same = np.array([_bits(replayed[:, i]) == _bits(np.array(column)) for i, column in enumerate(logged)]).T
    differing = np.flatnonzero(~np.all(same, axis=1)) if rows else np.zeros(0, int)
    first = None
    if differing.size:
        row = int(differing[0])
        column = int(np.flatnonzero(~same[row])[0])
        first = Difference(float(result.time[row]), names[column], logged[column][row], float(replayed[row, column]))
    return Replay(sum(map(bool, steps)), int(differing.size), first, controller.instance.description.guid == guid)


def _bits(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float64).view(np.int64)
