"""What a claim is and how it is decided: within a tolerance of the printed number, or by a ranking's share of the draws."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from ..studies.estimates import Share
from ..studies.numbers import Numbers, counted
from .study import Key

Runs = Mapping[Key, Numbers]
"""The numbers of runs."""

Verdict = Literal["holds", "does not hold", "undecided"]

Basis = Literal["independent", "fitted", "repeats"]
"""What a claim's verdict rests on: nothing else; the fits of the swing-up and of SMC1 to just that printed number; numbers
that other claims judge already, as another reading of the same statement or their arithmetical consequence.
"""

RELATIVE = 0.5
"""A printed margin counts as reproduced within half of itself, but at least within one percentage point."""

LEAST_MARGIN = 1.0
"""[%]"""


def verdict_of(share: Share) -> Verdict:
    """Return whether more than half of all draws would show the ranking, as far as the interval decides it."""
    verdicts: dict[int, Verdict] = {1: "holds", 0: "undecided", -1: "does not hold"}
    return verdicts[share.decided]


@dataclass(frozen=True)
class Claim:
    """One statement: what the paper says, its number, ours from the run without draws, and the verdict.

    `low`, `high`: between these ours must lie (both NaN: the share of draws decides). `runs`: the runs that ours is from.
    `main`: one of the paper's main statements, shown first. `basis`: what the verdict rests on.
    """

    section: str
    text: str
    printed: float
    ours: float
    unit: str
    low: float = math.nan
    high: float = math.nan
    share: Share | None = None
    runs: tuple[Key, ...] = ()
    main: bool = False
    basis: Basis = "independent"

    @property
    def verdict(self) -> Verdict:
        """Decided by the tolerance where there is one, by the share of draws otherwise."""
        if not math.isnan(self.low):
            return "holds" if self.low <= self.ours <= self.high else "does not hold"
        if self.share is None:
            raise ValueError(f"the claim {self.text!r} needs a tolerance or draws")
        return verdict_of(self.share)

    @property
    def rule(self) -> str:
        """What the verdict needs, as text."""
        if math.isnan(self.low):
            return "more than half of the draws"
        unit = "" if self.unit == "1" else f" {self.unit}"
        if math.isinf(self.low):
            return f"at most {self.high:.4g}{unit}"
        if math.isinf(self.high):
            return f"at least {self.low:.4g}{unit}"
        return f"{self.low:.4g} to {self.high:.4g}{unit}"


def share_of_wins(runs: Runs, keys: Iterable[Key], better: str, other: str, name: str) -> Share:
    """Return in which share of the draws among `keys` the controller `better` has the smaller number `name`.

    A controller that lost the pendulum loses the draw; draws that both lost, or in which neither has the number, are left
    out.
    """
    wins = draws = 0
    for key in keys:
        if key.variant != better:
            continue
        a, b = (counted(runs[k], name) for k in (key, key._replace(variant=other)))
        if a == b:
            continue
        draws += 1
        wins += a < b
    return Share(wins, draws)


def by_cell(runs: Runs) -> dict[tuple[str, str, float, float], list[Key]]:
    """Return the keys of the runs by (experiment, set, sample time, gain)."""
    cells: dict[tuple[str, str, float, float], list[Key]] = {}
    for key in runs:
        cells.setdefault(key[:4], []).append(key)
    return cells


def margin(a: float, b: float) -> float:
    """Return by how much a lies above b [%]."""
    return 100.0 * (a / b - 1.0)


def tolerance(value: float) -> tuple[float, float]:
    """Return the interval in which a margin [%] counts as the printed one."""
    width = max(LEAST_MARGIN, RELATIVE * abs(value))
    return value - width, value + width
