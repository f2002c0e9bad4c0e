"""The base class of both Python FMUs: what FMI 2.0 demands and PythonFMU's wrapper does not check.

The wrapper accepts a step before initialization, steps of zero or negative length, jumps in time, fixed parameters set
during a run and NaN, and turns an exception into a bare status. Here each of these is refused with its cause in the
log. What cannot be checked from Python is the GUID that the host passes: the wrapper does not hand it on.

Standard library only: this module travels inside the Python FMUs.
"""

from __future__ import annotations

import atexit
import ctypes
import hashlib
import json
import math
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from pythonfmu.enums import Fmi2Status
from pythonfmu.fmi2slave import Fmi2Slave

from .errors import UserError
from .manifest import MANIFEST, check_bundle, showing_in
from .variables import Interface, Value, Variable

STATE_FORMAT = 3

_finalized: set[str] = set()
"""Wrapper libraries that are told to finalize before the process ends."""


class Unit(Protocol):
    """What is stepped: built from parameter values, then initialized, then stepped."""

    def __init__(self, values: Mapping[str, Any]) -> None: ...

    def initialize(self, time: float, inputs: tuple[float, ...]) -> list[str]:
        """Take the start time [s] and the first inputs; return messages for the log."""
        ...

    def step(self, time: float, step: float, inputs: tuple[float, ...]) -> list[str]:
        """Advance from `time` by `step` [s] with the inputs held; return messages for the log."""
        ...

    def outputs(self) -> tuple[Value, ...]:
        """Return outputs and local variables in the order of the interface."""
        ...

    def get_state(self) -> dict[str, Any]:
        """Return everything that changes during a run, as JSON types."""
        ...

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore what `get_state` returned."""
        ...


F = TypeVar("F", bound=Callable[..., Any])


def _guarded(method: F) -> F:
    """Turn an exception into a log message with traceback, time and inputs, and a failure that names its cause."""

    @wraps(method)
    def call(self: GuardedSlave, *args: Any) -> Any:
        try:
            return method(self, *args)
        except Exception as error:
            self._record_failure(method.__name__, error)
            raise RuntimeError(_as_format(f"{self.instance_name}: {method.__name__}: {error}")) from None

    return call  # type: ignore[return-value]


def _as_format(message: str) -> str:
    """Return the message as the format string that FMI's logger takes it for."""
    return message.replace("%", "%%")


def _finalize_at_exit(library: Path) -> None:
    """Have the wrapper release its interpreter state before the process ends, where Python is the host.

    Left to itself it destroys that state twice on the way out, which now and then aborts the process after all is done.
    Where the wrapper has started Python itself, it ends it in its own time.
    """
    if sys.orig_argv and library.is_file() and str(library) not in _finalized:
        _finalized.add(str(library))
        atexit.register(ctypes.CDLL(str(library)).finalizePythonInterpreter)


