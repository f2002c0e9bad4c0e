"""Parameters of the plant from the log of a run: multiple shooting on the measured angles.

The log is cut into segments, short since the upright equilibrium is unstable. In a segment s the angles q follow from the
parameters p, the initial state x_s and the voltage by eq. (5); measured minus simulated angles are the residuals,

    r_s = y_s - q(p, x_s) - (0, b),      minimize  sum_s |r_s|^2  over p, b and all x_s,

with b [rad] a constant error of the measured delta: where in its count the encoder was zeroed. (That of theta is part of the
initial states, since nothing depends on theta.) The initial states are eliminated: for each p and b a few Gauss-Newton steps
find those of all segments at once, 4 unknowns each. What is left is a problem in p and b, with the Jacobian projected onto
the complement of the columns of the initial states (variable projection; Golub and Pereyra, 1973), however long the log is.

What the log does not hold is taken as absent: disturbances, the motor's inductance, a delay of the measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from fmu_export.variables import did_you_mean
from plant_fmu.dynamics import Motor, motor
from plant_fmu.integrator import substeps
from plant_fmu.parameters import ParameterSet, QubeParameters
from rotary_pendulum.equation import Coefficients, solve
from rotary_pendulum.runge_kutta import rk4_step

from ..errors import UserError
from ..provenance import provenance
from ..results import Result

Array = np.ndarray

ANGLES = ("plant.theta_encoder", "plant.delta_encoder")
COMMANDED = "controller.voltage"
VOLTAGES = ("hil.applied_voltage", COMMANDED)
"""Where the voltage over the step that ended at a row is: the first that the log has."""

ZERO_SCALES = {"D_p": 1e-5, "D_r": 1e-4, "T_r": 1e-4}
"""Scales of the parameters that may be 0, where the start is smaller [N.m.s/rad, N.m.s/rad, N.m]."""
BIAS_SCALE = 1e-3
"""Scale of the constant error of the measured delta [rad]."""
SMALLEST = 0.1
"""First guess of a parameter whose start is smaller than this in its scale."""
LOWEST = 0.01
"""Lower bound of the parameters that must be positive, in their start values."""

SOLVER_STEP = 1e-3
"""Longest Runge-Kutta step [s]."""
STATE_STEPS = np.array([1e-6, 1e-6, 1e-5, 1e-5])
"""Differences of the initial states for the Jacobian [rad, rad/s]."""
VOLTAGE_STEP = 0.01
"""Difference of the voltage for the residuals' test [V]."""
PARAMETER_STEP = 1e-5
"""Difference of a parameter for the Jacobian, in its scale."""
FIRST_GUESS = 0.03
"""What the first guess of the initial states looks at [s]."""
CONVERGED = 1e-6
"""The initial states are found when a step would lower each segment's sum of squares by less than this share of it."""
BIAS_FOUND = 1e-3
"""Step of the bias below which it is found, in its scale."""
MOST_STEPS = 20
"""Gauss-Newton steps for the initial states."""
TOLERANCE = 1e-5
"""Relative change of the sum of squares, and of the parameters, at which the search ends."""

