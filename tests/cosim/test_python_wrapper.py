"""FMUs of PythonFMU's own builder: their wrapper does not write to freed memory, with each deletion made to show it."""

import os
import subprocess
import sys

import pytest

from fmu_export.native_build import build_library, host_platform

DELETE = b"""
#include <stddef.h>

/* C++'s delete: what is deleted twice is a living object once more, of one reference and without functions. */
__attribute__((visibility("default"))) void _ZdlPvm(void *block, size_t size);
void _ZdlPvm(void *block, size_t size)
{
    int *words = block;
    for (size_t i = 0; i < size / sizeof *words; i++) {
        words[i] = 1;
    }
}
"""

CLOCK = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Clock(Fmi2Slave):
    time = 0.0

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.register_variable(Real("time", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.time = current_time + step_size
        return True
"""

SCRIPT = """
from clock import Clock


class Plant(Clock):
    \"\"\"No function here refers to the script's globals.\"\"\"
"""

HOST = """
import gc, sys
from pathlib import Path
from cosim.master import simulate
from cosim.structure import Component, SystemStructure

for path in sys.argv[1:]:
    for _ in range(3):
        result = simulate(SystemStructure([Component("a", Path(path)), Component("b", Path(path))]), 0.5, 1.0)
        gc.collect()
        print(result["b.time"].tolist())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="replaces C++'s delete by the loader of Linux")
def test_plants_are_instantiated_again_and_the_process_ends_well(tmp_path):
    (tmp_path / "clock.py").write_text(CLOCK)
    (tmp_path / "plant.py").write_text(SCRIPT)
    for name in ("one.fmu", "two.fmu"):
        build = [sys.executable, "-m", "pythonfmu", "build", "-f", "plant.py", "-d", name, "clock.py"]
        subprocess.run(build, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    delete = tmp_path / "delete.so"
    delete.write_bytes(build_library({"delete.c": DELETE}, "delete", host_platform()))
    host = [sys.executable, "-c", HOST, tmp_path / "one.fmu", tmp_path / "two.fmu"]
    environment = {**os.environ, "LD_PRELOAD": str(delete)}
    done = subprocess.run(host, capture_output=True, text=True, env=environment, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (0, 6 * "[0.0, 0.5, 1.0]\n"), done.stderr
