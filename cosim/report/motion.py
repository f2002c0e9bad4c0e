"""Runs in motion: samples of where bodies are, for the page's animation.

The rotary pendulum moves in space and has a drawing of its own. Of any other plant the scenario says under `animation` which
bodies there are; they move in a plane, x to the right and z up, angles anticlockwise from the direction of x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..animation import ZERO, BodySection
from ..judged_signals import can_evaluate, evaluation_in
from ..recording import Recording

FRAME = 0.02
"""Step of the samples [s], at least."""
MOST_FRAMES = 1001

Array = np.ndarray


def times_of(results: Mapping[str, Recording]) -> Array:
    """Return the times of the samples: those of all runs, every FRAME or, in long runs, fewer."""
    end = max(float(result.time[-1]) for result in results.values())
    count = min(max(math.floor(end / FRAME + 1e-9), 1), MOST_FRAMES - 1)
    return np.linspace(0.0, end, count + 1)


def is_rotary(result: Recording) -> bool:
    """Return whether a run is one of the rotary pendulum, with all that its drawing needs, in numbers."""
    needed = [*(error.signal for error in evaluation_in(result).errors), "controller.voltage", "controller.mode"]
    if evaluation_in(result).kind != "pendulum" or not can_evaluate(result):
        return False
    return all(name in result.signals and np.all(np.isfinite(result[name])) for name in needed)


def pendulum_in_motion(results: Mapping[str, Recording], colours: Mapping[str, str]) -> dict[str, Any]:
    """Return the samples of the rotary pendulum in runs by their names, which have `colours`."""
    times = times_of(results)
    runs = []
    for name, result in results.items():
        theta, delta = (result[error.signal] for error in evaluation_in(result).errors)
        row = np.searchsorted(result.time, times + 1e-9, side="right") - 1
        runs.append(
            {
                "name": name,
                "colour": colours[name],
                "theta": np.round(np.interp(times, result.time, theta), 5).tolist(),
                "delta": np.round(np.interp(times, result.time, delta), 5).tolist(),
                "voltage": np.round(np.interp(times, result.time, result["controller.voltage"]), 3).tolist(),
                "mode": result["controller.mode"][row].tolist(),
            }
        )
    return {"step": float(times[1]), "voltage_limit": 10, "runs": runs}


def bodies_in_motion(
    results: Mapping[str, Recording], colours: Mapping[str, str], bodies: Sequence[BodySection]
) -> dict[str, Any]:
    """Return the samples of bodies in a plane: of each its place and direction, one number where it does not move."""
    times = times_of(results)
    runs = [
        {"name": name, "colour": colours[name], "bodies": [_rounded(p) for p in _places(result, bodies, times)]}
        for name, result in results.items()
    ]
    shapes = [{"shape": body.shape, "size": body.size} for body in bodies]
    return {"step": float(times[1]), "frames": len(times), "bodies": shapes, "runs": runs}


def _places(result: Recording, bodies: Sequence[BodySection], times: Array) -> list[tuple[Array, Array, Array]]:
    """Return x [m], z [m] and the direction [rad] of each body, shapes (times,)."""
    found: dict[str, tuple[Array, Array, Array]] = {}

    def sampled(value: float | str) -> Array:
        if isinstance(value, str):
            return np.interp(times, result.time, result[value])
        return np.full(len(times), float(value))

    for body in bodies:
        x, z, direction = np.zeros(len(times)), np.zeros(len(times)), np.zeros(len(times))
        if body.on is not None:
            size = next(one.reach for one in bodies if one.name == body.on)
            x, z, direction = found[body.on]
            x, z = x + size * np.cos(direction), z + size * np.sin(direction)
        turned = body.sign * sampled(body.angle)
        own = direction + turned if body.relative else ZERO[body.zero] + turned
        found[body.name] = x + sampled(body.x), z + sampled(body.z), own
    return list(found.values())


def _rounded(place: tuple[Array, Array, Array]) -> list[float | list[float]]:
    numbers = [np.round(values, 4) for values in place]
    return [float(values[0]) if np.all(values == values[0]) else values.tolist() for values in numbers]
