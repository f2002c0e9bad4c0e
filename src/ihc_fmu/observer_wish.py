"""What a system says of the homogeneous observer that it asks for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from fmu_export.errors import UserError, shown

from .arrays import LARGEST, Array, check_numbers, check_weights, matrix

MATRICES = ("L", "poles", "Q", "R")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ObserverWish:
    """A homogeneous observer in place of a Kalman filter: its linear gain and its numbers, None: chosen.

    L (n, p): A + L C is Hurwitz; or poles (n,): its eigenvalues, real [1/s]; or Q (n, n) or (n,), R (p, p) or (p,): weights
    of the dual of an LQ regulator, L = -S C' R^-1. nu in [-1, 0]: degree. q_min, q_max > 0: limits of |C z - y| in the gain;
    q_linear > 0: where the gain is L. Raises UserError that names the entry.
    """

    L: Array | None = None
    poles: Array | None = None
    Q: Array | None = None
    R: Array | None = None
    nu: float | None = None
    q_min: float | None = None
    q_max: float | None = None
    q_linear: float | None = None

    def __post_init__(self) -> None:
        for name in MATRICES:
            if getattr(self, name) is not None:
                object.__setattr__(self, name, matrix(f"observer.{name}", getattr(self, name), flat=True))
        ways = sum(given is not None for given in (self.L, self.poles, self.Q))
        if (self.Q is None) != (self.R is None) or ways > 1:
            raise UserError("observer must have L, or poles, or both Q and R, or none of them")
        if self.poles is not None and not (self.poles < 0.0).all():
            raise UserError(f"observer.poles must be negative [1/s], found {self.poles.max():g}")
        if self.nu is not None and not -1.0 <= self.nu <= 0.0:
            raise UserError(f"observer.nu must lie in [-1, 0], found {self.nu:g}")
        for name in ("q_min", "q_max", "q_linear"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < LARGEST:
                raise UserError(f"observer.{name} must be positive and finite, found {value:g}")

    @classmethod
    def from_table(cls, table: object) -> ObserverWish:
        """Return the wish of a table of entries."""
        names = [f.name for f in fields(cls)]
        if not isinstance(table, Mapping) or not set(table) <= set(names):
            raise UserError(f"observer must be a table of {', '.join(names)}, found {shown(table)}")
        for name, value in table.items():
            if name in MATRICES:
                check_weights(f"observer.{name}", value)
            else:
                check_numbers(f"observer.{name}", value, 0)
        return cls(**table)

    def as_table(self) -> dict[str, Any]:
        """Return what `from_table` reads, in plain types."""
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        return {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in given.items()
            if value is not None
        }
