"""Multiple shooting: how well a plant with given parameters fits the segments of a log, each from its best initial state.

In a segment s the angles q follow from the parameters p, the initial state x_s and the voltage by eq. (5); measured minus
simulated angles are the residuals,

    r_s = y_s - q(p, x_s) - (0, b),

with b [rad] a constant error of the measured delta. The initial states are eliminated: for each p and b a few Gauss-Newton
steps find those of all segments at once, 4 unknowns each, and the Jacobian by p and b is projected onto the complement of
the columns of the initial states (variable projection; Golub and Pereyra, 1973).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from plant_fmu.dynamics import Motor, motor
from plant_fmu.integrator import substeps
from plant_fmu.parameters import ParameterSet, QubeParameters
from rotary_pendulum.equation import Coefficients, solve
from rotary_pendulum.runge_kutta import rk4_step

from .segments import LEAST_POINTS, Segments

Array = np.ndarray

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
MOST_STEPS = 20
"""Gauss-Newton steps for the initial states."""


class _Models(NamedTuple):
    """P pendulums and their motors; each number is an array of shape (P, 1)."""

    pendulums: Coefficients
    motors: Motor


def _models(sets: Sequence[QubeParameters], back_emf: bool) -> _Models:
    def stacked(rows: Sequence[Sequence[float]]) -> Any:
        return np.array(rows).T[..., None]

    motors = [motor(p, back_emf=back_emf) for p in sets]
    return _Models(Coefficients(*stacked([p.coefficients for p in sets])), Motor(*stacked(motors)))


def _simulate(models: _Models, x: Array, segments: Segments) -> Array:
    """Return the angles [rad] at the grid's points, of shape (n, 2, P, S), from initial states x of shape (4, P, S).

    P pendulums by the classical Runge-Kutta method, the motor static, the voltage held.
    """
    c, m = models
    per_volt: Any = m.k_m / m.R_m
    braking: Any = m.k_m * m.k_e / m.R_m

    def rate(x: Any) -> Any:
        _, delta, v, w = x
        return v, w, *solve(c, np.sin(delta), np.cos(delta), v, w, drive - braking * v, 0.0)

    count = substeps(segments.period, SOLVER_STEP)
    h = segments.period / count
    angles = np.empty((len(segments.angles), *x[:2].shape))
    angles[0] = x[:2]
    state: Any = tuple(x)
    for k, voltage in enumerate(segments.voltage, start=1):
        drive = per_volt * voltage
        for _ in range(count):
            state = rk4_step(rate, state, h)
        angles[k] = state[:2]
    return angles


def _first_states(segments: Segments) -> Array:
    """Return initial states of shape (4, S) from a parabola through each segment's first FIRST_GUESS seconds."""
    n = max(LEAST_POINTS - 2, min(len(segments.seen), round(FIRST_GUESS / segments.period)))
    weight = segments.seen[:n].T[..., None]
    basis = weight * np.vander(segments.period * np.arange(n), 3, increasing=True)
    parabola = np.linalg.pinv(basis) @ segments.angles[:n].transpose(2, 0, 1)
    return np.concatenate([parabola[:, 0].T, parabola[:, 1].T])


class Shooting:
    """Residuals and projected Jacobian as functions of z: the named parameters, then b, each in its scale.

    Rows are (segment, point, angle), with 0 where the log has no row. What `_solve` finds for the last z is kept: r of shape
    (S, 2 n), G of shape (S, 2 n, len(z)), the angles' derivatives by z, and orthonormal columns Q of shape (S, 2 n, 4) that
    span those by the initial states.
    """

    def __init__(self, segments: Segments, start: ParameterSet, names: Sequence[str]) -> None:
        self.segments, self.start, self.names = segments, start, tuple(names)
        values = np.array([float(getattr(start.parameters, name)) for name in names])
        self.scales = np.append(np.maximum(values, [ZERO_SCALES.get(name, 0.0) for name in names]), BIAS_SCALE)
        self.at_start = np.append(values, 0.0) / self.scales
        self.first = np.append(np.maximum(self.at_start[:-1], SMALLEST), 0.0)
        self.lowest = np.array([0.0 if name in ZERO_SCALES else LOWEST for name in names] + [-np.inf])
        self.seen = np.repeat(segments.seen.T, 2, axis=1)
        self.states, self.slope = _first_states(segments), np.zeros((len(self.seen), 4, len(self.scales)))
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

    def disturbance(self, z: Array) -> tuple[float, float]:
        """Return (score, RMS [V]) of a constant voltage in each segment, a test of the residuals at the solution z.

        With D_s the angles' derivative by a voltage in segment s, orthogonal to those by its initial state, the voltage is
        d_s = D_s' r_s / |D_s|^2; white residuals of variance v give E d_s^2 |D_s|^2 / v = 1, whose mean is the score.
        """
        self._solve(z)
        models = _models([self.parameters(z)], self.start.back_emf)
        q = [
            _simulate(models, self.states[:, None], replace(self.segments, voltage=self.segments.voltage + shift))
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
            q = _simulate(_models(sets, self.start.back_emf), states[:, None] + shifts[..., None], self.segments)
            q = np.ascontiguousarray(q.transpose(3, 0, 1, 2)).reshape(*self.seen.shape, -1)
            y = self.segments.angles - np.array([0.0, z[-1] * self.scales[-1]])[:, None]
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
