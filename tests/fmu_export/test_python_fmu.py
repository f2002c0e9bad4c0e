"""The files: reproducible, self-contained, running their own code and no other's."""

import ast
import csv
import json
import math
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from fmpy import extract, read_model_description

import fmu_export
from filing.origin import origin
from fmu_export.errors import UserError
from fmu_export.python_fmu import export_python_fmu
from ihc_fmu.pendulum.interface import LAWS

SRC = Path(fmu_export.__file__).parents[1]
UNIT_PACKAGES = {"QubeServo2": "plant_fmu", "IhcController": "ihc_fmu"}
SLAVE_MODULES = {"QubeServo2": "plant_fmu.slave", "IhcController": "ihc_fmu.pendulum.slave"}

EXPORT = """
import fmu_export
from pathlib import Path
from filing.origin import origin
from fmu_export.python_fmu import export_python_fmu
from ihc_fmu.pendulum.slave import IhcController
from plant_fmu.slave import QubeServo2
for slave in (QubeServo2, IhcController):
    name = slave.interface.name
    export_python_fmu(slave, Path(data["to"]) / f"{name}.fmu", data["start"][name], origin=origin())
result = fmu_export.__file__
"""

# Changes what the unit does without a word of its text, so that it holds whatever the text is.
LOUDER = """

def _louder(outputs):
    return lambda self: (outputs(self)[0] + 0.125, *outputs(self)[1:])

IhcControllerUnit.outputs = _louder(IhcControllerUnit.outputs)
"""

MEASURED = {"theta": 0.2, "delta": 0.1, "theta_dot": 0.0, "delta_dot": 0.0, "theta_setpoint": 0.1}