class GuardedSlave(Fmi2Slave):
    """An FMI 2.0 co-simulation slave around a `Unit`, driven by its `Interface`.

    The FMU shows all variables of `interface`, or some of them under other names, as its manifest says; the unit gets the
    values of all and speaks of them, by the names in `interface`. Value references are positions in `interface`.
    `packages` names those that its code imports besides its own and fmu_export.
    """

    interface: ClassVar[Interface]
    unit_class: ClassVar[type[Unit]]
    packages: ClassVar[tuple[str, ...]] = ()

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        resources = Path(str(self.resources))
        text = (resources / MANIFEST).read_bytes()
        manifest = json.loads(text)
        self._identity = hashlib.sha256(text).hexdigest()[:16]  # of code, interface and start values
        sys.path[:] = [entry for entry in sys.path if entry != str(self.resources)]  # the wrapper adds it each time
        _finalize_at_exit(resources.parent / "binaries" / "linux64" / f"{manifest['identifier']}.so")
        check_bundle(self.instance_name, type(self).__module__.split(".")[0], resources, manifest)
        self._showing = showing_in(self.interface, manifest)
        self._take_variables(manifest)
        self._phase = "instantiated"
        self._experiment_set = False
        self._time = 0.0
        self._stop: float | None = None
        self._unit: Unit | None = None

    def _take_variables(self, manifest: Mapping[str, Any]) -> None:
        """Take the values of the whole table, and who of it is shown, input or output, by value reference."""
        table, shown = self.interface.variables, self._showing
        start = shown.compiled_values(manifest["start_values"], manifest["hidden_values"])
        self._values: list[Value] = [start.get(v.name, 0.0) for v in table]
        self._variables = dict(zip(shown.references, shown.interface.variables, strict=True))
        self._types = {
            kind: frozenset(vr for vr, v in self._variables.items() if v.type in kinds)
            for kind, kinds in (("Real", {"Real"}), ("Integer", {"Integer", "Enumeration"}), ("Boolean", {"Boolean"}))
        }
        self._inputs = [vr for vr, v in enumerate(table) if v.causality == "input"]
        self._outputs = [vr for vr, v in enumerate(table) if v.calculated]
        self._real_inputs = {vr: v for vr, v in self._variables.items() if v.causality == "input" and v.type == "Real"}

    # The call order of FMI 2.0.5, section 4.2.4

    @_guarded
    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """Take the start time [s], which must be finite, and the stop time where one is defined."""
        self._require("instantiated", doing="setupExperiment")
        if not math.isfinite(start_time):
            raise ValueError(f"the start time must be finite, found {start_time}")
        if stop_time is not None and not stop_time >= start_time:
            raise ValueError(f"the stop time must not be before the start time {start_time} s, found {stop_time}")
        self._stop = stop_time
        self._experiment_set = True
        self._time = start_time

    @_guarded
    def enter_initialization_mode(self) -> None:
        """Leave the setting of start values."""
        self._require("instantiated", doing="enterInitializationMode")
        if not self._experiment_set:
            raise ValueError("enterInitializationMode needs setupExperiment before it")
        self._phase = "initialization mode"

    @_guarded
    def exit_initialization_mode(self) -> None:
        """Build the unit from its start values and compute its outputs at the start time."""
        self._require("initialization mode", doing="exitInitializationMode")
        self._initialize_unit()
        self._phase = "step"

    @_guarded
    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance from `current_time` by `step_size` [s]."""
        if self._phase != "step" or self._unit is None:
            self._require("step", doing="doStep")
        if not (step_size > 0.0 and math.isfinite(step_size)):
            raise ValueError(f"the communication step must be positive and finite, found {step_size:g} s")
        if not abs(current_time - self._time) <= 1e-6 * step_size + 1e-12 * abs(self._time):
            raise ValueError(
                f"time must not jump: the last step ended at {self._time!r} s, this begins at {current_time!r} s"
            )
        if self._stop is not None:
            self._check_stop(current_time + step_size, step_size)
        values = self._values
        with self._in_shown_words():
            messages = self._unit.step(current_time, step_size, tuple([values[vr] for vr in self._inputs]))  # type: ignore[union-attr]
        self._time = current_time + step_size
        self._read_outputs()
        self._report(current_time, messages)
        return True

    @_guarded
    def terminate(self) -> None:
        """End the run."""
        self._require("step", doing="terminate")
        self._phase = "terminated"

    # Variables

    @_guarded
    def get_real(self, vrs: list[int]) -> list[Any]:
        """Return Real values."""
        return self._get(vrs, "Real")

    @_guarded
    def get_integer(self, vrs: list[int]) -> list[Any]:
        """Return Integer and Enumeration values."""
        return self._get(vrs, "Integer")

    @_guarded
    def get_boolean(self, vrs: list[int]) -> list[Any]:
        """Return Boolean values."""
        return self._get(vrs, "Boolean")

    @_guarded
    def get_string(self, vrs: list[int]) -> list[str]:
        """Refuse: no variable is a String."""
        raise ValueError(f"{self._showing.interface.name} has no String variables, asked for value references {vrs}")

    @_guarded
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set Real inputs, and parameters where the call order allows."""
        if self._phase == "step":
            inputs = self._real_inputs
            for vr, value in zip(vrs, values, strict=True):
                if vr in inputs and (math.isfinite(value) or inputs[vr].fault_on_non_finite):
                    self._values[vr] = value
                else:
                    self._set([vr], [value], "Real")
        else:
            self._set(vrs, values, "Real")

    @_guarded
    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set Integer and Enumeration variables."""
        self._set(vrs, values, "Integer")

    @_guarded
    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Set Boolean variables."""
        self._set(vrs, values, "Boolean")

    @_guarded
    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """Refuse: no variable is a String."""
        raise ValueError(f"{self._showing.interface.name} has no String variables, asked to set value references {vrs}")

    # State

    @_guarded
    def _get_fmu_state(self) -> dict[str, Any]:
        return {
            "format": STATE_FORMAT,
            "fmu": self._identity,
            "phase": self._phase,
            "experiment_set": self._experiment_set,
            "time": self._time,
            "stop": self._stop,
            "values": list(self._values),
            "unit": None if self._unit is None else self._unit.get_state(),
        }

    @_guarded
    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        found, expected = (state.get("format"), state.get("fmu")), (STATE_FORMAT, self._identity)
        if found != expected:
            raise ValueError(f"the state must be one of this FMU, with (format, FMU) {expected}, found {found}")
        self._phase = state["phase"]
        self._experiment_set = state["experiment_set"]
        self._time = state["time"]
        self._stop = state["stop"]
        self._values = list(state["values"])
        self._unit = None
        if state["unit"] is not None:
            self._unit = self._made_unit()
            self._unit.set_state(state["unit"])

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> dict[str, Any]:
        """Return the state, or for bytes that are none a marker that `_set_fmu_state` refuses; the wrapper would crash."""
        try:
            data = json.loads(state.decode("utf-8"))
        except ValueError:
            return {}
        return data if isinstance(data, dict) else {}

    # Inside

    def _require(self, phase: str, doing: str) -> None:
        if self._phase != phase:
            raise ValueError(f"{doing} is not allowed in the state {self._phase!r}")

    def _check_stop(self, end: float, step: float) -> None:
        """Refuse a step that ends beyond the stop time by more than rounding."""
        stop = self._stop
        if stop is not None and not end <= stop + 1e-6 * step + 1e-12 * abs(stop):
            raise ValueError(f"a step must not pass the stop time {stop!r} s, found one that ends at {end!r} s")

    @contextmanager
    def _in_shown_words(self) -> Iterator[None]:
        """Let what the unit refuses be said with the names that the FMU shows."""
        try:
            yield
        except UserError as error:
            raise UserError(self._showing.sentence(str(error))) from error

    def _made_unit(self) -> Unit:
        with self._in_shown_words():
            return self.unit_class(dict(zip([v.name for v in self.interface.variables], self._values, strict=True)))

    def _initialize_unit(self) -> None:
        self._unit = self._made_unit()
        with self._in_shown_words():
            messages = self._unit.initialize(self._time, tuple([float(self._values[vr]) for vr in self._inputs]))
        self._report(self._time, messages)
        self._read_outputs()

    def _report(self, time: float, messages: Sequence[str]) -> None:
        for message in messages:
            self._say(f"t = {time:.9g} s: {self._showing.sentence(message)}", Fmi2Status.warning)

    def _read_outputs(self) -> None:
        for vr, value in zip(self._outputs, self._unit.outputs(), strict=True):  # type: ignore[union-attr]
            self._values[vr] = value

    def _get(self, vrs: list[int], kind: str) -> list[Any]:
        allowed = self._types[kind]
        if self._phase in ("instantiated", "initialization mode"):
            self._prepare_outputs(vrs)
        values = self._values
        for vr in vrs:
            if vr not in allowed:
                raise ValueError(f"no {kind} variable has the value reference {vr}")
        return [values[vr] for vr in vrs]

    def _prepare_outputs(self, vrs: Sequence[int]) -> None:
        """In initialization, outputs follow from the start values and inputs set so far."""
        asked = [self._variables[vr].name for vr in vrs if vr in self._variables and self._variables[vr].calculated]
        if asked and self._phase == "instantiated":
            raise ValueError(f"outputs are defined from initialization on, asked for {', '.join(asked)} before it")
        if asked:
            self._initialize_unit()

    def _set(self, vrs: Sequence[int], values: Sequence[Any], kind: str) -> None:
        allowed = self._types[kind]
        retune = False
        for vr, value in zip(vrs, values, strict=True):
            if vr not in allowed:
                raise ValueError(f"no {kind} variable has the value reference {vr}")
            variable = self._variables[vr]
            self._check_settable(variable)
            self._values[vr] = variable.check(value)
            retune = retune or variable.variability == "tunable"
        if retune and self._phase == "step" and self._unit is not None:
            state = self._unit.get_state()
            self._unit = self._made_unit()
            self._unit.set_state(state)

    def _check_settable(self, variable: Variable) -> None:
        if variable.calculated:
            raise ValueError(f"{variable.name} is an output and cannot be set")
        if self._phase == "terminated" or (self._phase == "step" and variable.variability == "fixed"):
            raise ValueError(
                f"{variable.name} is a {variable.variability} {variable.causality}, which cannot be set in the state "
                f"{self._phase!r}"
            )

    def _say(self, message: str, status: Fmi2Status) -> None:
        self.log(_as_format(message), status)

    def _record_failure(self, call: str, error: Exception) -> None:
        shown = ((vr, v) for vr, v in self._variables.items() if v.causality == "input")
        inputs = ", ".join(f"{v.name} = {self._values[vr]!r}" for vr, v in shown)
        text = "".join(traceback.format_exception(error))
        self._say(f"{error}\n{call} at t = {self._time!r} s with {inputs}\n{text}", Fmi2Status.error)
        # The wrapper releases these now, and again when the instance is freed: one reference more than it owns.
        for lent in (self, type(self), self.log_queue):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(lent))
