"""A Kalman filter's noises from what an engineer knows: sensors' resolutions or deviations, and one bandwidth."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from fmu_export.errors import UserError

from .arrays import QUIET
from .design import Design
from .kalman import NONE, KalmanDesign, Noise, kalman_filter

Array = np.ndarray

FASTER = 3.0
"""Of the disturbance's estimate than the fastest pole of the closed loop, where no bandwidth is given."""
MOST_PER_SAMPLE = 0.3
"""Largest bandwidth that is chosen, times the sample time [rad]."""
MOST_JUMP = 0.1
"""Of the room within the limits: a chosen bandwidth is lowered until a count of a sensor moves no command by more."""
MOST_PER_STEP, MOST_NOTABLE = 0.5, 0.25
"""Fastest pole times sample time, and jump of a command, beyond which something is said."""
NOISE_FREE = 1e-4
"""Deviation of an output whose sensor nobody described, relative to its extent on the unit ball."""
BIAS_RATE = 4.0
"""Intensity of a bias's noise relative to the spectral density of its sensor's [1/s^2]."""
LEAK = 1e-5
"""Rate at which biases are forgotten, relative to the bandwidth."""


@QUIET
@lru_cache(maxsize=4)  # Riccati equations; asked for by the export and by what is remarked of it
def estimator(design: Design) -> KalmanDesign:
    """Return the filter for the system of a design and its sample time; raises as `kalman_filter`.

    Without an output that sees them all, disturbances cannot be estimated: a bandwidth of 0 leaves them out.
    """
    s = design.system
    try:
        *faster, slowest = _bandwidths(design)
        for omega in faster:
            kalman = _filter(design, omega)
            if jump(design, kalman) <= MOST_JUMP:
                return kalman
        return _filter(design, slowest)
    except UserError as error:
        raise UserError(f"{s.name} has no Kalman filter: {str(error).removeprefix(NONE)}{_way_out(design)}") from None


def _filter(design: Design, omega: float) -> KalmanDesign:
    s = design.system
    names = [q.name for q in s.states] + [f"the disturbance of {q.name}" for q in s.inputs]
    names += [f"the bias of {q.name}" for q in s.outputs]
    return kalman_filter(s.A, s.B, np.asarray(s.C), s.sample_time, noise(design, omega), names)


def _way_out(design: Design) -> str:
    """Return what may be left out so that there is a filter, for the end of its refusal."""
    s = design.system
    without = [
        (
            s.bandwidth != 0.0 and s.integral is None,
            {"bandwidth": 0.0},
            "bandwidth = 0 in the system leaves the disturbances out",
        ),
        (bool(s.biases), {"biases": ()}, "without biases there is one"),
    ]
    for possible, change, hint in without:
        if possible:
            changed = replace(design, system=s.changed(**change))
            try:
                _filter(changed, _bandwidths(changed)[-1])
            except UserError:
                continue
            return f"; {hint}"
    return "; measure more, or leave out of the model what no output tells"


def jump(design: Design, kalman: KalmanDesign) -> float:
    """Return by how much a step of a sensor's resolution, or three deviations, moves a command, relative to its room.

    The room is half of what the limits leave; 0 without limits or where no sensor is described.
    """
    s = design.system
    room = np.asarray(s.upper) - np.asarray(s.lower)
    size = np.maximum(np.asarray(s.resolutions), 3.0 * np.asarray(s.deviations))
    moved = np.abs(design.K @ kalman.M[: s.n] - kalman.M[s.n : s.n + s.m]) * size
    return float((moved.max(axis=1) / (0.5 * room)).max())


def _bandwidths(design: Design) -> list[float]:
    """Return the bandwidths to try, from the wanted one down to the slowest pole's rate."""
    first = bandwidth(design)
    if design.system.bandwidth is not None:
        return [first]
    slowest = -float(np.linalg.eigvals(design.A + design.B @ design.K).real.max())
    count = max(1, int(np.ceil(np.log2(max(first / slowest, 1.0)))) + 1)
    return [first / 2.0**i for i in range(count)]


