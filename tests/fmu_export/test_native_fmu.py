"""Native FMUs: what the files hold, their start values, model exchange, and the binary rebuilt from their own sources."""

import ctypes
import math
import platform
import random
import re
import shutil
import struct
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.build import build_platform_binary
from fmpy.validation import validate_fmu

from filing.origin import origin
from fmu_export import native_fmu
from fmu_export.native_build import BINARIES, PLATFORMS, BuildError, host_platform
from fmu_export.native_fmu import export_native_fmu
from fmu_export.native_unit import start_value_file, variable_table
from ihc_fmu.pendulum.interface import LAWS
from ihc_fmu.pendulum.paper_system import PAPER_A, PAPER_B
from plant_fmu.interface import start_values as plant_start_values
from plant_fmu.linearization import linearize
from plant_fmu.parameters import PARAMETER_SETS
from rotary_pendulum.equation import FRICTION_SPEED

PLANT, CONTROLLER = "QubeServo2", "IhcController"
STEP = 1e-3
EXCHANGE = 0
STATIC, INDUCTANCE = 1, 2
STATES: dict[int, tuple[str, ...]] = {STATIC: ("theta", "delta", "theta_dot", "delta_dot")}
STATES[INDUCTANCE] = (*STATES[STATIC], "current")
DERIVATIVES: dict[int, tuple[str, ...]] = {STATIC: ("theta_dot", "delta_dot", "theta_ddot", "delta_ddot")}
DERIVATIVES[INDUCTANCE] = (*DERIVATIVES[STATIC], "current_dot")
INPUTS = ("voltage", "disturbance_voltage", "pendulum_torque")


