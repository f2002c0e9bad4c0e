"""The numbers of an implicit homogeneous controller for any (A, B), before their proof."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from fmu_export.errors import UserError

from .arrays import QUIET, Array
from .block_form import BlockForm
from .system import System


@dataclass(frozen=True, eq=False)
class Candidate:
    """An implicit homogeneous controller for x' = A x + B u, in whose numbers nothing is proven yet.

    The numbers are those of `Design`, which proves them. Raises UserError for numbers that no design can have.
    """

    system: System
    P: Array
    mu: float
    alpha: float
    psi: float = 0.0
    d_max: float = 0.0
    tau: float = 1.0
    form: BlockForm = field(init=False)

    @QUIET
    def __post_init__(self) -> None:
        n = self.system.n
        if self.system.K is None:
            raise UserError("a design needs a system with a gain K")
        P = np.array(self.P, dtype=float)
        if P.shape != (n, n):
            raise UserError(f"P must be of shape {(n, n)} to fit A, found shape {P.shape}")
        if not np.isfinite(P).all():
            raise UserError(f"P must be finite, found {P[~np.isfinite(P)][0]}")
        check_scalars(self.mu, self.alpha, self.psi, self.d_max, self.tau)
        P.setflags(write=False)  # what is certified stays as it is
        object.__setattr__(self, "P", P)
        object.__setattr__(self, "form", _near_one(self.system.form, P))

    @property
    def n(self) -> int:
        """The order of the system."""
        return self.system.n

    @property
    def A(self) -> Array:
        """The system's A (n, n)."""
        return self.system.A

    @property
    def B(self) -> Array:
        """The system's B (n, m)."""
        return self.system.B

    @property
    def b(self) -> Array:
        """The only column of B, shape (n,); UserError for several inputs."""
        return self.system.b

    @property
    def K(self) -> Array:
        """The gain of the linear controller u = K x, shape (m, n)."""
        assert self.system.K is not None
        return self.system.K

    @property
    def k_lin(self) -> Array:
        """The only row of K, shape (n,); UserError for several inputs."""
        self.system.b  # noqa: B018 - refuses
        return self.K[0]

    @cached_property
    def K_h(self) -> Array:
        """The homogeneous gain K - K_0, eq. (10), shape (m, n)."""
        return self.K - self.form.K_0

    @property
    def u_max(self) -> Array:
        """The largest |(K - K_0) x| of each input on the unit ball, shape (m,)."""
        return np.sqrt(np.einsum("ij,ji->i", self.K_h, np.linalg.solve(self.P, self.K_h.T)))

    @property
    def extent(self) -> Array:
        """The largest |x_i| on the unit ball, sqrt((P^-1)_ii), shape (n,)."""
        return np.sqrt(np.diag(np.linalg.inv(self.P)))


def _near_one(form: BlockForm, P: Array) -> BlockForm:
    """Return the form with its blocks scaled by powers of 2 so that P in it has a diagonal near 1."""
    size = np.abs(np.diag(form.T_inverse.T @ P @ form.T_inverse))
    factors = [float(np.sqrt(size[block].max())) for block in form.blocks]
    return form.scaled([2.0 ** np.round(np.log2(f)) if 0.0 < f < np.inf else 1.0 for f in factors])


def check_scalars(mu: float, alpha: float, psi: float, d_max: float, tau: float = 1.0) -> None:
    """Raise UserError for scalars that no design can have."""
    if not 0.0 < mu <= 1.0:
        raise UserError(f"mu must lie in (0, 1], found {mu}")
    if not 0.0 < alpha < np.inf:
        raise UserError(f"alpha must be positive and finite [1/s], found {alpha}")
    if not 0.0 < tau < np.inf:
        raise UserError(f"tau must be positive and finite, found {tau}")
    for name, value in (("psi", psi), ("d_max", d_max)):
        if not 0.0 <= value < np.inf:
            raise UserError(f"{name} must be non-negative and finite, found {value}")
    if d_max > 0.0 and mu < 1.0:
        raise UserError(f"a matched disturbance d_max > 0 can be rejected only at mu = 1, found mu = {mu}")
