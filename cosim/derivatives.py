"""Derivatives by differences with an error estimate, and equilibria: for functions that are only known by their values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

Array = np.ndarray
Function = Callable[[Array], Array]

FIRST = 0.009731
"""The first step, relative to the size of the variable; no round number, as the steps of counting sensors are."""
SHRINK = 4.0
LEVELS = 9
"""Steps are FIRST size / SHRINK^k, k < LEVELS: down to 1.5e-7 of the size."""
ENOUGH = 1e-11
"""Relative error at which no smaller step is tried."""
_EPS = float(np.finfo(float).eps)


class EvaluationError(RuntimeError):
    """A function has no value at a point; the message says why."""


@dataclass(frozen=True, slots=True, eq=False)
class Jacobian:
    """Partial derivatives, shape (r, c), their error estimates of the same shape, and where one-sided slopes differ."""

    J: Array
    error: Array
    kink: Array


@dataclass(slots=True, eq=False)
class _Column:
    """Ridders' tableau of one column: for each entry the value with the least error estimate so far."""

    best: Array
    error: Array
    row: list[Array] = field(default_factory=list)
    first_gap: Array | None = None
    gap: Array | None = None
    change: Array | None = None
    stepped: Array | None = None

    def take(self, plus: Array, minus: Array, middle: Array, width: float) -> None:
        """Take f(z + h e), f(z - h e), f(z) and the distance 2 h of the two points."""
        new, factor = [(plus - minus) / width], SHRINK**2
        for k, old in enumerate(self.row):
            new.append((factor * new[k] - old) / (factor - 1.0))
            factor *= SHRINK**2
            error = np.maximum(np.abs(new[k + 1] - new[k]), np.abs(new[k + 1] - old))
            better = error < self.error
            self.best, self.error = np.where(better, new[k + 1], self.best), np.where(better, error, self.error)
        self.row = new
        self.gap = np.abs(plus - 2.0 * middle + minus) / (0.5 * width)
        self.first_gap = self.gap if self.first_gap is None else self.first_gap
        change, size = np.abs(plus - minus), np.maximum(np.abs(plus), np.abs(minus))
        if self.change is not None:  # a smooth function does not stop changing from one step to the next
            stopped = (change == 0.0) & (self.change * SHRINK**-7 > 4.0 * _EPS * size)
            self.stepped = stopped if self.stepped is None else self.stepped | stopped
        self.change = change

    def settled(self, noise: Array) -> bool:
        """Whether smaller steps promise nothing: the errors are small, and the last steps say the same."""
        if len(self.row) < 3:
            return False
        size = np.abs(self.best)
        same = np.abs(self.row[1] - self.best) <= 1e-4 * size + noise
        return bool((same & (self.error <= ENOUGH * size + noise)).all())

    def kink(self) -> Array:
        """Return by how much one-sided slopes differ where that does not shrink with the step, else 0."""
        assert self.gap is not None
        assert self.first_gap is not None
        stays = (self.gap > 0.5 * self.first_gap) & (self.gap > 1e-3 * np.abs(self.best)) & (len(self.row) > 1)
        return np.where(stays, self.gap, 0.0)


def jacobian(f: Function, z: Array, size: Array) -> Jacobian:
    """Return the partial derivatives of f at z by central differences, extrapolated to step 0 (Ridders' tableau).

    The steps begin at FIRST of `size`, the magnitudes of z's entries, and shrink until the extrapolations agree; where f
    has no value beside z (EvaluationError, or not finite) smaller steps are tried. The error of an entry is the largest
    difference to its neighbours in the tableau; it is infinite for a function that moves in steps. Raises
    EvaluationError where two steps in a row cannot be made.
    """
    f0 = finite(f, z)
    columns = [_column(f, z, j, float(size[j]), f0) for j in range(len(z))]

    def stack(parts: list[Array]) -> Array:
        return np.stack(parts, axis=1) if parts else np.zeros((len(f0), 0))

    errors = [np.where(c.stepped, np.inf, c.error) if c.stepped is not None else c.error for c in columns]
    return Jacobian(stack([c.best for c in columns]), stack(errors), stack([c.kink() for c in columns]))


