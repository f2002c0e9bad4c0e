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
    return export_native_fmu(
        NATIVE, target, changes, notes(system), interface=shown, hidden=hidden, identifier=identifier
    )


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


UNSTABLE = CRANE.changed(A=np.diag([100.0, 0.0, 0.0, 0.0]), lower=None, upper=None, name="unstable")
START_REFUSALS = {  # system, start values, the sentence
    "limits": (
        CRANE,
        {"force_lower": 2.0, "force_upper": 1.0},
        "force_lower must not exceed force_upper, found 2 and 1",
    ),
    "outputs": (
        CRANE.changed(A=1e10 * CRANE.A),
        {"angle_0": 1e300},
        "start values must give finite outputs, found x = (0, 0, 1e+300, 0)",
    ),
}
STEP_REFUSALS = {  # start values, step, force and its disturbance, the beginning of the sentence
    "too long": ({}, 8.0, (0.0, 0.0), "a communication step must be shorter for the plant's fastest mode"),
    "diverged": ({"position_0": 1e300}, 1.0, (0.0, 0.0), "the state left the range of numbers, x = (1."),
    "inputs": ({}, 1e-3, (1e308, 1e308), "inputs must be finite, found force, force_disturbance = (1e+308, 1e+308)"),
}


@pytest.mark.parametrize("case", START_REFUSALS)
def test_start_values_are_refused_with_the_shown_names(case, host_of):
    system, start, sentence = START_REFUSALS[case]
    native = host_of(system)
    with pytest.raises(FMICallException):
        native.initialize(**start)
    assert native.log[-1][2].splitlines()[0] == sentence


def test_limits_that_cross_are_refused_at_the_export_with_the_shown_names(tmp_path):
    with pytest.raises(UserError, match=r"^force_lower must not exceed force_upper, found 2 and 1$"):
        export(CRANE, tmp_path, force_lower=2.0, force_upper=1.0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("case", STEP_REFUSALS)
def test_refused_step_says_why_in_both_and_changes_nothing(case, folder_of):
    start, step, (force, disturbance), words = STEP_REFUSALS[case]
    plant, native = plant_of(UNSTABLE, **start), Native(folder_of(UNSTABLE)).initialize(**start)
    plant.step(0.0, 1e-3, inputs_of())
    native.step(0.0, 1e-3)
    native.set(force=force, force_disturbance=disturbance)
    before, state = native.outputs(), plant.get_state()
    with pytest.raises((UserError, ArithmeticError)) as caught:
        plant.step(1e-3, step, inputs_of([force], [disturbance]))
    said = native.refused("DoStep", 1e-3, step, 0).splitlines()[0]
    assert said.startswith(words)
    assert str(caught.value) in (said, said.replace("force_disturbance", "disturbance_1").replace("force", "input_1"))
    assert (native.outputs(), plant.get_state()) == (before, state)
    plant.step(1e-3, 2e-3, inputs_of([1.0]))
    native.step(1e-3, 2e-3, force=1.0, force_disturbance=0.0)
    agree(native, plant, UNSTABLE)
    native.free()


def test_saved_state_brings_back_the_run_to_the_last_bit(folder_of):
    """Also where the length of the step, for which E and G are kept, has changed in between; and in another instance."""
    folder = folder_of(CRANE, angle_0=0.1)
    native, other = Native(folder).initialize(), Native(folder)
    for k in range(5):
        native.step(k * 1e-2, 1e-2, force=math.sin(k))
    state = native.save()
    kept = native.serialize(state)
    expected = [native.step(0.05 + k * 1e-2, 1e-2, force=1.0) for k in range(5)]
    native.done("SetFMUstate", state)
    native.step(0.05, 0.03)
    native.done("SetFMUstate", state)
    assert [native.step(0.05 + k * 1e-2, 1e-2, force=1.0) for k in range(5)] == expected
    restored = other.deserialize(kept)
    other.done("SetFMUstate", restored)
    assert [other.step(0.05 + k * 1e-2, 1e-2, force=1.0) for k in range(5)] == expected
    native.done("FreeFMUstate", ctypes.byref(state))
    other.done("FreeFMUstate", ctypes.byref(restored))
    for instance in (native, other):
        instance.free()


def signal_of(system, level):
    """Return the inputs as FMPy takes them, held from the start."""
    names = list(held(system, [0.0] * system.m, [0.0] * system.m))
    kinds = [("time", float), *((name, float) for name in names)]
    values = [level * (1 + i) for i in range(len(names))]
    return np.array([(0.0, *values), (100.0, *values)], dtype=kinds)


@pytest.mark.parametrize("system", [CRANE, random_system(2), random_system(15)], ids=["crane", "3 states", "16 states"])
def test_model_exchange_with_cvode_ends_where_the_steps_end(system, tmp_path):
    """FMPy's CVode integrates the derivatives; a step of co-simulation is the matrix exponential."""
    fmu = export(system, tmp_path)
    names = [v.name for v in shown_interface(system).variables if v.compiled.startswith("state_")]
    h = 1.0 / np.abs(np.linalg.eigvals(system.A)).max()
    scales = system.x_eq, np.abs(system.B).max(axis=1)
    start = {f"{q.name}_0": float(x + s) for q, x, s in zip(system.states, *scales, strict=True)}
    ends = []
    for kind in ("ModelExchange", "CoSimulation"):
        rows = simulate_fmu(
            str(fmu),
            fmi_type=kind,
            start_values=start,
            stop_time=20 * h,
            output_interval=h,
            relative_tolerance=1e-10,
            input=signal_of(system, 0.3),
            output=names,
        )
        ends.append(np.array([rows[name] for name in names]))
    largest = np.abs(ends[1] - np.asarray(system.x_eq)[:, None]).max(axis=1)
    assert (np.abs(ends[0] - ends[1]).max(axis=1) < 1e-5 * largest).all()
    assert (np.abs(np.diff(ends[1])).max(axis=1) > 1e-3 * largest).all()


def test_directional_derivatives_are_the_matrices_and_0_behind_limits_and_counts(folder_of):
    C = np.array([[1.0, 0.5, 0, 0], [0, 0, 2.0, -1.0]])
    system = CRANE.changed(C=C, outputs=CRANE.outputs, resolutions=CRANE.resolutions)
    native = Native(folder_of(system), Native.MODEL_EXCHANGE).initialize(force=1.0)
    rates = [f"{q.name}_derivative" for q in system.states]
    states = ["position_true", "velocity", "angle", "rate"]

    def column(known, unknowns):
        made = (ctypes.c_double * len(unknowns))()
        references = (ctypes.c_uint * len(unknowns))(*map(native.reference, unknowns))
        seed = ctypes.c_double(1.0), ctypes.c_uint(native.reference(known))
        native.done(
            "GetDirectionalDerivative", references, len(unknowns), ctypes.byref(seed[1]), 1, ctypes.byref(seed[0]), made
        )
        return list(made)

    np.testing.assert_array_equal(np.transpose([column(x, rates) for x in states]), system.A)
    np.testing.assert_array_equal(np.transpose([column(x, ["angle_sensor"]) for x in states])[0], [0, 0, 2.0, -1.0])
    np.testing.assert_array_equal(np.transpose([column(x, ["position"]) for x in states])[0], [0, 0, 0, 0])
    for name in ("force", "force_disturbance"):
        np.testing.assert_array_equal(column(name, rates), system.B[:, 0])
    native.set(force=4.5)
    for name in ("force", "force_disturbance"):
        np.testing.assert_array_equal(column(name, rates), [0, 0, 0, 0])
    native.free()
