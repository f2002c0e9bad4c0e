"""What "LMSE" may mean: each reading computed from the same runs, beside the printed numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..judged_signals import STABILIZING, angle_norm
from ..results import Result
from . import printed

Array = np.ndarray


@dataclass(frozen=True)
class Reading:
    """A reading of LMSE: its name, unit and value for each controller."""

    name: str
    unit: str
    values: Mapping[str, float]

    @property
    def ratio(self) -> float:
        """Ours over the printed value, for the LC."""
        return self.values["LC"] / printed.LMSE[0]["LC"]


def readings(results: Mapping[str, Result]) -> list[Reading]:
    """Return every reading, nearest to the printed LC first; `results` by controller, without disturbance."""
    degrees = 180.0 / math.pi
    kinds: tuple[tuple[str, str, Callable[[Array, Array, Array], float]], ...] = (
        ("∫|q|² dt over the run", "rad² s", lambda t, q, _: float(np.trapezoid(q**2, t))),
        ("mean of |q|² over the run", "rad²", lambda t, q, _: float(np.mean(q**2))),
        ("root mean square of |q| over the run", "rad", lambda t, q, _: float(np.sqrt(np.mean(q**2)))),
        ("mean of |q|² over the run", "deg²", lambda t, q, _: float(np.mean((degrees * q) ** 2))),
        ("root mean square of |q| over the run", "deg", lambda t, q, _: degrees * float(np.sqrt(np.mean(q**2)))),
        ("∫|q| dt over the run", "rad s", lambda t, q, _: float(np.trapezoid(q, t))),
        ("∫|q|² dt after the capture", "rad² s", lambda t, q, on: float(np.trapezoid(q[on] ** 2, t[on]))),
        ("∫|q|² dt after the capture", "deg² s", lambda t, q, on: float(np.trapezoid((degrees * q[on]) ** 2, t[on]))),
        ("mean of |q|² after the capture", "deg²", lambda t, q, on: float(np.mean((degrees * q[on]) ** 2))),
        (
            "root mean square of |q| after the capture",
            "deg",
            lambda t, q, on: degrees * float(np.sqrt(np.mean(q[on] ** 2))),
        ),
    )
    every = []
    for name, unit, measure in kinds:
        values = {}
        for law, result in results.items():
            on = result["controller.mode"] == STABILIZING
            values[law] = measure(result.time, angle_norm(result), on)
        every.append(Reading(name, unit, values))
    return sorted(every, key=lambda reading: abs(math.log(reading.ratio)))
