"""Both FMUs, exported once per test process, and a host that drives an instance by variable names.

Scripts in processes of their own import `Host` from here too, so the project is imported inside the fixtures only.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import platform as machine
import random
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from fmpy import extract, instantiate_fmu, read_model_description
from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE

NAMES = ("QubeServo2", "IhcController")
HERE = Path(__file__).parent

BEFORE = "import json, os, sys\ndata = json.loads(sys.stdin.readline())\n"
AFTER = "\nprint(json.dumps(result), flush=True)\n"


class Host:
    """One FMU instance; `log` collects (status, category, message)."""

    def __init__(self, folder: str | Path, *, logging: bool = True) -> None:
        self.description = description(str(folder))
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.output_names = [v.name for v in self.description.modelVariables if v.causality in ("output", "local")]
        self.log: list[tuple[int, str, str]] = []
        self.slave: Any = instantiate_fmu(
            str(folder), self.description, logger=self._take_message, debug_logging=logging
        )

    def _take_message(self, _environment, _instance, status, category, message) -> None:
        self.log.append((status, (category or b"").decode(), message.decode()))

    def set(self, **values) -> None:
        for name, value in values.items():
            getattr(self.slave, f"set{self._kind(name)}")([self.reference(name)], [value])

    def get(self, *names):
        return tuple(getattr(self.slave, f"get{self._kind(name)}")([self.reference(name)])[0] for name in names)

    def outputs(self):
        return self.get(*self.output_names)

    def initialize(self, start_time=0.0, **values) -> Host:
        self.set(**values)
        self.slave.setupExperiment(startTime=start_time)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        return self

    def step(self, time, step, **inputs):
        """Set the inputs, step, and return the outputs."""
        self.set(**inputs)
        self.slave.doStep(time, step)
        return self.outputs()

    def reference(self, name) -> int:
        return self.variables[name].valueReference

    def _kind(self, name) -> str:
        return {"Enumeration": "Integer"}.get(self.variables[name].type, self.variables[name].type)


STATUS_CALLS = ("GetStatus", "GetRealStatus", "GetIntegerStatus", "GetBooleanStatus", "GetStringStatus")
SIGNATURES = {  # of the arguments behind the component: p pointer, n size_t, i int, d double
    **dict.fromkeys(("EnterInitializationMode", "ExitInitializationMode", "Terminate", "Reset"), ""),
    **dict.fromkeys(
        (f"{do}{kind}" for do in ("Get", "Set") for kind in ("Real", "Integer", "Boolean", "String")), "pnp"
    ),
    **dict.fromkeys(("GetFMUstate", "SetFMUstate", "FreeFMUstate", "NewDiscreteStates"), "p"),
    **dict.fromkeys(("SetRealInputDerivatives", "GetRealOutputDerivatives"), "pnpp"),
    **dict.fromkeys(STATUS_CALLS, "ip"),
    **dict.fromkeys(("CancelStep", "EnterEventMode", "EnterContinuousTimeMode"), ""),
    **dict.fromkeys(("SetContinuousStates", "GetContinuousStates", "GetDerivatives"), "pn"),
    **dict.fromkeys(("GetNominalsOfContinuousStates", "GetEventIndicators"), "pn"),
    "SetDebugLogging": "inp",
    "SetupExperiment": "iddid",
    "SerializedFMUstateSize": "pp",
    "SerializeFMUstate": "ppn",
    "DeSerializeFMUstate": "pnp",
    "GetDirectionalDerivative": "pnpnpp",
    "DoStep": "ddi",
    "CompletedIntegratorStep": "ipp",
    "SetTime": "d",
}
C_TYPES = {"p": ctypes.c_void_p, "n": ctypes.c_size_t, "i": ctypes.c_int, "d": ctypes.c_double}


PLANT, CONTROLLER = NAMES
STEP = 1e-3
DEMANDING = {
    PLANT: {"noise_std": 1e-3, "measurement_delay": 2e-3, "motor_model": 2, "solver_step": 2.5e-4},
    CONTROLLER: {"norm_solver": 1, "discretization": 2},
}
"""Parameters under which a unit has as much state as it can have."""


def inputs_at(name, k):
    """Inputs of step k: random for the plant; from hanging to upright for the controller, with noise and set-points."""
    rng = random.Random(k)
    if name == PLANT:
        return {"voltage": rng.uniform(-12, 12), "disturbance_voltage": rng.uniform(-1, 1), "pendulum_torque": 1e-4}
    delta = math.pi * max(0.0, 1 - k / 40) + 1e-3 * rng.random()
    return {
        "theta": 0.1 * math.sin(0.1 * k),
        "delta": delta,
        "theta_dot": rng.random(),
        "delta_dot": rng.random(),
        "theta_setpoint": 0.05 * (k // 7 % 3),
    }


def run(instance, name, first, last):
    """Outputs of the steps first, ..., last - 1."""
    return [instance.step(k * STEP, STEP, **inputs_at(name, k)) for k in range(first, last)]


def step_silently(instance, name, first, last):
    """The same steps of a Native, of which no output is asked for."""
    for k in range(first, last):
        instance.set(**inputs_at(name, k))
        instance.done("DoStep", k * STEP, STEP, 0)


def binary(folder):
    """Return the path of this machine's binary in an unpacked FMU."""
    folders = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}
    if machine.machine().lower() in ("aarch64", "arm64") and sys.platform == "linux":
        folders["linux"] = "aarch64-linux"
    return str(next((Path(folder) / "binaries" / folders[sys.platform]).iterdir()))


