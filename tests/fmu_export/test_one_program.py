"""The sources inside both FMUs as parts of one program, compiled by several C compilers for targets of several kinds."""

import shutil
import subprocess
from pathlib import Path

import pytest

from fmu_export.native_unit import ADAPTER

PLANT, CONTROLLER = "QubeServo2", "IhcController"
PREFIXES = {PLANT: ("QubeServo2_", "qube_"), CONTROLLER: ("IhcController_", "ihc_")}
PROGRAM = Path(__file__).parent / "native" / "both.c"
STEPS = 400
STRICT = ["-std=c99", "-O2", "-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
COMPILERS = {
    "gcc": ["gcc", *STRICT],
    "tcc": ["tcc", "-std=c99", "-Wall", "-Werror"],
    "32 bits": ["gcc", *STRICT, "-m32", "-msse2", "-mfpmath=sse"],
    "big-endian": ["s390x-linux-gnu-gcc", *STRICT, "-static"],
}
RUNNERS = {"big-endian": ["qemu-s390x"]}


def command(*parts, cwd):
    done = subprocess.run([*map(str, parts)], cwd=cwd, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def links(compiler, folder):
    (folder / "trial.c").write_text("int main(void) { return 0; }\n")
    arguments = [*compiler, "trial.c", "-o", "trial"]
    return subprocess.run(arguments, cwd=folder, capture_output=True, check=False).returncode == 0


def need(*programs):
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"the sources were not tried this way: {program} is not on the PATH")


@pytest.fixture(scope="module")
def expected(native_folders):
    """Where the loop of both binaries ends, and the arguments under which the program must end there."""
    from tests.fmu_export.conftest import Native

    plant, controller = (Native(native_folders[name]) for name in (PLANT, CONTROLLER))
    plant.initialize(delta_0=0.1)
    controller.initialize()
    voltage = 0.0
    for k in range(STEPS):
        theta, delta = plant.get("theta_encoder", "delta_encoder")
        controller.step(k * 1e-3, 1e-3, theta=theta, delta=delta)
        (voltage,) = controller.get("voltage")
        plant.step(k * 1e-3, 1e-3, voltage=voltage)
    end = (*plant.get("theta_encoder", "delta_encoder"), voltage)
    numbers = [plant.reference(name) for name in ("delta_0", "theta_encoder", "delta_encoder")]
    assert controller.reference("voltage") == 4
    arguments = [plant.description.guid, controller.description.guid, *numbers, STEPS]
    plant.free()
    controller.free()
    return end, arguments


def compiled(compiler, native_folders, folder, *options):
    """Compile the sources of both FMUs; return their objects by unit."""
    objects = {}
    for name in (PLANT, CONTROLLER):
        target = folder / name
        target.mkdir()
        sources = sorted((native_folders[name] / "sources").glob("*.c"))
        for source in sources:
            command(
                *compiler, *options, "-c", source, "-I", ADAPTER / "fmi2", "-o", target / f"{source.stem}.o", cwd=target
            )
        objects[name] = sorted(target.glob("*.o"))
    return objects


def ends(program, arguments, *runner):
    return tuple(map(float, command(*runner, program, *arguments, cwd=program.parent).split()))


@pytest.mark.parametrize("which", COMPILERS)
def test_both_units_are_parts_of_one_program(which, native_folders, expected, tmp_path):
    compiler, runner = COMPILERS[which], RUNNERS.get(which, [])
    need(compiler[0], *runner)
    if "-m32" in compiler and not links(compiler, tmp_path):
        pytest.skip("the sources were not tried with 32 bits: gcc has no libraries for them (gcc-multilib)")
    objects = compiled(compiler, native_folders, tmp_path)
    program = tmp_path / "both"
    parts = [*objects[PLANT], *objects[CONTROLLER]]
    command(*compiler, PROGRAM, *parts, "-I", ADAPTER / "fmi2", "-o", program, "-lm", cwd=tmp_path)
    end, arguments = expected
    assert ends(program, arguments, *runner) == pytest.approx(end, rel=1e-9, abs=1e-12)


def test_both_units_are_static_libraries_of_one_program(native_folders, expected, tmp_path):
    need("gcc", "ar", "nm")
    libraries = []
    for name, objects in compiled(COMPILERS["gcc"], native_folders, tmp_path).items():
        libraries.append(tmp_path / f"lib{name}.a")
        command("ar", "rcs", libraries[-1], *objects, cwd=tmp_path)
        symbols = command("nm", "-g", "--defined-only", libraries[-1], cwd=tmp_path)
        names = [line.split()[2] for line in symbols.splitlines() if len(line.split()) == 3]
        assert len(names) > 60
        assert [symbol for symbol in names if not symbol.startswith(PREFIXES[name])] == []
    program = tmp_path / "both"
    command(*COMPILERS["gcc"], PROGRAM, *libraries, "-I", ADAPTER / "fmi2", "-o", program, "-lm", cwd=tmp_path)
    end, arguments = expected
    assert ends(program, arguments) == end


GLOBAL = """
import ctypes
from conftest import Native

made = []
for folder, library in data["units"]:
    instance = Native(folder, library=library, mode=ctypes.RTLD_GLOBAL)
    made.append(instance.component and instance.initialize().step(0.0, 1e-3))
result = made
"""


def test_rebuilt_libraries_keep_their_symbols_to_themselves(
    native_folders, native, native_units, start, run_python, tmp_path
):
    """Rebuilt with default visibility and loaded for all to see, also beside the same unit with another design."""
    from fmpy import extract

    from fmu_export.native_fmu import export_native_fmu

    need("gcc")
    other = export_native_fmu(native_units[PLANT], tmp_path / "other.fmu", {**start[PLANT], "delta_0": 0.5})
    folders = [native_folders[PLANT], native_folders[CONTROLLER], Path(extract(str(other), str(tmp_path / "other")))]
    units = []
    for number, folder in enumerate(folders):
        library = tmp_path / f"unit{number}.so"
        sources = sorted((folder / "sources").glob("*.c"))
        options = [
            "-DFMI2_OVERRIDE_FUNCTION_PREFIX",
            "-fPIC",
            "-shared",
            "-fvisibility=default",
            "-I",
            ADAPTER / "fmi2",
        ]
        command(*COMPILERS["gcc"], *options, *sources, "-o", library, "-lm", cwd=tmp_path)
        units.append((str(folder), str(library)))
    result = run_python(GLOBAL, {"units": units})
    assert [tuple(row) for row in result] == [native(folder).initialize().step(0.0, 1e-3) for folder in folders]
