"""The controller as a unit that is stepped: it samples on its own clock and holds its voltage between samples.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fmu_export.errors import UserError

from .. import homogeneity, laws
from ..linear_algebra import dot
from ..sampled_unit import LEAST, NOT_FINITE, Fault, SampledState, SampledUnit, flushed
from . import velocity
from .interface import (
    DISCRETIZATIONS,
    LAWS,
    NORM_SOLVERS,
    ORDER,
    STATES,
    VELOCITY_SOURCES,
    kalman_gains,
    matrix,
    upper_triangle,
    vector,
)
from .nominal_model import nominal_model
from .supervisor import Capture, Mode, next_mode
from .swing_up import saturate, swing_up, swing_up_voltage

TURN = 2.0 * math.pi
INPUTS = (*STATES, "theta_setpoint")
"""The unit's inputs, in their order."""


@dataclass(slots=True)
class ControllerState(SampledState):
    """Everything of the controller that changes during a run."""

    primed: bool = False  # whether the estimators have seen a measurement
    mode: int = Mode.IDLE
    voltage: float = 0.0  # held since the last sample [V]
    turns: float = 0.0  # whole turns by which the measured delta has been unwrapped
    measured_delta: float = 0.0  # as received last [rad]
    theta_lag: float = 0.0  # velocity filter [rad]
    delta_lag: float = 0.0  # velocity filter, unwrapped [rad]
    observed: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # swing-up observer, delta unwrapped
    interval: tuple[float, float] = (1.0, 1.0)  # [a, b] of Algorithm 1
    norm: float = 0.0  # homogeneous norm
    norm_used: float = 1.0  # its value in the law
    disturbance: float = 0.0  # Kalman filter's estimate [V]
    bias: float = 0.0  # Kalman filter's estimate of the bias of the measured delta [rad]
    integral: float = 0.0  # v of the super-twisting law [V]
    theta_dot: float = 0.0  # velocity that the law uses [rad/s]
    delta_dot: float = 0.0


def _deviation(x: list[float], inputs: tuple[float, ...]) -> list[float]:
    """Return x with the arm's angle less its set-point; x itself to the last bit where that is 0.

    Every angle of the arm is an equilibrium without a voltage, so nothing else depends on the set-point.
    """
    set_point = inputs[4]
    return [x[0] - set_point, *x[1:]] if set_point else x


