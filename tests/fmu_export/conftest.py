"""Both FMUs, exported once per test process, and a host that drives an instance by variable names.

Scripts in processes of their own import `Host` from here too, so the project is imported inside the fixtures only.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from fmpy import extract, instantiate_fmu, read_model_description

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


@cache
def description(folder):
    return read_model_description(folder)


@pytest.fixture(params=NAMES)
def name(request):
    """A test that asks for `name` runs once for each FMU."""
    return request.param


@pytest.fixture(scope="session")
def controller_start():
    from ihc_fmu.start_values import controller_start_values, default_design

    return controller_start_values(default_design())


@pytest.fixture(scope="session")
def slaves():
    """Each FMU's slave class by the FMU's name."""
    from ihc_fmu.slave import IhcController
    from plant_fmu.slave import QubeServo2

    return dict(zip(NAMES, (QubeServo2, IhcController), strict=True))


@pytest.fixture(scope="session")
def start(slaves, controller_start):
    """The complete start values of each exported FMU."""
    changes = dict(zip(NAMES, ({}, controller_start), strict=True))
    return {name: slaves[name].interface.start_values(changes[name]) for name in NAMES}


@pytest.fixture(scope="session")
def fmus(tmp_path_factory, slaves, start):
    from fmu_export.python_fmu import export_python_fmu

    folder = tmp_path_factory.mktemp("fmus")
    return {name: export_python_fmu(slaves[name], folder / f"{name}.fmu", start[name]) for name in NAMES}


@pytest.fixture(scope="session")
def folders(tmp_path_factory, fmus):
    """Each FMU unpacked."""
    return {name: Path(extract(str(fmus[name]), str(tmp_path_factory.mktemp(name)))) for name in NAMES}


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
