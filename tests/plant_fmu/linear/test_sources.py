"""The linear plant's C sources: several in one program, no floating-point exceptions, clean under sanitizers."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from fmpy import extract, read_model_description

from fmu_export.native_fmu import export_native_fmu
from fmu_export.native_unit import ADAPTER, unit_files
from fmu_export.shown import Showing
from plant_fmu.linear.interface import INTERFACE
from plant_fmu.linear.native_unit import NATIVE
from plant_fmu.linear.start_values import linear_plant_values, shown_interface
from tests.fmu_export.test_sanitizers import compile_c, run_clean

from .models import CRANE, random_system

PROGRAMS = Path(__file__).parents[2] / "fmu_export" / "native"
STRICT = ["gcc", "-std=c99", "-O2", "-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]

pytestmark = pytest.mark.skipif(
    shutil.which("gcc") is None, reason="the sources were not tried: gcc is not on the PATH"
)


def unpacked(path):
    return Path(extract(str(path), str(path.with_suffix(""))))


def test_two_linear_plants_are_parts_of_one_program(tmp_path):
    """All that the linker sees begins with the FMU's own name."""
    objects = []
    for name in ("crane", "other"):
        shown, hidden = shown_interface(CRANE), linear_plant_values(CRANE)
        path = export_native_fmu(NATIVE, tmp_path / f"{name}.fmu", interface=shown, hidden=hidden, identifier=name)
        for source in sorted((unpacked(path) / "sources").glob("*.c")):
            objects.append(tmp_path / f"{name}_{source.stem}.o")
            subprocess.run([*STRICT, "-c", source, "-I", ADAPTER / "fmi2", "-o", objects[-1]], check=True)
    (tmp_path / "main.c").write_text("int main(void) { return 0; }\n")
    subprocess.run([*STRICT, tmp_path / "main.c", *objects, "-lm", "-o", tmp_path / "program"], check=True)
    table = subprocess.run(["nm", "-g", "--defined-only", *objects], check=True, capture_output=True, text=True).stdout
    symbols = [line.split()[2] for line in table.splitlines() if len(line.split()) == 3]
    assert len(symbols) > 100
    assert [symbol for symbol in symbols if not symbol.startswith(("crane_", "other_"))] == []


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """An FMU that shows all compiled variables, of 16 states, unpacked."""
    system = random_system(15)
    shown = shown_interface(system)
    values = Showing(INTERFACE, shown).compiled_values(shown.start_values(), linear_plant_values(system))
    return unpacked(export_native_fmu(NATIVE, tmp_path_factory.mktemp("large") / "LinearPlant.fmu", values))


@pytest.mark.skipif(sys.platform != "linux", reason="not tried: exceptions are unmasked as glibc does")
def test_no_step_raises_a_floating_point_exception(large, tmp_path):
    """Large inputs that are limited, small ones, and a decay below what is a normal number."""
    program = tmp_path / "exceptions"
    command = ["gcc", "-std=gnu99", "-O1", "-isystem", ADAPTER / "fmi2", PROGRAMS / "exceptions.c", "-o", program]
    subprocess.run([*command, "-ldl", "-lm"], check=True)
    description = read_model_description(str(large))
    references = {v.name: v.valueReference for v in description.modelVariables}
    rows = [[1e100 if j == 0 else 1e-310 for j in range(16)], *[[0.0] * 16] * 200]
    lines = ["case decay", *(f"real {references[f'initial_state_{i}']} 1e-90" for i in range(1, 17))]
    lines += [f"real {references['lower_1']} -1.0", f"real {references['upper_1']} 1.0"]
    lines += ["row " + " ".join(f"{value:.17g}" for value in row) for row in rows]
    (binary,) = large.glob("binaries/*/*.so")
    inputs = [v.valueReference for v in description.modelVariables if v.causality == "input"]
    told = map(str, (references["output_1"], *inputs))
    arguments = [binary, (large / "resources").as_uri(), description.guid, *told]
    done = subprocess.run(
        [program, *arguments], input="\n".join([*lines, "end", ""]), capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout.splitlines()[-1:]) == (0, ["done"]), done.stderr


@pytest.fixture(scope="module")
def fuzz(tmp_path_factory):
    """The program of random calls, under sanitizers."""
    folder = tmp_path_factory.mktemp("fuzz")
    for file, text in unit_files(NATIVE).items():
        (folder / file).write_bytes(text)
    sources = sorted(file.name for file in folder.glob("*.c"))
    try:
        return compile_c(folder, "fuzz", PROGRAMS / "fuzz.c", *sources)
    except AssertionError as error:
        if "sanitize" not in str(error):
            raise
        pytest.skip("the sources were not run under sanitizers: gcc has none")


@pytest.mark.parametrize("largest", [1e3, 1e300])
def test_random_calls_do_no_harm(largest, large, fuzz):
    guid = read_model_description(str(large)).guid
    printed = run_clean(fuzz, (large / "resources").as_uri(), guid, 1, 100_000, largest, "forge")
    good = {call: int(count) for call, count in map(str.split, printed.splitlines())}
    assert good["step"] > 100
    assert good["derivative"] > 10