class IhcControllerUnit(SampledUnit):
    """The digital controller between two communication points.

    `values` maps every parameter of the interface to its value. Raises UserError where they contradict each other.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = values
        self.law = LAWS[values["law"] - 1]
        self.velocity_source = VELOCITY_SOURCES[values["velocity_source"] - 1]
        self.from_inputs = self.velocity_source == "inputs"
        self._take_design()
        self.a_min: float = values["a_min"]
        self.b_max: float = values["b_max"]
        if self.a_min > self.b_max:
            raise UserError(f"a_min must not exceed b_max, found a_min = {self.a_min:g} and b_max = {self.b_max:g}")
        exact = NORM_SOLVERS[values["norm_solver"] - 1] == "exact"
        self.search = homogeneity.NormSearch(exact, self.a_min, self.b_max, values["j_max"])
        self.sample_time = values["sample_time"]
        semi_implicit = DISCRETIZATIONS[values["discretization"] - 1] == "semi_implicit"
        self.ahead = self.sample_time if semi_implicit else None
        self.limit: float = values["voltage_limit"]
        self.cutoff: float = values["velocity_filter_cutoff"]
        self.decay = velocity.filter_decay(self.cutoff, self.sample_time)
        self.gains = velocity.alpha_beta_gains(
            values["observer_acceleration_noise"], values["observer_resolution"], self.sample_time
        )
        self.model = nominal_model(values)
        self.swing_up = swing_up(values)
        self.capture = Capture(
            values["capture_level"], values["capture_angle"], values["capture_velocity"], values["fall_back_angle"]
        )
        if self.capture.angle > self.capture.fall_back_angle:
            raise UserError(
                f"capture_angle must not exceed fall_back_angle, found {self.capture.angle:g} and "
                f"{self.capture.fall_back_angle:g} rad"
            )
        self._take_kalman_filter()
        self.state = ControllerState(interval=(self.a_min, self.b_max))

    def _take_design(self) -> None:
        values = self.values
        entries = [values[name] for name in matrix("Phi")]
        Phi = [entries[ORDER * i : ORDER * (i + 1)] for i in range(ORDER)]
        upper = iter([values[name] for name in upper_triangle("P")])
        P = [[0.0] * ORDER for _ in range(ORDER)]
        for i in range(ORDER):
            for j in range(i, ORDER):
                P[i][j] = P[j][i] = next(upper)
        row, k_lin = ([values[name] for name in vector(gain)] for gain in ("row", "k_lin"))
        self.mu: float = values["mu"]
        self.design = laws.chain_design(Phi, row, k_lin, P, self.mu)
        if not laws.is_finite(self.design):
            raise UserError("Phi, P, k_lin and row must be of moderate size, found a chain form that is not finite")
        self.smc_c = [values[name] for name in vector("smc_c")]
        self.smc_k = [values[name] for name in vector("smc_k")]
        self.smc_rho: float = values["smc_rho"]
        self.sta_c = [values[name] for name in vector("sta_c")]
        self.sta_k = [values[name] for name in vector("sta_k")]
        self.sta_rate: float = values["sta_rate"]

    def _take_kalman_filter(self) -> None:
        values = self.values
        entries = [values[name] for name in kalman_gains()]
        self.kalman_M = list(zip(entries[::2], entries[1::2], strict=True))
        self.count: tuple[float, float] = values["observer_resolution"], values["kalman_count_weight"]
        self.compensate: bool = values["compensate_disturbance"]
        self.kalman_angle: float = values["kalman_angle"]
        gain_time: float = values["kalman_sample_time"]
        if self.velocity_source == "kalman" and abs(gain_time - self.sample_time) > 1e-9 * self.sample_time:
            raise UserError(
                f"velocity_source kalman needs a gain for the sample_time, found kalman_sample_time = {gain_time:g} s and "
                f"sample_time = {self.sample_time:g} s"
            )

    def initialize(self, time: float, inputs: tuple[float, ...]) -> list[str]:
        """Start the sample clock at `time` [s]; with finite inputs, compute the norm of the state that they mean."""
        self.state.start_time = time
        if all(map(math.isfinite, inputs)):
            x = _deviation(self._first_estimate(inputs), inputs)
            self.state.norm = homogeneity.homogeneous_norm(laws.block_state(self.design, x).polynomial, self.mu)
        return []

    def sample(self, inputs: tuple[float, ...]) -> list[str]:
        """Run one sample: estimate, decide the mode, command a voltage. Returns messages for the log."""
        state = self.state
        bad = [f"{name} = {value}" for name, value in zip(INPUTS, inputs, strict=True) if not math.isfinite(value)]
        if bad:
            return self.fail(Fault.NON_FINITE_INPUT, ", ".join(bad))
        if state.mode == Mode.FAULT:
            return []
        inputs = tuple([flushed(value, LEAST) for value in inputs])
        x = self._estimate(inputs, self._unwrap(inputs[1])) if state.primed else self._prime(inputs)
        x = _deviation(x, inputs)
        if not math.isfinite(x[0] + x[1] + x[2] + x[3]):
            return self.fail(Fault.NON_FINITE_CONTROL, NOT_FINITE)
        chain = laws.block_state(self.design, x)
        state.norm = homogeneity.homogeneous_norm(chain.polynomial, self.mu, state.norm)
        earlier = state.mode
        state.mode = next_mode(
            earlier,
            self.capture,
            homogeneity.squared_norm(chain.polynomial, self.mu, 1.0),
            x[1],
            x[3],
            enabled=self.values["enabled"],
            swing_up=self.values["swing_up_enabled"],
        )
        if state.mode == Mode.STABILIZING and earlier != Mode.STABILIZING:
            state.interval = (self.a_min, self.b_max)
            x = self._at_capture(inputs, x)
            chain = laws.block_state(self.design, x)
            state.norm = homogeneity.homogeneous_norm(chain.polynomial, self.mu, state.norm)
        state.theta_dot, state.delta_dot = x[2], x[3]
        if not (self.law == "STA" and state.mode == earlier == Mode.STABILIZING):
            state.integral = 0.0
        command = self._command(x, chain)
        if self.compensate and state.mode == Mode.STABILIZING:
            command -= state.disturbance  # 0 without the Kalman filter
        if not math.isfinite(command):
            return self.fail(Fault.NON_FINITE_CONTROL, NOT_FINITE)
        state.voltage = saturate(command, self.limit)
        return []

    def outputs(self) -> tuple[float, ...]:
        """Return the outputs in the order of the interface."""
        s = self.state
        estimates = s.theta_dot, s.delta_dot, s.disturbance, s.bias
        return s.voltage, s.norm, s.norm_used, s.mode, *estimates, s.fault

    def _first_estimate(self, inputs: tuple[float, ...]) -> list[float]:
        """Return x from the first measurement: at rest, unless velocities are measured too."""
        velocities = [inputs[2], inputs[3]] if self.from_inputs else [0.0, 0.0]
        return [inputs[0], math.remainder(inputs[1], TURN), *velocities]

    def _prime(self, inputs: tuple[float, ...]) -> list[float]:
        """Start the estimators from the first measurement, and return x."""
        x = self._first_estimate(inputs)
        state = self.state
        state.primed = True
        state.theta_lag, state.delta_lag = inputs[0], inputs[1]
        state.measured_delta = inputs[1]
        state.observed = (inputs[0], inputs[1], x[2], x[3])
        state.theta_dot, state.delta_dot = x[2], x[3]
        return x

    def _unwrap(self, measured: float) -> float:
        """Return the pendulum angle without the jumps by a turn of a sensor that wraps."""
        state = self.state
        jump = measured - state.measured_delta
        if abs(jump) > math.pi:
            state.turns -= float(round(jump / TURN))
        state.measured_delta = measured
        return measured + TURN * state.turns

    def _estimate(self, inputs: tuple[float, ...], delta: float) -> list[float]:
        """Return x for the law in force, delta in (-pi, pi]; advance the filter, and the observer where it is used."""
        state = self.state
        theta, wrapped = inputs[0], math.remainder(inputs[1], TURN)  # whole turns cost `delta` small digits
        if self.from_inputs:
            return [theta, wrapped, inputs[2], inputs[3]]
        if self.velocity_source == "kalman":
            return self._kalman_estimate(theta, delta, wrapped)
        theta_dot, state.theta_lag = velocity.filter_velocity(self.cutoff, self.decay, state.theta_lag, theta)
        delta_dot, state.delta_lag = velocity.filter_velocity(self.cutoff, self.decay, state.delta_lag, delta)
        state.theta_dot, state.delta_dot = theta_dot, delta_dot
        if state.mode == Mode.STABILIZING and abs(wrapped) <= self.capture.fall_back_angle:
            state.observed = (theta, delta, theta_dot, delta_dot)
            return [theta, wrapped, theta_dot, delta_dot]
        state.observed = velocity.observe(
            self.model, self.gains, state.observed, state.voltage, self.sample_time, theta, delta
        )
        return self._observed()

    def _observed(self) -> list[float]:
        theta, delta, theta_dot, delta_dot = self.state.observed
        return [theta, math.remainder(delta, TURN), theta_dot, delta_dot]

    def _kalman_estimate(self, theta: float, delta: float, wrapped: float) -> list[float]:
        """Advance the Kalman filter; far from upright, where its linear gain is wrong, the swing-up observer."""
        state, h = self.state, self.sample_time
        if abs(wrapped) > self.kalman_angle:
            state.disturbance = state.bias = 0.0
            state.observed = velocity.observe(self.model, self.gains, state.observed, state.voltage, h, theta, delta)
        else:
            last = state.observed, state.disturbance, state.bias
            observed, disturbance, bias = velocity.kalman_step(
                self.model, self.kalman_M, self.count, *last, state.voltage, h, theta, delta
            )
            if not math.isfinite(disturbance + bias):
                raise OverflowError("the Kalman filter left the range of numbers")
            state.observed, state.disturbance, state.bias = observed, disturbance, bias
        return self._observed()

    def _at_capture(self, inputs: tuple[float, ...], x: list[float]) -> list[float]:
        """Return the deviation for the stabilizing law at capture: with the filter, measured angles, filtered velocities."""
        if self.velocity_source != "filter":
            return x
        delta = math.remainder(inputs[1], TURN)
        return _deviation([inputs[0], delta, self.state.theta_dot, self.state.delta_dot], inputs)

    def _command(self, x: list[float], chain: laws.BlockState) -> float:
        state = self.state
        state.norm_used = 1.0
        if state.mode == Mode.SWING_UP:
            return swing_up_voltage(self.swing_up, self.model, *x)
        if state.mode != Mode.STABILIZING:
            return 0.0
        if self.law == "LC":
            return laws.linear(self.design.K, x)[0]
        if self.law == "SMC":
            return laws.sliding_mode(self.smc_c, self.smc_k, self.smc_rho, x)
        if self.law == "STA":
            return self._super_twisting(x)
        state.norm_used, state.interval = homogeneity.norm_in_law(
            self.search, chain.polynomial, self.mu, state.norm, state.interval
        )
        return laws.controls(self.design, chain, state.norm_used, self.ahead)[0]

    def _super_twisting(self, x: list[float]) -> float:
        """Return the command, and advance its integral part but where that would push it farther beyond its limit."""
        state, implicit = self.state, self.ahead is not None
        w, moved = laws.super_twisting(dot(self.sta_c, x), state.integral, self.sta_rate, self.sample_time, implicit)
        command = dot(self.sta_k, x) + w
        wanted = command - state.disturbance if self.compensate else command
        if not laws.winds_up(wanted, moved - state.integral, -self.limit, self.limit):
            state.integral = flushed(moved, LEAST)
        return command

    def fail(self, fault: Fault, cause: str) -> list[str]:
        """Command 0 V from now on; the first cause is kept."""
        state = self.state
        state.voltage, state.norm_used = 0.0, 1.0
        if state.mode == Mode.FAULT:
            return []
        state.mode, state.fault = Mode.FAULT, fault
        return [f"fault {fault.name.lower()}: {cause}; the voltage is 0 V until reset"]
