"""Metrics as rows of text: for the command line, for notebooks and for pages."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .metric_meanings import MetricMeaning
from .metrics import Metrics


def metric_rows(metrics: Metrics) -> list[tuple[str, str]]:
    """Return symbol and value with its unit for each metric of one result."""
    rows = []
    for name, q in metrics.quantities.items():
        value = metrics.values[name]
        unit = "" if math.isnan(value) else q.unit
        rows.append((q.symbol, f"{q.text(value)} {unit}".rstrip() + mark(q, metrics.steady, value)))
    return rows


def side_by_side(metrics: Sequence[Metrics]) -> list[list[str]]:
    """Return a row for each metric with a cell for each result; all are judged by the same signals."""
    return [
        [q.heading, *(q.text(m.values[q.name]) + mark(q, m.steady, m.values[q.name]) for m in metrics)]
        for q in metrics[0].quantities.values()
    ]


def mark(q: MetricMeaning, steady: bool, value: float) -> str:
    """Return the mark of a number that is said of a steady state where there is none."""
    return "" if steady or not q.of_window or math.isnan(value) else "*"
