"""Analytic centers of matrix inequalities by Newton's method: the same point in all coordinates.

    maximize  t log det X(v) + sum_j log det F_j(v),    F_j(v) = F_j0 + sum_k v_k F_jk > 0,    X one of the F_j.

The center for a given t is unique, whatever the coordinates that the F_j are written in, and strictly inside; its log det X
is below the largest one by at most the sum of the sizes of the F_j, divided by t. Source: S. Boyd and L. Vandenberghe,
Convex Optimization, Cambridge 2004, sections 9.6 (self-concordance), 11.3 (path following) and 11.4 (phase I).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

Array = np.ndarray

FIRST, FASTER = 1.0, 30.0
"""Of t: where it begins, and how much it grows from one center to the next."""
NEAR, CENTERED = 0.5, 1e-4
"""Newton decrements: of a center on the way, and of the last one before its last step, whose own is about the square."""
STEPS, SEARCHES = 300, 5
"""Newton steps at most, and those of a line search."""
INSIDE = 1e-10
"""Smallest eigenvalue of what counts as strictly inside."""
WIDE = 1e3
"""Largest eigenvalue of X while an inner point is sought."""


@dataclass(frozen=True, eq=False)
class Affine:
    """A symmetric matrix (k, k) that is affine in v (N,): constant (k, k) and slopes (N, k, k)."""

    constant: Array
    slopes: Array

    def at(self, v: Array) -> Array:
        """Return the matrix at v."""
        return self.constant + np.tensordot(v, self.slopes, 1)


class _Newton(NamedTuple):
    """Newton's step, its decrement, and the eigenvalues of what it adds to each matrix, relative to that, with weights."""

    step: Array
    decrement: float
    changes: list[tuple[float, Array]]


def center(X: Affine, sides: Sequence[Affine], v: Array, gap: float, *, near: bool = False) -> Array | None:
    """Return the v of the center whose log det X is within `gap` of the largest one, from a v strictly inside.

    `near`: v is close to that center already. None where v is not strictly inside, or rounding ends the way there.
    """
    last = sum(len(side.constant) for side in sides) / gap
    return _follow(X, sides, v, last if near else FIRST, last, lambda _: False)


def inside(X: Affine, sides: Sequence[Affine], v: Array) -> Array | None:
    """Return a v strictly inside all F_j > 0, from any v with X > 0; None where none is found with X < WIDE.

    It follows the centers of F_j + s I > 0 for a smaller and smaller s until that is not positive.
    """
    s = max(-float(np.linalg.eigvalsh(side.at(v))[0]) for side in sides)
    if s < -INSIDE:
        return v
    size = len(X.constant)
    box = Affine(WIDE * np.eye(size) - X.constant, -X.slopes)
    lifted = [_lifted(side, np.eye(len(side.constant))) for side in sides] + [_lifted(box, np.zeros((size, size)))]
    below = Affine(np.array([[2.0 * abs(s) + 1.0]]), np.zeros((len(v), 1, 1)))
    reached = _follow(
        _lifted(below, -np.eye(1)), lifted, np.append(v, s + 0.5), FIRST, 1.0 / INSIDE, lambda w: w[-1] < -INSIDE
    )
    return None if reached is None or reached[-1] > -INSIDE else reached[:-1]


def _lifted(side: Affine, slope: Array) -> Affine:
    return Affine(side.constant, np.concatenate([side.slopes, slope[None]]))


def _follow(
    X: Affine, sides: Sequence[Affine], v: Array, t: float, last: float, enough: Callable[[Array], bool]
) -> Array | None:
    """Return the center for t = `last`, or the first point on the way that is enough; None where there is no way."""
    step = np.zeros_like(v)
    for _ in range(STEPS):
        newton = _newton([(t, X), *((1.0, side) for side in sides)], v)
        if newton is None:  # rounding took the step out of the set
            if not step.any():
                return None
            step = step / 2.0
            v = v - step
            continue
        if enough(v):
            return v
        if newton.decrement < (NEAR if t < last else CENTERED):
            if t == last:
                return v + newton.step
            t = min(t * FASTER, last)
        step = newton.step * _length(newton)
        v = v + step
    return None


def _newton(weighted: Sequence[tuple[float, Affine]], v: Array) -> _Newton | None:
    """Return Newton's step; None where a matrix is not positive definite."""
    gradient, hessian, relative = np.zeros(len(v)), np.zeros((len(v), len(v))), []
    try:
        for weight, side in weighted:
            half = np.linalg.inv(np.linalg.cholesky(side.at(v)))
            D = half @ side.slopes @ half.T
            flat = D.reshape(len(v), -1)
            gradient += weight * np.trace(D, axis1=1, axis2=2)
            hessian += weight * (flat @ flat.T)
            relative.append((weight, D))
        scale = 1.0 / np.sqrt(np.diag(hessian))
        step = scale * np.linalg.solve(hessian * scale * scale[:, None], scale * gradient)
        changes = [(weight, np.linalg.eigvalsh(np.tensordot(step, D, 1))) for weight, D in relative]
    except np.linalg.LinAlgError:
        return None
    return _Newton(step, float(np.sqrt(max(gradient @ step, 0.0))), changes)


def _length(newton: _Newton) -> float:
    """Return the share of the step with the largest sum of weighted log det, by Newton's method with damped steps."""
    if newton.decrement < NEAR:
        return 1.0
    length = 1.0 / (1.0 + newton.decrement)
    for _ in range(SEARCHES):
        ratios = [(weight, e / (1.0 + length * e)) for weight, e in newton.changes]
        slope = sum(weight * float(r.sum()) for weight, r in ratios)
        bend = sum(weight * float((r**2).sum()) for weight, r in ratios)
        length += slope / bend / (1.0 + abs(slope) / np.sqrt(bend))
    return length
