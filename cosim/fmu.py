"""One FMU instance through FMPy: found, checked, unpacked once per process, started, stepped with prepared buffers."""

from __future__ import annotations

import atexit
import ctypes
import math
import os
import shutil
import tempfile
import threading
import zipfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NoReturn
from weakref import WeakValueDictionary
from xml.parsers import expat

import fmpy
import fmpy.fmi1
import fmpy.fmi2
from fmpy.logging import addLoggerProxy
from fmpy.model_description import ModelDescription, ScalarVariable

from fmu_export.errors import shown
from fmu_export.files import FilePath
from fmu_export.variables import did_you_mean

from .archives import unpack
from .errors import UserError
from .pendulum_files import PENDULUM_FMUS
from .python_wrapper import finalize_at_exit, keep_globals

Value = float | int | bool | str

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


_loading = threading.Lock()
"""FMPy changes the process's folder while it loads a library."""

_idle: dict[tuple[str, ...], list[Any]] = {}
"""FMPy's loaded libraries without an instance, by folder, identifier and kind: loading costs more than a short run."""

_unpacked: dict[tuple[str, int, int], tuple[str, ModelDescription]] = {}

_starts: dict[str, dict[str, Value]] = {}
"""FMUs' own start values by the folder that they are unpacked in."""


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


def found(path: FilePath, advice: str = "") -> os.stat_result:
    """Return the status of an FMU's file; raise UserError, with `advice`, where there is none or it cannot be read."""
    path = Path(path)
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        made = "`qube-ihc export` makes the project's FMUs" if path.name in PENDULUM_FMUS else ""
        hints = ", ".join(filter(None, (made, advice)))
        raise UserError(f"FMU {path} does not exist{'; ' if hints else ''}{hints}") from None
    except OSError as error:
        raise UserError(f"FMU {path} cannot be read: {error.strerror}") from None


def describe(path: FilePath) -> tuple[str, ModelDescription]:
    """Return (folder with the unpacked FMU, its description); unpacked once per process and file content.

    It is unpacked again where its folder is gone, as where temporary files are tidied under a process that lasts. Raises
    UserError for a file that is missing, not an FMU, or not an FMU of FMI 2.0.
    """
    path = Path(path)
    status = found(path)
    key = (str(path.resolve()), status.st_mtime_ns, status.st_size)
    with _loading:
        if key not in _unpacked or not Path(_unpacked[key][0], "modelDescription.xml").is_file():
            _unpacked[key] = _unpack(path)
    return _unpacked[key]


def start_values_of(path: FilePath) -> dict[str, Value]:
    """Return the start values of an FMU's numbers and truth values by name, in their types; raises as `describe`."""
    folder, description = describe(path)
    if folder not in _starts:
        types = {"Real": float, "Boolean": lambda text: str(text).lower() in ("true", "1"), "String": None}
        _starts[folder] = {
            v.name: convert(v.start)
            for v in description.modelVariables
            if v.start is not None and (convert := types.get(v.type, int)) is not None
        }
    return dict(_starts[folder])