class Native:
    """One instance of an FMU of either kind, driven by the plain C functions: `call` returns the status and raises nothing.

    `log` collects (status, category, message). `folder` is the unpacked FMU; the keywords replace what a host would pass.
    `component` is None where the FMU refused to be instantiated.
    """

    MODEL_EXCHANGE, CO_SIMULATION = 0, 1

    def __init__(
        self,
        folder,
        kind=CO_SIMULATION,
        *,
        guid: str | None = "",
        location: str | None = "",
        name="unit",
        logging=True,
        library: str | None = None,
        mode=ctypes.DEFAULT_MODE,
    ) -> None:
        folder = Path(folder)
        self.description = description(str(folder))
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.output_names = [v.name for v in self.description.modelVariables if v.causality in ("output", "local")]
        self.kind = kind
        self.log: list[tuple[int, str, str]] = []
        self.library = ctypes.CDLL(library or binary(folder), mode)
        for function, signature in SIGNATURES.items():
            if self.description.modelExchange is None and not hasattr(self.library, f"fmi2{function}"):
                continue  # PythonFMU's wrapper has no functions of model exchange
            entry = getattr(self.library, f"fmi2{function}")
            entry.argtypes = [ctypes.c_void_p, *(C_TYPES[letter] for letter in signature)]
        self.callbacks = fmi2CallbackFunctions(logger=fmi2CallbackLoggerTYPE(self._take_message))
        self.library.fmi2Instantiate.restype = ctypes.c_void_p
        guid = self.description.guid if guid == "" else guid
        location = (folder / "resources").as_uri() if location == "" else location
        texts = [None if text is None else text.encode() for text in (name, guid, location)]
        self.arguments = texts[0], kind, *texts[1:], ctypes.byref(self.callbacks), 0, int(logging)
        self.instantiate()

    def instantiate(self) -> None:
        self.component = self.library.fmi2Instantiate(*self.arguments)

    def _take_message(self, _environment, _instance, status, category, message) -> None:
        self.log.append((status, (category or b"").decode(), message.decode() % ()))  # a format, as C hosts take it

    def free(self) -> None:
        """Free the instance, once."""
        self.library.fmi2FreeInstance(ctypes.c_void_p(self.component))
        self.component = None

    def call(self, function, *arguments) -> int:
        return getattr(self.library, f"fmi2{function}")(self.component, *arguments)

    def refused(self, function, *arguments) -> str:
        """Return the one sentence that the call is refused with."""
        before = len(self.log)
        status = self.call(function, *arguments)
        assert status == 3, f"{function}: status {status}"
        ((level, category, message),) = self.log[before:]
        assert (level, category) == (3, "logStatusError")
        return message

    def done(self, function, *arguments) -> None:
        status = self.call(function, *arguments)
        assert status == 0, f"{function}: status {status}, {self.log[-1:]}"

    def values(self, *references, kind="Real"):
        """Return what the getter of a type gives for value references."""
        values = ctypes.c_double if kind == "Real" else ctypes.c_int
        row = (values * len(references))()
        self.done(f"Get{kind}", (ctypes.c_uint * len(references))(*references), len(references), row)
        return tuple(row)

    def get(self, *names):
        return tuple(self.values(self.reference(name), kind=self.type(name))[0] for name in names)

    def setting(self, **values):
        """Return the function and the arguments that set variables of one type."""
        (kind,) = {self.type(name) for name in values}
        references = (ctypes.c_uint * len(values))(*map(self.reference, values))
        numbers = ((ctypes.c_double if kind == "Real" else ctypes.c_int) * len(values))(*values.values())
        return f"Set{kind}", references, len(values), numbers

    def set(self, **values) -> None:
        for name, value in values.items():
            self.done(*self.setting(**{name: value}))

    def outputs(self):
        return self.get(*self.output_names)

    def setup(self, start_time=0.0) -> None:
        self.done("SetupExperiment", 0, 0.0, start_time, 0, 0.0)

    def initialize(self, start_time=0.0, **values) -> Native:
        self.set(**values)
        self.setup(start_time)
        self.done("EnterInitializationMode")
        self.done("ExitInitializationMode")
        return self

    def step(self, time, step, **inputs):
        """Set the inputs, step, and return the outputs."""
        self.set(**inputs)
        self.done("DoStep", time, step, 0)
        return self.outputs()

    def save(self):
        state = ctypes.c_void_p()
        self.done("GetFMUstate", ctypes.byref(state))
        return state

    def serialize(self, state) -> bytes:
        size = ctypes.c_size_t()
        self.done("SerializedFMUstateSize", state, ctypes.byref(size))
        serialized = ctypes.create_string_buffer(size.value)
        self.done("SerializeFMUstate", state, serialized, size)
        return serialized.raw

    def deserialize(self, serialized: bytes):
        state = ctypes.c_void_p()
        self.done("DeSerializeFMUstate", serialized, len(serialized), ctypes.byref(state))
        return state

    def everything(self) -> bytes:
        """Return all that a call could have changed."""
        state = self.save()
        serialized = self.serialize(state)
        self.done("FreeFMUstate", ctypes.byref(state))
        return serialized

    def reference(self, name) -> int:
        return self.variables[name].valueReference

    def type(self, name) -> str:
        return {"Enumeration": "Integer"}.get(self.variables[name].type, self.variables[name].type)


