"""Coupled FMUs that can run again and again: what their coupling costs is paid once, each run instantiates them anew."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, get_args

import numpy as np

from .coupling import Coupling, split
from .evaluation import Evaluation
from .fmu import FmuError, Port
from .interrupts import deferred_interrupt, second_ends
from .native_loop import Conversion, NativeLoop, Slot
from .results import Interrupted, Result, SimulationError
from .start_values import StartValues
from .structure import Signal

Order = Literal["controller-first", "parallel"]
ORDERS: tuple[str, ...] = get_args(Order)

Engine = Literal["auto", "native", "fmpy"]
ENGINES: tuple[str, ...] = get_args(Engine)
"""Which loop steps the FMUs: that in C, or FMPy's functions called from Python; `auto` takes C unless an FMU is Python."""

PROGRESS_EVERY = 256
"""Steps between two reports of progress by the loop in Python."""

Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""


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
        self.copies: dict[str, list[tuple[Slot, Slot]]] = {name: [] for name in instances}
        self.conversions: dict[str, list[Conversion]] = {name: [] for name in instances}
        for source, target, wire in coupling.wires:
            ends = (where_out[source], where_in[target])
            if wire.converts:
                self.conversions[target[0]].append((*ends, wire.factor, wire.offset))
            else:
                self.copies[target[0]].append(ends)
        self._where_in = where_in
        self.drives: dict[str, list[tuple[Signal, Slot]]] = {}
        self.drive(coupling)
        where = {**where_in, **where_out}
        self.recorded = [where[split(name)] for name in recorded]

    def drive(self, coupling: Coupling) -> None:
        """Take the coupling's signals."""
        self.drives = {name: [] for name in coupling.instances}
        for target, driver in coupling.signals:
            self.drives[target[0]].append((driver, self._where_in[target]))

    def gather(self, name: str, time: float) -> None:
        """Copy what the instance's inputs are wired to into its input buffers."""
        for (source, i), (target, j) in self.copies[name]:
            target[j] = source[i]
        for (source, i), (target, j), factor, offset in self.conversions[name]:
            target[j] = factor * source[i] + offset
        for driver, (target, j) in self.drives[name]:
            target[j] = driver.function(time)


def _slots(ports: Mapping[str, list[Port]]) -> dict[tuple[str, ...], Slot]:
    return {(n, v): (port.values, i) for n, group in ports.items() for port in group for i, v in enumerate(port.names)}


class _Recorder:
    """Rows of recorded outputs: one array of float64 and one of int64."""

    def __init__(self, exchange: _Exchange, names: Sequence[str], units: Mapping[str, str], rows: int) -> None:
        self.count, self.rows = rows, 0
        slots = dict(zip(names, exchange.recorded, strict=True))
        is_real = {name: slot[0]._type_ is ctypes.c_double for name, slot in slots.items()}
        self.names = {kind: [n for n in names if is_real[n] is kind] for kind in (True, False)}
        self.slots = {kind: [slots[n] for n in names_of_kind] for kind, names_of_kind in self.names.items()}
        self.order, self.units = list(names), dict(units)
        self.fresh()

    def fresh(self) -> None:
        """Make new arrays, so that what has been recorded stays as it is."""
        types = {True: np.float64, False: np.int64}
        self.time = np.empty(self.count)
        self.tables = {kind: np.empty((self.count, len(s)), types[kind]) for kind, s in self.slots.items()}

    def record(self, time: float) -> None:
        row = self.rows
        self.time[row] = time
        for kind, table in self.tables.items():
            table[row] = [buffer[index] for buffer, index in self.slots[kind]]
        self.rows = row + 1

    def result(self, metadata: dict[str, Any], judged_by: Evaluation | None) -> Result:
        n = self.rows
        columns = {name: table[:n, i] for kind, table in self.tables.items() for i, name in enumerate(self.names[kind])}
        return Result(self.time[:n], {name: columns[name] for name in self.order}, self.units, metadata, judged_by)


