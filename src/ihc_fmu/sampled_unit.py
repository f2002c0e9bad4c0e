"""A controller's unit between two communication points: its sample clock, its faults, its state; a base class.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Any

from fmu_export.errors import UserError

FAULTS = ("none", "non_finite_input", "non_finite_control")
MAX_SAMPLES = 1_000_000
"""Most samples in one communication step."""

LEAST = 2.0**-1000
"""Measurements and filtered values below this, about 1e-301, count as 0: further decay would reach subnormal numbers, on
which processors are many times slower."""

LEAST_ESTIMATE = 2.0**-300
"""The same for the estimates of an observer, about 5e-91: models multiply up to three of them."""

NOT_FINITE = "the command is not finite"


class Fault(IntEnum):
    """Values of the output `fault`."""

    NONE = FAULTS.index("none") + 1
    NON_FINITE_INPUT = FAULTS.index("non_finite_input") + 1
    NON_FINITE_CONTROL = FAULTS.index("non_finite_control") + 1


@dataclass(slots=True)
class SampledState:
    """What of the sample clock and the faults changes during a run."""

    start_time: float = 0.0  # [s]
    next_sample: int = 0  # index of the next sample instant
    held: bool = False  # whether it has been said that a step held its inputs over several samples
    fault: int = Fault.NONE


def flushed(value: float, least: float) -> float:
    """Return `value`, 0 where it is smaller in magnitude than `least`; NaN stays."""
    return 0.0 if 0.0 < abs(value) < least else value


def weighed(e: float, count: float, weight: float) -> float:
    """Return e - (1 - weight) sat(e), sat to half a count: a Kalman filter's innovation less what counting alone explains.

    `count` is the sensor's resolution, 0 for none, in the unit of `e`; `weight` in [0, 1], 1 leaves innovations as they are.
    """
    half = 0.5 * count
    within = half if e > half else -half if e < -half else e
    return e - (1.0 - weight) * within


def check_step(sample_time: float, step: float) -> None:
    """Raise UserError where neither the sample time nor the communication step [s] is a multiple of the other."""
    ratio = step / sample_time if step > sample_time else sample_time / step
    if step > sample_time and ratio > MAX_SAMPLES + 0.5:
        raise UserError(
            f"a communication step must not exceed {MAX_SAMPLES} samples of sample_time = {sample_time:g} s, "
            f"found {step:g} s"
        )
    if not math.isfinite(ratio) or abs(ratio - round(ratio)) > 1e-6 * ratio:
        raise UserError(
            f"sample_time must be a multiple of the communication step, or the step of it, found sample_time = "
            f"{sample_time:g} s and a communication step of {step:g} s"
        )


class SampledUnit:
    """Samples its inputs on a clock of its own, and holds its commands between samples.

    A subclass sets `sample_time` [s] and `state`, and implements `sample`, `outputs` and `fail`.
    """

    sample_time: float
    state: Any
    checked_step = 0.0

    def sample(self, inputs: tuple[float, ...]) -> list[str]:
        """Run one sample; return messages for the log. ArithmeticError and ValueError stand for a command that is none."""
        raise NotImplementedError

    def fail(self, fault: Fault, cause: str) -> list[str]:
        """Stop commanding from now on, and return the message; the first cause is kept, others have none."""
        raise NotImplementedError

    def step(self, time: float, step: float, inputs: tuple[float, ...]) -> list[str]:
        """Sample the inputs at each sample instant within `step` [s] from `time` [s] on; hold the commands otherwise.

        Returns messages for the log. Raises UserError where neither the sample time nor the communication step is a
        multiple of the other.
        """
        if step != self.checked_step:
            check_step(self.sample_time, step)
            self.checked_step = step
        state = self.state
        samples = step / self.sample_time
        beyond = samples - 0.5 if samples > 1.0 else 0.5 * samples
        last = math.floor((time - state.start_time) / self.sample_time + beyond)
        if last - state.next_sample >= max(1, round(samples)):
            raise UserError(f"sample {state.next_sample} of sample_time = {self.sample_time:g} s was stepped over")
        messages: list[str] = []
        while state.next_sample <= last:
            state.next_sample += 1
            try:
                messages += self.sample(inputs)
            except (ArithmeticError, ValueError):  # finite measurements beyond the range of numbers on the way
                messages += self.fail(Fault.NON_FINITE_CONTROL, NOT_FINITE)
        if samples > 1.5 and not messages and not state.held:
            state.held = True
            return [
                f"a communication step of {step:g} s holds the inputs over several samples of sample_time = "
                f"{self.sample_time:g} s"
            ]
        return messages

    def get_state(self) -> dict[str, Any]:
        """Return everything that changes during a run, as JSON types."""
        return asdict(self.state)

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore what `get_state` returned, also after a passage through JSON."""
        fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in state.items()}
        self.state = type(self.state)(**fields)