@cache
def description(folder):
    return read_model_description(folder)


@pytest.fixture(params=NAMES)
def name(request):
    """A test that asks for `name` runs once for each FMU."""
    return request.param


@pytest.fixture(scope="session")
def controller_start():
    from ihc_fmu.pendulum.start_values import controller_start_values, default_design

    return controller_start_values(default_design())


@pytest.fixture(scope="session")
def slaves():
    """Each FMU's slave class by the FMU's name."""
    from ihc_fmu.pendulum.slave import IhcController
    from plant_fmu.slave import QubeServo2

    return dict(zip(NAMES, (QubeServo2, IhcController), strict=True))


@pytest.fixture(scope="session")
def start(slaves, controller_start):
    """The complete start values of each exported FMU."""
    changes = dict(zip(NAMES, ({}, controller_start), strict=True))
    return {name: slaves[name].interface.start_values(changes[name]) for name in NAMES}


@pytest.fixture(scope="session")
def fmus(tmp_path_factory, slaves, start):
    from filing.origin import origin
    from fmu_export.python_fmu import export_python_fmu

    folder = tmp_path_factory.mktemp("fmus")
    return {
        name: export_python_fmu(slaves[name], folder / f"{name}.fmu", start[name], origin=origin()) for name in NAMES
    }


