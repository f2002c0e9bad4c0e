"""The example plants: their classes without an FMU, and their FMUs, each built once."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"

CLASSES = {
    "crane": "Crane",
    "arm": "Arm",
    "double_pendulum": "DoublePendulum",
    "rotorcraft": "Rotorcraft",
    "servo": "Servo",
}


@pytest.fixture(params=CLASSES)
def name(request):
    return request.param


@pytest.fixture(scope="session")
def plant_of():
    """Make the plant of an example, as a Python object with parameters changed."""

    def make(name, **parameters):
        spec: Any = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / name / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        sys.path.insert(0, str(EXAMPLES))
        try:
            spec.loader.exec_module(module)
        finally:
            sys.path.remove(str(EXAMPLES))
        plant = getattr(module, CLASSES[name])(instance_name=name)
        for parameter, value in parameters.items():
            assert parameter in plant.parameters
            setattr(plant, parameter, value)
        return plant

    return make


@pytest.fixture(scope="session")
def fmu_of(tmp_path_factory):
    """Return the FMU of an example, built as its Makefile does."""
    folder = tmp_path_factory.mktemp("examples")

    def build(name):
        path = folder / f"{name}.fmu"
        if not path.exists():
            options = ["--handle-state", "--serialize-state", "-f", f"{name}/{name}.py", "-d", str(path)]
            command = [sys.executable, "-m", "pythonfmu", "build", *options, "rk4_plant.py"]
            subprocess.run(command, cwd=EXAMPLES, check=True, capture_output=True, timeout=60)
        return path

    return build
