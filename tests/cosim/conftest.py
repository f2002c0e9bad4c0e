"""Both FMUs and a tiny one, exported once per test process to a folder with a space; results made by hand."""

from __future__ import annotations

import importlib
import json
import shutil
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cosim.pendulum_export import export_units
from cosim.results import Result
from cosim.scenario import load_scenario
from cosim.scenario_system import build_system
from cosim.structure import Component
from fmu_export.python_fmu import export_python_fmu
from ihc_fmu.pendulum.start_values import default_design

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def design():
    return default_design()


@pytest.fixture(scope="session")
def fmus(tmp_path_factory, design):
    """The folder with both FMUs and the SSP, as the command line exports them."""
    folder = tmp_path_factory.mktemp("exported FMUs")
    export_units(design, output=folder)
    return folder


@pytest.fixture
def pair(fmus):
    """Make the system of plant and controller from a built-in scenario with changes."""

    def make(name="tilt", **changes):
        scenario, folder = load_scenario(name)
        return build_system(scenario.changed({k.replace("__", "."): v for k, v in changes.items()}), fmus, folder)

    return make


@pytest.fixture(scope="session")
def tiny_slave():
    sys.path.insert(0, str(HERE))
    try:
        yield importlib.import_module("tiny.slave").Tiny
    finally:
        sys.path.remove(str(HERE))


@pytest.fixture(scope="session")
def tiny_fmu(tmp_path_factory, tiny_slave):
    return export_python_fmu(tiny_slave, tmp_path_factory.mktemp("tiny FMU") / "Tiny.fmu")


@pytest.fixture
def tiny(tiny_fmu):
    """Make components of the tiny FMU."""
    return lambda name="a", **start: Component(name, tiny_fmu, start)


@pytest.fixture
def repacked(tmp_path):
    """Make a copy of an FMU with its text changed by functions; None removes a file, a name that ends in / a folder."""

    def repack(fmu, changes):
        path = tmp_path / f"changed {fmu.name}"
        with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                change = next((c for c in changes if name == c or (c.endswith("/") and name.startswith(c))), None)
                if change is None:
                    new.writestr(name, old.read(name))
                elif changes[change] is not None:
                    new.writestr(name, changes[change](old.read(name).decode()))
        return path

    return repack


@pytest.fixture
def made_result():
    """Make a result from time, |q| in the arm's angle, and other signals by their short names."""

    def make(time, theta=0.0, **signals):
        columns = {"plant.theta": theta, "plant.delta": 0.0, "controller.voltage": 0.0, "controller.mode": 3}
        columns |= {"controller.homogeneous_norm": 1.0} | {n.replace("_", ".", 1): v for n, v in signals.items()}
        full = {n: np.full(len(time), v) if np.ndim(v) == 0 else np.asarray(v) for n, v in columns.items()}
        return Result(np.asarray(time, dtype=float), full, dict.fromkeys(full, "1"), {})

    return make


@pytest.fixture
def same():
    """Assert that two results are the same to the last bit, metadata included where it is asked for."""

    def check(a, b, *, metadata=True):
        assert a.time.tobytes() == b.time.tobytes()
        assert list(a.signals) == list(b.signals)
        assert a.units == b.units
        for name, signal in a.signals.items():
            assert signal.dtype == b[name].dtype, name
            np.testing.assert_array_equal(signal, b[name], err_msg=name)
        if metadata:
            assert a.metadata == b.metadata

    return check


@pytest.fixture
def design_file(tmp_path, design):
    """Write the default design as a file, with entries of the JSON changed."""

    def write(name="design.json", **changes):
        path = tmp_path / name
        path.write_text(json.dumps({**json.loads(design.to_json()), **changes}), encoding="utf-8")
        return path

    return write


@pytest.fixture
def elsewhere(tmp_path, fmus):
    """A fresh working folder with the exported FMUs in `fmus`."""
    shutil.copytree(fmus, tmp_path / "fmus")
    return tmp_path
