"""The master: steps coupled FMUs at a fixed step and records.

Time is an integer step index k; the communication points are t_k = t_0 + k h. In the order `controller-first` (Gauss-
Seidel) the instances step one after the other as listed, each reading what those before it have just computed: with the
controller listed first its voltage acts in the step in which it was computed, without delay. In the order `parallel`
(Jacobi) all read the outputs of the last communication point, which delays every wire by one step.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from fmu_export.files import FilePath

from .coupling import Coupling, split
from .errors import UserError
from .fmu import FmuError, Port
from .integration import IntegratedInstance
from .interrupts import deferred_interrupt, second_ends
from .native_loop import NativeLoop, needs_python
from .results import Interrupted, Result, SimulationError, versions
from .room import check_rows
from .structure import SystemStructure

Order = Literal["controller-first", "parallel"]
ORDERS: tuple[str, ...] = get_args(Order)

Engine = Literal["auto", "native", "fmpy"]
ENGINES: tuple[str, ...] = get_args(Engine)
"""Which loop steps the FMUs: that in C, or FMPy's functions called from Python; `auto` takes C unless an FMU is Python."""

PROGRESS_EVERY = 256
"""Steps between two reports of progress by the loop in Python."""

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


class _Exchange:
    """The buffers of a running coupling: input and output ports per instance, and what is copied between them."""

    def __init__(self, coupling: Coupling, recorded: Sequence[str]) -> None:
        instances = coupling.instances
        sources = {source for source, _, _ in coupling.wires} | {split(name) for name in recorded}
        targets = [t for _, t, _ in coupling.wires] + [t for t, _ in coupling.signals]
        sources -= {target for target, _ in coupling.signals}  # recorded from the buffer that they are set from
        self.outputs = {n: i.ports([v for v in i.variables if (n, v) in sources], "Get") for n, i in instances.items()}
        self.inputs = {n: i.ports([v for o, v in targets if o == n], "Set") for n, i in instances.items()}
        where_out = _slots(self.outputs)
        where_in = _slots(self.inputs)
        self.copies = {name: [] for name in instances}
        self.conversions = {name: [] for name in instances}
        for source, target, wire in coupling.wires:
            ends = (*where_out[source], *where_in[target])
            if wire.converts:
                self.conversions[target[0]].append((*ends, wire.factor, wire.offset))
            else:
                self.copies[target[0]].append(ends)
        self.drives = {name: [] for name in instances}
        for target, driver in coupling.signals:
            self.drives[target[0]].append((driver, *where_in[target]))
        where = {**where_in, **where_out}
        self.recorded = [where[split(name)] for name in recorded]

    def gather(self, name: str, time: float) -> None:
        """Copy what the instance's inputs are wired to into its input buffers."""
        for source, i, target, j in self.copies[name]:
            target[j] = source[i]
        for source, i, target, j, factor, offset in self.conversions[name]:
            target[j] = factor * source[i] + offset
        for driver, target, j in self.drives[name]:
            target[j] = driver.function(time)


def _slots(ports: Mapping[str, list[Port]]) -> dict[tuple[str, ...], tuple[ctypes.Array, int]]:
    return {(n, v): (port.values, i) for n, group in ports.items() for port in group for i, v in enumerate(port.names)}


