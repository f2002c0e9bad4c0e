"""One FMU instance through FMPy: started, stepped with prepared buffers, freed."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NoReturn
from weakref import WeakValueDictionary

import fmpy
import fmpy.fmi1
import fmpy.fmi2
from fmpy.logging import addLoggerProxy
from fmpy.model_description import ModelDescription, ScalarVariable

from fmu_export.variables import did_you_mean

from .errors import UserError
from .fmu_files import LOADING, unpacked
from .python_wrapper import keep_globals
from .start_values import StartValue, as_value, not_settable

_STATUS = ("OK", "warning", "discard", "error", "fatal", "pending")
_GOOD = (0, 1)
DISCARD = 2
"""The status of a call whose point an FMU has no values at."""

_FATAL = 4
_MESSAGES_KEPT = 200
_MESSAGE_LENGTH = 10_000

RECORDED = ("Real", "Integer", "Boolean", "Enumeration")
"""Types of the variables that can be wired and recorded; String is the other."""


def status_text(status: int) -> str:
    """Return an fmi2Status in words, or its number where FMI has none of that number."""
    return _STATUS[status] if 0 <= status < len(_STATUS) else f"the status {status}, which FMI does not know"


_instances: WeakValueDictionary[int, Instance] = WeakValueDictionary()
"""Instances by the environment pointer that their FMUs hand back with each message."""


def _log(environment: int, name: bytes, status: int, category: bytes | None, message: bytes | None) -> None:
    instance = _instances.get(environment)
    if instance is None:
        return
    text = f"{status_text(status)}: {(message or b'')[:_MESSAGE_LENGTH].decode('utf-8', 'replace').strip()}"
    if len(instance.messages) < _MESSAGES_KEPT:
        instance.messages.append(text)
    elif status not in _GOOD and not instance.cause():
        instance.messages[-1] = text  # among many, that of the failure is not lost


# FMPy's proxy, which formats C's variadic messages, knows one Python logger per process: this one, kept for ever.
_logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(_log)
_allocate = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
_free = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)


class FmuError(RuntimeError):
    """An FMI call failed; the message holds instance, call, status and what the FMU logged."""


class Strict(fmpy.fmi2._FMU2):
    """FMPy's FMU, for which every status but OK and warning is a failure; FMPy lets negative ones pass."""

    def _call(self, fname: str, *args: Any) -> Any:
        result = super()._call(fname, *args)
        if self._functions[fname].restype is ctypes.c_int and result not in _GOOD:
            raise fmpy.fmi1.FMICallException(fname, result)
        return result


class FMU2Strict(Strict, fmpy.fmi2.FMU2Slave):
    """FMPy's slave, strict."""


@dataclass(eq=False)
class Port:
    """A buffer that one FMI call fills or empties: variables of one type, in a fixed order."""

    names: tuple[str, ...]
    references: ctypes.Array
    values: ctypes.Array
    call: Callable[..., int]
    function: str


