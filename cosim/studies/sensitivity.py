"""Which parameter decides a number: shares of its variance over draws, estimated from the draws themselves.

Of a number y and a parameter x the first-order index S = Var E[y|x] / Var y (Sobol) is the share of the variance that goes
when x is known. E[y|x] is taken as the mean of y in classes of x of equal size, a list's values as they are, as in Plischke,
Borgonovo and Smith (2013), "Global sensitivity measures from given data". The bias that comes from the number of classes is
taken out, as in the adjusted R^2. Two parameters in common classes give what they decide together. What is left is decided
by more than two parameters together, or by nothing that is varied. Intervals are the jackknife's over groups of draws.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ihc_fmu.arrays import QUIET

from .estimates import CONFIDENCE, MeanEstimate

Array = np.ndarray

KEPT = "kept"
"""Under which what decides whether a law keeps the plant stands."""
LEAST = 64
"""Draws below which nothing is said."""
LEAST_IN_CLASS, MOST_CLASSES = 16, 32
"""Draws in a class, and classes of one parameter."""
MATERIAL = 0.05
"""Share of the variance from which on it is worth a word."""
GROUPS = 20
"""Groups of draws that the jackknife leaves out in turn."""


@dataclass(frozen=True)
class Sensitivity:
    """Of one number: each parameter's share of its variance alone, by name, and of each pair what they add together.

    `rest` is the share that none of them explains. `draws`: how many it is from.
    """

    single: Mapping[str, MeanEstimate]
    pairs: Mapping[tuple[str, str], MeanEstimate]
    draws: int

    @property
    def rest(self) -> float:
        """What neither the parameters alone nor the decided pairs explain, at least 0."""
        pairs = sum(e.value for e in self.pairs.values() if e.decided > 0)
        return max(0.0, 1.0 - sum(max(0.0, e.value) for e in self.single.values()) - pairs)

    def deciding(self, least: float = MATERIAL) -> list[tuple[str, MeanEstimate]]:
        """Return the parameters, and pairs of them, that are decided to add at least that share, the largest first."""
        pairs = {" with ".join(names): estimate for names, estimate in self.pairs.items()}
        found = [(name, e) for name, e in {**self.single, **pairs}.items() if e.decided > 0 and e.value >= least]
        return sorted(found, key=lambda one: -one[1].value)


def sensitivity(inputs: Mapping[str, tuple[Array, bool]], y: Array) -> Sensitivity | None:
    """Return what decides `y`, a number for each draw, NaN in those that do not count.

    `inputs`: by name a number for each draw, and whether it is one of a list. None where there are less than LEAST draws,
    or y is the same in all of them.
    """
    there = np.isfinite(y)
    y = y[there]
    if y.size < LEAST or float(np.ptp(y)) == 0.0:
        return None
    y = (y - np.mean(y)) / np.std(y)
    group = np.random.default_rng(0).permutation(y.size) % GROUPS
    one = min(MOST_CLASSES, int(math.sqrt(y.size)) // 2)
    two = min(MOST_CLASSES, int(math.sqrt(y.size / LEAST_IN_CLASS)))
    fine = {name: classes_of(x[there], listed, one) for name, (x, listed) in inputs.items()}
    coarse = {name: classes_of(x[there], listed, two) for name, (x, listed) in inputs.items()}
    single = {name: _estimate(_shares(classes, y, group)) for name, classes in fine.items()}
    alone = {name: _shares(classes, y, group) for name, classes in coarse.items()}
    pairs = {}
    for a, b in itertools.combinations(inputs, 2):
        together = _shares(coarse[a] * (int(coarse[b].max()) + 1) + coarse[b], y, group)
        pairs[a, b] = _estimate(together - alone[a] - alone[b])
    return Sensitivity(single, pairs, int(y.size))


def classes_of(x: Array, listed: bool, most: int) -> Array:
    """Return the class of each draw: of a list the value's number, otherwise one of `most` of equal size."""
    if listed:
        return np.unique(x, return_inverse=True)[1].astype(np.intp)
    order = np.empty(x.size, dtype=np.intp)
    order[np.argsort(x, kind="stable")] = np.arange(x.size)
    return order * most // x.size


@QUIET
def _shares(classes: Array, y: Array, group: Array) -> Array:
    """Return the adjusted share of the variance between classes: of all draws, then without each group; shape (GROUPS + 1,).

    1 - (within / (n - classes)) / (total / (n - 1)), where within and total are sums of squares.
    """
    count = int(classes.max()) + 1
    cell = group * count + classes

    def sums(weights: Array | None) -> Array:
        of_group = np.bincount(cell, weights, minlength=GROUPS * count).reshape(GROUPS, count).astype(float)
        whole = of_group.sum(axis=0)
        return np.vstack([whole, whole - of_group])

    n, s, q = sums(None), sums(y), sums(y * y)
    between = np.sum(np.where(n > 0.5, s * s / np.maximum(n, 1.0), 0.0), axis=1)
    filled, draws = np.sum(n > 0.5, axis=1), n.sum(axis=1)
    within = q.sum(axis=1) - between
    total = q.sum(axis=1) - s.sum(axis=1) ** 2 / draws
    return 1.0 - (within / (draws - filled)) / (total / (draws - 1.0))


def _estimate(shares: Array) -> MeanEstimate:
    """Return the share of all draws with its interval, from those without each group."""
    from scipy.stats import t  # noqa: PLC0415 - heavy

    value, left = float(shares[0]), shares[1:]
    error = math.sqrt((GROUPS - 1) / GROUPS * float(np.sum((left - np.mean(left)) ** 2)))
    return MeanEstimate(value, float(t.ppf(0.5 + CONFIDENCE / 2, GROUPS - 1)) * error)
