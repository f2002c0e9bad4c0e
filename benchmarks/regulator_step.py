"""What a sample of HomogeneousController costs in C: against IhcController for the same pendulum, and over n and m.

Both controllers see the same recorded states, angles and velocities measured, and have the same law: the exact norm,
semi-implicit. Then both with their Kalman filters on the angles alone. Larger designs are made of random block forms.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from benchmarks.compiled import compiled
from fmu_export.native_unit import struct_initializer
from ihc_fmu.block_form import block_form
from ihc_fmu.design import Design
from ihc_fmu.estimation import estimator
from ihc_fmu.quantity import Quantity
from ihc_fmu.regulator.interface import OUTPUTS, Shape
from ihc_fmu.regulator.native_unit import NATIVE
from ihc_fmu.regulator.start_values import LinearFilter, Regulator, design_regulator

SIZES = ((1, 1), (2, 1), (4, 1), (4, 2), (6, 2), (8, 1), (8, 4), (12, 4), (16, 1), (16, 8))
COUNT = 2 * np.pi / 2048


class RegulatorStep:
    """The program, with one design after the other compiled in, and the measurements that each runs on."""

    def __init__(self, cases: Mapping[str, tuple[Regulator, np.ndarray]]) -> None:
        """Take, by name, what the controller needs and rows of measured outputs (count, p)."""
        self._names = list(cases)
        self._library = _library([regulator for regulator, _ in cases.values()])
        self._rows = []
        for regulator, rows in cases.values():
            padded = np.zeros((len(rows), OUTPUTS))
            padded[:, : len(regulator.shape.outputs)] = rows
            self._rows.append(padded)

    def cases(self) -> dict[str, Callable[[], float]]:
        """Return what is measured by name; each call returns ns per sample."""
        return {name: lambda k=k: self._whole(k) for k, name in enumerate(self._names)}

    def _whole(self, design: int) -> float:
        rows = self._rows[design]
        start = time.perf_counter()
        stabilizing = self._library.whole_steps(design, rows.ctypes.data, len(rows))
        seconds = time.perf_counter() - start
        if stabilizing != len(rows):
            raise RuntimeError(f"only {stabilizing} of {len(rows)} samples were in the stabilizing mode")
        return 1e9 * seconds / len(rows)


def pendulum_cases(design: Design, sample_time: float, x: np.ndarray) -> dict[str, tuple[Regulator, np.ndarray]]:
    """Return the pendulum's design with measured states (count, 4), and with its Kalman filter on the angles."""
    design = replace(design, system=design.system.changed(sample_time=sample_time))
    angles = (Quantity("theta", "rad"), Quantity("delta", "rad"))
    counted = {"C": np.eye(2, 4), "outputs": angles, "resolutions": np.full(2, COUNT), "biases": ("delta",)}
    encoders = replace(design, system=design.system.changed(C=counted.pop("C")).changed(**counted))
    k = estimator(encoders)
    found = LinearFilter(F=k.F, G=k.G, C=np.eye(2, 4), M=k.M, decay=k.decay)
    return {
        "HomogeneousController, n 4, m 1, states measured": (design_regulator(design), x),
        "HomogeneousController, n 4, m 1, Kalman filter": (design_regulator(encoders, found), x[:, :2]),
    }


def random_cases(count: int) -> dict[str, tuple[Regulator, np.ndarray]]:
    """Return designs of growing size on `count` states with norms between 0.03 and 1."""
    return {f"n {n}, m {m}": _random_case(n, m, count) for n, m in SIZES}


def _random_case(n: int, m: int, count: int) -> tuple[Regulator, np.ndarray]:
    """Return a design with P = T' T, whose dilation is monotone; the law's cost does not depend on what it proves."""
    rng = np.random.default_rng([n, m])
    A, B = rng.normal(size=(n, n)) / np.sqrt(n), rng.normal(size=(n, m))
    form = block_form(A, B)
    r = 10.0 ** rng.uniform(-1.5, 0.0, count)
    z = rng.normal(size=(count, n))
    z *= r[:, None] ** form.weights(1.0) / np.linalg.norm(z, axis=1)[:, None]

    def named(letter: str, size: int) -> tuple[tuple[str, str], ...]:
        return tuple((f"{letter}{i}", "1") for i in range(1, size + 1))

    regulator = Regulator(
        shape=Shape(name="plant", states=named("x", n), inputs=named("u", m), outputs=named("y", n)),
        exponents=form.exponents,
        T=form.T,
        N=form.N,
        B=form.Bz,
        K_0=form.K_0,
        K=form.K_0 - form.Bz.T @ form.T,
        P=form.T.T @ form.T,
        mu=1.0,
        sample_time=1e-3,
    )
    return regulator, z @ form.T_inverse.T


def _library(regulators: list[Regulator]) -> ctypes.CDLL:
    values = (NATIVE.interface.start_values(regulator.values()) for regulator in regulators)
    designs = ",\n".join(struct_initializer(NATIVE, v) for v in values)
    header = f'#include "homogeneous_controller.h"\nstatic const regulator_params DESIGNS[] = {{{designs}}};\n'
    library = compiled("regulator_step", NATIVE.core, header)
    library.whole_steps.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_long]
    library.whole_steps.restype = ctypes.c_long
    return library
