"""A plain C host, which has no Python in it, runs the native FMUs as FMPy does; under wine those for Windows too."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from fmpy import extract, instantiate_fmu, read_model_description

from make_dist import ROOT, build, unpacked

PLANT, CONTROLLER = "QubeServo2", "IhcController"
KINDS = [(PLANT, "cs"), (PLANT, "me"), (CONTROLLER, "cs")]
PROGRAM = Path(__file__).parent / "native" / "host.c"
STEP, STEPS, PRINT_EVERY = 1e-3, 1000, 100

LOOP = rb"""
#include <stdio.h>
#include <windows.h>
#include "loop.h"

int main(int count, char **arguments)
{
    double times[10];
    loop_run run = {.step = 0.5, .steps = 10, .every = 1, .times = times};
    int (*advance)(loop_run *, int64_t, double);
    (void)count;
    *(FARPROC *)&advance = GetProcAddress(LoadLibraryA(arguments[1]), "loop_advance");
    printf("%d %d %g\nno Python\n", advance(&run, 10, 60.0), (int)run.recorded, times[9]);
    return 0;
}
"""
"""Runs the master's loop, given by its path, for ten steps of no FMUs; prints its result, the rows, the last time."""

FLAGS = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]


def compile_host(target, *options, program=PROGRAM, headers=ROOT / "src" / "fmu_export" / "adapter" / "fmi2"):
    command = [sys.executable, "-m", "ziglang", "cc", *options, *FLAGS, "-isystem", headers, program, "-o", target]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return target


@pytest.fixture(scope="module")
def plain_host(tmp_path_factory):
    if sys.platform != "linux":
        pytest.skip("the plain host was not tried: it looks for Python as Linux shows it")
    return compile_host(tmp_path_factory.mktemp("plain host") / "host", "-ldl")


class Interface:
    """What a host has to know of an unpacked FMU."""

    def __init__(self, folder) -> None:
        self.folder = Path(folder)
        self.description = read_model_description(str(folder))
        variables = self.description.modelVariables
        self.inputs = [v.valueReference for v in variables if v.causality == "input"]
        calculated = [v for v in variables if v.causality in ("output", "local") and v.type == "Real"]
        self.outputs = [v.valueReference for v in calculated]
        (self.binary,) = self.folder.glob("binaries/*/*.*")

    def arguments(self, kind):
        counts = [self.description.numberOfContinuousStates, len(self.inputs), *self.inputs, *self.outputs]
        return [self.description.guid, kind, *map(str, counts)]


def run_host(command, environment=None):
    """Rows of outputs that the host prints, and what it says of Python."""
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    *rows, python = done.stdout.splitlines()
    return [[float(number) for number in row.split()] for row in rows], python


