"""The rules that end a run: each sample gets a verdict before the controller sees it. Counts and rates; no clock, no I/O."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

from .device import AMPLIFIER_FAULT, STALL_DETECTED, STALL_ERROR, VOLTAGE_CUT, Sample

STALL_VOLTAGE = 5.0
"""Largest voltage while the board reports a stalled motor [V]."""


class Action(Enum):
    """What a sample asks of the loop."""

    GO = 0
    HOLD = 1  # not to be believed: repeat the last voltage without a step of the controller
    LIMIT = 2  # at most STALL_VOLTAGE
    STOP = 3


@dataclass(frozen=True, slots=True)
class Limits:
    """Where the rules bite.

    Angles of the arm [rad]; currents [A] and how long the continuous one may be exceeded [s]; the largest believable speed
    of an encoder [counts/s], above the 78 counts/ms of the motor without load at 10 V; missed periods in a row, and as a
    share of the last second; the longest gap between two samples [s], beyond which nothing is known any more; the
    pendulum's angle [rad] beyond which a balanced one has fallen.
    """

    arm_warning: float = math.radians(90.0)
    arm: float = math.radians(120.0)
    peak_current: float = 2.0
    continuous_current: float = 0.5
    continuous_time: float = 3.0
    encoder_speed: float = 100_000.0
    missed_in_a_row: int = 5
    missed_share: float = 0.01
    longest_gap: float = 1.0
    fall: float = math.radians(20.0)


class Guard:
    """The rules' state over a run."""

    def __init__(
        self, limits: Limits, period: float, *, stop_on_misses: bool = True, stop_on_fall: bool = False
    ) -> None:
        self.limits, self.period = limits, period
        self.stop_on_misses, self.stop_on_fall = stop_on_misses, stop_on_fall
        self.warnings: dict[str, float] = {}  # text: time of its first occurrence [s]
        self.missed = 0  # periods lost since the first sample
        self.dropped = 0  # samples not believed
        self._tick, self._arm, self._pendulum = -1, 0, 0  # of the last believed sample
        self._seen = -1  # tick of the last sample
        self._begin = 0  # tick of the first
        self._jumps = 0
        self._over_current = 0.0  # time beyond the continuous current [s]
        self._in_a_row = 0
        self._recent: deque[tuple[int, int]] = deque()  # (tick, missed) of the last second
        self._balanced = False
        self._most = limits.encoder_speed * period

    def check(self, s: Sample, theta: float, delta: float, *, stabilizing: bool) -> tuple[Action, str]:  # noqa: PLR0911, PLR0912
        """Return what the sample asks for, and why; `stabilizing` is whether the stabilizing law acted last."""
        limits = self.limits
        first = self._seen < 0
        if first:
            self._begin = s.tick
        missed = 0 if first else s.tick - self._seen - 1
        if not 0 <= missed * self.period <= limits.longest_gap or s.tick < 0:
            return (
                Action.STOP,
                f"the device's clock is not to be believed: from period {self._seen} to {s.tick} at once",
            )
        self._seen = s.tick
        if missed or self._in_a_row:
            reason = self._miss(s.tick, missed)
            if reason and self.stop_on_misses:
                return Action.STOP, reason
            if reason:
                self._warn("more periods were missed than a real device would be run with", s.tick)
        if s.digital & ~STALL_DETECTED:
            return Action.STOP, digital_reason(s.digital) or f"unknown digital inputs: {s.digital}"
        current = abs(s.current)
        if not current <= limits.continuous_current:
            reason = self._too_much(current, missed + 1)
            if reason:
                return Action.STOP, reason
        else:
            self._over_current = 0.0
        most = self._most if first else self._most * (s.tick - self._tick)
        if not first and (abs(s.arm - self._arm) > most or abs(s.pendulum - self._pendulum) > most):
            self._jumps += 1
            self.dropped += 1
            if self._jumps >= 2:
                return Action.STOP, "two encoder readings in a row that no motion explains; check the encoder cables"
            self._warn("an encoder reading that no motion explains was dropped", s.tick)
            return Action.HOLD, ""
        self._jumps = 0
        self._tick, self._arm, self._pendulum = s.tick, s.arm, s.pendulum
        if abs(theta) > limits.arm_warning:
            if abs(theta) > limits.arm:
                return Action.STOP, f"arm at {math.degrees(theta):.0f}°, beyond ±{math.degrees(limits.arm):.0f}°"
            self._warn(f"arm beyond ±{math.degrees(limits.arm_warning):.0f}°", s.tick)
        if self.stop_on_fall and self._fell(delta, stabilizing):
            return Action.STOP, f"the pendulum fell: beyond {math.degrees(limits.fall):.0f}° of upright while balancing"
        if s.digital:
            self._warn(f"motor stalled: voltage limited to {STALL_VOLTAGE:g} V", s.tick)
            return Action.LIMIT, ""
        return Action.GO, ""

    def _miss(self, tick: int, missed: int) -> str:
        """Count missed periods; return the rule that they break, or nothing."""
        self.missed += missed
        self._in_a_row = self._in_a_row + missed if missed else 0
        second = round(1.0 / self.period)
        if missed:
            self._recent.append((tick, missed))
        while self._recent and self._recent[0][0] <= tick - second:
            self._recent.popleft()
        if self._in_a_row >= self.limits.missed_in_a_row:
            return f"{self._in_a_row} periods missed in a row; lower the rate or free the processor"
        lost = 0
        for _, count in self._recent:
            lost += count
        allowed = self.limits.missed_share * second
        if lost > allowed:
            return f"{lost} of {second} periods missed within a second, allowed {allowed:g}; lower the rate"
        return ""

    def _too_much(self, current: float, periods: int) -> str:
        """Count the time beyond the continuous current; return the rule that is broken, or nothing."""
        limits = self.limits
        if not math.isfinite(current):
            return f"the current is not finite: {current}"
        if current > limits.peak_current:
            return f"current {current:.2f} A, beyond {limits.peak_current:g} A"
        self._over_current += periods * self.period
        if self._over_current > limits.continuous_time:
            return f"current beyond {limits.continuous_current:g} A for {limits.continuous_time:g} s"
        return ""

    def _fell(self, delta: float, stabilizing: bool) -> bool:
        """Whether a pendulum that has been balanced within half the limit has left it since."""
        angle = abs(math.remainder(delta, 2.0 * math.pi))
        if not stabilizing:
            fell, self._balanced = self._balanced, False
            return fell
        if angle < 0.5 * self.limits.fall:
            self._balanced = True
        return self._balanced and angle > self.limits.fall

    def _warn(self, text: str, tick: int) -> None:
        self.warnings.setdefault(text, (tick - self._begin) * self.period)


def digital_reason(digital: int) -> str:
    """Return why the digital inputs end a run; nothing where they do not."""
    if digital & AMPLIFIER_FAULT:
        return "the amplifier reports a fault; switch the device off and on, check the power supply"
    if digital & STALL_ERROR:
        return "the motor was stalled too long and the board switched it off; free the arm"
    if digital & VOLTAGE_CUT:
        return "the device cut its voltage by itself: it had not heard from the loop in time"
    return ""