def contents(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def description(path) -> Any:
    return read_model_description(str(path))


def guid(path):
    return description(path).guid


@pytest.fixture(scope="module")
def plants(tmp_path_factory, native_units):
    """The unpacked plant by its motor model."""
    folder = tmp_path_factory.mktemp("plants")

    def made(motor):
        path = export_native_fmu(native_units[PLANT], folder / f"{motor}.fmu", {"motor_model": motor})
        return Path(extract(str(path), str(folder / str(motor))))

    return {motor: made(motor) for motor in (STATIC, INDUCTANCE)}


# The file


def test_file_holds_sources_the_binary_of_this_machine_start_values_and_documentation(name, native_fmus, native_units):
    unit, files, host = native_units[name], contents(native_fmus[name]), host_platform()
    own = {f"sources/{file}" for file in (*unit.sources, *unit.generated, "start_values.c")}
    binary = f"binaries/{host.name}/{name}{host.suffix}"
    others = {binary, "modelDescription.xml", "resources/start_values.bin", "documentation/index.html"}
    assert {file for file in files if file.startswith("sources/")} == own
    assert others <= set(files)
    assert {file.split("/")[0] for file in files if file not in own | others} <= {"documentation", "binaries"}
    assert files[binary] == (BINARIES / host.name / f"{name}{host.suffix}").read_bytes()
    assert files[f"sources/{unit.stem}_table.h"] == variable_table(unit).encode()
    assert b"MIT License" in files["documentation/licenses/license.txt"]
    assert b"Modelica Association" in files["documentation/licenses/FMI.txt"]
    assert b"Zig contributors" in files["documentation/licenses/Zig.txt"]
    assert b"mingw-w64 project" in files["documentation/licenses/mingw-w64.txt"]
    for file, path in unit.sources.items():
        assert files[f"sources/{file}"] == path.read_bytes()


def test_file_holds_no_python_and_no_time_stamps(name, native_fmus):
    with zipfile.ZipFile(native_fmus[name]) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert archive.namelist()[0] == "modelDescription.xml"
        assert archive.testzip() is None
        assert not [entry for entry in archive.namelist() if ".py" in entry]


def test_description_names_the_sources_to_compile(name, native_fmus):
    files = contents(native_fmus[name])
    root = ET.fromstring(files["modelDescription.xml"])
    kinds = ["ModelExchange", "CoSimulation"] if name == PLANT else ["CoSimulation"]
    assert [child.tag for child in root if child.tag in ("ModelExchange", "CoSimulation")] == kinds
    compiled = sorted(file.removeprefix("sources/") for file in files if re.fullmatch(r"sources/.*\.c", file))
    for kind in kinds:
        assert [file.get("name") for file in root.iterfind(f"{kind}/SourceFiles/File")] == compiled
        assert root.find(kind).get("needsExecutionTool") == "false"  # type: ignore[union-attr]


def test_fmpy_finds_no_problem(name, native_fmus):
    assert validate_fmu(str(native_fmus[name])) == []


@pytest.mark.parametrize("motor", [STATIC, INDUCTANCE])
def test_fmpy_finds_no_problem_in_either_motor_model(motor, plants):
    assert validate_fmu(str(plants[motor])) == []


def test_both_kinds_of_fmu_have_the_same_variables(name, native_fmus, fmus):
    def variables(path):
        root = ET.fromstring(contents(path)["modelDescription.xml"])
        for variable in root.iterfind("ModelVariables/ScalarVariable"):
            kind = dict(variable[0].attrib)
            kind.pop("derivative", None)
            yield dict(variable.attrib), variable[0].tag, kind

    native, python = list(variables(native_fmus[name])), list(variables(fmus[name]))
    assert native == python
    assert len(native) > 30


@pytest.mark.parametrize("section", ["UnitDefinitions", "TypeDefinitions", "DefaultExperiment"])
def test_both_kinds_of_fmu_have_the_same_units_types_and_experiment(section, name, native_fmus, fmus):
    native, python = (ET.fromstring(contents(of[name])["modelDescription.xml"]) for of in (native_fmus, fmus))
    assert ET.tostring(native.find(section)) == ET.tostring(python.find(section))  # type: ignore[arg-type]


# Reproducible


def test_same_arguments_give_the_same_bytes(name, native_units, native_fmus, start, tmp_path):
    path = export_native_fmu(
        native_units[name], tmp_path / "again.fmu", dict(reversed(start[name].items())), origin=origin()
    )
    assert path.read_bytes() == native_fmus[name].read_bytes()


def test_guid_follows_start_values_and_notes(native_units, native_fmus, tmp_path):
    changes = [{"theta_0": math.nextafter(0.0, 1.0)}, {"back_emf": False}, {"noise_seed": 2}]
    paths = [export_native_fmu(native_units[PLANT], tmp_path / f"{i}.fmu", c) for i, c in enumerate(changes)]
    paths.append(export_native_fmu(native_units[PLANT], tmp_path / "notes.fmu", notes="<p>other</p>"))
    assert len({guid(path) for path in [*paths, native_fmus[PLANT]]}) == 5


def test_binary_does_not_follow_start_values(native_units, native_fmus, tmp_path):
    changed = export_native_fmu(native_units[PLANT], tmp_path / "changed.fmu", {"theta_0": 0.5, "motor_model": 2})
    host = host_platform()
    binary = f"binaries/{host.name}/{PLANT}{host.suffix}"
    assert contents(changed)[binary] == contents(native_fmus[PLANT])[binary]


# Start values


def test_start_values_of_an_instance_are_those_exported(name, host, native_folders, start):
    instance = host(native_folders[name])
    assert dict(zip(start[name], instance.get(*start[name]), strict=True)) == start[name]


def test_changed_start_values_are_in_description_resources_sources_and_instance(host, native_units, tmp_path):
    changes = {
        "m_p": math.nextafter(0.03, 1.0),
        "motor_model": "inductance",
        "back_emf": False,
        "noise_seed": 2**31 - 1,
    }
    numbers = changes | {"motor_model": 2}
    unit = native_units[PLANT]
    path = export_native_fmu(unit, tmp_path / "plant.fmu", changes)
    described = {v.name: v.start for v in description(path).modelVariables}
    assert {name: described[name] for name in changes} == {
        "m_p": repr(numbers["m_p"]),
        "motor_model": "2",
        "back_emf": "false",
        "noise_seed": "2147483647",
    }
    files = contents(path)
    values = unit.interface.start_values(changes)
    assert files["resources/start_values.bin"] == start_value_file(
        unit.interface, guid(path), values, {v.name: v.name for v in unit.interface.variables}
    )
    assert f'"{guid(path)}"'.encode() in files["sources/start_values.c"]
    instance = host(Path(extract(str(path), str(tmp_path / "plant"))))
    assert instance.get(*numbers) == tuple(numbers.values())


@pytest.mark.parametrize(
    ("name", "changes", "part"),
    [
        (PLANT, {"m_p": 0.0}, r"m_p must lie in \[1e-12, 1e\+12\] kg"),
        (PLANT, {"solver_step": 1.0}, r"solver_step must lie in \[1e-07, 0.1\] s"),
        (PLANT, {"m_q": 1.0}, "did you mean m_p"),
        (PLANT, {"theta": 1.0}, "no parameter or input named 'theta'"),
        (CONTROLLER, {"a_min": 2.0}, "a_min must not exceed b_max"),
        (CONTROLLER, {"theta": math.nan}, "theta must be finite"),
        (CONTROLLER, {"law": "PID"}, f"law must be one of {', '.join(LAWS)}"),
    ],
)
def test_bad_start_values_are_refused_before_anything_is_written(name, changes, part, native_units, tmp_path):
    with pytest.raises(ValueError, match=part):
        export_native_fmu(native_units[name], tmp_path / "new" / "unit.fmu", changes)
    assert list(tmp_path.iterdir()) == []


# Platforms


def test_unknown_platform_is_refused_with_those_that_there_are(native_units, tmp_path):
    with pytest.raises(ValueError, match=f"one of {', '.join(PLATFORMS)}, found 'amiga'"):
        export_native_fmu(native_units[PLANT], tmp_path / "plant.fmu", platforms=[host_platform().name, "amiga"])
    assert list(tmp_path.iterdir()) == []


def test_binaries_are_for_the_platforms_asked_for(native_units, native_fmus, tmp_path):
    names = [host_platform().name, "aarch64-linux", "aarch64-linux"]
    built = []
    path = export_native_fmu(
        native_units[PLANT], tmp_path / "plant.fmu", platforms=names, building=built.append, origin=origin()
    )
    assert built == [f"{PLANT} for {name}" for name in names[:2]]
    files = contents(path)
    platforms = {file.split("/")[1] for file in files if file.startswith("binaries/")}
    assert platforms == set(names)
    assert struct.unpack_from("<H", files[f"binaries/aarch64-linux/{PLANT}.so"], 18) == (183,)
    assert len(files) == len(contents(native_fmus[PLANT])) + len(platforms) - 1


def test_file_without_binaries_is_sources_only(native_units, tmp_path):
    files = contents(export_native_fmu(native_units[PLANT], tmp_path / "plant.fmu", platforms=[]))
    assert not [file for file in files if file.startswith("binaries/")]
    assert "sources/qube_servo2.c" in files


def test_missing_or_outdated_binary_is_refused_before_anything_is_written(name, native_units, tmp_path, monkeypatch):
    monkeypatch.setattr(native_fmu, "BINARIES", tmp_path / "binaries")
    host = host_platform()
    with pytest.raises(BuildError, match=rf"{host.name}/{name}\{host.suffix} is missing"):
        export_native_fmu(native_units[name], tmp_path / "unit.fmu")
    shutil.copytree(BINARIES / host.name, tmp_path / "binaries" / host.name)
    assert export_native_fmu(native_units[name], tmp_path / "good.fmu").is_file()
    (tmp_path / "binaries" / host.name / f"{name}.sha256").write_text("0" * 64)
    with pytest.raises(BuildError, match=rf"{host.name}/{name}\{host.suffix} is older than its sources"):
        export_native_fmu(native_units[name], tmp_path / "unit.fmu")
    assert not (tmp_path / "unit.fmu").exists()


# Model exchange


def square_wave(seconds):
    """A voltage that changes its sign at every communication point and is constant between them."""
    steps = np.arange(0.0, seconds, 0.05)
    voltages = [3.0 * (-1) ** k for k in range(len(steps))]
    rows = [(0.0, voltages[0])]
    for time, voltage in zip(steps[1:], voltages[1:], strict=True):
        rows += [(time, rows[-1][1]), (time, voltage)]
    return np.array([*rows, (seconds, rows[-1][1])], dtype=[("time", float), ("voltage", float)])


@pytest.mark.parametrize("motor", [STATIC, INDUCTANCE])
def test_model_exchange_agrees_with_co_simulation(motor, plants):
    common = {
        "filename": str(plants[motor]),
        "stop_time": 0.5,
        "output_interval": 0.05,
        "output": [*STATES[INDUCTANCE], "energy"],
        "input": square_wave(0.5),
        "start_values": {"delta_0": 0.3, "theta_dot_0": 1.0, "solver_step": 1e-4},
        "record_events": False,
    }
    stepped = simulate_fmu(**common, fmi_type="CoSimulation")
    solved = simulate_fmu(**common, fmi_type="ModelExchange", relative_tolerance=1e-10)
    assert len(stepped) == len(solved) == 11
    assert abs(stepped["delta"][-1]) > 1.0
    for column in ("theta", "delta", "theta_dot", "delta_dot", "energy"):
        scale = max(abs(stepped[column]))
        np.testing.assert_allclose(solved[column], stepped[column], atol=1e-6 * scale, err_msg=column)


@pytest.mark.parametrize("motor", [STATIC, INDUCTANCE])
def test_description_counts_the_states_and_names_their_derivatives(motor, plants):
    described = description(plants[motor])
    assert described.numberOfContinuousStates == len(STATES[motor]) == {STATIC: 4, INDUCTANCE: 5}[motor]
    assert tuple(unknown.variable.name for unknown in described.derivatives) == DERIVATIVES[motor]
    assert tuple(unknown.variable.derivative.name for unknown in described.derivatives) == STATES[motor]


def real(*values):
    return (ctypes.c_double * len(values))(*values)


class Exchange:
    """The plant in continuous-time mode, as functions of states and inputs."""

    def __init__(self, native, motor, **start):
        self.instance, self.motor = native.initialize(**start), motor
        native.done("EnterContinuousTimeMode")

    def at(self, x, u):
        self.instance.done("SetContinuousStates", real(*x), len(x))
        self.instance.set(**dict(zip(INPUTS, map(float, u), strict=True)))
        return self

    def states(self):
        values = real(*[0.0] * len(STATES[self.motor]))
        self.instance.done("GetContinuousStates", values, len(values))
        return tuple(values)

    def derivatives(self, x, u):
        values = real(*[0.0] * len(x))
        self.at(x, u).instance.done("GetDerivatives", values, len(values))
        return np.array(values)

    def outputs(self, x, u, names):
        return np.array(self.at(x, u).instance.get(*names))

    def directional(self, unknowns, knowns, seeds):
        numbers = [(ctypes.c_uint * len(n))(*map(self.instance.reference, n)) for n in (unknowns, knowns)]
        values = real(*[0.0] * len(unknowns))
        arguments = (numbers[0], len(unknowns), numbers[1], len(knowns), real(*seeds), values)
        self.instance.done("GetDirectionalDerivative", *arguments)
        return np.array(values)

    def jacobian(self, x, u, unknowns):
        """Return the derivatives of `unknowns` by states and inputs, a column each."""
        self.at(x, u)
        return np.column_stack([self.directional(unknowns, [k], [1.0]) for k in (*STATES[self.motor], *INPUTS)])


@pytest.fixture
def exchange(native, plants):
    return lambda motor, **start: Exchange(native(plants[motor], EXCHANGE), motor, **start)


def differences(f, x, u):
    """Central differences by states and inputs, of an error near 1e-10 of f."""
    point, columns = np.array([*x, *u]), []
    for i, value in enumerate(point):
        h = 1e-5 * max(1.0, abs(value)) * (1e-2 if i == len(point) - 1 else 1.0)
        up, down = point.copy(), point.copy()
        up[i], down[i] = value + h, value - h
        columns.append((f(up[: len(x)], up[len(x) :]) - f(down[: len(x)], down[len(x) :])) / (up[i] - down[i]))
    return np.column_stack(columns)


def random_point(motor, seed):
    rng = random.Random(seed)
    x = [rng.uniform(-3, 3), rng.uniform(-4, 4), rng.uniform(-10, 10), rng.uniform(-10, 10), rng.uniform(-1, 1)]
    return x[: len(STATES[motor])], [rng.uniform(-4, 4), rng.uniform(-4, 4), rng.uniform(-1e-2, 1e-2)]


def assert_close_to_differences(actual, expected):
    """Row by row, to the accuracy of the differences."""
    scale = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(actual, expected, atol=1e-7 * max(1.0, float(scale.max())), rtol=1e-6)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    "changes",
    [{"back_emf": True}, {"back_emf": False}, {"T_r": 2e-3}],
    ids=["back-EMF", "no back-EMF", "dry friction"],
)
@pytest.mark.parametrize("motor", [STATIC, INDUCTANCE])
def test_directional_derivatives_of_the_rates_are_their_differences(motor, changes, seed, exchange):
    plant, point = exchange(motor, **changes), random_point(motor, seed)
    expected = differences(plant.derivatives, *point)
    assert_close_to_differences(plant.jacobian(*point, DERIVATIVES[motor]), expected)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("motor", [STATIC, INDUCTANCE])