def noise(design: Design, omega: float | None = None) -> Noise:
    """Return the noises of the filter, for the bandwidth omega [rad/s] of the disturbances' estimate, None: the wanted one.

    A sample's variance is deviation^2 + resolution^2/12, for a sensor without both NOISE_FREE of its extent. The intensity
    of disturbance i makes its estimate as fast as the bandwidth omega, as if nothing else moved the system: an output that
    answers to the input's k-th integral with the gain g tells it with q = r omega^(2 k + 2)/g^2, r the sensor's spectral
    density, and outputs together with the harmonic sum. White noise on the inputs has the same size within the bandwidth.
    """
    s = design.system
    variances = _variances(design)
    omega = bandwidth(design) if omega is None else omega
    density = variances * s.sample_time
    powers = _intensities(design, density, max(omega, 1e-300) if s.bandwidth != 0.0 else _fastest(design))
    return Noise(
        inputs=(powers / _reference(design, omega) ** 2).tolist(),
        disturbances=(powers if omega > 0.0 else 0.0 * powers).tolist(),
        biases=[BIAS_RATE * r if q.name in s.biases else 0.0 for q, r in zip(s.outputs, density, strict=True)],
        outputs=variances.tolist(),
        leak=LEAK * _reference(design, omega),
    )


def bandwidth(design: Design) -> float:
    """Return the wanted bandwidth [rad/s] of the disturbances' estimate, 0 where they are not estimated."""
    s = design.system
    if s.bandwidth is not None:
        return s.bandwidth
    return min(FASTER * _fastest(design), MOST_PER_SAMPLE / s.sample_time)


def _reference(design: Design, omega: float) -> float:
    return omega if omega > 0.0 else _fastest(design)


def _fastest(design: Design) -> float:
    """Return the magnitude of the fastest pole of the closed loop [1/s]."""
    return float(np.abs(np.linalg.eigvals(design.A + design.B @ design.K)).max())


def _variances(design: Design) -> Array:
    s = design.system
    C = np.asarray(s.C)
    extent = np.sqrt(np.einsum("ij,ji->i", C, np.linalg.solve(design.P, C.T)))
    deviations = np.asarray(s.deviations)
    known = deviations**2 + np.asarray(s.resolutions) ** 2 / 12.0
    return np.where(known > 0.0, known, (NOISE_FREE * extent) ** 2)


def _intensities(design: Design, density: Array, omega: float) -> Array:
    s = design.system
    C, reached = np.asarray(s.C), s.B / omega
    told = np.zeros(s.m)  # sum over outputs of 1/q
    seen = np.zeros((s.p, s.m), dtype=bool)
    for _ in range(s.n):  # the first Markov parameter that is not 0, in time scaled by omega
        gains = C @ reached
        size = np.abs(C) @ np.abs(reached)
        new = (np.abs(gains) > 1e-9 * np.maximum(size, 1e-300)) & ~seen
        told += (np.where(new, gains, 0.0) ** 2 / density[:, None]).sum(axis=0)
        seen |= new
        reached = s.A @ reached / omega
    return np.where(told > 0.0, omega**2 / np.maximum(told, 1e-300), 0.0)


def remarks(design: Design) -> list[str]:
    """Return what is to be known of a design's sampling and sensors before it runs, a sentence each."""
    s, sentences = design.system, []
    fast = _fastest(design) * s.sample_time
    if fast > MOST_PER_STEP:
        sentences.append(
            f"sample_time = {s.sample_time:g} s is long beside the fastest pole of A + B K, {_fastest(design):.4g} 1/s: the "
            "sampled loop may be far from what is proven, or unstable"
        )
    if not s.measures_state and s.observer is None:
        most = jump(design, estimator(design))
        if most > MOST_NOTABLE:
            sentences.append(
                f"a count of a sensor, or three deviations, moves a command by {100 * most:.0f} % of its room within the "
                "limits: the loop may never come to rest; a smaller `bandwidth` of the estimated disturbances, smaller "
                "gains (`K`, or a larger R of `lqr`) or finer sensors (`resolutions`, `deviations`) lower that"
            )
    return sentences