class _Recorder:
    """Rows of recorded outputs, in arrays made before the run: one of float64 and one of int64."""

    def __init__(self, exchange: _Exchange, names: Sequence[str], rows: int) -> None:
        self.rows = 0
        self.time = np.empty(rows)
        is_real = {name: slot[0]._type_ is ctypes.c_double for name, slot in zip(names, exchange.recorded, strict=True)}
        self.names = {kind: [n for n in names if is_real[n] is kind] for kind in (True, False)}
        self.order = list(names)
        slots = dict(zip(names, exchange.recorded, strict=True))
        self.slots = {kind: [slots[n] for n in names_of_kind] for kind, names_of_kind in self.names.items()}
        types = {True: np.float64, False: np.int64}
        self.tables = {kind: np.empty((rows, len(s)), types[kind]) for kind, s in self.slots.items()}

    def record(self, time: float) -> None:
        row = self.rows
        self.time[row] = time
        for kind, table in self.tables.items():
            table[row] = [buffer[index] for buffer, index in self.slots[kind]]
        self.rows = row + 1

    def result(self, coupling: Coupling, metadata: dict[str, Any]) -> Result:
        n = self.rows
        columns = {name: table[:n, i] for kind, table in self.tables.items() for i, name in enumerate(self.names[kind])}
        signals = {name: columns[name] for name in self.order}
        return Result(self.time[:n], signals, {name: coupling.unit(name) for name in self.order}, metadata)


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
    coupling = Coupling(system)
    recorded = coupling.checked_outputs(record)
    check_rows(steps // every + 2, len(recorded), every, folder=None if folder is None else Path(folder))
    if engine == "auto":
        engine = "fmpy" if needs_python(coupling.instances) else "native"
    integrated = [name for name, i in coupling.instances.items() if isinstance(i, IntegratedInstance)]
    if integrated and engine == "native":
        raise UserError(
            f"engine must be auto or fmpy where FMUs are run for model exchange, found native and {', '.join(integrated)}"
        )
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
    run = _Run(coupling, recorded, steps, every, known)
    return run.execute(step, start_time, order, engine, progress)


def _conversions(system: SystemStructure) -> dict[str, Any]:
    """Return factor and offset of the wires that convert, by their targets, as metadata; nothing where none does."""
    conversions = {w.target: [w.factor, w.offset] for w in system.wires if w.converts}
    return {"conversions": conversions} if conversions else {}


class _Run:
    """One run, from instantiation to the freed instances."""

    def __init__(
        self, coupling: Coupling, recorded: list[str], steps: int, every: int, metadata: dict[str, Any]
    ) -> None:
        self.coupling, self.steps, self.every, self.metadata = coupling, steps, every, metadata
        self.recorded = recorded
        self.recorder: _Recorder | None = None
        self.time, self.current = 0.0, ""
        self.interrupt: list[int] = []

    def execute(
        self,
        step: float,
        start_time: float,
        order: Order,
        engine: Engine,
        progress: Callable[[int, int], None] | None,
    ) -> Result:
        self.time = start_time
        loop = self._native_loop if engine == "native" else self._python_loop
        try:
            with second_ends(), deferred_interrupt() as self.interrupt:
                self._start(start_time, start_time + self.steps * step)
                loop(step, start_time, order, progress)
            self.metadata["complete"] = True
        except FmuError as error:
            where = f"at t = {self.time:.9g} s: "
            raise SimulationError(where + str(error), self._result(), self.time, self.current) from None
        except KeyboardInterrupt:
            raise Interrupted(self._result()) from None
        finally:
            for instance in self.coupling.instances.values():
                instance.close()
        return self._result()

    def _start(self, start_time: float, stop_time: float) -> None:
        """Initialize: all enter, outputs are exchanged once in stepping order, all leave."""
        instances = self.coupling.instances
        for name, instance in instances.items():
            self.current = name
            instance.start(self.coupling.start[name], start_time, stop_time)
        self.exchange = exchange = _Exchange(self.coupling, self.recorded)
        for direction in (exchange.outputs, exchange.inputs):
            for name, instance in instances.items():
                self.current = name
                if direction is exchange.inputs:
                    exchange.gather(name, start_time)
                instance.transfer(direction[name])
        for name, instance in instances.items():
            self.current = name
            instance.run()
            instance.transfer(exchange.outputs[name])
        self.recorder = _Recorder(exchange, self.recorded, -(-self.steps // self.every) + 1)
        self.recorder.record(start_time)

    def _native_loop(
        self, step: float, start_time: float, order: Order, progress: Callable[[int, int], None] | None
    ) -> None:
        assert self.recorder is not None
        exchange, recorder, instances = self.exchange, self.recorder, self.coupling.instances
        names = list(instances)
        loop = NativeLoop(
            [instances[n] for n in names],
            [exchange.inputs[n] for n in names],
            [exchange.outputs[n] for n in names],
            [[((a, i), (b, j)) for a, i, b, j in exchange.copies[n]] for n in names],
            [[(driver.ahead, (b, j)) for driver, b, j in exchange.drives[n]] for n in names],
            (recorder.slots[True], recorder.tables[True]),
            (recorder.slots[False], recorder.tables[False]),
            recorder.time,
            [
                [((a, i), (b, j), factor, offset) for a, i, b, j, factor, offset in exchange.conversions[n]]
                for n in names
            ],
        )
        parallel = order == "parallel"
        for done in loop.advance(start_time, step, self.steps, self.every, recorder.rows, parallel=parallel):
            recorder.rows = loop.run.recorded
            self.time = start_time + done * step
            if progress is not None:
                progress(done, self.steps)
            if self.interrupt and done < self.steps:
                raise KeyboardInterrupt
        failure = loop.failure()
        if failure is not None:
            index, what, status = failure
            self.current = names[index]
            instances[names[index]].fail(what, status)

    def _python_loop(
        self, step: float, start_time: float, order: Order, progress: Callable[[int, int], None] | None
    ) -> None:
        assert self.recorder is not None
        exchange, recorder = self.exchange, self.recorder
        stages = [
            (name, instance, exchange.inputs[name], exchange.outputs[name], instance.stepper())
            for name, instance in self.coupling.instances.items()
        ]
        groups = [[stage] for stage in stages] if order == "controller-first" else [stages]
        interrupt = self.interrupt
        for k in range(self.steps):
            if interrupt:
                raise KeyboardInterrupt
            self.time = time = start_time + k * step
            for group in groups:
                for name, _, _, _, _ in group:
                    exchange.gather(name, time)
                for name, instance, inputs, outputs, do_step in group:
                    self.current = name
                    instance.transfer(inputs)
                    do_step(time, step)
                    instance.transfer(outputs)
            done = k + 1
            if done % self.every == 0 or done == self.steps:
                recorder.record(start_time + done * step)
            if progress is not None and (done % PROGRESS_EVERY == 0 or done == self.steps):
                progress(done, self.steps)

    def _result(self) -> Result:
        messages = {n: i.messages for n, i in self.coupling.instances.items() if i.messages}
        metadata = {**self.metadata, "messages": messages}
        if self.recorder is None:
            return Result(np.zeros(0), {}, {}, metadata)
        return self.recorder.result(self.coupling, metadata)
