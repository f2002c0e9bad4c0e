"""The master: steps coupled FMUs at a fixed step and records.

Time is an integer step index k; the communication points are t_k = t_0 + k h. In the order `controller-first` (Gauss-
Seidel) the instances step one after the other as listed, each reading what those before it have just computed: with the
controller listed first its voltage acts in the step in which it was computed, without delay. In the order `parallel`
(Jacobi) all read the outputs of the last communication point, which delays every wire by one step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fmu_export.files import FilePath

from .coupling import Coupling
from .errors import UserError
from .integration import IntegratedInstance
from .native_loop import needs_python
from .results import Result, versions
from .rig import ENGINES, ORDERS, Engine, Order, Rig
from .room import check_rows
from .structure import SystemStructure

MOST_STEPS = 10**9
"""Steps of the longest run."""


def step_count(step: float, duration: float) -> int:
    """Return duration/step; raise UserError where the two do not fit, naming both."""
    for name, value in (("step", step), ("duration", duration)):
        if not (math.isfinite(value) and value > 0.0):
            raise UserError(f"{name} must be positive and finite, found {value} s")
    steps = round(min(duration / step, 2.0 * MOST_STEPS))
    if steps > MOST_STEPS:
        raise UserError(f"a run may have {MOST_STEPS:g} steps, found a duration of {duration} s and a step of {step} s")
    if steps < 1 or abs(duration / step - steps) > 1e-6:
        raise UserError(f"duration must be a multiple of the step, found {duration} s and {step} s")
    return steps


def simulate(
    system: SystemStructure,
    step: float,
    duration: float,
    order: Order = "controller-first",
    *,
    engine: Engine = "auto",
    start_time: float = 0.0,
    record: Sequence[str] | None = None,
    every: int = 1,
    metadata: Mapping[str, Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
    folder: FilePath | None = None,
) -> Result:
    """Run coupled FMUs at a fixed communication step.

    Parameters
    ----------
    system
        The FMUs, their wires and signals.
    step
        Communication step [s].
    duration
        A multiple of the step [s].
    order
        "controller-first": one after the other as listed, each reads what those before it have just computed; "parallel":
        all read the outputs of the last communication point.
    engine
        The loop: "native" in C, "fmpy" in Python, "auto" in C unless an FMU is Python or for model exchange. Both make the
        same calls and give the same result to the last bit.
    start_time
        When it begins [s].
    record
        Outputs to record, as `instance.variable`; None: all.
    every
        Record each n-th communication point besides the first and the last.
    metadata
        What the result's metadata hold besides.
    progress
        Called with (steps done, steps in all).
    folder
        Where the result will be written, which must have room for it.

    Returns
    -------
    Result
        What was recorded.

    Raises
    ------
    UserError
        Before anything runs, for what cannot work or leaves more than there is room for.
    SimulationError
        Where an FMU fails, with what was recorded.
    Interrupted
        On Ctrl-C, with what was recorded.

    Examples
    --------
    An arm upside down falls by itself, angle'' = 4 angle, so that angle = 0.1 cosh(2 t):

    >>> import cosim
    >>> plant = cosim.Component("plant", "fmus/arm_linear_plant.fmu", {"angle_0": 0.1})
    >>> result = cosim.simulate(cosim.SystemStructure([plant]), step=0.1, duration=1.0)
    >>> round(float(result["plant.angle"][-1]), 6)
    0.37622
    """
    steps = step_count(step, duration)
    if order not in ORDERS:
        raise UserError(f"order must be one of {', '.join(ORDERS)}, found {order!r}")
    if engine not in ENGINES:
        raise UserError(f"engine must be one of {', '.join(ENGINES)}, found {engine!r}")
    if every < 1:
        raise UserError(f"every must be at least 1, found {every}")
    coupling, engine = coupled(system, engine)
    recorded = coupling.checked_outputs(record)
    check_rows(steps // every + 2, len(recorded), every, folder=None if folder is None else Path(folder))
    integrated = [name for name, i in coupling.instances.items() if isinstance(i, IntegratedInstance)]
    known = {
        "versions": dict(versions()),
        "fmus": {
            n: {"file": i.path.name, "model": i.description.modelName, "guid": i.description.guid}
            for n, i in coupling.instances.items()
        },
        "start_values": coupling.start,
        "wires": [[w.source, w.target] for w in system.wires],
        **_conversions(system),
        **({"integrated": {n: coupling.instances[n].tolerance for n in integrated}} if integrated else {}),
        "order": order,
        "engine": engine,
        "step": step,
        "every": every,
        "complete": False,
        **(metadata or {}),
    }
    rig = Rig(coupling, recorded, step, steps, order, engine, start_time, every)
    try:
        return rig.run(metadata=known, progress=progress)
    finally:
        rig.close()


def coupled(system: SystemStructure, engine: Engine) -> tuple[Coupling, Engine]:
    """Return the coupling of a system and the engine that runs it; raises UserError for what cannot work."""
    coupling = Coupling(system)
    integrated = [name for name, i in coupling.instances.items() if isinstance(i, IntegratedInstance)]
    if integrated and engine == "native":
        raise UserError(
            f"engine must be auto or fmpy where FMUs are run for model exchange, found native and {', '.join(integrated)}"
        )
    if engine == "auto":
        engine = "fmpy" if needs_python(coupling.instances) else "native"
    return coupling, engine


def _conversions(system: SystemStructure) -> dict[str, Any]:
    """Return factor and offset of the wires that convert, by their targets, as metadata; nothing where none does."""
    conversions = {w.target: [w.factor, w.offset] for w in system.wires if w.converts}
    return {"conversions": conversions} if conversions else {}
