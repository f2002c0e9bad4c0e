"""The linear plant in C, as an FMU, against the one in Python, FMPy's validation and CVode."""

import ctypes
import math
import platform
import random
import sys
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from fmu_export.errors import UserError
from fmu_export.native_fmu import export_native_fmu
from plant_fmu.linear.documentation import notes
from plant_fmu.linear.native_unit import NATIVE
from plant_fmu.linear.start_values import linear_plant_values, shown_interface
from tests.fmu_export.conftest import Host, Native

from .models import CRANE, inputs_of, plant_of, random_system

EXACT = sys.platform == "linux" and platform.machine() == "x86_64"
"""Where nothing but the order of operations decides; elsewhere too, but for how a compiler joins them."""


def export(system, path, **changes):
    identifier = f"{system.name}_linear_plant"
    shown, hidden = shown_interface(system), linear_plant_values(system)
    target = path / f"{identifier}.fmu"
    return export_native_fmu(NATIVE, target, changes, notes(system), interface=shown, hidden=hidden, identifier=identifier)


@pytest.fixture
def folder_of(tmp_path):
    """Export a system's plant and unpack it."""
    return lambda system, **changes: Path(extract(str(export(system, tmp_path, **changes)), str(tmp_path / "unpacked")))


@pytest.fixture
def host_of(folder_of):
    made = []

    def make(system, **changes):
        made.append(Host(folder_of(system, **changes)))
        return made[-1]

    yield make
    for host in made:
        host.slave.freeInstance()


def shown_outputs(plant, system):
    """Return the outputs of the Python unit that the FMU shows, in its order."""
    y, x, rates = np.split(np.array(plant.outputs()), [16, 32])
    return (*y[: system.p], *x[: system.n], *rates[: system.n])


def agree(native, plant, system):
    expected = shown_outputs(plant, system)
    if EXACT:
        assert native.outputs() == expected
    else:
        np.testing.assert_allclose(native.outputs(), expected, rtol=1e-12, atol=1e-12)


def held(system, u, d):
    names = [q.name for q in system.inputs]
    return {**dict(zip(names, u, strict=True)), **{f"{n}_disturbance": v for n, v in zip(names, d, strict=True)}}


@pytest.mark.parametrize("seed", range(32))
def test_native_plant_equals_the_python_plant_to_the_last_bit(seed, host_of):
    system, rng = random_system(seed), random.Random(seed)
    changes = {f"x{i + 1}_0": rng.gauss(0, 1) for i in range(system.n)}
    changes |= {f"y{i + 1}_bias": rng.gauss(0, 0.1) for i in range(system.p)}
    changes |= {f"y{i + 1}_resolution_offset": rng.random() for i in range(system.p)}
    plant, native = plant_of(system, **changes), host_of(system).initialize(**changes)
    agree(native, plant, system)
    time, fixed = 0.0, 1e-3
    for k in range(60):
        h = fixed if k % 3 else 10 ** rng.uniform(-6, -1)
        u, d = ([rng.gauss(0, 2) for _ in range(system.m)] for _ in range(2))
        plant.step(time, h, inputs_of(u, d))
        native.step(time, h, **held(system, u, d))
        agree(native, plant, system)
        time += h


def test_stiff_plant_is_the_same_in_both(host_of):
    system = CRANE.changed(A=np.array([[0, 1, 0, 0], [0, -1e6, 2.4, 0], [0, 0, 0, 1e3], [1e-9, -1.1, -2.7e7, -0.1]]))
    plant, native = plant_of(system, angle_0=0.5), host_of(system).initialize(angle_0=0.5)
    for k in range(50):
        plant.step(k * 0.1, 0.1, inputs_of([4.0]))
        native.step(k * 0.1, 0.1, force=4.0)
        agree(native, plant, system)


@pytest.mark.parametrize("system", [CRANE, random_system(4), random_system(15)], ids=["crane", "5 states", "16 states"])
def test_fmu_is_valid_in_fmpy(system, tmp_path):
    assert validate_fmu(str(export(system, tmp_path))) == []


def test_unit_as_it_is_compiled_is_valid_too(tmp_path):
    assert validate_fmu(str(export_native_fmu(NATIVE, tmp_path / "LinearPlant.fmu"))) == []


UNSTABLE = CRANE.changed(A=np.diag([100.0, 0.0, 0.0, 0.0]), name="unstable")
REFUSALS = {  # system, start values, step, inputs, the sentence
    "limits": (CRANE, {"force_lower": 2.0, "force_upper": 1.0}, 0.0, {}, "force_lower must not exceed force_upper, found 2 and 1"),
    "start": (
        CRANE.changed(A=1e10 * CRANE.A),
        {"angle_0": 1e300},
        0.0,
        {},
        "start values must give finite outputs, found x = (0, 0, 1e+300, 0)",
    ),
    "inputs": (
        CRANE,
        {},
        1e-3,
        {"force": -1.0, "force_disturbance": -sys.float_info.max, "position_0": 1.0},
        None,
    ),
    "too long": (
        UNSTABLE,
        {},
        8.0,
        {},
        "a communication step must be shorter for the plant's fastest mode to be computed, found 8 s",
    ),
    "diverged": (
        UNSTABLE,
        {"position_0": 1e300},
        1.0,
        {},
        "the state left the range of numbers, x = (1e+300, 0, 0, 0) before the step",
    ),
}


@pytest.mark.parametrize("case", ["limits", "start"])
def test_start_values_are_refused_with_the_shown_names(case, host_of):
    system, start, _, _, sentence = REFUSALS[case]
    native = host_of(system)
    with pytest.raises(FMICallException):
        native.initialize(**start)
    assert native.log[-1][2].splitlines()[0] == sentence


@pytest.mark.parametrize("case", ["too long", "diverged"])
def test_refused_step_says_why_in_both_and_changes_nothing(case, folder_of):
    system, start, step, inputs, sentence = REFUSALS[case]
    plant, native = plant_of(system, **start), Native(folder_of(system)).initialize(**start)
    plant.step(0.0, 1e-3, inputs_of())
    native.step(0.0, 1e-3)
    before, state = native.everything(), plant.get_state()
    with pytest.raises((UserError, ArithmeticError)) as caught:
        plant.step(1e-3, step, inputs_of())
    assert native.refused("DoStep", 1e-3, step, 0).splitlines()[0] == str(caught.value)
    assert (native.everything(), plant.get_state()) == (before, state)
    native.free()
