"""Draws of what a measurement leaves open, the same for every controller.

The encoders' sub-count offsets decide the steady state so strongly that a few random ones rank controllers by luck. They
are taken from a Sobol set, which covers the unit cube evenly with any number of points, best with a power of two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..offsets import offsets
from ..scenario import Scenario
from ..start_values import StartValue, StartValues

SEED = 1
"""Seed of the scrambling of the Sobol set."""


@dataclass(frozen=True, slots=True)
class Chance:
    """What of a plant is drawn: its encoder offsets by their names, and whether it has noise with a seed."""

    offsets: tuple[str, ...] = ("theta_encoder_offset", "delta_encoder_offset")
    noise: bool = True

    def __bool__(self) -> bool:
        return bool(self.offsets) or self.noise


PENDULUM = Chance()


def chance_of(own: StartValues) -> Chance:
    """Return what is drawn of a plant FMU with these start values; false where nothing is."""
    return Chance(tuple(offsets(own)), "noise_seed" in own)


@lru_cache(maxsize=8)
def encoder_offsets(count: int, encoders: int = 2) -> tuple[tuple[float, ...], ...]:
    """Return the first `count` points of a scrambled Sobol sequence in the unit cube: an offset for each encoder.

    More points begin with the same ones.
    """
    from scipy.stats import qmc  # noqa: PLC0415 - heavy

    generator = np.random.default_rng(SEED)
    sobol = qmc.Sobol(encoders, scramble=True, seed=generator)  # type: ignore[call-arg] # `rng` from SciPy 1.15 on, which takes both
    points = sobol.random_base2(math.ceil(math.log2(count)))
    return tuple(tuple(map(float, point)) for point in points[:count])


def drawn(scenario: Scenario, draw: int, chance: Chance = PENDULUM) -> Scenario:
    """Return the scenario of a draw, counted from 1, see `draw_changes`."""
    return scenario.changed(draw_changes(scenario, draw, chance))


def draw_changes(scenario: Scenario, draw: int, chance: Chance = PENDULUM) -> dict[str, Any]:
    """Return what a draw, counted from 1, changes in a scenario: its encoder offsets, its seed of the noise.

    What the scenario itself sets of these stays.
    """
    size = 1 << (draw - 1).bit_length()  # so that one set serves many draws
    point = encoder_offsets(size, len(chance.offsets))[draw - 1] if chance.offsets else ()
    values: dict[str, StartValue] = dict(zip(chance.offsets, point, strict=True))
    if chance.noise:
        values["noise_seed"] = draw
    changes = {f"plant.start.{name}": value for name, value in values.items() if name not in scenario.plant.start}
    return {**changes, "run.seed": None}
