"""Parameters of the plant from the log of a run, with confidence intervals: multiple shooting on the measured angles.

The log is cut into segments, short since the upright equilibrium is unstable. With the residuals r_s of `shooting`,

    minimize  sum_s |r_s|^2  over the parameters p, the bias b and the initial states of all segments,

where b [rad] is where in its count the encoder of delta was zeroed. (That of theta is part of the initial states, since
nothing depends on theta.) What is left when the initial states are eliminated is a problem in p and b, however long the log.

What the log does not hold is taken as absent: disturbances, the motor's inductance, a delay of the measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fmu_export.variables import did_you_mean
from plant_fmu.parameters import ParameterSet, QubeParameters

from ..errors import UserError
from ..provenance import provenance
from ..results import Result
from .segments import LEAST_SEGMENTS, cut
from .shooting import MOST_STEPS, Shooting

Array = np.ndarray

BIAS_FOUND = 1e-3
"""Step of the bias below which it is found, in its scale."""
TOLERANCE = 1e-5
"""Relative change of the sum of squares, and of the parameters, at which the search ends."""

SINGULAR = 1e-8
"""Eigenvalue of the normalized J'J below which the log says nothing of a combination of parameters."""
INVOLVED = 1e-3
"""Share of a parameter in such a combination, of unit length, from which on it is not identifiable."""
LIKE_VOLTAGE = ("D_r", "T_r", "k_m", "R_m")
"""Parameters whose effect is a torque on the arm, as a disturbance voltage's is."""
DISTURBED_SCORE = 50.0
"""Mean square of the segments' voltages over that which white residuals give; 6 to 20 in simulations with the encoders'
counts as the only error (they are not white), 95 and more from a disturbance of 8 mV RMS on."""
DISTURBED_VOLTAGE = 5e-3
"""RMS of the segments' voltages from which on a disturbance is spoken of [V]; at most 3.4 mV in those simulations."""
WIDE = 10.0
"""A parameter with an interval wider than this many times its value, and its scale, is not identifiable from the log."""


@dataclass(frozen=True)
class FittedValue:
    """A fitted value with its 95 % interval, in its unit, and whether the log tells it at all."""

    value: float
    low: float
    high: float
    identifiable: bool


@dataclass(frozen=True)
class Identification:
    """What a log says about the plant.

    parameters: the start set with the fitted values, also with those that are not identifiable. estimates: by the names of
    the parameters. bias [rad]: constant error of the measured delta. rms_before, rms_after [rad]: RMS of the residuals of
    both angles with the start set and with the fitted one, the initial states and the bias fitted in both. segments,
    samples: how many segments and rows were used. disturbance [V]: RMS of what the residuals take a constant voltage in
    each segment for; disturbed: whether that is more than counting explains, so that the arm's damping and friction cannot
    be told from it: they are not identifiable.
    """

    parameters: ParameterSet
    estimates: dict[str, FittedValue]
    bias: FittedValue
    rms_before: float
    rms_after: float
    segments: int
    samples: int
    disturbance: float
    disturbed: bool


