"""The stepping loop in C (`native/loop.c`): its structs, made from a coupling's buffers, and its calls.

The loop calls the FMUs' own functions without Python in between and without the global lock, so runs in threads scale.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from fmu_export.native_build import BuildError

from .build import loop_library
from .errors import UserError
from .fmu import Instance, Port
from .integration import IntegratedInstance

SECONDS_PER_CALL = 0.05
"""How long a call runs before Python may look for Ctrl-C and report progress."""

SIGNAL_STEPS = 4096
"""Steps for which functions of time are evaluated ahead."""

_P, _Z, _I32, _I64, _D = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int32, ctypes.c_int64, ctypes.c_double


class _Port(ctypes.Structure):
    _fields_ = [("call", _P), ("references", _P), ("count", _Z), ("values", _P)]


class _Wire(ctypes.Structure):
    _fields_ = [("source", _P), ("target", _P), ("size", _Z)]


class _Conversion(ctypes.Structure):
    _fields_ = [("source", _P), ("target", _P), ("factor", _D), ("offset", _D)]


class _Signal(ctypes.Structure):
    _fields_ = [("values", _P), ("target", _P), ("size", _Z)]


_COUNTS = ("input_count", "output_count", "wire_count", "conversion_count", "signal_count")


class _Instance(ctypes.Structure):
    _fields_ = [
        ("component", _P),
        ("do_step", _P),
        *[(name, _Z) for name in _COUNTS],
        *[(name, _P) for name in ("inputs", "outputs", "wires", "conversions", "signals")],
    ]


class _Span(ctypes.Structure):
    _fields_ = [("first", _P), ("count", _Z)]


class _Reals(ctypes.Structure):
    _fields_ = [("count", _Z), ("span_count", _Z), ("spans", _P), ("rows", _P)]


class _Integers(ctypes.Structure):
    _fields_ = [("count", _Z), ("sources", _P), ("rows", _P)]


class _Run(ctypes.Structure):
    _fields_ = [
        ("instance_count", _Z),
        ("instances", _P),
        ("reals", _Reals),
        ("integers", _Integers),
        ("start_time", _D),
        ("step", _D),
        ("steps", _I64),
        ("every", _I64),
        ("parallel", _I32),
        ("done", _I64),
        ("recorded", _I64),
        ("times", _P),
        ("failed_in", _I32),
        ("failed_status", _I32),
        ("failed_instance", _Z),
        ("failed_port", _Z),
    ]


_INPUT, _STEP = 1, 2


@cache
def _advance() -> Callable[..., int]:
    try:
        library = ctypes.CDLL(str(loop_library()))
    except BuildError as error:
        raise UserError(f"{error}; --engine fmpy runs without it") from None
    call = library.loop_advance
    call.argtypes = [ctypes.POINTER(_Run), _I64, _D]
    call.restype = ctypes.c_int
    return call


Slot = tuple[ctypes.Array, int]
"""A place in a port's buffer."""

Conversion = tuple[Slot, Slot, float, float]
"""A wire that converts: source, target, factor, offset."""

Ahead = Callable[[float, float, int, int], Sequence[float]]
"""A signal's values ahead: from start time, step, index of the first step and number of steps."""