def contents(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def guid(path):
    return read_model_description(str(path)).guid


def python_modules(path):
    """Every bundled Python file below resources: path as parts without the suffix -> source."""
    return {
        tuple(name.removesuffix(".py").split("/")[1:]): text.decode()
        for name, text in contents(path).items()
        if name.endswith(".py")
    }


@pytest.fixture(scope="module")
def louder_controller(tmp_path_factory, run_python, start):
    """The controller exported from a changed copy of the source."""
    folder = tmp_path_factory.mktemp("louder")
    shutil.copytree(SRC, folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
    with (folder / "src/ihc_fmu/pendulum/unit.py").open("a") as file:
        file.write(LOUDER)
    request = {"to": str(folder), "start": start}
    used = run_python(EXPORT, request, environment={"PYTHONPATH": str(folder / "src")})
    assert Path(used).is_relative_to(folder)
    return folder / "IhcController.fmu"


# Reproducible


def test_second_export_is_the_same_byte_for_byte(name, slaves, start, fmus, tmp_path):
    again = export_python_fmu(slaves[name], tmp_path / "again.fmu", start[name], origin=origin())
    assert again.read_bytes() == fmus[name].read_bytes()


def test_export_in_another_process_hash_order_and_folder_is_the_same(run_python, fmus, start, tmp_path):
    request = {"to": str(tmp_path), "start": start}
    run_python(EXPORT, request, environment={"PYTHONHASHSEED": "4711", "TZ": "Asia/Tokyo"}, cwd="/")
    for name, path in fmus.items():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), name


def test_guid_follows_start_values_and_notes(slaves, fmus, tmp_path):
    slave = slaves["QubeServo2"]
    changes = [{"theta_0": math.nextafter(0.0, 1.0)}, {"back_emf": False}, {"noise_seed": 2}]
    paths = [export_python_fmu(slave, tmp_path / f"{i}.fmu", change) for i, change in enumerate(changes)]
    paths.append(export_python_fmu(slave, tmp_path / "notes.fmu", notes="<p>other</p>"))
    assert len({guid(path) for path in [*paths, fmus["QubeServo2"]]}) == 5


def test_guid_and_package_name_follow_the_code(louder_controller, fmus):
    original = fmus["IhcController"]
    assert guid(louder_controller) != guid(original)
    names = [contents(path)["resources/slavemodule.txt"] for path in (louder_controller, original)]
    assert names[0] != names[1]


# Self-contained


def test_file_holds_what_fmi_wants_with_no_time_stamps(name, fmus):
    with zipfile.ZipFile(fmus[name]) as archive:
        names = archive.namelist()
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert archive.testzip() is None
    assert names[0] == "modelDescription.xml"
    assert len(set(names)) == len(names)
    expected = {f"binaries/linux64/{name}.so", f"binaries/win64/{name}.dll", "documentation/licenses/PythonFMU.txt"}
    assert expected <= set(names)


def test_bundle_holds_the_units_own_packages_and_the_shared_ones_only(name, fmus, slaves):
    modules = [parts for parts in python_modules(fmus[name]) if len(parts) > 1]
    (bundle,) = {parts[0] for parts in modules}
    assert bundle.startswith(f"{name}_")
    packages = {parts[1] for parts in modules if len(parts) > 2}
    assert packages == {UNIT_PACKAGES[name], *slaves[name].packages, "fmu_export", "pythonfmu"}
    assert {parts[2] for parts in modules if parts[1] == "fmu_export"} == {
        "__init__",
        "errors",
        "guarded_slave",
        "manifest",
        "shown",
        "variables",
    }
    offline = {"design", "certificate", "start_values", "sliding_mode", "linearization"}
    assert {parts[2] for parts in modules if len(parts) > 2} & offline == set()


def test_bundled_modules_import_each_other_and_the_standard_library_only(name, fmus):
    modules = python_modules(fmus[name])
    (script,) = (parts for parts in modules if len(parts) == 1)
    for parts, source in modules.items():
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                assert {alias.name.split(".")[0] for alias in node.names} <= sys.stdlib_module_names, parts
            elif isinstance(node, ast.ImportFrom):
                target = tuple(filter(None, (node.module or "").split(".")))
                if node.level:
                    base = parts[: -node.level]
                    candidates = [base + target, *[base + target + (alias.name,) for alias in node.names]]
                    assert base, parts
                    assert any(candidate in modules for candidate in candidates), (parts, ast.unparse(node))
                elif parts == script:
                    assert target in modules, ast.unparse(node)
                else:
                    assert target[0] in sys.stdlib_module_names, (parts, ast.unparse(node))


HOST_WITHOUT_PACKAGES = """
import ctypes
from ctypes import CFUNCTYPE, POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path

class Callbacks(ctypes.Structure):
    _fields_ = [
        ("logger", CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)),
        ("allocate", CFUNCTYPE(c_void_p, c_size_t, c_size_t)),
        ("free", CFUNCTYPE(None, c_void_p)),
        ("finished", c_void_p),
        ("environment", c_void_p),
    ]

messages = []
logger = Callbacks._fields_[0][1](lambda _e, _n, status, category, message: messages.append(message.decode()))
callbacks = Callbacks(logger)
folder = Path(data["folder"])
fmu = ctypes.CDLL(str(folder / f"binaries/linux64/{data['name']}.so"))
fmu.fmi2Instantiate.restype = c_void_p
location = (folder / "resources").as_uri().encode()
slave = c_void_p(fmu.fmi2Instantiate(b"alone", 1, b"", location, byref(callbacks), 0, 1))
assert slave, messages
assert fmu.fmi2SetupExperiment(slave, 0, c_double(0), c_double(0), 0, c_double(0)) == 0, messages
assert fmu.fmi2EnterInitializationMode(slave) == 0, messages
assert fmu.fmi2ExitInitializationMode(slave) == 0, messages
inputs, outputs = data["inputs"], data["outputs"]
set_vrs, get_vrs = (c_uint * len(inputs))(*inputs), (c_uint * len(outputs))(*outputs)
values, rows = (c_double * len(outputs))(), []
for k, row in enumerate(data["rows"]):
    assert fmu.fmi2SetReal(slave, set_vrs, c_size_t(len(inputs)), (c_double * len(inputs))(*row)) == 0, messages
    assert fmu.fmi2DoStep(slave, c_double(k * 1e-3), c_double(1e-3), 1) == 0, messages
    assert fmu.fmi2GetReal(slave, get_vrs, c_size_t(len(outputs)), values) == 0, messages
    rows.append(list(values))
fmu.fmi2Terminate(slave)
fmu.fmi2FreeInstance(slave)
own = sorted({module.split(".")[0] for module in sys.modules} - sys.stdlib_module_names - {"__main__"})
files = [m.__file__ for n, m in sys.modules.items() if n.split(".")[0] in own and getattr(m, "__file__", None)]
result = {"rows": rows, "own": own, "files": files}
"""


@pytest.mark.skipif(sys.platform != "linux", reason="loads the linux64 binary by its path")
def test_file_runs_in_an_interpreter_that_has_the_standard_library_only(name, fmus, slaves, unit, run_python, tmp_path):
    folder = str(extract(str(fmus[name]), str(tmp_path)))
    interface = slaves[name].interface
    reference = interface.variables.index
    inputs = [reference(v) for v in interface.of("input")]
    reals = [(i, reference(v)) for i, v in enumerate(interface.of("output")) if v.type == "Real"]
    rows = [[0.01 * math.sin(0.1 * k + i) for i in range(len(inputs))] for k in range(20)]
    request = {"folder": folder, "name": name, "rows": rows, "inputs": inputs, "outputs": [vr for _, vr in reals]}
    result = run_python(HOST_WITHOUT_PACKAGES, request, options=("-I", "-S"))
    library = unit(name)
    library.initialize(0.0, tuple(0.0 for _ in inputs))
    for k, row in enumerate(rows):
        library.step(k * 1e-3, 1e-3, tuple(row))
        assert result["rows"][k] == [library.outputs()[i] for i, _ in reals]
    script = (Path(folder) / "resources/slavemodule.txt").read_text()
    assert set(result["own"]) == {script, f"{script}_code"}
    assert [file for file in result["files"] if not Path(file).is_relative_to(folder)] == []


def test_paths_with_spaces_work(name, slaves, start, unit, host, tmp_path):
    path = export_python_fmu(slaves[name], tmp_path / "my own folder" / "the unit.fmu", start[name])
    instance = host(extract(str(path), str(tmp_path / "unpacked right here")))
    assert instance.initialize().outputs() == unit(name).outputs()


# Refusals


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("QubeServo2", {"thetta_0": 0.0}, "no parameter or input named 'thetta_0'; did you mean theta_0"),
        ("QubeServo2", {"theta": 0.0}, "no parameter or input named 'theta'"),
        ("QubeServo2", {"solver_step": 1.0}, "solver_step must lie in .* s, found 1.0"),
        ("QubeServo2", {"voltage": math.nan}, "voltage must be finite, found nan"),
        ("QubeServo2", {"m_p": 0.0}, r"m_p must lie in \[1e-12, 1e\+12\] kg, found 0.0"),
        ("IhcController", {"a_min": 2.0, "b_max": 1.5}, "a_min must not exceed b_max, found a_min = 2"),
        ("IhcController", {"capture_angle": 1.0}, "capture_angle must not exceed fall_back_angle, found 1 and 0.8"),
        ("IhcController", {"law": "PID"}, f"law must be one of {', '.join(LAWS)}, found 'PID'"),
    ],
)
def test_refused_start_values_leave_an_earlier_file_alone(name, changes, message, slaves, start, tmp_path):
    path = tmp_path / "unit.fmu"
    path.write_bytes(b"an earlier file")
    with pytest.raises(ValueError, match=message):
        export_python_fmu(slaves[name], path, {**start[name], **changes})
    assert path.read_bytes() == b"an earlier file"
    assert list(tmp_path.iterdir()) == [path]


