"""Shared by the tests of the general controller: random designs, the native FMU that shows all, and pairs of both."""

import platform
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import extract
from scipy.linalg import expm

from fmu_export.native_fmu import export_native_fmu
from ihc_fmu.regulator.interface import INTERFACE, OUTPUTS, Shape
from ihc_fmu.regulator.native_unit import NATIVE
from ihc_fmu.regulator.start_values import LinearFilter, Observer, Regulator
from ihc_fmu.regulator.unit import HomogeneousControllerUnit
from tests.fmu_export.conftest import Host
from tests.ihc_fmu.blocks import exponents_of, random_blocks, random_system, regular

EXACT = sys.platform == "linux" and platform.machine() == "x86_64"
"""Where Python and the binary call the same mathematical library, all results are equal to the last bit."""

OUTPUT_NAMES = [v.name for v in INTERFACE.calculated]
H = 1e-3


def agree(actual, expected):
    """NaN agrees with NaN."""
    tolerance = 0.0 if EXACT else 1e-12
    np.testing.assert_allclose(np.array(actual, float), np.array(expected, float), rtol=tolerance, atol=tolerance)


def row(measured, wanted=None):
    """Return the inputs of the compiled table: measured outputs, set-points (as the measured ones' equilibrium: 0)."""
    wanted = np.zeros(len(measured)) if wanted is None else wanted
    padded = [np.concatenate([part, np.zeros(OUTPUTS - len(part))]) for part in (measured, wanted)]
    return tuple(map(float, np.concatenate(padded)))


def by_name(inputs):
    return dict(zip([v.name for v in INTERFACE.of("input")], inputs, strict=True))


class Both:
    """The native FMU and the Python unit with the same values; every step's outputs, messages and refusals are equal."""

    def __init__(self, folder, values, inputs=None, start_time=0.0):
        inputs = row([]) if inputs is None else inputs
        self.values = dict(values)
        self.native, self.python = Host(folder), self._twin()
        self.native.initialize(start_time, **{**self.values, **by_name(inputs)})
        self.python.initialize(start_time, inputs)
        self.start_time, self.k = start_time, 0
        self.compare()

    def _twin(self):
        return HomogeneousControllerUnit(INTERFACE.start_values(self.values))

    def compare(self):
        agree(self.native.outputs(), self.python.outputs())

    def step(self, inputs, h=H):
        """Step both; return the outputs by name."""
        time = self.start_time + self.k * h
        self.k += 1
        self.native.log.clear()
        said = self.python.step(time, h, inputs)
        self.native.step(time, h, **by_name(inputs))
        assert [text for _, _, text in self.native.log] == [f"t = {time:.9g} s: {text}" for text in said]
        self.compare()
        return dict(zip(OUTPUT_NAMES, self.python.outputs(), strict=True))

    def tune(self, **changes):
        self.values |= changes
        self.native.set(**changes)
        state, self.python = self.python.get_state(), self._twin()
        self.python.set_state(state)
        self.compare()


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """The folder of a native FMU that shows the whole compiled table."""
    path = tmp_path_factory.mktemp("regulator")
    return Path(extract(str(export_native_fmu(NATIVE, path / "whole.fmu")), str(path / "whole")))


@pytest.fixture
def both(whole):
    made = []

    def make(values, *args, **options):
        made.append(Both(whole, values, *args, **options))
        return made[-1]

    yield make
    for pair in made:
        pair.native.slave.freeInstance()


def names(letter, count):
    return tuple((f"{letter}{i}", "1") for i in range(1, count + 1))


def random_regulator(n, m, p=0, mu=1.0, seed=0, *, observed=0, integral=False, set_points=False, h=H) -> Any:
    """Return a random design of measured states, of p outputs with a Kalman filter, or of `observed` with an observer."""
    system, rng = random_system(n, m, mu, seed), np.random.default_rng([n, m, p + observed, seed, 7])
    count = p or observed or n
    outputs = names("y", count)
    shape = Shape(
        name="plant",
        states=names("x", n),
        inputs=names("u", m),
        outputs=outputs,
        set_points=tuple(name for name, _ in outputs) if set_points else (),
        biases=(outputs[-1][0],) if p else (),
        estimated=p > 0,
    )
    rest = {}
    if p:
        block = expm(h * np.block([[system.A, system.B], [np.zeros((m, n + m))]]))
        M = 0.05 * rng.normal(size=(n + m + p, p))
        M[n + m : -1] = 0.0
        C = rng.normal(size=(p, n))
        counts = np.where(np.arange(p) % 2, 0.0, 0.3)  # without a weight for them it is the linear filter
        rest["filter"] = LinearFilter(F=block[:n, :n], G=block[:n, n:], C=C, M=M, decay=0.999, counts=counts)
    if integral:
        rest["K_i"] = -system.B.T @ system.P
    if set_points:
        rest |= {"N_x": rng.normal(size=(n, count)), "N_u": rng.normal(size=(m, count))}
    if observed:
        e = exponents_of(random_blocks(rng, n, observed))
        T, gains = regular(rng, n), 0.3 * rng.normal(size=(2, n, observed))
        rest["filter"] = Observer(
            A=system.A, B=system.B, C=rng.normal(size=(observed, n)), T=T, exponents=e, L_0=gains[0], L=gains[1],
            nu=-0.3, q_min=0.1, q_max=3.0,
        )  # fmt: skip
    limits = rng.uniform(1.0, 5.0, m) * np.where(np.arange(m) % 2, 1.0, 1e3)  # of some inputs never reached
    return Regulator(
        shape=shape,
        exponents=system.e,
        T=system.T,
        N=system.N,
        B=system.B_z,
        K_0=system.K_0,
        K=system.K,
        P=system.P,
        mu=mu,
        sample_time=h,
        lower=-limits,
        upper=2 * limits,
        x_eq=rng.normal(size=n),
        u_eq=rng.uniform(-0.5, 0.5, m),
        y_eq=rng.normal(size=count),
        **rest,
    )
