"""The controller of any linear model as a unit that is stepped: it samples on its own clock and holds its commands.

At each sample, with deviations x, y, u from the equilibrium of the model and those set-points r that it has:

    the state x: measured, or estimated from the measured outputs y by a Kalman filter or a homogeneous observer
    e = x - N_x r,   r_d = ||e||_d,   u_h the LC or IHC at e
    u = u_h + N_u r - d + v, limited;   v' = q s^2 sum over j of Ki_z_ij s^e_j z_j,   s = r_d^-mu

with d the estimated disturbances and v the integral action (HPIC), v' = q r_d^(1-2 mu) K_i d(-ln r_d) e. With the r_d
in the law within its limits q = 1/(y' P G_d y), y = d(-ln r_d) e; elsewhere, and with the LC, the law is linear and q = 1.
v stands still where its input is beyond a limit and v would move farther beyond. Under the super-twisting law v is its own,
u_i = (K_s e)_i - k_1 |s_i|^(1/2) sign(s_i) + v_i with s = S e, and there is no other.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from typing import Any

from fmu_export.errors import UserError

from .. import homogeneity, laws
from ..linear_algebra import Matrix, Vector, dot, solve, transpose
from ..sampled_unit import LEAST, NOT_FINITE, Fault, SampledState, SampledUnit, flushed
from .estimators import Estimate, HomogeneousObserver, KalmanFilter, kalman_step, observer_step
from .interface import DISCRETIZATIONS, ESTIMATORS, INPUTS, LAWS, MODES, NORM_SOLVERS, OUTPUTS, STATES, numbered


class Mode(IntEnum):
    """Values of the output `mode`."""

    IDLE = MODES.index("idle") + 1
    STABILIZING = MODES.index("stabilizing") + 1
    FAULT = MODES.index("fault") + 1


@dataclass(slots=True)
class RegulatorState(SampledState):
    """Everything of the controller that changes during a run."""

    primed: bool = False  # whether the estimator has seen a measurement
    mode: int = Mode.IDLE
    commands: tuple[float, ...] = ()  # held since the last sample
    x: tuple[float, ...] = ()  # estimated state
    d: tuple[float, ...] = ()  # estimated disturbances of the inputs
    b: tuple[float, ...] = ()  # estimated biases of the outputs
    v: tuple[float, ...] = ()  # integral action
    interval: tuple[float, float] = (1.0, 1.0)  # [a, b] of Algorithm 1
    norm: float = 0.0  # homogeneous norm
    norm_used: float = 1.0  # its value in the law


def clamp(value: float, low: float, high: float) -> float:
    """Return `value` limited to [low, high]; `low` for NaN."""
    above = value if value > low else low
    return above if above < high else high


class HomogeneousControllerUnit(SampledUnit):
    """The digital controller between two communication points.

    `values` maps every parameter of the compiled table to its value. Raises UserError where they contradict each other.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = values
        self.n, self.m, self.p = (values[name] for name in ("state_count", "input_count", "output_count"))
        self.law = LAWS[values["law"] - 1]
        self.mu: float = values["mu"]
        self.sample_time = values["sample_time"]
        self.enabled: bool = values["enabled"]
        self.compensate: bool = values["compensate_disturbance"]
        self.design = self._design()
        self.search = self._search()
        semi_implicit = DISCRETIZATIONS[values["discretization"] - 1] == "semi_implicit"
        self.ahead = self.sample_time if semi_implicit else None
        self.lower, self.upper = self._limits()
        self.idle = tuple(clamp(0.0, low, high) for low, high in zip(self.lower, self.upper, strict=True))
        self.y_eq, self.u_eq = self._vector("output_equilibrium", self.p), self._vector("input_equilibrium", self.m)
        self.Nx, self.Nu = self._matrix("Nx", self.n, self.p), self._matrix("Nu", self.m, self.p)
        self.estimator = ESTIMATORS[values["estimator"] - 1]
        self._take_estimator()
        self.state = RegulatorState(
            commands=self.idle,
            x=(0.0,) * self.n,
            d=(0.0,) * self.m,
            b=(0.0,) * self.p,
            v=(0.0,) * self.m,
            interval=(self.search.a_min, self.search.b_max),
        )

    def _vector(self, name: str, count: int) -> list[Any]:
        return [self.values[entry] for entry in numbered(name, count)]

    def _matrix(self, name: str, rows: int, columns: int) -> list[list[float]]:
        entries = self._vector(name, rows * columns)
        return [entries[columns * i : columns * (i + 1)] for i in range(rows)]

    def _exponents(self, name: str) -> list[int]:
        e = self._vector(name, self.n)
        if e[-1] != 0 or any(a - b not in (0, 1) for a, b in pairwise(e)):
            raise UserError("the exponents must fall by 0 or 1 from coordinate to coordinate, to 0")
        return e

    def _design(self) -> laws.BlockDesign:
        n, m = self.n, self.m
        upper = iter(self._vector("P", n * (n + 1) // 2))
        P = [[0.0] * n for _ in range(n)]
        for i in range(n):
            for j in range(i, n):
                P[i][j] = P[j][i] = next(upper)
        e = self._exponents("exponent")
        T, K, Ki = self._matrix("T", n, n), self._matrix("K", m, n), self._matrix("Ki", m, n)
        design = laws.block_design(
            e, T, self._matrix("N", n, n), self._matrix("B", n, m), K, self._matrix("K0", m, n), P, self.mu
        )
        self.S, self.Ks = self._matrix("S", m, n), self._matrix("Ks", m, n)
        self.sta_rates = self._vector("sta_rate", m)
        self.Kiz = transpose(solve(transpose(T), transpose(Ki), "T"))
        if not laws.is_finite(design) or not all(math.isfinite(entry) for row in self.Kiz for entry in row):
            raise UserError("P and the gains must be of moderate size, found block coordinates that are not finite")
        self.integrates = any(entry != 0.0 for row in Ki for entry in row)
        return design

    def _search(self) -> homogeneity.NormSearch:
        a_min, b_max = self.values["a_min"], self.values["b_max"]
        if a_min > b_max:
            raise UserError(f"a_min must not exceed b_max, found a_min = {a_min:g} and b_max = {b_max:g}")
        exact = NORM_SOLVERS[self.values["norm_solver"] - 1] == "exact"
        return homogeneity.NormSearch(exact, a_min, b_max, self.values["j_max"])

    def _limits(self) -> tuple[list[float], list[float]]:
        lower, upper = self._vector("lower", self.m), self._vector("upper", self.m)
        for i, (low, high) in enumerate(zip(lower, upper, strict=True), 1):
            if low > high:
                raise UserError(f"lower_{i} must not exceed upper_{i}, found {low:g} and {high:g}")
        return lower, upper

    def _take_estimator(self) -> None:
        n, m, p = self.n, self.m, self.p
        measured = self.estimator == "measured_state"
        if measured and p != n:
            raise UserError(f"states that are measured need as many outputs, found {n} states and {p} outputs")
        self.x_eq = self.y_eq if measured else self._vector("state_equilibrium", n)
        if measured:
            return
        self.first = self._matrix("first", n, p)
        F, G, C = self._matrix("F", n, n), self._matrix("G", n, m), self._matrix("C", p, n)
        if self.estimator == "homogeneous_observer":
            self._take_observer(F, G, C)
            return
        M, counts = self._matrix("M", n + m + p, p), self._vector("count", p)
        self.filter = KalmanFilter(F, G, C, M, self.values["bias_decay"], counts, self.values["kalman_count_weight"])
        gain_time = self.values["filter_sample_time"]
        if abs(gain_time - self.sample_time) > 1e-9 * self.sample_time:
            raise UserError(
                f"the Kalman filter is for a sample_time of {gain_time:g} s, found sample_time = {self.sample_time:g} s"
            )

    def _take_observer(self, A: Matrix, B: Matrix, C: Matrix) -> None:
        n, p, values = self.n, self.p, self.values
        T, L_0, Lz = self._matrix("To", n, n), self._matrix("L0", n, p), self._matrix("Lz", n, p)
        e, nu = self._exponents("observer_exponent"), values["observer_degree"]
        q_min, q_max = values["q_min"], values["q_max"]
        if q_min > q_max:
            raise UserError(f"q_min must not exceed q_max, found q_min = {q_min:g} and q_max = {q_max:g}")
        self.observer = HomogeneousObserver(A, B, C, T, e, L_0, Lz, nu, q_min, q_max)

    def initialize(self, time: float, inputs: tuple[float, ...]) -> list[str]:
        """Start the sample clock at `time` [s]; with finite inputs, compute the norm of the state that they mean."""
        self.state.start_time = time
        if all(map(math.isfinite, inputs)):
            y, r = self._deviations(inputs)
            x = self._first_estimate(y)
            block = laws.block_state(self.design, self._error(x, r))
            self.state.norm = homogeneity.homogeneous_norm(block.polynomial, self.mu)
        return []

    def sample(self, inputs: tuple[float, ...]) -> list[str]:
        """Run one sample: estimate, decide the mode, command. Returns messages for the log."""
        state = self.state
        bad = [f"{name} = {value}" for name, value in self._used(inputs) if not math.isfinite(value)]
        if bad:
            return self.fail(Fault.NON_FINITE_INPUT, ", ".join(bad))
        if state.mode == Mode.FAULT:
            return []
        y, r = self._deviations(inputs)
        x = self._estimate(y)
        error = self._error(x, r)
        if not all(map(math.isfinite, error)):
            return self.fail(Fault.NON_FINITE_CONTROL, NOT_FINITE)
        block = laws.block_state(self.design, error)
        state.norm = homogeneity.homogeneous_norm(block.polynomial, self.mu, state.norm)
        self._next_mode()
        state.norm_used = 1.0
        if state.mode == Mode.IDLE:
            state.commands = self.idle
            return []
        return self._command(error, block, r)

    def outputs(self) -> tuple[float, ...]:
        """Return the outputs in the order of the compiled table; those that the design has not are 0."""
        s = self.state
        estimated = [x + at_rest for x, at_rest in zip(s.x, self.x_eq, strict=True)]
        return (
            *_padded(s.commands, INPUTS),
            s.norm,
            s.norm_used,
            s.mode,
            *_padded(estimated, STATES),
            *_padded(s.d, INPUTS),
            *_padded(s.b, OUTPUTS),
            s.fault,
        )

    def fail(self, fault: Fault, cause: str) -> list[str]:
        """Command what an idle controller does from now on; the first cause is kept."""
        state = self.state
        state.commands, state.norm_used = self.idle, 1.0
        if state.mode == Mode.FAULT:
            return []
        state.mode, state.fault = Mode.FAULT, fault
        return [f"fault {fault.name.lower()}: {cause}; the commands are 0 within their limits until reset"]

    def _used(self, inputs: tuple[float, ...]) -> list[tuple[str, float]]:
        """Return the inputs that the design has, by their names."""
        names = numbered("measurement", self.p) + numbered("setpoint", self.p)
        return list(zip(names, inputs[: self.p] + inputs[OUTPUTS : OUTPUTS + self.p], strict=True))

    def _deviations(self, inputs: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return measured outputs and set-points less the outputs at the equilibrium."""
        measured, wanted = inputs[: self.p], inputs[OUTPUTS : OUTPUTS + self.p]
        return tuple(  # type: ignore[return-value]
            [flushed(value - at_rest, LEAST) for value, at_rest in zip(values, self.y_eq, strict=True)]
            for values in (measured, wanted)
        )

    def _first_estimate(self, y: Vector) -> list[float]:
        """Return x from the first measurement."""
        return list(y) if self.estimator == "measured_state" else [dot(row, y) for row in self.first]

    def _estimate(self, y: Vector) -> tuple[float, ...]:
        """Advance the estimator and return x; estimates that are not finite are not kept, and x has a NaN."""
        state = self.state
        if self.estimator == "measured_state" or not state.primed:
            estimate = Estimate(self._first_estimate(y), state.d, state.b)
        else:
            held = [command - at_rest for command, at_rest in zip(state.commands, self.u_eq, strict=True)]
            if self.estimator == "kalman":
                estimate = kalman_step(self.filter, Estimate(state.x, state.d, state.b), held, y)
            else:
                estimate = Estimate(observer_step(self.observer, self.sample_time, state.x, held, y), state.d, state.b)
        state.primed = True
        if not all(map(math.isfinite, (*estimate.x, *estimate.d, *estimate.b))):
            return (math.nan,) * self.n
        state.x, state.d, state.b = tuple(estimate.x), tuple(estimate.d), tuple(estimate.b)
        return state.x

    def _error(self, x: Vector, r: Vector) -> list[float]:
        """Return x less the states at rest for the set-points; x itself to the last bit where they are 0."""
        if not any(r):
            return list(x)
        return [x_i - dot(row, r) for x_i, row in zip(x, self.Nx, strict=True)]

    def _next_mode(self) -> None:
        state = self.state
        mode = Mode.STABILIZING if self.enabled else Mode.IDLE
        if mode == Mode.STABILIZING and state.mode != Mode.STABILIZING:
            state.interval = (self.search.a_min, self.search.b_max)
            state.v = (0.0,) * self.m
        if not self.integrates and self.law != "STA":
            state.v = (0.0,) * self.m
        state.mode = mode

    def _command(self, error: Vector, block: laws.BlockState, r: Vector) -> list[str]:
        state = self.state
        added = moved = state.v
        if self.law == "LC":
            u = laws.linear(self.design.K, error)
        elif self.law == "STA":
            u, moved = self._super_twisting(error)
            added = (0.0,) * self.m
        else:
            state.norm_used, state.interval = homogeneity.norm_in_law(
                self.search, block.polynomial, self.mu, state.norm, state.interval
            )
            u = laws.controls(self.design, block, state.norm_used, self.ahead)
        if any(r):
            u = [u_i + dot(row, r) for u_i, row in zip(u, self.Nu, strict=True)]
        if self.compensate:
            u = [u_i - d_i for u_i, d_i in zip(u, state.d, strict=True)]
        wanted = [u_i + v_i + at_rest for u_i, v_i, at_rest in zip(u, added, self.u_eq, strict=True)]
        if not all(map(math.isfinite, wanted)):
            return self.fail(Fault.NON_FINITE_CONTROL, NOT_FINITE)
        state.commands = tuple(map(clamp, wanted, self.lower, self.upper))
        if self.law == "STA":
            return self._integrated(moved, wanted)
        return self._integrate(block, wanted) if self.integrates else []

    def _super_twisting(self, error: Vector) -> tuple[list[float], list[float]]:
        """Return the inputs and the next v."""
        implicit, v = self.ahead is not None, self.state.v
        surfaces = laws.linear(self.S, error)
        found = [
            laws.super_twisting(s, v_i, rate, self.sample_time, implicit)
            for s, v_i, rate in zip(surfaces, v, self.sta_rates, strict=True)
        ]
        u = [u_i + w for u_i, (w, _) in zip(laws.linear(self.Ks, error), found, strict=True)]
        return u, [moved for _, moved in found]

    def _integrate(self, block: laws.BlockState, wanted: Vector) -> list[str]:
        state = self.state
        r = state.norm_used
        free = self.law != "LC" and self.search.a_min < r < self.search.b_max
        rates = laws.integrand(self.design, self.Kiz, r, block, free)
        return self._integrated(
            [v_i + self.sample_time * rate for v_i, rate in zip(state.v, rates, strict=True)], wanted
        )

    def _integrated(self, moved: Vector, wanted: Vector) -> list[str]:
        """Take the next v, but for entries that would push a command farther beyond its limit."""
        state = self.state
        v = [
            v_i if laws.winds_up(u, next_v - v_i, low, high) else flushed(next_v, LEAST)
            for v_i, next_v, u, low, high in zip(state.v, moved, wanted, self.lower, self.upper, strict=True)
        ]
        if not all(map(math.isfinite, v)):
            return self.fail(Fault.NON_FINITE_CONTROL, NOT_FINITE)
        state.v = tuple(v)
        return []


def _padded(values: Vector, count: int) -> tuple[float, ...]:
    return (*values, *[0.0] * (count - len(values)))