class Rig:
    """Coupled FMUs ready to run `steps` steps of `step` [s]; rows are each `every`-th, besides the first and the last.

    With `reuse` the arrays of a result are those of the next one. Not for several threads at a time; `close` in the end.
    """

    def __init__(
        self,
        coupling: Coupling,
        recorded: Sequence[str],
        step: float,
        steps: int,
        order: Order = "controller-first",
        engine: Engine = "native",
        start_time: float = 0.0,
        every: int = 1,
        *,
        reuse: bool = False,
    ) -> None:
        self.coupling, self.recorded, self.reuse = coupling, recorded, reuse
        self.step, self.steps, self.every, self.start_time = step, steps, every, start_time
        self.order: Order = order
        self.native = engine == "native"
        self.instances = coupling.instances
        self._said = {name: len(i.messages) for name, i in self.instances.items()}
        self._exchange: _Exchange | None = None
        self._recorder: _Recorder | None = None
        self._loop: NativeLoop | None = None
        self._recording = False
        self._time, self._current = start_time, ""
        self._judged_by: Evaluation | None = None

    def run(
        self,
        start: Mapping[str, StartValues] | None = None,
        metadata: Mapping[str, Any] | None = None,
        progress: Progress | None = None,
        signals: Sequence[Signal] | None = None,
        judged_by: Evaluation | None = None,
    ) -> Result:
        """Run once, with the checked start values of each component (None: the coupling's), and other signals on its inputs.

        Raises SimulationError and Interrupted with what was recorded.
        """
        about, self._time, self._recording = {"complete": False, **(metadata or {})}, self.start_time, False
        self._judged_by = judged_by
        if signals is not None:
            self.coupling.drive(signals)
            if self._exchange is not None:
                self._exchange.drive(self.coupling)
        try:
            with second_ends(), deferred_interrupt() as interrupt:
                self._start(self.coupling.start if start is None else start)
                (self._run_native if self.native else self._run_python)(progress, interrupt)
            about["complete"] = True
        except FmuError as error:
            where = f"at t = {self._time:.9g} s: "
            raise SimulationError(where + str(error), self._result(about), self._time, self._current) from None
        except KeyboardInterrupt:
            raise Interrupted(self._result(about)) from None
        finally:
            for instance in self.instances.values():
                instance.free()
        return self._result(about)

    def close(self) -> None:
        """Give the FMUs' libraries back."""
        for instance in self.instances.values():
            instance.close()

    def _start(self, start: Mapping[str, StartValues]) -> None:
        """Initialize: all enter, outputs are exchanged once in stepping order, all leave."""
        stop_time = self.start_time + self.steps * self.step
        for name, instance in self.instances.items():
            self._current = name
            del instance.messages[self._said[name] :]
            instance.start(start[name], self.start_time, stop_time)
        if self._exchange is None:
            self._exchange = _Exchange(self.coupling, self.recorded)
        exchange = self._exchange
        for direction in (exchange.outputs, exchange.inputs):
            for name, instance in self.instances.items():
                self._current = name
                if direction is exchange.inputs:
                    exchange.gather(name, self.start_time)
                instance.transfer(direction[name])
        for name, instance in self.instances.items():
            self._current = name
            instance.run()
            instance.transfer(exchange.outputs[name])
        if self._recorder is None:
            units = {name: self.coupling.unit(name) for name in self.recorded}
            self._recorder = _Recorder(exchange, self.recorded, units, -(-self.steps // self.every) + 1)
        elif not self.reuse:
            self._recorder.fresh()
        self._recorder.rows = 0
        self._recorder.record(self.start_time)
        self._recording = True

    def _run_native(self, progress: Progress | None, interrupt: Sequence[int]) -> None:
        exchange, recorder = self._exchange, self._recorder
        assert exchange is not None
        assert recorder is not None
        if self._loop is None:
            names = list(self.instances)
            self._loop = NativeLoop(
                list(self.instances.values()),
                [exchange.inputs[n] for n in names],
                [exchange.outputs[n] for n in names],
                [exchange.copies[n] for n in names],
                [[slot for _, slot in exchange.drives[n]] for n in names],
                recorder.slots[True],
                recorder.slots[False],
                [exchange.conversions[n] for n in names],
            )
        loop = self._loop
        loop.drive([driver.ahead for drives in exchange.drives.values() for driver, _ in drives])
        loop.begin(recorder.tables[True], recorder.tables[False], recorder.time)
        parallel = self.order == "parallel"
        for done in loop.advance(self.start_time, self.step, self.steps, self.every, recorder.rows, parallel=parallel):
            recorder.rows = loop.run.recorded
            self._time = self.start_time + done * self.step
            if progress is not None:
                progress(done, self.steps)
            if interrupt and done < self.steps:
                raise KeyboardInterrupt
        failure = loop.failure()
        if failure is not None:
            index, what, status = failure
            self._current = list(self.instances)[index]
            self.instances[self._current].fail(what, status)

    def _run_python(self, progress: Progress | None, interrupt: Sequence[int]) -> None:
        exchange, recorder, step = self._exchange, self._recorder, self.step
        assert exchange is not None
        assert recorder is not None
        stages = [
            (name, instance, exchange.inputs[name], exchange.outputs[name], instance.stepper())
            for name, instance in self.instances.items()
        ]
        groups = [[stage] for stage in stages] if self.order == "controller-first" else [stages]
        for k in range(self.steps):
            if interrupt:
                raise KeyboardInterrupt
            self._time = time = self.start_time + k * step
            for group in groups:
                for name, _, _, _, _ in group:
                    exchange.gather(name, time)
                for name, instance, inputs, outputs, do_step in group:
                    self._current = name
                    instance.transfer(inputs)
                    do_step(time, step)
                    instance.transfer(outputs)
            done = k + 1
            if done % self.every == 0 or done == self.steps:
                recorder.record(self.start_time + done * step)
            if progress is not None and (done % PROGRESS_EVERY == 0 or done == self.steps):
                progress(done, self.steps)

    def _result(self, metadata: dict[str, Any]) -> Result:
        metadata["messages"] = {n: list(i.messages) for n, i in self.instances.items() if i.messages}
        if self._recorder is None or not self._recording:
            return Result(np.zeros(0), {}, {}, metadata, self._judged_by)
        return self._recorder.result(metadata, self._judged_by)