def test_directional_derivatives_of_the_outputs_are_their_differences(motor, seed, exchange):
    plant, point = exchange(motor, encoder_counts=0), random_point(motor, seed)
    names = plant.instance.output_names
    expected = differences(lambda x, u: plant.outputs(x, u, names), *point)
    assert_close_to_differences(plant.jacobian(*point, names), expected)


@pytest.mark.parametrize("motor", [STATIC, INDUCTANCE])
def test_directional_derivative_is_linear_in_the_seeds(motor, exchange):
    plant, rng = exchange(motor), random.Random(3)
    names, knowns = plant.instance.output_names, (*STATES[motor], *INPUTS)
    point = random_point(motor, 7)
    jacobian = plant.jacobian(*point, names)
    seeds = [rng.uniform(-1, 1) for _ in knowns]
    np.testing.assert_allclose(plant.directional(names, knowns, seeds), jacobian @ seeds, rtol=1e-9, atol=1e-9)
    twice = plant.directional(names, ["voltage", "voltage"], [1.0, 2.0])
    np.testing.assert_allclose(twice, 3.0 * jacobian[:, knowns.index("voltage")], rtol=1e-12)


@pytest.mark.parametrize("motor", [STATIC, INDUCTANCE])
def test_saturated_voltage_and_counting_encoders_have_no_derivative(motor, exchange):
    plant = exchange(motor)
    x, _ = random_point(motor, 1)
    jacobian = plant.jacobian(x, [9.0, 2.0, 0.0], plant.instance.output_names)
    inputs = jacobian[:, len(x) :]
    assert not inputs[:, :2].any()
    assert inputs[:, 2].any()
    for name in ("theta_encoder", "delta_encoder"):
        assert not jacobian[plant.instance.output_names.index(name)].any()


