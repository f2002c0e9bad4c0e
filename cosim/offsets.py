"""The sub-count offsets of a plant's encoders: which there are, and a random draw of them."""

from __future__ import annotations

import numpy as np

from .start_values import StartValue, StartValues

OFFSETS = ("_encoder_offset", "_resolution_offset")
"""How the names of parameters end that say where inside a count a sensor was zeroed, in counts.

A sensor `y` whose parameter `y_resolution` is 0 does not count, so that its offset means nothing.
"""


def random_measurement(own: StartValues, seed: int) -> dict[str, StartValue]:
    """Return encoder offsets drawn uniformly inside a count, and the noise's seed, for a seed of the run.

    `own` are all start values of the plant; nothing is drawn of one that has neither.
    """
    names = offsets(own)
    values = np.random.default_rng(seed).random(len(names))
    drawn_values: dict[str, StartValue] = {name: float(value) for name, value in zip(names, values, strict=True)}
    return drawn_values | ({"noise_seed": seed} if "noise_seed" in own else {})


def offsets(own: StartValues) -> list[str]:
    """Return the names of the offsets of a plant's sensors that count, in the order of its variables."""
    return [name for name in own if name.endswith(OFFSETS) and own.get(name.removesuffix("_offset")) != 0.0]
