"""Random controllable systems in all units, each from a seed of its own."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_are
from scipy.signal import place_poles

from fmu_export.errors import UserError
from ihc_fmu.block_form import block_form
from ihc_fmu.design import Design
from ihc_fmu.system import System

Array = np.ndarray

KINDS = ("dense", "sparse", "integrators")
GAINS = ("lqr", "poles")
SHARES = (0.02, 0.1, 0.3, 0.6)
"""Of the decay rate of the slowest pole of A + B K: the alpha that is asked for."""
DENSITY = 0.4
"""Share of the entries of a sparse A that are not 0."""
NEAR = 1e-3
"""Poles closer to the imaginary axis than this, in the units that the system is drawn in, are drawn again."""


@dataclass(frozen=True)
class Drawn:
    """A system with its gain, alpha [1/s] and bounds u_max (m,) to ask for, and how it was drawn.

    State and input are `units` and `inputs` times those of the same system drawn without units, and time runs `omega` times
    as fast.
    """

    system: System
    alpha: float
    u_max: Array
    units: Array
    inputs: Array
    omega: float
    about: str


def drawn(seed: int, n: int | None = None, units: bool = True) -> Drawn:
    """Return the system of a seed: n of 2..8 unless given, m of 1..3, states and inputs in units of 1e-4..1e4, time of
    1e-3..1e3 unless `units` is False; its gain, kind and alpha's share are drawn too."""
    rng = np.random.default_rng([seed, n or 0])
    n = n or int(rng.integers(2, 9))
    m = int(rng.integers(1, min(3, n) + 1))
    kind, gain = KINDS[rng.integers(len(KINDS))], GAINS[rng.integers(len(GAINS))]
    share = SHARES[rng.integers(len(SHARES))]
    while True:
        A, B = _matrices(rng, kind, n, m)
        K = _gain(rng, gain, A, B)
        if K is not None:
            break
    omega = 10.0 ** rng.uniform(-3, 3) if units else 1.0
    x, u = (10.0 ** rng.uniform(-4, 4, size) if units else np.ones(size) for size in (n, m))
    u_max = np.linalg.norm(K, axis=1) * u
    slowest = -np.linalg.eigvals(A + B @ K).real.max()
    system = System(A=omega * A * x[:, None] / x, B=omega * B * x[:, None] / u, K=K * u[:, None] / x)
    about = f"seed {seed}: n {n}, m {m}, {kind}, {gain}, alpha {share:g} of the slowest pole"
    return Drawn(system, share * slowest * omega, u_max, x, u, omega, about)


def distance(design: Design, plain: Design, case: Drawn) -> float:
    """Return how far the design of a case is from that of the same system without units, relative to the latter's unit ball.

    Of P, and of K - K_0 relative to its bounds: 0 for designs that differ in units only.
    """
    x, to_y = case.units, np.linalg.inv(np.linalg.cholesky(plain.P))
    P = to_y @ (x[:, None] * design.P * x) @ to_y.T
    K = (design.K / case.inputs[:, None] * x - plain.K) @ to_y.T / plain.u_max[:, None]
    return max(float(np.linalg.norm(P - np.eye(len(P)), 2)), float(np.abs(K).max()))


def _matrices(rng: np.random.Generator, kind: str, n: int, m: int) -> tuple[Array, Array]:
    if kind == "integrators":  # chains whose lengths differ by at most 1
        return np.eye(n, k=m), np.eye(n)[:, n - m :]
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    return (A * (rng.random((n, n)) < DENSITY) if kind == "sparse" else A), B


def _gain(rng: np.random.Generator, gain: str, A: Array, B: Array) -> Array | None:
    """Return K of u = K x; None for a pair that is not controllable, or nearly not.

    Where SciPy's placement does not converge, K is very large and its poles are others; such a gain is kept.
    """
    n, m = B.shape
    Q, R = 10.0 ** rng.uniform(-1, 1, n), 10.0 ** rng.uniform(-2, 1, m)
    poles = _poles(rng, n)
    try:
        block_form(A, B)
        if gain == "lqr":
            K = -(B.T @ solve_continuous_are(A, B, np.diag(Q), np.diag(R))) / R[:, None]
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # how robust the gain is does not matter here
                placed: Any = place_poles(A, B, poles)
            K = -placed.gain_matrix
    except (UserError, LinAlgError, ValueError):
        return None
    return K if np.linalg.eigvals(A + B @ K).real.max() < -NEAR else None


def _poles(rng: np.random.Generator, n: int) -> Array:
    """Return n different poles of magnitude 0.3..3, at least half of them in pairs of damping 0.3..1."""
    pairs = int(rng.integers((n + 1) // 4, n // 2 + 1))
    size, angle = 10.0 ** rng.uniform(-0.5, 0.5, pairs), np.arccos(rng.uniform(0.3, 1.0, pairs))
    complex_poles = -size * np.exp(1j * angle)
    return np.concatenate([complex_poles, complex_poles.conj(), -(10.0 ** rng.uniform(-0.5, 0.5, n - 2 * pairs))])