def test_interrupted_export_leaves_an_earlier_file_alone(slaves, tmp_path, monkeypatch):
    path = tmp_path / "unit.fmu"
    export_python_fmu(slaves["QubeServo2"], path)
    earlier = path.read_bytes()
    written = []

    def write_three(archive, entry, data, *_):
        written.append(entry)
        if len(written) > 3:
            raise OSError("disk full")

    monkeypatch.setattr(zipfile.ZipFile, "writestr", write_three)
    with pytest.raises(UserError, match=r"unit\.fmu cannot be written: disk full"):
        export_python_fmu(slaves["QubeServo2"], path, {"delta_0": 0.1})
    assert len(written) > 3
    assert path.read_bytes() == earlier
    assert list(tmp_path.iterdir()) == [path]


SLAVE = "from fmu_export.guarded_slave import GuardedSlave\nfrom {package} import unit\n"


@pytest.mark.parametrize(
    ("unit_source", "message"),
    [
        ("import numpy as np\n", "imports numpy: .* standard library only"),
        ("def f():\n    from numpy.linalg import norm\n    return norm\n", "imports numpy.linalg"),
        ("from .gains import K\n", r"gains imports scipy\.linalg"),
        ("from plant_fmu.dynamics import energy\n", "imports plant_fmu.dynamics"),
        ("from .missing import K\n", "missing cannot be found"),
    ],
    ids=["numpy", "inside a function", "by another module", "other unit", "missing"],
)
def test_code_that_needs_more_than_the_standard_library_is_refused(
    unit_source, message, slaves, tmp_path, monkeypatch, request
):
    package = "heavy_" + "".join(filter(str.isalpha, request.node.callspec.id))
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").touch()
    (tmp_path / package / "gains.py").write_text("import scipy.linalg\n")
    (tmp_path / package / "unit.py").write_text(unit_source)
    (tmp_path / package / "slave.py").write_text("from .unit import f\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    heavy = type("Heavy", (slaves["QubeServo2"],), {"__module__": f"{package}.slave"})
    with pytest.raises(ImportError, match=message):
        export_python_fmu(heavy, tmp_path / "heavy.fmu")
    assert not (tmp_path / "heavy.fmu").exists()


# Whose code runs

SEVERAL_IN_ONE_PROCESS = """
import ihc_fmu.pendulum.unit, plant_fmu.unit, fmu_export.guarded_slave
from conftest import Host
from ihc_fmu.pendulum.interface import INTERFACE
from ihc_fmu.pendulum.unit import IhcControllerUnit
from plant_fmu.interface import INTERFACE as PLANT
from plant_fmu.unit import QubePlant

hosts = {key: Host(folder).initialize() for key, folder in data["folders"].items()}
library = IhcControllerUnit(INTERFACE.start_values(data["start"]))
library.initialize(0.0, (0.0, 0.0, 0.0, 0.0, 0.0))
plant = QubePlant(PLANT.start_values())
result = []
for k in range(20):
    t = k * 1e-3
    library.step(t, 1e-3, tuple(data["measured"].values()))
    plant.step(t, 1e-3, (1.0, 0.0, 0.0))
    rows = {"library": library.outputs(), "library plant": plant.outputs()}
    for key in ("louder", "controller"):
        rows[key] = hosts[key].step(t, 1e-3, **data["measured"])
    rows["plant"] = hosts["plant"].step(t, 1e-3, voltage=1.0)
    result.append({key: list(row) for key, row in rows.items()})
for host in hosts.values():
    host.slave.terminate()
    host.slave.freeInstance()
"""


def test_host_and_three_fmus_in_one_process_run_their_own_code_each(
    folders, louder_controller, start, run_python, tmp_path
):
    paths = {"controller": folders["IhcController"], "plant": folders["QubeServo2"]}
    paths["louder"] = extract(str(louder_controller), str(tmp_path))
    request = {
        "folders": {key: str(path) for key, path in paths.items()},
        "start": start["IhcController"],
        "measured": MEASURED,
    }
    rows = run_python(SEVERAL_IN_ONE_PROCESS, request)
    assert any(row["library"][0] != 0.0 for row in rows)
    for row in rows:
        assert row["controller"] == row["library"]
        assert row["louder"] == [row["library"][0] + 0.125, *row["library"][1:]]
        assert row["plant"] == row["library plant"]


def test_modules_of_the_host_with_the_same_names_are_not_touched(folders, unit, run_python):
    script = """
import types
names = ("plant_fmu", "ihc_fmu", "fmu_export", "pythonfmu", "unit", "slave", "interface", "variables", "dynamics")
strangers = {name: types.ModuleType(name) for name in names}
from conftest import Host
sys.modules.update(strangers)
result = [list(Host(folder).initialize().outputs()) for folder in data]
assert all(sys.modules[name] is module for name, module in strangers.items())
"""
    result = run_python(script, [str(folders[name]) for name in UNIT_PACKAGES])
    assert result == [list(unit(name).outputs()) for name in UNIT_PACKAGES]


def test_same_code_with_other_start_values_keeps_its_own(host, slaves, tmp_path):
    tilted = export_python_fmu(slaves["QubeServo2"], tmp_path / "tilted.fmu", {"theta_0": 0.5})
    folder = extract(str(tilted), str(tmp_path / "tilted"))
    instances = [host(which) for which in ("QubeServo2", folder, "QubeServo2")]
    assert [instance.initialize().get("theta")[0] for instance in instances] == [0.0, 0.5, 0.0]


TAMPERED = """
import shutil
from pathlib import Path
from conftest import Host
original = Host(data["folder"]).initialize() if data["beside_original"] else None
before = original and original.outputs()
result = []
for number, file in enumerate(data["files"]):
    copy = Path(data["to"]) / str(number)
    shutil.copytree(data["folder"], copy, ignore=shutil.ignore_patterns("__pycache__"))
    with (copy / file).open("a") as text:
        text.write(data["text"])
    refused = Host.__new__(Host)
    try:
        refused.__init__(copy)
    except Exception:
        result.append(" ".join(message for _, _, message in refused.log))
    else:
        result.append("")
if original:
    assert original.outputs() == before
    original.slave.freeInstance()
"""


@pytest.mark.parametrize("beside_original", [False, True])
def test_file_changed_after_export_is_refused_at_instantiation(name, beside_original, folders, run_python, tmp_path):
    package = next(folders[name].glob("resources/*_code"))
    files = sorted(file for file in package.rglob("*.py") if file.name in ("unit.py", "variables.py", "fmi2slave.py"))
    assert len({file.name for file in files}) == 3
    request = {
        "folder": str(folders[name]),
        "to": str(tmp_path),
        "files": [str(file.relative_to(folders[name])) for file in files],
        "text": "\n# harmless\n",
        "beside_original": beside_original,
    }
    for message in run_python(TAMPERED, request):
        assert f"the code in {package.name} is not the code that was exported" in message


def test_script_that_runs_the_hosts_code_is_refused(name, folders, run_python, tmp_path):
    (script,) = folders[name].glob("resources/*.py")
    request = {
        "folder": str(folders[name]),
        "to": str(tmp_path),
        "files": [str(script.relative_to(folders[name]))],
        "text": f"\nfrom {SLAVE_MODULES[name]} import {name}\n",
        "beside_original": False,
    }
    (message,) = run_python(TAMPERED, request)
    assert f"but Python runs {UNIT_PACKAGES[name]}" in message


# The command line of FMPy


def fmpy_command(*arguments, start=("-m", "fmpy")):
    command = [sys.executable, *start, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_fmpy_validate_finds_no_problems(name, fmus):
    assert fmpy_command("validate", fmus[name]).strip() == "No problems found."


def test_fmpy_info_shows_name_and_platforms(name, fmus):
    shown = fmpy_command("info", fmus[name])
    assert name in shown
    assert "linux64" in shown


def test_fmpy_simulate_starts_with_the_row_at_zero(name, fmus, slaves, unit, tmp_path):
    table = tmp_path / "result.csv"
    fmpy_command("simulate", fmus[name], "--output-file", table)
    with table.open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    interface = slaves[name].interface
    outputs = dict(zip([v.name for v in interface.calculated], unit(name).outputs(), strict=True))
    recorded = [v.name for v in interface.of("output")]
    assert rows[0] == {"time": 0.0, **{name: outputs[name] for name in recorded}}
    assert len(rows) == 1 + round(interface.stop_time / interface.step_size)
    assert rows[-1]["time"] == pytest.approx(interface.stop_time)


def test_manifest_names_the_package_and_the_start_values(name, fmus, start):
    manifest = json.loads(contents(fmus[name])["resources/manifest.json"])
    assert manifest["start_values"] == start[name]