@dataclass(eq=False)
class Instance:
    """A running FMU for co-simulation under the name it has in the system.

    `tolerance`: the relative one that the FMU is told for what it solves itself; None: its own.
    """

    name: str
    path: Path
    tolerance: float | None = field(default=None, kw_only=True)
    description: ModelDescription = field(init=False)
    variables: dict[str, ScalarVariable] = field(init=False)
    messages: list[str] = field(default_factory=list)
    _fmu: Any = None
    _alive: bool = False
    _running: bool = False
    _callbacks: Any = None
    _arguments: tuple[Any, ...] = ()
    _setting: tuple[tuple[str, ...], list[Port]] = ((), [])
    _library: ClassVar[type[Strict]] = FMU2Strict

    def __post_init__(self) -> None:
        self._unpacked = unpacked(self.path)
        self.description = self._unpacked.description
        self.model_identifier = self._identifier()
        self.variables = {v.name: v for v in self.description.modelVariables}

    def _identifier(self) -> str:
        """Return the model identifier; raise UserError for an FMU that is not for this."""
        if self.description.coSimulation is None:
            raise UserError(f"{self.path} must be an FMU for co-simulation, found one for model exchange only")
        return self.description.coSimulation.modelIdentifier or ""

    def variable(self, name: str) -> ScalarVariable:
        """Return the variable, or raise UserError with the nearest names."""
        try:
            return self.variables[name]
        except KeyError:
            raise UserError(f"{self.name} has no variable named {name!r}{did_you_mean(name, self.variables)}") from None

    def require(self, name: str, causality: str, unit: str) -> None:
        """Raise UserError where the FMU has no real input or output `name` of that unit."""
        variable = self.variable(name)
        if (variable.causality, variable.type, variable.unit or "1") != (causality, "Real", unit):
            raise UserError(
                f"{self.path}: {name} must be a real {causality} in {unit}, found {variable.type} {variable.causality} in "
                f"{variable.unit or '1'}"
            )

    def item(self, name: str, item: str) -> int | None:
        """Return the value of an enumeration's item; None where the variable has none of that name."""
        declared: Any = self.variables[name].declaredType if name in self.variables else None
        return next((int(i.value) for i in getattr(declared, "items", ()) if i.name == item), None)

    def checked_start(self, start: Mapping[str, StartValue]) -> dict[str, StartValue]:
        """Return start values in their types.

        Raises UserError for unknown names, for variables that FMI does not let be set before the initialization, and for
        inadmissible values.
        """
        checked = {}
        for name, value in start.items():
            variable = self.variable(name)
            if (reason := not_settable(variable)) is not None:
                raise UserError(f"{self.name}.{name} {reason}")
            try:
                checked[name] = as_value(variable, value)
            except UserError as error:
                raise UserError(f"{self.name}.{error}") from None
        return checked

    def outputs(self) -> list[ScalarVariable]:
        """Return the outputs that can be recorded."""
        return [v for v in self.variables.values() if v.causality == "output" and v.type in RECORDED]

    def texts(self) -> list[str]:
        """Return the names of the String outputs, which cannot be recorded."""
        return [v.name for v in self.variables.values() if v.causality == "output" and v.type not in RECORDED]

    def start(self, start: Mapping[str, StartValue], start_time: float, stop_time: float | None) -> None:
        """Instantiate and set the start values, up to initialization mode; None: no stop time."""
        self._set_up(start_time, stop_time)
        said = len(self.messages)
        if not self._set_at_once(start):
            del self.messages[said:]
            self.free()  # and again from the beginning, to name the value that is refused
            self._set_up(start_time, stop_time)
            for name, value in start.items():
                self._set(name, value)
        self._call("enterInitializationMode", self._fmu.enterInitializationMode)

    def _set_up(self, start_time: float, stop_time: float | None) -> None:
        self._instantiate()
        experiment = {"tolerance": self.tolerance, "startTime": start_time, "stopTime": stop_time}
        self._call("setupExperiment", self._fmu.setupExperiment, **experiment)

    def _set(self, name: str, value: StartValue) -> None:
        variable = self.variables[name]
        setters = {"Real": self._fmu.setReal, "Boolean": self._fmu.setBoolean, "String": self._fmu.setString}
        setter = setters.get(variable.type, self._fmu.setInteger)
        self._call(f"setting {name} = {value}", setter, [variable.valueReference], [value])

    def _set_at_once(self, start: Mapping[str, StartValue]) -> bool:
        """Set start values by a call for each type; return whether all succeeded."""
        names = tuple(start)
        if self._setting[0] != names:
            self._setting = names, self.ports([n for n in names if self.variables[n].type in RECORDED], "Set")
        for port in self._setting[1]:
            port.values[:] = [start[name] for name in port.names]
            status = port.call(self._fmu.component, port.references, len(port.names), port.values)
            if status == _FATAL:
                self.fail(f"setting {', '.join(port.names)}", status)
            if status not in _GOOD:
                return False
        for name in names:
            if self.variables[name].type not in RECORDED:
                self._set(name, start[name])
        return True

    def run(self) -> None:
        """Leave initialization mode."""
        self._call("exitInitializationMode", self._fmu.exitInitializationMode)
        self._running = True

    def ports(self, names: Iterable[str], direction: str) -> list[Port]:
        """Return one port per type among `names`; direction is 'Get' or 'Set'."""
        ports = []
        for kind, types, ctype in (
            ("Real", {"Real"}, ctypes.c_double),
            ("Integer", {"Integer", "Enumeration"}, ctypes.c_int),
            ("Boolean", {"Boolean"}, ctypes.c_int),
        ):
            group = tuple(name for name in names if self.variables[name].type in types)
            if group:
                references = [self.variables[name].valueReference for name in group]
                function = f"fmi2{direction}{kind}"
                call = self._fmu.dll[function]
                call.restype = ctypes.c_int
                size = len(group)
                call.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint), ctypes.c_size_t, ctypes.POINTER(ctype)]
                ports.append(Port(group, (ctypes.c_uint * size)(*references), (ctype * size)(), call, function))
        return ports

    def transfer(self, ports: list[Port]) -> None:
        """Perform the FMI call of each port."""
        for port in ports:
            status = port.call(self._fmu.component, port.references, len(port.names), port.values)
            if status not in _GOOD:
                self.fail(port.function, status)

    def pointers(self) -> tuple[int, int]:
        """Return the addresses of the component and of its fmi2DoStep."""
        component = self._fmu.component
        address = ctypes.cast(self._fmu.dll["fmi2DoStep"], ctypes.c_void_p).value
        assert address is not None
        return component if isinstance(component, int) else component.value, address

    def stepper(self) -> Callable[[float, float], None]:
        """Return doStep(time, step); it raises FmuError where the FMU does not return OK or a warning."""
        call = self._fmu.dll["fmi2DoStep"]
        call.restype = ctypes.c_int
        call.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
        component = self._fmu.component

        def step(time: float, size: float) -> None:
            status = call(component, time, size, 1)
            if status not in _GOOD:
                self.fail(f"doStep({time!r}, {size!r})", status)

        return step

    def free(self) -> None:
        """Terminate and free what runs; it can be started anew. One whose status was fatal may not be called and is left."""
        if self._fmu is None or not self._alive:
            return
        self._alive = False
        if self._running:
            self._running = False
            try:
                self._fmu.terminate()
            except fmpy.fmi1.FMICallException as error:
                self.messages.append(f"terminate: {error}")
                if error.status == _FATAL:
                    self._fmu = None
                    return
        self._fmu.fmi2FreeInstance(self._fmu.component)

    def close(self) -> None:
        """Free what runs, and give the library back."""
        self.free()
        if self._fmu is not None:
            self._unpacked.give_back(self._fmu)
            self._fmu = None

    def _instantiate(self) -> None:
        if self._fmu is None:
            self._load()
        fmu: Any = self._fmu
        with LOADING:
            component = fmu.fmi2Instantiate(*self._arguments)
        if not component:
            raise FmuError(f"{self.name} ({self.path}): Failed to instantiate model{self.cause()}")
        fmu.component, self._alive = component, True

    def _load(self) -> None:
        with LOADING:
            where = Path.cwd()
            try:
                self._fmu = self._unpacked.library(self._library, self.model_identifier, self.name)
                keep_globals(self._unpacked.folder)
            except Exception as error:
                raise FmuError(f"{self.name} ({self.path}): {error}{self.cause()}") from None
            finally:
                os.chdir(where)  # FMPy leaves its own folder where loading fails
        if self._callbacks is None:
            self._callbacks = self._made_callbacks()
        model = issubclass(self._library, fmpy.fmi2.FMU2Model)
        self._arguments = (
            self.name.encode(),
            fmpy.fmi2.fmi2ModelExchange if model else fmpy.fmi2.fmi2CoSimulation,
            self._fmu.guid.encode(),
            Path(self._unpacked.folder, "resources").as_uri().encode(),
            ctypes.byref(self._callbacks),
            fmpy.fmi2.fmi2False,
            fmpy.fmi2.fmi2True,
        )

    def _made_callbacks(self) -> Any:
        _instances[id(self)] = self
        callbacks = fmpy.fmi2.fmi2CallbackFunctions()
        callbacks.logger = _logger
        callbacks.allocateMemory = _allocate
        callbacks.freeMemory = _free
        callbacks.componentEnvironment = id(self)
        addLoggerProxy(ctypes.byref(callbacks))
        return callbacks

    def _call(self, what: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except fmpy.fmi1.FMICallException as error:
            self.fail(what, error.status)

    def fail(self, what: str, status: int) -> NoReturn:
        """Raise FmuError for the call `what` that returned `status`."""
        if status == _FATAL:
            self._alive = False
            self._fmu = None
        raise FmuError(f"{self.name}: {what} returned {status_text(status)}{self.cause()}")

    def cause(self) -> str:
        """Return the first line of what the FMU logged of its failure, if it did; the whole log stays in `messages`."""
        for message in self.messages:
            kind, _, text = message.partition(": ")
            lines = text.splitlines()
            if lines and not kind.startswith(("OK", "warning")):
                wrapped = lines[0].startswith("Fatal py exception") and len(lines) > 1
                return f": {lines[1] if wrapped else lines[0]}"
        return ""
