"""Points of the unit cube that runs are drawn at: Sobol sets, Latin hypercubes, grids.

One set has a dimension for all that is drawn, since two scrambled Sobol sets side by side do not fill their product.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from fmu_export.errors import UserError

Array = np.ndarray

Sampling = Literal["sobol", "latin", "grid"]

MOST_BITS = 30
"""Of the number of points of a Sobol set."""


def points(sampling: Sampling, dimensions: int, count: int, seed: int) -> Array:
    """Return `count` points in [0, 1)^dimensions, an array of shape (count, dimensions).

    A Sobol set of more points begins with the same ones, a Latin hypercube of another number has others. Raises UserError
    for more points than a Sobol set has.
    """
    from scipy.stats import qmc  # noqa: PLC0415 - heavy

    if not dimensions:
        return np.zeros((count, 0))
    generator = np.random.default_rng(seed)
    if sampling == "latin":
        return qmc.LatinHypercube(dimensions, seed=generator).random(count)  # type: ignore[call-arg] # see draws
    power = math.ceil(math.log2(count))
    if power > MOST_BITS:
        raise UserError(f"a sweep has at most 2^{MOST_BITS} draws, found {count}")
    return qmc.Sobol(dimensions, scramble=True, seed=generator).random_base2(power)[:count]  # type: ignore[call-arg]


def grid(sizes: Sequence[int], repeats: int) -> Array:
    """Return every combination of numbers below `sizes`, the last fastest, each `repeats` times; shape (all, len(sizes))."""
    combinations = np.indices(sizes).reshape(len(sizes), -1).T
    return np.repeat(combinations, repeats, axis=0)
