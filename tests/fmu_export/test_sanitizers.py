"""The native sources under the address and undefined behaviour sanitizers of the system's C compiler."""

import os
import random
import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from fmu_export.native_unit import unit_files

PLANT, CONTROLLER = "QubeServo2", "IhcController"
PROGRAMS = Path(__file__).parent / "native"

COMPILER = shutil.which("gcc") or shutil.which("clang")
FLAGS = [
    "-DFMI2_OVERRIDE_FUNCTION_PREFIX",
    "-std=c99",
    "-O1",
    "-g",
    "-fPIC",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-ffp-contract=off",
]
SANITIZERS = ["-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
ENVIRONMENT = {**os.environ, "ASAN_OPTIONS": "detect_leaks=1", "UBSAN_OPTIONS": "print_stacktrace=1"}

FAULTS = {
    "heap-buffer-overflow": "char *p = malloc(4); memset(p, 1, 4 + (size_t)count); free(p); return 0;",
    "signed integer overflow": "return 2147483647 + count;",
    "outside the range of representable values": "double x = 1e300 * count; return (int)x;",
    "detected memory leaks": "return malloc((unsigned)count) == NULL;",
}


def compile_c(folder, target, *sources, options=()):
    """Compile in `folder`, with sanitizers, unless that is done; returns the target."""
    if (folder / target).exists():
        return folder / target
    command = [str(COMPILER), *FLAGS, *SANITIZERS, *options, "-isystem", ".", *map(str, sources), "-o", target]
    done = subprocess.run([*command, "-lm", "-ldl"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / target


def run_clean(*command):
    """Run a program that must find nothing; returns what it prints."""
    done = subprocess.run(
        [*map(str, command)], capture_output=True, text=True, env=ENVIRONMENT, check=False, timeout=120
    )
    assert done.returncode == 0, f"exit code {done.returncode}\n{done.stderr[-5000:]}"
    return done.stdout


@pytest.fixture(scope="module", autouse=True)
def _sanitizers(tmp_path_factory):
    if COMPILER is None:
        pytest.skip("the native sources were not run under sanitizers: that needs gcc or clang on the PATH")
    folder = tmp_path_factory.mktemp("trial")
    (folder / "trial.c").write_text("int main(void) { return 0; }\n")
    command = [COMPILER, *SANITIZERS, "trial.c", "-o", "trial"]
    for attempt in (command, [str(folder / "trial")]):
        done = subprocess.run(attempt, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"the native sources were not run under sanitizers: {attempt[0]} says {done.stderr.strip()}")


@pytest.mark.parametrize("fault", FAULTS)
def test_sanitizers_find_faults_here(fault, tmp_path):
    program = (
        "#include <stdlib.h>\n#include <string.h>\nint main(int count, char **a) { (void)a; " + FAULTS[fault] + " }\n"
    )
    (tmp_path / "fault.c").write_text(program)
    faulty = compile_c(tmp_path, "fault", "fault.c", options=["-O0"])
    done = subprocess.run([faulty], capture_output=True, text=True, env=ENVIRONMENT, check=False)
    assert done.returncode != 0
    assert fault in done.stderr


@pytest.fixture(scope="module")
def objects(tmp_path_factory, native_units):
    """Compile a unit, once: the folder of its sources and its object files."""
    made = {}

    def make(name):
        if name not in made:
            folder = tmp_path_factory.mktemp(name)
            for file, text in unit_files(native_units[name]).items():
                (folder / file).write_bytes(text)
            sources = sorted(file.name for file in folder.glob("*.c"))
            compiled = [compile_c(folder, f"{source}.o", source, options=["-c"]) for source in sources]
            made[name] = folder, compiled
        return made[name]

    return make


@pytest.fixture
def host_arguments(native, native_folders):
    """What the plain host wants to know of an FMU, behind the path of the binary."""

    def make(name, kind):
        description = native(name).description
        outputs = [v for v in description.modelVariables if v.causality in ("output", "local") and v.type == "Real"]
        inputs = [v.valueReference for v in description.modelVariables if v.causality == "input"]
        location = (native_folders[name] / "resources").as_uri()
        counts = [description.numberOfContinuousStates, len(inputs), *inputs]
        return [location, description.guid, kind, *counts, *(v.valueReference for v in outputs)]

    return make


@pytest.mark.parametrize(("name", "kind"), [(PLANT, "cs"), (PLANT, "me"), (CONTROLLER, "cs")])
def test_host_runs_the_unit_clean(name, kind, objects, host_arguments):
    folder, compiled = objects(name)
    library = compile_c(folder, f"{name}.so", *compiled, options=["-shared"])
    host = compile_c(folder, "host", PROGRAMS / "host.c")
    printed = run_clean(host, library, *host_arguments(name, kind)).splitlines()
    assert len(printed) == 11


def damaged(data, rng):
    """Return start values of which bytes are changed, left out or added, most of them among the names."""
    data = bytearray(data)
    for _ in range(rng.randint(1, 3)):
        at = rng.choice([rng.randrange(len(data)), rng.randrange(len(data) // 2, len(data))])
        new = bytes(rng.choice(b"\0\0\xff\xc3\xe2\xf0\x80a") for _ in range(rng.randint(0, 3)))
        data[at : at + rng.randint(0, 2)] = new
    return bytes(data[: rng.choice([len(data), len(data), rng.randrange(len(data))])])


def test_damaged_start_values_do_no_harm(objects, native_folders, tmp_path):
    folder, _ = objects(PLANT)
    loads = compile_c(folder, "loads", PROGRAMS / "loads.c", "start_values_file.c")
    whole = (native_folders[PLANT] / "resources" / "start_values.bin").read_bytes()
    (count,) = struct.unpack_from("<I", whole, 12)
    rng = random.Random(1)
    files = [whole, *(damaged(whole, rng) for _ in range(400))]
    for i, data in enumerate(files):
        (tmp_path / str(i)).mkdir()
        (tmp_path / str(i) / "start_values.bin").write_bytes(data)
    printed = run_clean(loads, count, *((tmp_path / str(i)).as_uri() for i in range(len(files)))).splitlines()
    names = whole[16 + 64 + 8 * count + 4 :]
    assert printed[0].split()[::2] == ["1", str(len(names) - count)]
    assert {line.split()[0] for line in printed} == {"0", "1"}


@pytest.mark.parametrize(("largest", "manner"), [(1e3, "honest"), (1e300, "honest"), (1e300, "forge")])
def test_random_calls_do_no_harm(name, largest, manner, objects, native, native_folders):
    folder, compiled = objects(name)
    fuzz = compile_c(folder, "fuzz", PROGRAMS / "fuzz.c", *compiled)
    location, guid = (native_folders[name] / "resources").as_uri(), native(name).description.guid
    printed = run_clean(fuzz, location, guid, 1, 200_000, largest, manner)
    good = {call: int(count) for call, count in map(str.split, printed.splitlines())}
    assert good["step"] > 1000
    assert good["bytes"] > 100
    assert good["messages"] > 1000
    assert (good["derivative"] > 10) == (good["continuous_mode"] > 10) == (name == PLANT)