def _unpack(path: Path) -> tuple[str, ModelDescription]:
    if not zipfile.is_zipfile(path):
        raise UserError(f"{path} is not an FMU: it is not a zip file")
    folder = tempfile.mkdtemp(prefix="qube-ihc-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    try:
        unpack(path, Path(folder))
        description = _description(path, Path(folder))
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    escapes = "%" in Path(folder).as_uri().replace("%20", "")
    if (
        description.coSimulation is not None and description.coSimulation.needsExecutionTool and escapes
    ):  # PythonFMU's wrapper cannot read them
        raise UserError(f"the temporary folder (TMPDIR) must be named in plain letters for Python FMUs, found {folder}")
    return folder, description


def _description(path: Path, folder: Path) -> ModelDescription:
    """Return the description in `folder`; raise UserError for one that is not that of an FMI 2.0 FMU."""
    file = folder / "modelDescription.xml"
    if not file.is_file():
        raise UserError(f"{path} is not a valid FMU: it has no modelDescription.xml")
    try:
        _refuse_entities(path, file.read_bytes())
        description = fmpy.read_model_description(str(folder))
    except UserError:
        raise
    except Exception as error:  # FMPy raises bare exceptions of many kinds
        raise UserError(f"{path} is not a valid FMU: {_first_line(error)}") from None
    kinds = [kind for kind in (description.coSimulation, description.modelExchange) if kind is not None]
    if description.fmiVersion != "2.0" or not kinds:
        raise UserError(f"{path} must be an FMI 2.0 FMU, found FMI {description.fmiVersion}")
    for identifier in (kind.modelIdentifier or "" for kind in kinds):
        if not (identifier.isascii() and identifier.isidentifier()):  # a file's name: a path would load another library
            raise UserError(f"{path} must have a C identifier as modelIdentifier, found {shown(identifier)}")
    return description


def _refuse_entities(path: Path, xml: bytes) -> None:
    """Raise UserError for XML with a document type: its entities can read other files, and grow without end."""

    def refuse(*_: object) -> NoReturn:
        raise UserError(f"{path} is not a valid FMU: a model description has no document type")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(xml, True)


def _first_line(error: Exception) -> str:
    """Return the first line of an error's text, and where that announces a list its first item too."""
    first, *others = str(error).splitlines() or [type(error).__name__]
    return f"{first} {others[0].lstrip('- ')}" if first.endswith(":") and others else first


def forget_unpacked() -> None:
    """Remove the folders of all unpacked FMUs: for a process that ends without leaving in the usual way."""
    for folder, _ in _unpacked.values():
        shutil.rmtree(folder, ignore_errors=True)


def as_value(variable: ScalarVariable, value: Value | str) -> Value:
    """Return `value` in the type of `variable`; an enumeration may be given by its item's name.

    Raises UserError that names variable, rule and value.
    """
    name, kind = variable.name, variable.type
    if kind == "Enumeration":
        declared: Any = variable.declaredType
        items: dict[str, int] = {item.name: int(item.value) for item in declared.items}
        if value in items:
            return items[str(value)]
        if isinstance(value, bool) or value not in items.values():
            raise UserError(f"{name} must be one of {', '.join(items)}, found {shown(value)}")
        return int(value)
    if kind == "Boolean":
        if not isinstance(value, bool):
            raise UserError(f"{name} must be true or false, found {shown(value)}")
        return value
    if kind == "String":
        if not isinstance(value, str) or "\0" in value:
            raise UserError(f"{name} must be a text, found {shown(value)}")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UserError(f"{name} must be a number, found {shown(value)}")
    if isinstance(value, int) and value.bit_length() > 1000:
        raise UserError(f"{name} must be a number of moderate size, found {shown(value)}")
    if not math.isfinite(value):
        raise UserError(f"{name} must be finite, found {value}")
    if kind == "Integer" and (value != int(value) or not -(2**31) <= value < 2**31):
        raise UserError(f"{name} must be an integer of 32 bits, found {shown(value)}")
    low = -math.inf if variable.min is None else float(variable.min)
    high = math.inf if variable.max is None else float(variable.max)
    if not low <= value <= high:
        unit = "" if variable.unit in (None, "1") else f" {variable.unit}"
        raise UserError(f"{name} must lie in [{low:g}, {high:g}]{unit}, found {value}")
    return int(value) if kind == "Integer" else float(value)


def _not_settable(variable: ScalarVariable) -> str | None:
    """Return why a variable cannot be set before the initialization; None: it can.

    Set can be parameters, inputs, and what begins with its start attribute (FMI 2.0: initial = "exact", "approx").
    """
    causality, initial = variable.causality, variable.initial
    if variable.variability == "constant":
        return "is a constant and cannot be set"
    if causality == "independent":
        return "is the independent variable, the time, and cannot be set"
    if causality == "calculatedParameter":
        return "is a parameter that the FMU calculates from others, and has no start value to set"
    if causality in ("parameter", "input") or initial in ("exact", "approx"):
        return None
    article = "an" if causality == "output" else "a"
    return (
        f'is {article} {causality} variable that the FMU calculates (initial = "{initial}"), with no start value to set'
    )


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
    _library: ClassVar[type[Strict]] = FMU2Strict

    def __post_init__(self) -> None:
        self._folder, self.description, self.model_identifier = self._described()
        self._key = (self._folder, self.model_identifier, self._library.__name__)
        self.variables = {v.name: v for v in self.description.modelVariables}

    def _described(self) -> tuple[str, ModelDescription, str]:
        """Return the unpacked FMU's folder, its description and its model identifier."""
        folder, description = describe(self.path)
        if description.coSimulation is None:
            raise UserError(f"{self.path} must be an FMU for co-simulation, found one for model exchange only")
        return folder, description, description.coSimulation.modelIdentifier or ""

    def variable(self, name: str) -> ScalarVariable:
        """Return the variable, or raise UserError with the nearest names."""
        try:
            return self.variables[name]
        except KeyError:
            raise UserError(f"{self.name} has no variable named {name!r}{did_you_mean(name, self.variables)}") from None

    def require(self, name: str, causality: str, unit: str) -> None:
        """Raise UserError where the FMU has no real input or output `name` of that unit."""
        found = self.variable(name)
        if (found.causality, found.type, found.unit or "1") != (causality, "Real", unit):
            raise UserError(
                f"{self.path}: {name} must be a real {causality} in {unit}, found {found.type} {found.causality} in "
                f"{found.unit or '1'}"
            )

    def item(self, name: str, item: str) -> int | None:
        """Return the value of an enumeration's item; None where the variable has none of that name."""
        declared: Any = self.variables[name].declaredType if name in self.variables else None
        return next((int(i.value) for i in getattr(declared, "items", ()) if i.name == item), None)

    def checked_start(self, start: Mapping[str, Value | str]) -> dict[str, Value]:
        """Return start values in their types.

        Raises UserError for unknown names, for variables that FMI does not let be set before the initialization, and for
        inadmissible values.
        """
        checked = {}
        for name, value in start.items():
            variable = self.variable(name)
            if (reason := _not_settable(variable)) is not None:
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

    def start(self, start: Mapping[str, Value], start_time: float, stop_time: float | None) -> None:
        """Instantiate and set the start values, up to initialization mode; None: no stop time."""
        self._instantiate()
        fmu = self._fmu
        self._call(
            "setupExperiment", fmu.setupExperiment, tolerance=self.tolerance, startTime=start_time, stopTime=stop_time
        )
        for name, value in start.items():
            variable = self.variables[name]
            setters = {"Real": fmu.setReal, "Boolean": fmu.setBoolean, "String": fmu.setString}
            setter = setters.get(variable.type, fmu.setInteger)
            self._call(f"setting {name} = {value}", setter, [variable.valueReference], [value])
        self._call("enterInitializationMode", fmu.enterInitializationMode)

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
            chosen = tuple(name for name in names if self.variables[name].type in types)
            if chosen:
                references = [self.variables[name].valueReference for name in chosen]
                function = f"fmi2{direction}{kind}"
                call = self._fmu.dll[function]
                call.restype = ctypes.c_int
                size = len(chosen)
                call.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint), ctypes.c_size_t, ctypes.POINTER(ctype)]
                ports.append(Port(chosen, (ctypes.c_uint * size)(*references), (ctype * size)(), call, function))
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

    def close(self) -> None:
        """Terminate and free the instance; one whose status was fatal may not be called any more and is left."""
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
                    return
        self._fmu.fmi2FreeInstance(self._fmu.component)
        _idle[self._key].append(self._fmu)

    def _instantiate(self) -> None:
        with _loading:
            self._load()
        self._alive = True

    def _load(self) -> None:
        idle = _idle.setdefault(self._key, [])
        where = Path.cwd()
        try:
            self._fmu = idle.pop() if idle else self._loaded()
            self._fmu.instanceName = self.name
            keep_globals(Path(self._folder))
            self._fmu.instantiate(callbacks=self._callbacks(), loggingOn=True)
        except Exception as error:
            raise FmuError(f"{self.name} ({self.path}): {error}{self.cause()}") from None
        finally:
            os.chdir(where)  # FMPy leaves its own folder where loading fails

    def _loaded(self) -> Any:
        fmu = self._library(
            guid=self.description.guid,
            unzipDirectory=self._folder,
            modelIdentifier=self.model_identifier,
            instanceName=self.name,
        )
        finalize_at_exit(fmu.dll)
        return fmu

    def _callbacks(self) -> Any:
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
