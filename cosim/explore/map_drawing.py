"""Axes of a map and what is drawn over them, in shares: 0 at the left and lower ends, 1 at the others."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex
from matplotlib.image import imsave
from matplotlib.ticker import LogLocator, MaxNLocator

from ..studies.pareto_files import LARGEST_RATIO

Array = np.ndarray

TICKS = 4
"""On an axis, about."""
MOST_PIXELS = 256
"""Of a map's picture, along each axis."""
ROOM = 0.06
"""Beside the points of a front, as a share of what they extend over."""
SHADES = "viridis_r"
"""Of settling times, from 0 to the latest."""


@dataclass(frozen=True)
class Scale:
    """An axis from `low` to `high`."""

    label: str
    low: float
    high: float
    logarithmic: bool = False

    def share(self, value: float) -> float:
        """Return where a value lies: 0 at `low`, 1 at `high`."""
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low) if value > 0.0 else -math.inf
        return (value - self.low) / (self.high - self.low)

    def drawn(self) -> dict[str, Any]:
        """Return the label and the ticks, their places and texts."""
        locator = LogLocator(subs=(1.0, 2.0, 5.0)) if self.logarithmic else MaxNLocator(TICKS, steps=[1, 2, 5, 10])
        ticks = [float(v) for v in locator.tick_values(self.low, self.high)]
        if self.logarithmic and sum(self.low <= v <= self.high for v in ticks) > 2 * TICKS:
            ticks = [10.0**k for k in range(math.ceil(math.log10(self.low)), math.floor(math.log10(self.high)) + 1)]
        width = self.high - self.low
        texts = [(self.share(v), f"{0.0 if abs(v) < 1e-9 * width else v:.6g}".replace("-", "−")) for v in ticks]
        return {"label": self.label, "ticks": [(at, text) for at, text in texts if -1e-9 <= at <= 1.0 + 1e-9]}


def scale_of(values: Sequence[float], label: str) -> Scale:
    """Return an axis that has some room around values; logarithmic where they are over more than a decade."""
    low, high = min(values), max(values)
    if low > 0.0 and high > LARGEST_RATIO * low:
        room = (high / low) ** ROOM
        return Scale(label, low / room, high * room, logarithmic=True)
    room = ROOM * (high - low) or 0.5 * abs(low) or 1.0
    return Scale(label, low - room, high + room)


def image(shares: Array) -> str:
    """Return a picture of shares (n, m), the first axis to the right and the second up, transparent where NaN."""
    every = -(-max(shares.shape) // MOST_PIXELS)
    buffer = io.BytesIO()
    rgba = mpl.colormaps[SHADES].with_extremes(bad=(0.0, 0.0, 0.0, 0.0))(
        np.ma.masked_invalid(shares[::every, ::every].T)
    )
    imsave(buffer, rgba, origin="lower", format="png")
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def gradient() -> str:
    """Return the shades of a map as CSS."""
    shades = mpl.colormaps[SHADES](np.linspace(0.0, 1.0, 6))
    return f"linear-gradient(to right, {', '.join(to_hex(shade) for shade in shades)})"


def outline(inside: Array) -> str:
    """Return the border of the cells that are inside (n, m), along their sides, as a path with y down."""
    n, m = inside.shape
    sides = []
    for i, j in zip(*np.nonzero(inside[1:] != inside[:-1]), strict=True):
        sides.append(f"M{(i + 1) / n:.5g} {1.0 - j / m:.5g}V{1.0 - (j + 1) / m:.5g}")
    for i, j in zip(*np.nonzero(inside[:, 1:] != inside[:, :-1]), strict=True):
        sides.append(f"M{i / n:.5g} {1.0 - (j + 1) / m:.5g}H{(i + 1) / n:.5g}")
    return "".join(sides)


def polyline(at: Sequence[tuple[float, float]]) -> str:
    """Return a line through points as a path with y down, broken where a point has no number."""
    steps, drawing = [], False
    for x, y in at:
        known = math.isfinite(x) and math.isfinite(y)
        if known:
            steps.append(f"{'L' if drawing else 'M'}{x:.5g} {1.0 - y:.5g}")
        drawing = known
    return "".join(steps)
