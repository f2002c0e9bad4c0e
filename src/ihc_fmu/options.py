"""What a design is asked for besides its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fmu_export.errors import UserError, counted

from .arrays import reals
from .candidate import check_scalars

Array = np.ndarray

SCALES = (1e-9, 1e9)
"""Bounds on what scales the problem: beyond, double precision does not resolve it."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """What both designs take besides the model.

    Parameters
    ----------
    mu
        Minus the degree of homogeneity, in (0, 1]; 1 rejects bounded disturbances.
    alpha
        Decrease to be proven [1/s], d||x||_d/dt <= -alpha ||x||_d^(1-mu), inequality (11).
    u_max
        Bound on |(K - K_0) x| on the unit ball, a number or one for each input [units of u]: the scale of P. None: by
        `delta_max` alone.
    delta_max
        Instead or as well, a bound on |x_index| on the unit ball [unit of that state].
    index
        Number of that state, from 0.
    beta
        G_d X + X G_d' >= 2 beta X keeps the dilation monotone with a margin; in (0, 1).
    psi
        Relative bound on an uncertainty of the model, Remark 3; 0: none.
    d_max
        Bound on a disturbance added to the control [units of u], Remark 3; 0: none.

    Raises
    ------
    UserError
        For a number outside its rule.

    Examples
    --------
    >>> from ihc_fmu import Options
    >>> options = Options(mu=0.5, alpha=0.3, u_max=[2.0, 5.0])
    >>> options.bounds(2).tolist()
    [2.0, 5.0]
    >>> Options(mu=1.5)
    Traceback (most recent call last):
    fmu_export.errors.UserError: mu must lie in (0, 1], found 1.5
    """

    mu: float = 1.0
    alpha: float = 0.2
    u_max: float | Sequence[float] | None = 1.5
    delta_max: float | None = None
    index: int = 1
    beta: float = 0.1
    psi: float = 0.0
    d_max: float = 0.0

    def __post_init__(self) -> None:
        check_scalars(self.mu, self.alpha, self.psi, self.d_max)
        if self.u_max is None and self.delta_max is None:
            raise UserError("the scale of P needs a rule: u_max, delta_max or both")
        bounds = [] if self.u_max is None else self._given_bounds().tolist()
        sizes = [
            *(("u_max", value) for value in bounds),
            *([] if self.delta_max is None else [("delta_max", self.delta_max)]),
        ]
        for name, value in sizes:
            if not 0.0 < value < np.inf:
                raise UserError(f"{name} must be positive and finite, found {value}")
        for name, value in (*sizes, ("psi", self.psi), ("d_max", self.d_max)):  # 0 is for none
            if value and not SCALES[0] <= value <= SCALES[1]:
                raise UserError(f"{name} must lie in [{SCALES[0]:g}, {SCALES[1]:g}], found {value}")
        if not 0.0 < self.beta < 1.0:
            raise UserError(f"beta must lie in (0, 1), found {self.beta}")

    def bounds(self, m: int) -> Array | None:
        """Return u_max for each input.

        Parameters
        ----------
        m
            Number of inputs.

        Returns
        -------
        numpy.ndarray or None
            Shape (m,); None where `u_max` is None.
        """
        if self.u_max is None:
            return None
        bounds = self._given_bounds()
        if bounds.shape not in ((1,), (m,)):
            raise UserError(
                f"u_max must be a number, or one for each input, found {len(bounds)} for {counted(m, 'input')}"
            )
        return np.broadcast_to(bounds, (m,))

    def _given_bounds(self) -> Array:
        return np.atleast_1d(reals("u_max", self.u_max, "a number, or one for each input"))
