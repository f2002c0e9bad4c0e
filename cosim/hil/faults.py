"""Faults of a simulated device, as a script: `kind@time[=value[:duration]]`, separated by commas."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fmu_export.variables import did_you_mean

from ..errors import UserError

KINDS: dict[str, tuple[float | None, float, str]] = {
    "arm-jump": (None, 0.0, "counts added to the arm's encoder, for one sample or the duration"),
    "pendulum-jump": (None, 0.0, "counts added to the pendulum's encoder, for one sample or the duration"),
    "amplifier-fault": (1.0, math.inf, "digital input 0"),
    "stall": (1.0, math.inf, "digital input 1, stall detected"),
    "stall-error": (1.0, math.inf, "digital input 2, stall error"),
    "current": (None, 0.0, "amperes reported instead of the true current; nan is possible"),
    "push": (None, 0.05, "torque on the pendulum [N.m]"),
    "late": (None, 0.0, "periods that pass before the next sample arrives"),
    "silent": (1.0, math.inf, "no sample and no command gets through"),
    "read-error": (1.0, 0.0, "reading fails"),
    "write-error": (1.0, 0.0, "setting the voltage fails"),
}
"""Value and duration [s] where the script names none (None: it must), and what the value is, by kind."""


COUNTS = ("arm-jump", "pendulum-jump", "late")
"""Kinds whose value is a whole number."""


@dataclass(frozen=True, slots=True)
class InjectedFault:
    """Something that goes wrong from `time` [s] of the device's clock for `duration` [s]; 0 is one sample."""

    kind: str
    time: float
    value: float
    duration: float


def parse(script: str) -> tuple[InjectedFault, ...]:
    """Return the faults of a script; raise UserError that names the part, the rule and what was found."""
    return tuple(_one(part.strip()) for part in script.split(",") if part.strip())


def _one(part: str) -> InjectedFault:
    kind, at, rest = part.partition("@")
    if kind not in KINDS:
        raise UserError(f"there is no fault {kind!r}, but {', '.join(KINDS)}{did_you_mean(kind, KINDS)}")
    value, duration, what = KINDS[kind]
    given, has_duration, length = rest.partition(":")
    time, has_value, text = given.partition("=")
    try:
        fault = InjectedFault(
            kind,
            float(time),
            float(text) if has_value else math.nan if value is None else value,
            float(length) if has_duration else duration,
        )
    except ValueError:
        raise UserError(f"a fault is written kind@time[=value[:duration]] with numbers, found {part!r}") from None
    if not at or not (math.isfinite(fault.time) and fault.time >= 0.0) or math.isnan(fault.duration):
        raise UserError(f"a fault needs a time of at least 0 s, as in {kind}@2.5, found {part!r}")
    if value is None and not has_value:
        raise UserError(f"the fault {kind} needs a value ({what}), as in {kind}@2.5=3, found {part!r}")
    if fault.duration < 0.0:
        raise UserError(f"a fault lasts no negative time, found {part!r}")
    if kind in COUNTS and not (math.isfinite(fault.value) and fault.value == int(fault.value)):
        raise UserError(f"the value of {kind} is a whole number, found {part!r}")
    if kind == "late" and fault.value < 1.0:
        raise UserError(f"a sample is late by at least one period, found {part!r}")
    if kind == "push" and not math.isfinite(fault.value):
        raise UserError(f"the torque of push must be finite, found {part!r}")
    return fault
