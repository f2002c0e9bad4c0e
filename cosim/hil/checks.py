"""What is verified before a run: that the device rests, and that its signs are the model's."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .device import LED_IDLE, Device, DeviceError, Sample
from .guards import digital_reason
from .scaling import hardware_voltage
from .settings import Settings, Stopped

STILL_COUNTS = 2
"""Encoder counts by which a device at rest may differ from its zero."""

PULSE = 0.06
"""Length [s] of each half of the sign test's pulse, first positive, then negative, which ends near rest."""
VOLTAGES = (0.5, 1.0, 1.5)
"""Voltages [V] tried one after the other until the arm moves."""
MOVED_COUNTS = 4
"""Encoder counts that count as a motion."""
COAST = 0.2
"""Time at 0 V after each pulse [s]."""

TIMEOUT = 0.5


def verify_still(device: Device, settings: Settings, received: list[int]) -> None:
    """Read for `settings.still` [s] at 0 V; raise DeviceError where something moves or a digital input complains."""
    for _ in range(round(settings.still * settings.rate)):
        sample = _next(device, 0.0, received)
        for name, counts in (("arm", sample.arm), ("pendulum", sample.pendulum)):
            if abs(counts) > STILL_COUNTS:
                raise DeviceError(
                    f"the {name} must rest before a run, the pendulum hanging; it moved by {counts} encoder counts; hold it "
                    "still and try again"
                )


@dataclass(frozen=True)
class Signs:
    """What a pulse did, in the model's signs: voltage [V], and where arm and pendulum went [counts]."""

    voltage: float
    arm: int
    pendulum: int

    def problem(self) -> str:
        """Return what is wrong with the signs, and what to do; nothing where all is right."""
        if abs(self.arm) < MOVED_COUNTS and abs(self.pendulum) < MOVED_COUNTS:
            return f"the arm did not move at {self.voltage:g} V: check power supply and amplifier, free the arm"
        if abs(self.arm) < MOVED_COUNTS:
            return "the pendulum moved and the arm's encoder did not: check the arm's encoder"
        if abs(self.pendulum) < MOVED_COUNTS:
            return "the arm moved and the pendulum's encoder did not: plug in the cable of the pendulum's encoder"
        if self.arm < 0:
            return (
                "the arm turned against the voltage's sign: motor or encoder are connected the other way round than this "
                "program expects; do not run the controller"
            )
        if self.pendulum > 0:
            return (
                "the pendulum's encoder counts the other way round than this program expects: look at the sign figure in "
                "docs/hil.md, turn the module to face the front; do not run the controller"
            )
        return ""


def sign_test(device: Device, settings: Settings, received: list[int]) -> Signs:
    """Turn the arm back and forth by a few degrees, amplifier on; raise DeviceError where the signs are wrong.

    A positive voltage must turn the arm to positive angles at first, and the hanging pendulum to negative ones.
    """
    signs = measure_signs(device, settings, received)
    problem = signs.problem()
    if problem:
        raise DeviceError(f"sign test: {problem}")
    return signs


def measure_signs(device: Device, settings: Settings, received: list[int]) -> Signs:
    """Pulse with growing voltages until arm and pendulum move; return the last pulse's motion."""
    length = max(1, round(PULSE * settings.rate))
    signs = Signs(0.0, 0, 0)
    for voltage in VOLTAGES:
        arm, pendulum = [], []
        begin: tuple[int, int] | None = None
        for k in range(2 * length):
            sample = _next(device, voltage if k < length else -voltage, received)
            begin = begin or (sample.arm, sample.pendulum)
            arm.append(begin[0] - sample.arm)  # the model's sign
            pendulum.append(sample.pendulum - begin[1])
        _next(device, 0.0, received)
        signs = Signs(voltage, max(arm, key=abs), max(pendulum[: length + length // 2], key=abs))
        for _ in range(round(COAST * settings.rate)):
            _next(device, 0.0, received)
        if min(abs(signs.arm), abs(signs.pendulum)) >= MOVED_COUNTS:
            break
    return signs


def _next(device: Device, voltage: float, received: list[int]) -> Sample:
    """Read a sample and answer it with `voltage` of the model's sign; raise where an input or a signal says stop."""
    sample = device.read(TIMEOUT)
    if received:
        raise Stopped("stopped by a signal before the run", "signal")
    reason = digital_reason(sample.digital)
    if reason:
        raise DeviceError(reason)
    if not math.isfinite(sample.current):
        raise DeviceError(f"the current is not finite: {sample.current}")
    device.write(hardware_voltage(voltage), LED_IDLE)
    return sample
