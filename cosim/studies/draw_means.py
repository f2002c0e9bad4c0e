"""Means of a study's numbers over its draws, and their changes over another controller's in the same draws.

Means are over the draws in which the law took over once and acted to the end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..metric_meanings import MetricMeaning
from .comparison import UNSTEADY
from .estimates import MeanEstimate, change_of, mean, root_mean_square
from .numbers import Numbers

NOTHING = MeanEstimate(math.nan)


def kept(draws: Sequence[Numbers]) -> list[Numbers]:
    """Return the draws in which the law acted to the end."""
    return [draw for draw in draws if draw.get("kept")]


def steady(draws: Sequence[Numbers]) -> bool:
    """Return whether the runs of these draws end in a steady state, in at least three quarters of those kept."""
    acted = kept(draws)
    return sum(not draw["steady"] for draw in acted) <= UNSTEADY * len(acted)


def mean_over(draws: Sequence[Numbers], q: MetricMeaning) -> MeanEstimate:
    """Return a metric's mean, or root mean square where it is one of these.

    A draw that never settles counts the run's duration. NaN where no draw was kept, none ever settles, or the metric is one
    of a steady state that was not reached.
    """
    acted = kept(draws)
    if not acted or (q.of_window and not steady(draws)) or (q.never and all(math.isnan(d[q.name]) for d in acted)):
        return NOTHING
    return (root_mean_square if q.over_draws == "rms" else mean)(np.array([_number(draw, q) for draw in acted]))


def change_over(draws: Sequence[Numbers], base: Sequence[Numbers], q: MetricMeaning) -> MeanEstimate:
    """Return by which part the metric's mean lies above that of `base`, in the same draws, over those that both kept."""
    both = [(a, b) for a, b in zip(draws, base, strict=True) if a.get("kept") and b.get("kept")]
    pairs = np.array([[_number(draw, q) for draw in pair] for pair in both]).reshape(-1, 2)
    return change_of(pairs[:, 0], pairs[:, 1], q)


def _number(draw: Numbers, q: MetricMeaning) -> float:
    value = draw[q.name]
    return draw["duration"] if math.isnan(value) and q.never else value