def identify(
    result: Result,
    start: ParameterSet,
    names: Sequence[str] = ("D_r", "D_p", "T_r"),
    segment: float = 0.25,
    progress: Callable[[int, float], None] | None = None,
) -> Identification:
    """Return the named parameters of the plant that a log shows, with the others, and the back-EMF, of the set `start`.

    The log has measured angles (plant.theta_encoder, plant.delta_encoder [rad]) and the voltage [V] (hil.applied_voltage, or
    controller.voltage) that was applied over the step that ended at a row; rows may be missing. `segment` [s] is the length
    of a segment; upright an error of the state grows forty-fold in 0.25 s. `progress` is called with the number
    of trials and the RMS residual [rad].

    The intervals are those of a jackknife over segments: the spread of the estimate when one segment after the other is left
    out, to first order, and Student's t with the effective number of segments that a parameter is known from, less one.
    That allows for residuals that depend on each other within a segment, as those of a slow angle seen by an encoder do,
    but takes segments as independent, and knows nothing of a model that is wrong; `disturbed` is a test for that. In
    simulation, with the encoders' counts as the only error, they held the true T_r in all of 24 logs of 8 s, but in 17 of 24
    of 20 s (benchmarks/coverage.py): the arm's few counts while it balances bias T_r by some per cent, and more of it
    narrows the interval, not the bias.

    Raises UserError for a log that is too short, lacks signals, is not finite or does not move, and for unknown names.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 - slow to import

    _check_names(names)
    problem = Shooting(cut(result, segment), start, names)
    trials = 0

    def residuals(z: Array) -> Array:
        nonlocal trials
        trials += 1
        r = problem.residuals(z)
        if progress is not None:
            progress(trials, problem.rms(r))
        return r

    if not problem.can_start():
        raise UserError(f"the log cannot be simulated with the set {start.name}; is it the log of this plant?")
    rms_before = problem.rms_without_bias()
    try:
        solution = least_squares(
            residuals,
            problem.first,
            problem.jacobian,  # type: ignore[arg-type] # a function may stand here
            bounds=(problem.lowest, np.inf),
            method="trf",
            xtol=TOLERANCE,
            ftol=TOLERANCE,
        )
    except np.linalg.LinAlgError:
        raise UserError(f"no parameters near the set {start.name} fit the log; is it the log of this plant?") from None
    estimates = _estimates(problem, solution.x)
    score, disturbance = problem.disturbance(solution.x)
    disturbed = score > DISTURBED_SCORE and disturbance > DISTURBED_VOLTAGE
    if disturbed:
        estimates = [
            replace(e, identifiable=e.identifiable and name not in LIKE_VOLTAGE)
            for name, e in zip((*names, "bias"), estimates, strict=True)
        ]
    named = ", ".join(names)
    fitted = ParameterSet(
        name=f"{start.name}_identified",
        parameters=problem.parameters(solution.x),
        source=f"{named} identified from {_name(result)}; the rest: {start.source}",
        use="the plant that a log shows",
        back_emf=start.back_emf,
    )
    return Identification(
        parameters=fitted,
        estimates=dict(zip(names, estimates, strict=False)),
        bias=estimates[-1],
        rms_before=rms_before,
        rms_after=problem.rms(problem.residuals(solution.x)),
        segments=len(problem.seen),
        samples=int(np.count_nonzero(problem.segments.seen)),
        disturbance=disturbance,
        disturbed=disturbed,
    )


@dataclass(frozen=True)
class Beginning:
    """What a log shows of its measurement and its first moment, with the plant known.

    bias [rad]: constant error of the measured delta. state: theta, delta [rad], theta', delta' [rad/s] at the first row,
    theta as measured on average. rms [rad]: RMS of the residuals of both angles; counting alone leaves a count over the
    square root of 12.
    """

    bias: float
    state: tuple[float, float, float, float]
    rms: float


def beginning(result: Result, plant: ParameterSet, segment: float = 0.25) -> Beginning:
    """Return the bias and the first state that fit a log best, the plant's numbers given.

    Segments are as in `identify`, shorter where the log has no four of them. Raises UserError for a log that is too
    short, lacks signals, is not finite, has a gap at its beginning or cannot be simulated.
    """
    span = float(result.time[-1] - result.time[0]) if len(result.time) else 0.0
    segments = cut(result, min(segment, span / (LEAST_SEGMENTS + 1)), least_motion=0.0)
    if segments.begins[0] != 0:
        raise UserError("the log must be without a long gap at its beginning")
    problem = Shooting(segments, plant, ())
    z = np.zeros(1)
    for _ in range(MOST_STEPS):
        r, by_bias = problem.residuals(z), problem.jacobian(z)[:, 0] if problem.solved else np.zeros(1)
        if not np.all(np.isfinite(r)):
            raise UserError(f"the log cannot be simulated with the set {plant.name}; is it the log of this plant?")
        step = -float(by_bias @ r) / float(by_bias @ by_bias)
        z = z + step
        if abs(step) < BIAS_FOUND:
            break
    r = problem.residuals(z)
    theta, delta, theta_dot, delta_dot = problem.states[:, 0].tolist()
    return Beginning(float(z[0] * problem.scales[0]), (theta, delta, theta_dot, delta_dot), problem.rms(r))


def _check_names(names: Sequence[str]) -> None:
    known = [f.name for f in fields(QubeParameters)]
    for name in names:
        if name not in known:
            raise UserError(f"there is no parameter {name!r}{did_you_mean(name, known)}")
    if not names or len(set(names)) < len(names):
        raise UserError(f"parameters to identify must be named, once each, found {', '.join(names) or 'none'}")


def _name(result: Result) -> str:
    """Return what the log's metadata call it, and its length."""
    return f"a log of {provenance(result).scenario.name}, {result.time[-1] - result.time[0]:g} s"