def unpacked(files, tmp_path_factory):
    return {name: Path(extract(str(files[name]), str(tmp_path_factory.mktemp(name)))) for name in NAMES}


@pytest.fixture(scope="session")
def folders(tmp_path_factory, fmus):
    """Each FMU unpacked."""
    return unpacked(fmus, tmp_path_factory)


@pytest.fixture(scope="session")
def native_units():
    """Each unit's native side by the FMU's name."""
    from ihc_fmu.pendulum.native_unit import NATIVE as CONTROLLER
    from plant_fmu.native_unit import NATIVE as PLANT

    return dict(zip(NAMES, (PLANT, CONTROLLER), strict=True))


@pytest.fixture(scope="session")
def native_fmus(tmp_path_factory, native_units, start):
    from filing.origin import origin
    from fmu_export.native_fmu import export_native_fmu

    folder = tmp_path_factory.mktemp("native")
    return {
        name: export_native_fmu(native_units[name], folder / f"{name}.fmu", start[name], origin=origin())
        for name in NAMES
    }


@pytest.fixture(scope="session")
def native_folders(tmp_path_factory, native_fmus):
    """Each native FMU unpacked."""
    return unpacked(native_fmus, tmp_path_factory)


@pytest.fixture
def native(native_folders):
    """Make instances of a native FMU, by its name or by the folder of another one; all are freed after the test."""
    made = []

    def make(which, kind=Native.CO_SIMULATION, **options):
        made.append(Native(native_folders.get(which, which), kind, **options))
        return made[-1]

    yield make
    for instance in made:
        instance.free()


@pytest.fixture(params=["native", "python"])
def fmu(request):
    """Make instances of an FMU of either kind by its name; all are freed after the test."""
    folders = request.getfixturevalue({"native": "native_folders", "python": "folders"}[request.param])
    made = []

    def make(which, **options):
        made.append(Native(folders[which], **options))
        return made[-1]

    setattr(make, "folders", folders)  # noqa: B010
    yield make
    for instance in made:
        instance.free()


@pytest.fixture
def host(folders):
    """Make instances of an FMU, by its name or by the folder of another one; all are freed after the test."""
    made = []

    def make(which, **options):
        made.append(Host(folders.get(which, which), **options))
        return made[-1]

    yield make
    for instance in made:
        instance.slave.freeInstance()


@pytest.fixture(scope="session")
def unit(slaves, start):
    """Make units of the library with the start values of the exported FMUs and changes to them."""

    def make(name, **changes):
        return slaves[name].unit_class({**start[name], **changes})

    return make


@pytest.fixture(scope="session")
def run_python():
    """Run a script in a fresh interpreter, `data` in its `data`, and return what it left in its `result`."""

    def run(script, data=None, *, options=(), environment=None, cwd=None):
        program = BEFORE + script + AFTER
        own = {**os.environ, **(environment or {})}
        own["PYTHONPATH"] = os.pathsep.join(filter(None, [own.get("PYTHONPATH"), str(HERE)]))
        done = subprocess.run(
            [sys.executable, *options, "-c", program],
            input=json.dumps(data) + "\n",
            capture_output=True,
            text=True,
            env=own,
            cwd=cwd,
            check=False,
        )
        assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
        return json.loads(done.stdout.splitlines()[-1])

    return run
