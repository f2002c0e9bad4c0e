"""The norm and the laws for states of every size, against 60 digits; Python and C."""

import math
import random
from pathlib import Path

import mpmath
import numpy as np
import pytest
from fmpy import extract

from fmu_export.native_fmu import export_native_fmu
from ihc_fmu.homogeneity import bisection_update
from ihc_fmu.laws import block_state
from ihc_fmu.pendulum.interface import INTERFACE, STATES, matrix, upper_triangle, vector
from ihc_fmu.pendulum.native_unit import NATIVE
from tests.fmu_export.conftest import Host

INPUTS = [v.name for v in INTERFACE.of("input")]
OUTPUTS = [v.name for v in INTERFACE.calculated]
DEGREES = (0.01, 0.25, 0.5, 0.75, 1.0)
TOLERANCE = 1e-12
A_MIN, B_MAX, H = 1e-6, 1e6, 1e-3
EXACT, INPUT = 2, 2


def states(seed, count):
    """Entries of one size, of sizes from 1e-300 to 1e300 each for itself, and some that are 0."""
    rng = random.Random(seed)
    for k in range(count):
        common = rng.uniform(-300, 300)
        sizes = [common if k % 3 == 0 else rng.uniform(-300, 300) for _ in STATES]
        entries = [rng.choice((-1.0, 1.0)) * 10.0 ** min(300.0, size + rng.random()) for size in sizes]
        yield tuple(0.0 if k % 3 == 2 and rng.random() < 0.4 else entry for entry in entries)


def axes(reference, seed, count):
    """States near the axes of the dilation, where a converging loop ends: the terms of their chain coordinates cancel."""
    rng = random.Random(seed)
    inverse = reference.Phi**-1
    for _ in range(count):
        axis, size = rng.randrange(1, 4), rng.uniform(-270, 270)
        yield tuple(float(inverse[i, axis] * reference.mp.mpf(10) ** size) for i in range(4))


class Reference:
    """The design's norm and laws in 60 digits, for the numbers that the FMU has."""

    def __init__(self, start):
        mp = self.mp = mpmath.mp.clone()
        mp.dps = 60
        self.Phi = mp.matrix(np.array([start[n] for n in matrix("Phi")]).reshape(4, 4).tolist())
        P = np.zeros((4, 4))
        P[np.triu_indices(4)] = [start[n] for n in upper_triangle("P")]
        inverse = self.Phi**-1
        self.Pz = inverse.T * mp.matrix((P + np.triu(P, 1).T).tolist()) * inverse
        self.row = mp.matrix([[mp.mpf(start[n]) for n in vector("row")]])
        k = mp.matrix(
            [[mp.mpf(start[a]) + mp.mpf(start[b]) for a, b in zip(vector("k_lin"), vector("row"), strict=True)]]
        )
        self.kz = k * inverse

    def chain(self, x):
        return self.Phi * self.mp.matrix(x)

    def squared_norm(self, z, mu, r):
        """||d(-ln r) x||_P^2."""
        y = self.mp.matrix([self.mp.mpf(r) ** -(1 + self.mp.mpf(mu) * (3 - i)) * z[i] for i in range(4)])
        return (y.T * self.Pz * y)[0]

    def control(self, x, mu, r, h=None):
        """u = K x, or K (I - h (A + b K))^-1 x."""
        mp, z = self.mp, self.chain(x)
        s = mp.mpf(r) ** -mp.mpf(mu)
        row_z = self.row * self.Phi**-1
        K = mp.matrix([[self.kz[i] * s ** (4 - i) - row_z[i] for i in range(4)]])
        if h is not None:
            closed = mp.matrix(4)
            for i in range(3):
                closed[i, i + 1] = 1
            for i in range(4):
                closed[3, i] = K[i] + row_z[i]
            z = mp.lu_solve(mp.eye(4) - mp.mpf(h) * closed, z)
        return (K * z)[0]


@pytest.fixture(scope="module")
def reference(start_values):
    return Reference(start_values)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, start_values):
    path = tmp_path_factory.mktemp("native")
    return Path(
        extract(str(export_native_fmu(NATIVE, path / "controller.fmu", start_values)), str(path / "controller"))
    )


WIDE = dict.fromkeys(("capture_level", "capture_angle", "capture_velocity", "fall_back_angle"), 1e300)
RUN = {**WIDE, "velocity_source": INPUT, "norm_solver": EXACT, "a_min": A_MIN, "b_max": B_MAX, "voltage_limit": 1e300}


@pytest.mark.parametrize("discretization", [1, 2], ids=["explicit", "semi-implicit"])
@pytest.mark.parametrize("mu", DEGREES)
def test_norm_and_laws_are_right_for_states_of_every_size(mu, discretization, controller, folder, reference):
    """In Python to 1e-12 of 60 digits, N(r) being compared with 1 on both sides of r; in C to the last bit of Python."""
    changes = {**RUN, "mu": mu, "discretization": discretization}
    unit, native = controller(**changes), Host(folder).initialize(**changes)
    unit.initialize(0.0, (0.0,) * len(INPUTS))
    h = H if discretization == 2 else None
    seed = int(100 * mu)
    for k, (theta, delta, *rest) in enumerate([*states(seed, 45), *axes(reference, seed, 15)]):
        x = (theta, math.remainder(delta, math.tau), *rest)
        inputs = (*x, 0.0)
        assert unit.step(k * H, H, inputs) == []
        assert native.step(k * H, H, **dict(zip(INPUTS, inputs, strict=True))) == unit.outputs()
        values = dict(zip(OUTPUTS, unit.outputs(), strict=True))
        r, z = values["homogeneous_norm"], reference.chain(x)
        if any(x):
            below, above = (
                reference.squared_norm(z, mu, reference.mp.mpf(r) * f) for f in (1 - TOLERANCE, 1 + TOLERANCE)
            )
            assert below > 1 > above
        assert values["homogeneous_norm_used"] == min(B_MAX, max(A_MIN, r))
        u = max(-1e300, min(1e300, reference.control(x, mu, values["homogeneous_norm_used"], h)))
        assert abs(values["voltage"] - u) <= TOLERANCE * abs(u)
        interval = (A_MIN, B_MAX)
        for _ in range(2):
            interval = bisection_update(block_state(unit.design, list(x)).polynomial, mu, interval, A_MIN, B_MAX, 60)
        assert interval[1] == pytest.approx(values["homogeneous_norm_used"], rel=TOLERANCE)
    native.slave.freeInstance()
