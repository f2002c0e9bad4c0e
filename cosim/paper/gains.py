"""What the printed k and P are: each way to read them, judged by eigenvalues and by a run of the controller FMU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigh

from ihc_fmu.companion import chain_form, generator
from ihc_fmu.pendulum.interface import upper_triangle, vector
from ihc_fmu.pendulum.paper_system import PAPER_A, PAPER_B, PAPER_K_LIN
from ihc_fmu.pendulum.start_values import zip_names

from . import printed

Array = np.ndarray

A, B, K_LIN = (np.asarray(given, dtype=float) for given in (PAPER_A, PAPER_B, PAPER_K_LIN))

RUN = {"velocity_source": "filter", "norm_solver": "algorithm1", "discretization": "explicit"}


@dataclass(frozen=True)
class GainReading:
    """A way to read the printed k: the control at r = 1 is u = K x. poles: of A + b K [1/s]. start: of the FMU's run."""

    name: str
    K: Array
    poles: Array
    start: Mapping[str, Any]

    @property
    def stable(self) -> bool:
        """Whether all poles lie in the left half plane."""
        return bool(np.real(self.poles).max() < 0.0)


@dataclass(frozen=True)
class NormReading:
    """A way to read the printed P, with the k of eq. (10): margins of eq. (11) relative to P, both must be positive.

    monotone: lambda_min of G_d'P + P G_d [1]. decrease: -lambda_max of the left side of (11) with the printed alpha [1/s].
    """

    name: str
    P: Array
    monotone: float
    decrease: float
    start: Mapping[str, Any]

    @property
    def solves(self) -> bool:
        """Whether eq. (11) holds, up to 1e-6 1/s for a matrix on its boundary."""
        return self.monotone > 0.0 and self.decrease > -1e-6


def recovered_gain() -> Array:
    """Return the linear gain that the printed k was made from, 100 (k - row) Phi.

    k = k_lin Phi^-1 / 100 + row adds a gain in chain coordinates, scaled by 100, to a row in the coordinates of x. The
    result is [2, -30, 2, -2.6], not the printed k_lin with its -2.5.
    """
    chain = chain_form(A, B)
    return 100.0 * (printed.K - chain.row) @ chain.Phi


def gain_readings() -> list[GainReading]:
    """Return the readings of the printed k, then what eq. (10) gives."""
    chain = chain_form(A, B)
    Phi, row = chain.Phi, chain.row
    readings = {
        "printed k: u = k x": printed.K,
        "printed k: u = k x - row x": printed.K - row,
        "printed k in chain coordinates: u = k Φ x": printed.K @ Phi,
        "printed k in chain coordinates: u = k Φ x - row x": printed.K @ Phi - row,
        "recovered: u = 100 (k - row) Φ x": recovered_gain(),
        "eq. (10), k = k_lin + row: u = k x - row x": K_LIN,
    }
    return [
        GainReading(
            name,
            K,
            np.linalg.eigvals(A + np.outer(B, K)),
            {**RUN, "law": "LC", **zip_names(vector("k_lin"), K)},
        )
        for name, K in readings.items()
    ]


def norm_readings(solved: Array) -> list[NormReading]:
    """Return the readings of the printed P, then `solved`, the P that eq. (11) gives."""
    Phi = chain_form(A, B).Phi
    inverse = np.linalg.inv(Phi)
    readings = {
        "printed P in x": printed.P,
        "printed P in z = Φ x": Phi.T @ printed.P @ Phi,
        "printed P is that of x, given in z": inverse.T @ printed.P @ inverse,
        "printed matrix is P⁻¹": np.linalg.inv(printed.P),
        "eq. (11)": solved,
    }
    return [_norm_reading(name, P) for name, P in readings.items()]


def _norm_reading(name: str, P: Array) -> NormReading:
    G = generator(chain_form(A, B).Phi, printed.MU)
    closed = A + np.outer(B, K_LIN) + printed.ALPHA * G
    entries = zip_names(upper_triangle("P"), P[np.triu_indices(len(P))])
    start = {**RUN, "law": "IHC", "a_min": printed.A_MIN, "b_max": printed.B_MAX, "j_max": printed.J_MAX, **entries}
    return NormReading(
        name,
        P,
        monotone=float(_relative_eigenvalues(G.T @ P + P @ G, P)[0]),
        decrease=-float(_relative_eigenvalues(closed.T @ P + P @ closed, P)[-1]),
        start={**start, "capture_level": capture_level(P)},
    )


def _relative_eigenvalues(M: Array, P: Array) -> Array:
    """Return the eigenvalues of the symmetric M relative to P > 0, ascending: those of P^(-1/2) M P^(-1/2)."""
    d = 1.0 / np.sqrt(np.diag(P))
    return eigh(d[:, None] * (M + M.T) / 2 * d, d[:, None] * P * d, eigvals_only=True)


def capture_level(P: Array) -> float:
    """Return a level that takes over at once from the tilt of the experiment, ten times its x'Px there."""
    return 10.0 * float(P[1, 1]) * TILT**2


TILT = 0.1
"""Initial angle of the pendulum in the experiments without swing-up [rad]."""


def poles_text(poles: Array) -> str:
    """Return poles as text, conjugate pairs once."""
    shown = []
    for pole in sorted(poles, key=lambda p: (-p.real, abs(p.imag))):
        if pole.imag < -1e-9:
            continue
        shown.append(f"{pole.real:.4g}" + (f" ± {pole.imag:.4g}i" if pole.imag > 1e-9 else ""))
    return ", ".join(shown)