class NativeLoop:
    """The C structs of one run, and all that they point to.

    `wires`, `signals` and `conversions` (None: none) are, per instance in stepping order, (source, target), targets and
    (source, target, factor, offset); `reals` and `integers` are the recorded outputs.
    """

    def __init__(
        self,
        instances: Sequence[Instance],
        inputs: Sequence[Sequence[Port]],
        outputs: Sequence[Sequence[Port]],
        wires: Sequence[Sequence[tuple[Slot, Slot]]],
        signals: Sequence[Sequence[Slot]],
        reals: Sequence[Slot] = (),
        integers: Sequence[Slot] = (),
        conversions: Sequence[Sequence[Conversion]] | None = None,
    ) -> None:
        self._advance = _advance()
        self._kept: list[Any] = [instances, inputs, outputs]
        self._driven: list[ctypes.Array] = []
        self._signals: list[tuple[Ahead, ctypes.Array]] = []
        parts = zip(instances, inputs, outputs, wires, conversions or [[] for _ in instances], signals, strict=True)
        self._stages = (_Instance * len(instances))(*[self._instance(*part) for part in parts])
        self.run = _Run(
            instance_count=len(self._stages),
            instances=ctypes.addressof(self._stages),
            reals=self._reals(reals),
            integers=self._integers(integers),
        )

    def drive(self, signals: Sequence[Ahead]) -> None:
        """Say what the signals are, by their `Signal.ahead`, in the order of their targets."""
        self._signals = list(zip(signals, self._driven, strict=True))

    def begin(self, reals: np.ndarray, integers: np.ndarray, times: np.ndarray) -> None:
        """Prepare a run of the instances as they have just been made.

        `reals` (float64) and `integers` (int64) have a row for each record and a column for each output, `times` the rows'
        times.
        """
        for stage, instance in zip(self._stages, self._kept[0], strict=True):
            stage.component, stage.do_step = instance.pointers()
        run = self.run
        self._rows = (reals, integers, times)
        run.reals.rows, run.integers.rows, run.times = (table.ctypes.data for table in self._rows)
        run.done, run.failed_in = 0, 0

    def advance(
        self, start_time: float, step: float, steps: int, every: int, recorded: int, *, parallel: bool
    ) -> Iterator[int]:
        """Step to the end; yield the number of steps done, every `SECONDS_PER_CALL` or less, and after a failed call."""
        run = self.run
        run.start_time, run.step, run.steps, run.every = start_time, step, steps, every
        run.parallel, run.recorded = parallel, recorded
        while run.done < steps and not run.failed_in:
            until = steps
            if self._signals:
                until = min(steps, (run.done // SIGNAL_STEPS + 1) * SIGNAL_STEPS)
                for ahead, values in self._signals:
                    values[: until - run.done] = ahead(start_time, step, run.done, until - run.done)
            self._advance(ctypes.byref(run), until, SECONDS_PER_CALL)
            yield run.done

    def stepper(self, step: float) -> Callable[[], int]:
        """Return a function that does the next step, from time 0 on, recording nothing; it returns 1 where a call failed."""
        run = self.run
        run.step, run.steps, run.every = step, 2**62, 2**62
        reference, advance, forever = ctypes.byref(run), self._advance, math.inf
        done = 0

        def one_step() -> int:
            nonlocal done
            done += 1
            return advance(reference, done, forever)

        return one_step

    def failure(self) -> tuple[int, str, int] | None:
        """Return (index of the instance, what was called, status) of the call that failed; None if none did."""
        run = self.run
        if not run.failed_in:
            return None
        index = run.failed_instance
        time = run.start_time + run.done * run.step
        if run.failed_in == _STEP:
            return index, f"doStep({time!r}, {run.step!r})", run.failed_status
        ports = self._kept[1 if run.failed_in == _INPUT else 2][index]
        return index, ports[run.failed_port].function, run.failed_status

    def _instance(
        self,
        instance: Instance,
        inputs: Sequence[Port],
        outputs: Sequence[Port],
        wires: Sequence[tuple[Slot, Slot]],
        conversions: Sequence[Conversion],
        signals: Sequence[Slot],
    ) -> _Instance:
        component, do_step = instance.pointers()
        rows = []
        for target in signals:
            kind: Any = target[0]._type_
            values = (kind * SIGNAL_STEPS)()
            self._driven.append(values)
            rows.append(_Signal(ctypes.addressof(values), _address(target), ctypes.sizeof(kind)))
        wire_rows = [_Wire(_address(s), _address(t), ctypes.sizeof(t[0]._type_)) for s, t in wires]
        scaled = [_Conversion(_address(s), _address(t), factor, offset) for s, t, factor, offset in conversions]
        return _Instance(
            component=component,
            do_step=do_step,
            input_count=len(inputs),
            output_count=len(outputs),
            wire_count=len(wire_rows),
            conversion_count=len(scaled),
            signal_count=len(rows),
            inputs=self._array(_Port, [_port(p) for p in inputs]),
            outputs=self._array(_Port, [_port(p) for p in outputs]),
            wires=self._array(_Wire, wire_rows),
            conversions=self._array(_Conversion, scaled),
            signals=self._array(_Signal, rows),
        )

    def _reals(self, slots: Sequence[Slot]) -> _Reals:
        spans: list[_Span] = []
        end = None
        for address in map(_address, slots):
            if address == end:  # the next one of an FMU's outputs
                spans[-1].count += 1
            else:
                spans.append(_Span(address, 1))
            end = address + ctypes.sizeof(_D)
        return _Reals(len(slots), len(spans), self._array(_Span, spans))

    def _integers(self, slots: Sequence[Slot]) -> _Integers:
        sources = (_P * max(1, len(slots)))(*[_address(s) for s in slots])
        self._kept.append(sources)
        return _Integers(len(slots), ctypes.addressof(sources))

    def _array(self, kind: type[ctypes.Structure], rows: Sequence[ctypes.Structure]) -> int:
        array = (kind * max(1, len(rows)))(*rows)
        self._kept.append(array)
        return ctypes.addressof(array)


def _port(port: Port) -> _Port:
    call = ctypes.cast(port.call, _P)  # type: ignore[arg-type]
    return _Port(call, ctypes.addressof(port.references), len(port.names), ctypes.addressof(port.values))


def _address(slot: Slot) -> int:
    array, index = slot
    return ctypes.addressof(array) + index * ctypes.sizeof(array._type_)


def needs_python(instances: Mapping[str, Instance]) -> bool:
    """Whether the loop in C is no gain or cannot be: for FMUs that are Python, or that are integrated here.

    Called without Python's global lock a Python FMU takes and gives it back in every call, which costs more than the loop
    saves; it declares that it needs an execution tool.
    """
    kinds = [i.description.coSimulation for i in instances.values() if not isinstance(i, IntegratedInstance)]
    return len(kinds) < len(instances) or any(kind.needsExecutionTool for kind in kinds)  # type: ignore[union-attr]
