"""The shipped default design: certified, what the command that makes it gives, the same FMU on every processor."""

import os
import platform
import subprocess
import sys

import numpy as np
import pytest

from ihc_fmu.certificate import certify
from ihc_fmu.pendulum import default_design as module
from ihc_fmu.pendulum.start_values import default_design

EXPORT = """
import hashlib, sys
from pathlib import Path
from cosim.pendulum_export import export_units
from ihc_fmu.pendulum.start_values import default_design
for file in export_units(default_design(), output=Path(sys.argv[1])):
    print(file.name, hashlib.sha256(file.read_bytes()).hexdigest())
"""


def test_shipped_design_is_certified_and_agrees_with_a_fresh_solution():
    shipped, fresh = default_design(), module.solved()
    assert certify(shipped).decrease > 0.0
    assert (shipped.mu, shipped.alpha, shipped.method) == (fresh.mu, fresh.alpha, fresh.method)
    for name in ("A", "B", "K"):
        np.testing.assert_array_equal(getattr(shipped, name), getattr(fresh, name))
    np.testing.assert_allclose(shipped.P, fresh.P, rtol=1e-4)


def test_export_does_not_depend_on_the_processor(tmp_path):
    """OpenBLAS computes in another order for each kind of processor."""
    if platform.machine() not in ("x86_64", "AMD64"):
        pytest.skip("not tried: the kinds of processor are those of x86-64")
    said = {}
    for core in ("Nehalem", "Haswell", "SkylakeX"):
        done = subprocess.run(
            [sys.executable, "-c", EXPORT, str(tmp_path / core)],
            env={**os.environ, "OPENBLAS_CORETYPE": core},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode >= 0:  # negative: this processor lacks the instructions
            assert done.returncode == 0, done.stderr
            said[core] = done.stdout
    assert len(said) > 1
    assert len(set(said.values())) == 1, said