@pytest.mark.parametrize("name", PARAMETER_SETS)
def test_directional_derivatives_upright_are_the_linear_model(name, exchange):
    values = plant_start_values(name)
    jacobian = exchange(STATIC, **values).jacobian([0.0] * 4, [0.0] * 3, DERIVATIVES[STATIC])
    A, b = linearize(PARAMETER_SETS[name].parameters, back_emf=bool(values["back_emf"]))
    np.testing.assert_allclose(jacobian[:, :4], A, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(jacobian[:, 4], b, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(jacobian[:, 5], jacobian[:, 4])


def test_dry_friction_at_rest_is_a_damping_by_its_slope(exchange):
    ident, friction = PARAMETER_SETS["ident"].parameters, 1e-4
    jacobian = exchange(STATIC, T_r=friction).jacobian([0.0] * 4, [0.0] * 3, DERIVATIVES[STATIC])
    A, _ = linearize(replace(ident, D_r=ident.D_r + friction / FRICTION_SPEED))
    np.testing.assert_allclose(jacobian[:, :4], A, rtol=1e-12, atol=1e-12)


def test_directional_derivatives_upright_are_the_papers_a_and_b(exchange):
    plant = exchange(STATIC, **plant_start_values("matrices"))
    jacobian = plant.jacobian([0.0] * 4, [0.0] * 3, DERIVATIVES[STATIC])
    np.testing.assert_allclose(jacobian[:, :4], PAPER_A, atol=5.1e-5)
    np.testing.assert_allclose(jacobian[:, 4], PAPER_B, atol=5.1e-5)


@pytest.mark.parametrize("motor", [STATIC, INDUCTANCE])
def test_declared_dependencies_are_the_entries_that_are_not_zero(motor, plants, exchange):
    """At random points an entry is zero only where nothing depends on anything."""
    described = description(plants[motor])
    plant, knowns = exchange(motor, encoder_counts=0), (*STATES[motor], *INPUTS)
    unknowns = [*described.outputs, *described.derivatives]
    names = [unknown.variable.name for unknown in unknowns]
    sums = np.sum([abs(plant.jacobian(*random_point(motor, seed), names)) for seed in range(5)], axis=0)
    for name, unknown, row in zip(names, unknowns, sums, strict=True):
        assert {v.name for v in unknown.dependencies} == {k for k, entry in zip(knowns, row, strict=True) if entry}, (
            name
        )


@pytest.mark.parametrize("motor", [STATIC, INDUCTANCE])
def test_initial_states_are_the_start_values(motor, exchange):
    plant = exchange(motor, theta_0=0.1, delta_0=0.2, theta_dot_0=0.3, delta_dot_0=0.4)
    assert plant.states() == (0.1, 0.2, 0.3, 0.4, 0.0)[: len(STATES[motor])]


def test_outputs_of_co_simulation_do_not_depend_on_inputs_before_the_next_step(native, native_folders):
    instance = native(native_folders[PLANT]).initialize(delta_0=0.3)
    instance.step(0.0, STEP, voltage=2.0)
    names = instance.output_names
    numbers = [(ctypes.c_uint * len(n))(*map(instance.reference, n)) for n in (names, INPUTS)]
    values = real(*[math.nan] * len(names))
    for seeds in np.eye(len(INPUTS)):
        instance.done("GetDirectionalDerivative", numbers[0], len(names), numbers[1], 3, real(*seeds), values)
        assert list(values) == [0.0] * len(names)


@pytest.mark.parametrize("parameter", ["noise_std", "measurement_delay"])
def test_what_needs_communication_points_is_refused_in_model_exchange(parameter, native, native_folders):
    instance = native(native_folders[PLANT], EXCHANGE)
    instance.set(**{parameter: 1e-3})
    instance.setup()
    instance.done("EnterInitializationMode")
    assert instance.refused("ExitInitializationMode").startswith(f"in model exchange {parameter} must be 0")


# The FMU's own sources


@pytest.fixture(scope="module")
def rebuilt(tmp_path_factory, native_fmus):
    """Unpack an FMU and let FMPy compile its sources in place of its binary; start_values.bin is deleted."""
    if shutil.which("cmake") is None or not any(map(shutil.which, ("cc", "gcc", "clang"))):
        pytest.skip("needs cmake and a C compiler")
    if sys.platform != "linux":
        pytest.skip("FMPy chooses the compiler's platform elsewhere")

    def compiled(name):
        folder = tmp_path_factory.mktemp("rebuilt")
        unpacked = Path(extract(str(native_fmus[name]), str(folder / "fmu")))
        shutil.rmtree(unpacked / "binaries")
        (unpacked / "resources" / "start_values.bin").unlink()
        (folder / "build").mkdir()
        build_platform_binary(unpacked, folder / "build")
        return unpacked

    return compiled


def agree(actual, expected):
    exact = platform.machine() == "x86_64"
    np.testing.assert_allclose(actual, expected, rtol=0.0 if exact else 1e-12, atol=0.0 if exact else 1e-12)


def test_rebuilt_binary_equals_the_one_that_came_with_it(name, rebuilt, native, native_folders):
    compiled, original = native(rebuilt(name)).initialize(), native(native_folders[name]).initialize()
    assert compiled.library._name != original.library._name
    inputs = {PLANT: "voltage", CONTROLLER: "delta"}[name]
    agree(compiled.outputs(), original.outputs())
    for k in range(500):
        row = {inputs: 3.0 * math.cos(6.0 * k * STEP)}
        agree(compiled.step(k * STEP, STEP, **row), original.step(k * STEP, STEP, **row))