def _estimates(problem: Shooting, z: Array) -> list[FittedValue]:
    """Return the estimates at the solution z: of the parameters and of b."""
    J = problem.jacobian(z).reshape(*problem.seen.shape, len(z))
    half, known = _half_widths(J, problem.r)
    values = []
    for value, width, scale, told, lowest in zip(z, half, problem.scales, known, problem.lowest, strict=True):
        least = -np.inf if lowest == -np.inf else 0.0
        low, high = max(value - width, least), value + width
        identifiable = bool(told and high - low <= WIDE * max(abs(value), 1.0))
        values.append(FittedValue(float(value * scale), float(low * scale), float(high * scale), identifiable))
    return values


def _half_widths(J: Array, r: Array) -> tuple[Array, Array]:
    """Return half of each unknown's 95 % interval, and whether the residuals depend on it apart from the others.

    J of shape (S, m, P) and r of shape (S, m) at the solution. Leaving out segment s moves the estimate, to first order, by
    d_s = (A - A_s)^-1 J_s' r_s with A = sum_s A_s, A_s = J_s' J_s; the jackknife's covariance is (S - 1)/S sum_s d_s d_s'.
    Combinations of unknowns that A does not tell are left out; the unknowns in them get infinity.
    """
    from scipy.stats import t as student  # noqa: PLC0415 - slow to import

    norms = np.sqrt(np.sum(J * J, axis=(0, 1)))
    norms[norms == 0.0] = 1.0
    J = J / norms
    A_s = np.swapaxes(J, 1, 2) @ J
    eigenvalues, vectors = np.linalg.eigh(np.sum(A_s, axis=0))
    told = eigenvalues > SINGULAR
    U = vectors[:, told]
    known = np.all(np.abs(vectors[:, ~told]) < INVOLVED, axis=1)
    A_s = U.T @ A_s @ U
    A = np.sum(A_s, axis=0)
    tiny = 1e-6 * SINGULAR * np.eye(len(A))  # where one segment tells all, the rest is singular, and the interval huge
    d = np.linalg.solve(A - A_s + tiny, U.T @ np.swapaxes(J, 1, 2) @ r[..., None])[..., 0] @ U.T
    deviation = np.sqrt(np.sum(d * d, axis=0) * (len(d) - 1) / len(d))
    inverse = U @ np.linalg.inv(A)
    share = np.einsum("ij,sjk,ik->si", inverse, A_s, inverse) / np.maximum(np.einsum("ij,ij->i", inverse, U), 1e-300)
    segments = 1.0 / np.maximum(np.sum(share * share, axis=0), 1e-300)
    half = student.ppf(0.975, np.maximum(segments - 1.0, 1.0)) * deviation / norms
    return np.where(known, half, np.inf), known
