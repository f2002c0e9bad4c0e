"""What a study keeps of each run: its metrics, and whether the law acted to the end."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..judged_signals import kept_upright
from ..metrics import evaluate
from ..results import Result

Numbers = Mapping[str, float]
"""What is kept of a run: numbers by name, NaN where there is none."""

PURPOSE = "metrics 1"
"""Named in the journal; to be changed with `numbers`."""


def numbers(result: Result) -> dict[str, float]:
    """Return all metrics of a run by name, and besides:

    kept: 1 where the law took over once and acts at the end; steady: 1 where the end of the run is a steady state;
    duration [s].
    """
    metrics = evaluate(result)
    return {
        **{name: float(value) for name, value in metrics.values.items()},
        "kept": float(kept_upright(result)),
        "steady": float(metrics.steady),
        "duration": float(result.time[-1] - result.time[0]),
    }


def counted(numbers: Numbers, name: str) -> float:
    """Return a number by which draws are compared: infinite where it is NaN or missing, or the law lost the plant."""
    value = numbers.get(name, math.nan) if numbers.get("kept") else math.nan
    return math.inf if math.isnan(value) else value
