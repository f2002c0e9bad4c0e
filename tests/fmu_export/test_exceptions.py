"""No step raises a floating-point exception: in hosts that unmask them, one would end the process."""

import itertools
import math
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fmu_export.conftest import description

PROGRAM = Path(__file__).parent / "native" / "exceptions.c"
PLANT, CONTROLLER = "QubeServo2", "IhcController"

BUILDS = {
    "shipped": None,
    "gcc -O2": ["gcc", "-std=c99", "-O2"],
    "gcc -O3": ["gcc", "-std=c99", "-O3", "-march=native", "-fno-math-errno"],
    "tcc": ["tcc"],
    "zig -O3": [sys.executable, "-m", "ziglang", "cc", "-std=c99", "-O3", "-march=native", "-fno-math-errno"],
}

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() != "x86_64", reason="not tried: exceptions are unmasked as glibc does"
)


def falling_and_rising():
    """From hanging to upright, a tilt that decays to 0 and below what is a normal number, a fall to 1.3 rad, a fault."""
    delta = [math.pi * (1 + math.cos(math.pi * k / 60)) / 2 for k in range(60)]
    tilt = [0.1 * 10.0**-k for k in (*range(0, 330, 3), 400, 400)]
    delta += [*tilt, *tilt[::-1], *(0.02 * k for k in range(65))]
    rows = [(0.1 * d, d, b - d, 1e3 * (b - d), k % 2 * 0.05 * d) for k, (d, b) in enumerate(itertools.pairwise(delta))]
    return [*rows, (math.nan, *[0.0] * 4), (0.0,) * 5]


def cases_of(name):
    """Return {case: (start values, rows of inputs)}."""
    if name == PLANT:
        rows = [(2.0 * math.sin(k), 1e-3 * k, 1e-4) for k in range(60)] + [(0.0, 0.0, 0.0)] * 3 + [(1e-310,) * 3] * 3
        small = {"theta_0": 1e-310, "delta_0": 1e-200, "theta_dot_0": 1e-160, "delta_dot_0": 1e-105}
        changes = [{}, {"encoder_counts": 0, "delta_0": 0.0}, {"encoder_counts": 0, **small}, {"noise_std": 1e-3}]
        changes += [{"measurement_delay": 2e-3}, {"T_r": 1e-3, "voltage_limit": 0.0}]
        return {f"{motor} {c}": ({"motor_model": motor, **c}, rows) for motor in (1, 2) for c in changes}
    choices = itertools.product((1, 2, 3), (1, 2), (1, 2), (1, 2, 3), (1.0, 0.5, 0.0))
    names = ("law", "norm_solver", "discretization", "velocity_source", "mu")
    made = [dict(zip(names, choice, strict=True)) for choice in choices]
    made = [c for c in made if c["law"] == 3 or (c["norm_solver"], c["discretization"], c["mu"]) == (1, 1, 1.0)]
    return {str(c): ({**c, "a_min": 1e-6, "b_max": 2.0}, falling_and_rising()) for c in made}


def script(name, folder):
    """Return the host's standard input."""
    variables = {v.name: v for v in description(str(folder)).modelVariables}
    lines = []
    for case, (changes, rows) in cases_of(name).items():
        lines.append(f"case {case}")
        for changed, value in changes.items():
            kind = "real" if variables[changed].type == "Real" else "int"
            lines.append(f"{kind} {variables[changed].valueReference} {value!r}")
        lines += ["row " + " ".join(f"{value:.17g}" for value in row) for row in rows]
        lines.append("end")
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    if shutil.which("gcc") is None:
        pytest.skip("not tried: the host needs gcc")
    from fmu_export import native_build

    target = tmp_path_factory.mktemp("exceptions") / "exceptions"
    headers = Path(native_build.__file__).parent / "adapter" / "fmi2"
    command = ["gcc", "-std=gnu99", "-O1", "-Wall", "-Wextra", "-Werror", "-isystem", headers, PROGRAM, "-o", target]
    subprocess.run([*command, "-ldl", "-lm"], check=True)
    return target


@pytest.mark.parametrize("build", BUILDS)
def test_no_step_raises_a_floating_point_exception(build, name, program, native_folders, tmp_path):
    folder = Path(native_folders[name])
    (binary,) = folder.glob("binaries/*/*.so")
    compiler = BUILDS[build]
    if compiler is not None:
        if shutil.which(compiler[0]) is None:
            pytest.skip(f"not tried: {compiler[0]} is missing")
        binary = tmp_path / "unit.so"
        headers = folder / "sources"
        sources = sorted(headers.glob("*.c"))
        from fmu_export import native_build

        fmi = Path(native_build.__file__).parent / "adapter" / "fmi2"
        command = [
            *compiler,
            "-shared",
            "-DFMI2_OVERRIDE_FUNCTION_PREFIX",
            "-fPIC",
            f"-I{headers}",
            f"-I{fmi}",
            *map(str, sources),
            "-o",
            str(binary),
            "-lm",
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    guid = str(description(str(folder)).guid)
    output = next(v.valueReference for v in description(str(folder)).modelVariables if v.causality == "output")
    inputs = [str(v.valueReference) for v in description(str(folder)).modelVariables if v.causality == "input"]
    location = (folder / "resources").as_uri()
    done = subprocess.run(
        [program, binary, location, guid, str(output), *inputs],
        input=script(name, folder),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, (done.returncode, done.stdout.splitlines()[-1:], done.stderr[-500:])
    assert done.stdout.endswith("done\n")