def input_at(k, i):
    return ((k // 10 * 7 + i * 3) % 11 - 5) * 0.03125 / (1024.0 if i == 2 else 1.0)


def expected_rows(interface, kind):
    """The same run through FMPy."""
    fmi_type = {"cs": "CoSimulation", "me": "ModelExchange"}[kind]
    unit: Any = instantiate_fmu(str(interface.folder), interface.description, fmi_type=fmi_type)
    unit.setupExperiment(startTime=0.0)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    if kind == "me":
        unit.enterContinuousTimeMode()
    rows = []
    for k in range(STEPS):
        unit.setReal(interface.inputs, [input_at(k, i) for i in range(len(interface.inputs))])
        if kind == "me":
            integrate(unit, k * STEP, interface.description.numberOfContinuousStates)
        else:
            unit.doStep(k * STEP, STEP)
        if (k + 1) % PRINT_EVERY == 0:
            rows.append(unit.getReal(interface.outputs))
    unit.freeInstance()
    return rows


def integrate(unit, time, count):
    from ctypes import c_double

    x, rate = (c_double * count)(), (c_double * count)()
    unit.setTime(time)
    unit.getContinuousStates(x, count)
    unit.getDerivatives(rate, count)
    for i in range(count):
        x[i] += STEP * rate[i]
    unit.setContinuousStates(x, count)


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_plain_host_gives_the_numbers_of_fmpy_to_the_last_digit(name, kind, plain_host, native_folders):
    interface = Interface(native_folders[name])
    location = (interface.folder / "resources").as_uri()
    rows, _ = run_host([plain_host, interface.binary, location, *interface.arguments(kind)])
    assert len(rows) == STEPS / PRINT_EVERY
    assert rows == expected_rows(interface, kind)


def test_no_python_is_loaded(name, plain_host, native_folders):
    interface = Interface(native_folders[name])
    location = (interface.folder / "resources").as_uri()
    _, python = run_host([plain_host, interface.binary, location, *interface.arguments("cs")])
    assert python == "python: none"


def test_folder_with_spaces(name, plain_host, native_fmus, native_folders, tmp_path):
    folder = extract(str(native_fmus[name]), str(tmp_path / "a folder with spaces"))
    interface = Interface(folder)
    location = (Path(folder) / "resources").as_uri()
    assert "%20" in location
    rows, _ = run_host([plain_host, interface.binary, location, *interface.arguments("cs")])
    assert rows == expected_rows(Interface(native_folders[name]), "cs")


def test_host_cannot_be_fooled(plain_host, native_folders):
    """A host that is given a wrong folder or GUID ends with an error: the comparisons above can fail."""
    interface = Interface(native_folders[PLANT])
    good = [plain_host, interface.binary, (interface.folder / "resources").as_uri(), *interface.arguments("cs")]
    for place, wrong in ((2, "file:///nowhere"), (3, "{}")):
        done = subprocess.run([*good[:place], wrong, *good[place + 1 :]], capture_output=True, text=True, check=False)
        assert done.returncode == 1


# Windows, by way of wine

WINE = shutil.which("wine") or shutil.which("wine64")


@pytest.fixture(scope="module")
def wine(tmp_path_factory):
    """Run a Windows program in a wine of its own."""
    if WINE is None:
        pytest.skip("the win64 binaries were not run: that needs wine on the PATH, for example apt-get install wine")
    prefix = tmp_path_factory.mktemp("wine")
    own = {"WINEPREFIX": str(prefix), "TMPDIR": str(prefix), "WINEDEBUG": "-all", "WINEDLLOVERRIDES": "mscoree,mshtml="}
    environment = {**os.environ, **own}
    yield lambda *command: run_host([WINE, *command], environment)
    server = shutil.which("wineserver")
    if server is not None:
        subprocess.run([server, "-k"], env=environment, check=False)


@pytest.fixture(scope="module")
def windows_host(tmp_path_factory, wine):
    return compile_host(tmp_path_factory.mktemp("windows host") / "host.exe", "-target", "x86_64-windows-gnu")


def on_windows(path):
    return f"Z:{path}".replace("/", "\\")


@pytest.fixture(scope="module")
def windows_interface(tmp_path_factory, wine, native_units, start):
    """Export and unpack a win64 FMU, once."""
    from fmu_export.native_fmu import export_native_fmu

    made = {}

    def make(name):
        if name not in made:
            folder = tmp_path_factory.mktemp(name)
            path = export_native_fmu(native_units[name], folder / f"{name}.fmu", start[name], platforms=["win64"])
            made[name] = Interface(extract(str(path), str(folder / "un packed")))
        return made[name]

    return make


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_windows_binary_gives_the_same_numbers(name, kind, wine, windows_host, windows_interface, native_folders):
    interface = windows_interface(name)
    location = "file:///Z:" + (interface.folder / "resources").as_uri().removeprefix("file://")
    assert "%20" in location
    rows, _ = wine(windows_host, on_windows(interface.binary), location, *interface.arguments(kind))
    expected = expected_rows(Interface(native_folders[name]), kind)
    assert len(rows) == len(expected)
    for row, other in zip(rows, expected, strict=True):
        assert row == pytest.approx(other, rel=1e-12, abs=1e-12)


def test_windows_binary_finds_its_resources_in_any_folder(wine, windows_host, windows_interface):
    interface = windows_interface(CONTROLLER)
    folder = interface.folder.parent / "Grüße, 世界"
    shutil.copytree(interface.folder / "resources", folder)
    uri = folder.as_uri().removeprefix("file://")
    expected = None
    for location in (f"file:///Z:{uri}", f"file:/Z:{uri}/", on_windows(interface.folder / "resources")):
        rows = wine(windows_host, on_windows(interface.binary), location, *interface.arguments("cs"))
        expected = expected or rows
        assert rows == expected


@pytest.fixture(scope="module")
def windows_wheel(tmp_path_factory, wine):
    """Build and unpack the wheel for Windows."""
    folder = tmp_path_factory.mktemp("windows wheel")
    with (
        unpacked(build(ROOT, "sdist", folder)) as source,
        zipfile.ZipFile(build(source, "wheel", folder, "win64")) as wheel,
    ):
        wheel.extractall(folder)
    return folder


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_binary_of_the_windows_wheel_gives_the_same_numbers(
    name, kind, wine, windows_host, windows_wheel, windows_interface, native_folders
):
    interface, binary = windows_interface(name), windows_wheel / "fmu_export" / "binaries" / "win64" / f"{name}.dll"
    location = "file:///Z:" + (interface.folder / "resources").as_uri().removeprefix("file://")
    rows, _ = wine(windows_host, on_windows(binary), location, *interface.arguments(kind))
    expected = expected_rows(Interface(native_folders[name]), kind)
    assert rows == [pytest.approx(row, rel=1e-12, abs=1e-12) for row in expected]


def test_loop_of_the_windows_wheel_steps(wine, windows_wheel, tmp_path):
    (tmp_path / "loop.c").write_bytes(LOOP)
    options = {"program": tmp_path / "loop.c", "headers": ROOT / "cosim" / "native"}
    program = compile_host(tmp_path / "loop.exe", "-target", "x86_64-windows-gnu", **options)
    rows, _ = wine(program, on_windows(windows_wheel / "cosim" / "binaries" / "win64" / "loop.dll"))
    assert rows == [[0, 10, 5.0]]