def differences(f: Function, z: Array, widths: Array) -> tuple[Array, Array, Array]:
    """Return f(z), shape (r,), [f(z + w e) - f(z - w e)]/(2 w), shape (r, c), and by how much the sides differ, (r, c).

    That is |f(z + w e) - 2 f(z) + f(z - w e)|/(2 w). `widths` (c,): how far to go, whatever lies between: the counts of a
    sensor and dry friction are averaged. Raises EvaluationError where f has no value.
    """
    f0 = finite(f, z)
    J, skew = np.zeros((len(f0), len(z))), np.zeros((len(f0), len(z)))
    for j, width in enumerate(widths):
        up, down = z.copy(), z.copy()
        up[j] += width
        down[j] -= width
        plus, minus = finite(f, up), finite(f, down)
        J[:, j], skew[:, j] = (plus - minus) / (2.0 * width), np.abs(plus - 2.0 * f0 + minus) / (2.0 * width)
    return f0, J, skew


def _column(f: Function, z: Array, j: int, size: float, f0: Array) -> _Column:
    column = _Column(np.zeros_like(f0), np.full_like(f0, np.inf))
    failure = EvaluationError("it has no value there")
    for level in range(LEVELS):
        up, down = z.copy(), z.copy()
        up[j] += FIRST * size * SHRINK**-level
        down[j] -= FIRST * size * SHRINK**-level
        width = float(up[j] - down[j])
        try:
            column.take(finite(f, up), finite(f, down), f0, width)
        except EvaluationError as error:
            failure, column.row, column.change, column.first_gap = error, [], None, None
            continue
        if column.settled(8.0 * _EPS * np.abs(f0) / width):
            break
    if len(column.row) < 2:
        raise failure
    return column


def finite(f: Function, z: Array) -> Array:
    """Return f(z); raise EvaluationError where it is not finite."""
    value = f(z)
    if not np.isfinite(value).all():
        raise EvaluationError(f"value {int(np.flatnonzero(~np.isfinite(value))[0]) + 1} is not finite")
    return value


def least_steps(J: Array, f: Array) -> Array:
    """Return the least d, in the Euclidean norm, of those that make |f + J d| least; rows are weighed equally."""
    rows = np.abs(J).max(axis=1, initial=0.0)
    weights = np.divide(1.0, rows, out=np.ones_like(rows), where=rows > 0.0)
    return np.linalg.lstsq(J * weights[:, None], -f * weights, rcond=1e-9)[0]


def solve(f: Function, jac: Function, z: Array, free: Sequence[int], size: Array) -> Array:
    """Return a zero of f near z, or a point where |f| is least, by damped Gauss-Newton steps of the `free` entries.

    Steps are the least ones in units of `size` (entries without influence stay) and at most one of these units long.
    """
    z = z.copy()
    s = size[list(free)]
    for _ in range(100):
        value = finite(f, z)
        J = jac(z)[:, list(free)] * s
        step = least_steps(J, value)
        length = float(np.abs(step).max(initial=0.0))
        if length < 1e-14:
            break
        rows = np.abs(J).max(axis=1, initial=0.0)
        weights = np.divide(1.0, rows, out=np.ones_like(rows), where=rows > 0.0)
        moved = _searched(f, z, free, s * step / max(1.0, length), value, weights)
        if moved is None:
            break
        z = moved
    return z


def _searched(f: Function, z: Array, free: Sequence[int], step: Array, value: Array, weights: Array) -> Array | None:
    """Return z after the longest of step, step / 2, ... that makes f smaller; None where none does."""
    before = float(np.linalg.norm(weights * value))
    part = 1.0
    while part > 1e-7:
        new = z.copy()
        new[list(free)] += part * step
        try:
            if float(np.linalg.norm(weights * finite(f, new))) < (1.0 - 1e-4 * part) * before:
                return new
        except EvaluationError:
            pass
        part *= 0.5
    return None
