"""A log fed to the controller FMU again: does it command the same, to the last bit?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..fmu import FmuError
from ..fmu_files import describe
from ..interrupts import second_ends
from ..provenance import Provenance, provenance
from ..results import Result, SimulationError
from ..structure import Component
from .controller import ControllerFmu
from .driven import names_of

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


LEAST_ROWS = 2
"""Rows with one sample between them."""


def controller_of(result: Result, given: Path | None, fmus: Path) -> Path:
    """Return the controller FMU to use with a log: the file that the user named, or the log's own in the folder `fmus`.

    What the log names is a file in that folder and nowhere else, and its contents are what the log was made with; UserError
    otherwise.
    """
    if given is not None:
        return given
    used = provenance(result).fmus.get("controller")
    if used is None:
        raise UserError("the log does not say with which controller it was made; --controller names one")
    path = fmus / used.file
    guid = describe(path).guid
    if guid != used.guid:
        raise UserError(
            f"{path} is not the FMU that the log was made with, its GUID is {guid} and that of the log {used.guid}; "
            "--controller FILE takes a file all the same"
        )
    return path


def is_own(result: Result, fmu: Path) -> bool:
    """Return whether `fmu` is the controller that the log was made with, by its GUID."""
    used = provenance(result).fmus.get("controller")
    return used is not None and describe(fmu).guid == used.guid


def replay(result: Result, fmu: Path) -> Replay:
    """Feed the measured angles of `result` to the controller `fmu` with the log's start values and compare all outputs.

    Inputs that signals drove have the log's values again.

    The log is one of a device, or a simulation's with encoders, the order controller-first and every row. Raises
    UserError for a log that lacks what is needed, SimulationError where the FMU fails.
    """
    origin = provenance(result)
    used, start = origin.fmus.get("controller"), origin.start_values.get("controller")
    if used is None or start is None or origin.step is None:
        raise UserError("the log does not say with which controller and start values it was made")
    if origin.order != "controller-first" or origin.every != 1:
        raise UserError("a replay needs every row of a run in the order controller-first")
    if not _got_angles_only(origin):
        raise UserError("a replay needs a run whose controller got the encoders' angles and signals, and nothing else")
    if len(result.time) < LEAST_ROWS:
        raise UserError(f"a replay needs at least {LEAST_ROWS} rows, the log has {len(result.time)}")
    theta, delta = (result[name] for name in MEASURED)
    controller = ControllerFmu(Component("controller", fmu, start), origin.step, driven_inputs(origin))
    controller.follow({name: driven_values(result, name).tolist() for name in controller.inputs})
    names = (*controller.layout.reals, *controller.layout.integers)
    logged = [result[f"controller.{name}"].tolist() for name in names]
    rows = len(result.time)
    steps = result["hil.steps"].tolist() if "hil.steps" in result.signals else [1] * rows
    if rows:
        steps[-1] = 0  # the outputs after the last row were never in force
    replayed = np.empty((rows, len(names)))
    row = 0
    try:
        with second_ends():
            controller.prepare()
            outputs = controller.begin(float(theta[0]), float(delta[0]))
            earlier = 0.0, 0.0, 0
            for row in range(rows):
                replayed[row] = outputs
                if steps[row]:
                    sample = float(theta[row]), float(delta[row]), row
                    controller.catch_up(earlier, *sample[:2], steps[row])
                    controller.command(*sample)
                    outputs, earlier = controller.outputs(), sample
    except FmuError as error:
        done = Result(result.time[:row], {}, {}, result.metadata)
        time = float(result.time[row]) if rows else 0.0
        raise SimulationError(f"at t = {time:.9g} s of the replay: {error}", done, time, "controller") from None
    finally:
        controller.close()
    same = np.array([_bits(replayed[:, i]) == _bits(np.array(column)) for i, column in enumerate(logged)]).T
    differing = np.flatnonzero(~np.all(same, axis=1)) if rows else np.zeros(0, int)
    first = None
    if differing.size:
        row = int(differing[0])
        column = int(np.flatnonzero(~same[row])[0])
        first = Difference(float(result.time[row]), names[column], logged[column][row], float(replayed[row, column]))
    return Replay(sum(map(bool, steps)), int(differing.size), first, is_own(result, fmu))


def driven_inputs(origin: Provenance) -> tuple[str, ...]:
    """Return the names of the controller's inputs that signals drove."""
    return names_of([signal.input for signal in origin.scenario.signals])


def driven_values(result: Result, name: str) -> np.ndarray:
    """Return the values of a driven input of the controller from each row on; a row has that which was in force until it.

    Raises UserError where they were not recorded.
    """
    column = result[f"controller.{name}"]
    return np.append(column[1:], column[-1:])


def _got_angles_only(origin: Provenance) -> bool:
    """Return whether wires gave the controller the encoders' angles and nothing else."""
    angles = dict(zip(("controller.theta", "controller.delta"), MEASURED, strict=True))
    wires = origin.wires if origin.wires is not None else [(source, target) for target, source in angles.items()]
    fed = {target: source for source, target in wires if target.startswith("controller.")}
    return fed == angles


def _bits(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float64).view(np.int64)