LARGEST = 1e9
"""Times [s], angles [rad] and voltages [V] of a log are smaller."""
LEAST_POINTS = 8
"""Points of a segment."""
LEAST_SEGMENTS = 4
LEAST_ROWS = 0.5
"""A segment with gaps is used where it has this share of its rows."""
LEAST_MOTION = 0.05
"""One of the angles must move by this, or there is nothing to identify [rad]."""
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
    problem = _Problem(_read(result, segment), start, names)
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
        found = least_squares(
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
    estimates = problem.estimates(found.x)
    score, disturbance = problem.disturbance(found.x)
    disturbed = score > DISTURBED_SCORE and disturbance > DISTURBED_VOLTAGE
    if disturbed:
        estimates = [
            replace(e, identifiable=e.identifiable and name not in LIKE_VOLTAGE)
            for name, e in zip((*names, "bias"), estimates, strict=True)
        ]
    named = ", ".join(names)
    fitted = ParameterSet(
        name=f"{start.name}_identified",
        parameters=problem.parameters(found.x),
        source=f"{named} identified from {_name(result)}; the rest: {start.source}",
        use="the plant that a log shows",
        back_emf=start.back_emf,
    )
    return Identification(
        parameters=fitted,
        estimates=dict(zip(names, estimates, strict=False)),
        bias=estimates[-1],
        rms_before=rms_before,
        rms_after=problem.rms(problem.residuals(found.x)),
        segments=len(problem.seen),
        samples=int(np.count_nonzero(problem.log.seen)),
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
    log = _read(result, min(segment, span / (LEAST_SEGMENTS + 1)), least_motion=0.0)
    if log.begins[0] != 0:
        raise UserError("the log must be without a long gap at its beginning")
    problem = _Problem(log, plant, ())
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


# The log


@dataclass(frozen=True)
class _Log:
    """S segments of n points on a grid of the log's period [s].

    angles [rad] of shape (n, 2, S), 0 where `seen`, of shape (n, S), says that the log has no row; voltage [V] of shape
    (n - 1, S), held from each point to the next; begins, of shape (S,): the segments' first points in the log.
    """

    period: float
    angles: Array
    seen: Array
    voltage: Array
    begins: Array


def _read(result: Result, segment: float, least_motion: float = LEAST_MOTION) -> _Log:
    """Return the log cut into segments of `segment` [s]; a rest at the end, and segments that are mostly gaps, are left out.

    A row after a gap has the voltage of all the time since the row before it.
    """
    angles, voltage = _signals(result)
    period, points = _grid(np.asarray(result.time, dtype=float))
    n = round(segment / period)
    if n < LEAST_POINTS:
        least = LEAST_POINTS * period
        raise UserError(f"a segment must have at least {LEAST_POINTS} periods, {least:g} s, found {segment:g} s")
    count = (points[-1] + 1) // n
    seen = np.isin(np.arange(count * n), points).reshape(count, n)
    used = np.mean(seen, axis=1) >= LEAST_ROWS
    if np.count_nonzero(used) < LEAST_SEGMENTS:
        raise UserError(
            f"the log must have at least {LEAST_SEGMENTS} segments of {segment:g} s without long gaps, found "
            f"{np.count_nonzero(used)}"
        )
    motion = np.max(np.ptp(angles, axis=0))
    if motion < least_motion:
        raise UserError(f"an angle must move by {least_motion:g} rad, or nothing is to be seen, found {motion:.3g} rad")
    row = np.searchsorted(points, np.arange(count * n))  # at the point, or the first after it
    at = np.where(seen[..., None], angles[row].reshape(count, n, 2), 0.0)
    held = voltage[row].reshape(count, n)
    begins = n * np.flatnonzero(used)
    return _Log(period, at[used].transpose(1, 2, 0), seen[used].T, held[used, 1:].T, begins)


def _signals(result: Result) -> tuple[Array, Array]:
    """Return the angles [rad] of shape (rows, 2) and the voltage [V] over the step that ended at each row."""
    voltage_name = next((name for name in VOLTAGES if name in result.signals), VOLTAGES[-1])
    for name in (*ANGLES, voltage_name):
        if name not in result.signals:
            raise UserError(f"the identification needs {name}; the log has {', '.join(result.signals) or 'no signals'}")
    about = provenance(result)
    if about.every not in (None, 1):
        raise UserError(f"the identification needs every row, found a log with every = {about.every}")
    angles = np.column_stack([result[name] for name in ANGLES]).astype(float)
    voltage = np.asarray(result[voltage_name], dtype=float)
    for name, values in (
        ("time", result.time),
        (ANGLES[0], angles[:, 0]),
        (ANGLES[1], angles[:, 1]),
        (voltage_name, voltage),
    ):
        if not np.all(np.abs(values) < LARGEST):
            raise UserError(f"the identification needs finite numbers below {LARGEST:g}, found others in {name}")
    if voltage_name == COMMANDED and about.order == "parallel":
        voltage = np.concatenate([voltage[:1], voltage[:-1]])  # a row then has the voltage of the next step
    return angles, voltage


def _grid(time: Array) -> tuple[float, Array]:
    """Return the period [s], the shortest step between two rows, and each row's number of periods since the first."""
    steps = np.diff(time)
    if not len(steps) or np.min(steps) <= 0.0:
        raise UserError("the log must have at least two rows, with increasing times")
    period = float(np.min(steps))
    points = np.cumsum(np.concatenate([[0], np.rint(steps / period).astype(int)]))
    if np.max(np.abs(steps / period - np.diff(points))) > 0.1:
        raise UserError(f"rows must be whole periods apart, found steps that are no multiples of {period:g} s")
    return float((time[-1] - time[0]) / points[-1]), points


# The simulation


class _Models(NamedTuple):
    """P pendulums and their motors; each number is an array of shape (P, 1)."""

    pendulums: Coefficients
    motors: Motor


def _models(sets: Sequence[QubeParameters], back_emf: bool) -> _Models:
    def stacked(rows: Sequence[Sequence[float]]) -> Any:
        return np.array(rows).T[..., None]

    motors = [motor(p, back_emf=back_emf) for p in sets]
    return _Models(Coefficients(*stacked([p.coefficients for p in sets])), Motor(*stacked(motors)))


def _simulate(models: _Models, x: Array, log: _Log) -> Array:
    """Return the angles [rad] at the grid's points, of shape (n, 2, P, S), from initial states x of shape (4, P, S).

    P pendulums by the classical Runge-Kutta method, the motor static, the voltage held.
    """
    c, m = models
    per_volt: Any = m.k_m / m.R_m
    braking: Any = m.k_m * m.k_e / m.R_m

    def rate(x: Any) -> Any:
        _, delta, v, w = x
        return v, w, *solve(c, np.sin(delta), np.cos(delta), v, w, drive - braking * v, 0.0)

    count = substeps(log.period, SOLVER_STEP)
    h = log.period / count
    angles = np.empty((len(log.angles), *x[:2].shape))
    angles[0] = x[:2]
    state: Any = tuple(x)
    for k, voltage in enumerate(log.voltage, start=1):
        drive = per_volt * voltage
        for _ in range(count):
            state = rk4_step(rate, state, h)
        angles[k] = state[:2]
    return angles


def _first_states(log: _Log) -> Array:
    """Return initial states of shape (4, S) from a parabola through each segment's first FIRST_GUESS seconds."""
    n = max(LEAST_POINTS - 2, min(len(log.seen), round(FIRST_GUESS / log.period)))
    weight = log.seen[:n].T[..., None]
    basis = weight * np.vander(log.period * np.arange(n), 3, increasing=True)
    found = np.linalg.pinv(basis) @ log.angles[:n].transpose(2, 0, 1)
    return np.concatenate([found[:, 0].T, found[:, 1].T])


# The fit


class _Problem:
    """Residuals and projected Jacobian as functions of z: the named parameters, then b, each in its scale.

    Rows are (segment, point, angle), with 0 where the log has no row. What `_solve` finds for the last z is kept: r of shape
    (S, 2 n), G of shape (S, 2 n, len(z)), the angles' derivatives by z, and orthonormal columns Q of shape (S, 2 n, 4) that
    span those by the initial states.
    """

    def __init__(self, log: _Log, start: ParameterSet, names: Sequence[str]) -> None:
        self.log, self.start, self.names = log, start, tuple(names)
        values = np.array([float(getattr(start.parameters, name)) for name in names])
        self.scales = np.append(np.maximum(values, [ZERO_SCALES.get(name, 0.0) for name in names]), BIAS_SCALE)
        self.at_start = np.append(values, 0.0) / self.scales
        self.first = np.append(np.maximum(self.at_start[:-1], SMALLEST), 0.0)
        self.lowest = np.array([0.0 if name in ZERO_SCALES else LOWEST for name in names] + [-np.inf])
        self.seen = np.repeat(log.seen.T, 2, axis=1)
        self.states, self.slope = _first_states(log), np.zeros((len(self.seen), 4, len(self.scales)))
        self.z = self.at_start.copy()
        self.solved = False

    def parameters(self, z: Array) -> QubeParameters:
        """Return the start's parameters with the named ones from z."""
        values = (z * self.scales).tolist()
        return replace(self.start.parameters, **dict(zip(self.names, values, strict=False)))

    def residuals(self, z: Array) -> Array:
        """Return the residuals [rad] with the best initial states, as one vector."""
        self._solve(z)
        return self.r.ravel()

    def jacobian(self, z: Array) -> Array:
        """Return the residuals' derivatives by z, orthogonal to those by the initial states."""
        self._solve(z)
        return -(self.G - self.Q @ (np.swapaxes(self.Q, 1, 2) @ self.G)).reshape(-1, len(z))

    def rms(self, r: Array) -> float:
        """Return the RMS of residuals [rad] over the rows that the log has."""
        return float(np.sqrt(np.sum(r * r) / np.count_nonzero(self.seen)))

    def can_start(self) -> bool:
        """Whether the residuals with the start set are finite."""
        self.residuals(self.at_start)
        return bool(self.solved)

    def rms_without_bias(self) -> float:
        """Return the RMS of the residuals [rad] with the start set, the initial states and b the best."""
        r = self.residuals(self.at_start)
        by_bias = self.jacobian(self.at_start)[:, -1]
        return self.rms(r - by_bias * (by_bias @ r) / (by_bias @ by_bias))

    def estimates(self, z: Array) -> list[FittedValue]:
        """Return the estimates at the solution z: of the parameters and of b."""
        J = self.jacobian(z).reshape(*self.seen.shape, len(z))
        half, known = _half_widths(J, self.r)
        found = []
        for value, width, scale, told, lowest in zip(z, half, self.scales, known, self.lowest, strict=True):
            least = -np.inf if lowest == -np.inf else 0.0
            low, high = max(value - width, least), value + width
            identifiable = bool(told and high - low <= WIDE * max(abs(value), 1.0))
            found.append(FittedValue(float(value * scale), float(low * scale), float(high * scale), identifiable))
        return found

    def disturbance(self, z: Array) -> tuple[float, float]:
        """Return (score, RMS [V]) of a constant voltage in each segment, a test of the residuals at the solution z.

        With D_s the angles' derivative by a voltage in segment s, orthogonal to those by its initial state, the voltage is
        d_s = D_s' r_s / |D_s|^2; white residuals of variance v give E d_s^2 |D_s|^2 / v = 1, whose mean is the score.
        """
        self._solve(z)
        models = _models([self.parameters(z)], self.start.back_emf)
        q = [
            _simulate(models, self.states[:, None], replace(self.log, voltage=self.log.voltage + shift))
            for shift in (0.0, VOLTAGE_STEP)
        ]
        D = ((q[1] - q[0])[:, :, 0].transpose(2, 0, 1).reshape(self.seen.shape) / VOLTAGE_STEP) * self.seen
        D = D - (self.Q @ (np.swapaxes(self.Q, 1, 2) @ D[..., None]))[..., 0]
        weight = np.maximum(np.sum(D * D, axis=1), 1e-300)
        d = np.sum(D * self.r, axis=1) / weight
        squares = d * d * weight
        variance = max(self.rms(self.r) ** 2, 1e-300)
        return float(np.mean(squares) / variance), float(np.sqrt(np.sum(squares) / np.sum(weight)))

    def _linear(self, z: Array, states: Array) -> tuple[Array, Array, Array]:
        """Return residuals and the angles' derivatives by the initial states and by z, by differences."""
        count = len(self.names)
        shifts = np.hstack([np.zeros((4, 1)), np.diag(STATE_STEPS), np.zeros((4, count))])
        shifted = [z + PARAMETER_STEP * row for row in np.eye(count, len(z))]
        sets = [self.parameters(row) for row in [z] * 5 + shifted]
        with np.errstate(all="ignore"):  # what is not finite is seen where the residuals are compared
            q = _simulate(_models(sets, self.start.back_emf), states[:, None] + shifts[..., None], self.log)
            q = np.ascontiguousarray(q.transpose(3, 0, 1, 2)).reshape(*self.seen.shape, -1)
            y = self.log.angles - np.array([0.0, z[-1] * self.scales[-1]])[:, None]
            r = (y.transpose(2, 0, 1).reshape(self.seen.shape) - q[..., 0]) * self.seen
            slopes = (q[..., 1:] - q[..., :1]) * self.seen[..., None]
        by_bias = np.tile([0.0, self.scales[-1]], self.seen.shape[1] // 2) * self.seen
        G = np.concatenate([slopes[..., 4:] / PARAMETER_STEP, by_bias[..., None]], axis=2)
        return r, slopes[..., :4] / STATE_STEPS, G

    def _solve(self, z: Array) -> None:
        """Find the best initial states for z by Gauss-Newton steps, shorter where a segment's residuals grow.

        The steps begin where the last states lead along their slope by z.
        """
        if self.solved and np.array_equal(z, self.z):
            return
        states = self.states + (self.slope @ (z - self.z)).T
        r, X, G = self._linear(z, states)
        share = np.ones(len(r))
        for _ in range(MOST_STEPS):
            if not np.all(np.isfinite(r)):
                break
            Q, R = np.linalg.qr(X)
            down = (np.swapaxes(Q, 1, 2) @ r[..., None])[..., 0]
            cost = np.sum(r * r, axis=1)
            if np.all(np.sum(down * down, axis=1) <= CONVERGED * cost):
                break
            trial = states + share * np.linalg.solve(R, down[..., None])[..., 0].T
            tried = self._linear(z, trial)
            better = np.sum(tried[0] * tried[0], axis=1) <= cost
            share = np.where(better, np.minimum(2.0 * share, 1.0), share / 4.0)
            states = np.where(better, trial, states)
            r = np.where(better[:, None], tried[0], r)
            X, G = (np.where(better[:, None, None], new, old) for new, old in zip(tried[1:], (X, G), strict=True))
        self.r = r
        if np.all(np.isfinite(r)):
            self.Q, R = np.linalg.qr(X)
            self.slope = -np.linalg.solve(R, np.swapaxes(self.Q, 1, 2) @ G)
            self.G, self.states, self.z, self.solved = G, states, z.copy(), True


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
