"""A device in raw units: counts, volts, amperes. Signs, scales and guards sit above it, once, for every device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ..errors import UserError

AMPLIFIER_FAULT, STALL_DETECTED, STALL_ERROR, VOLTAGE_CUT = 1, 2, 4, 8
"""Bits of `Sample.digital`: DI0, DI1, DI2 of the board, and that the device has cut its voltage by itself."""

LED_IDLE, LED_SWING_UP, LED_BALANCE, LED_STOPPED = (0.0, 0.0, 1.0), (1.0, 0.6, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
"""Colours (red, green, blue) of the device's light."""

RETRIES = 3
"""How often a step of the stop sequence is tried again."""

Led = tuple[float, float, float]


class DeviceError(RuntimeError):
    """The device refused or failed; the message says what, why and what to do."""


class LinkLostError(DeviceError):
    """Nothing came from the device within the timeout."""


class UnavailableError(UserError):
    """The device cannot be used on this machine as it is: software, board or process missing, or in use."""


@dataclass(slots=True)
class Sample:
    """One reading, filled again and again.

    tick: periods since the start by the device's own count, which goes on while nobody reads. due: when the sample should
    have come [ns of `time.perf_counter_ns`], 0 where the device's clock is another one. arm, pendulum: encoder counts since
    the zero, pendulum hanging. current [A]; tachometer [counts/s]; digital: bits, see above.
    """

    tick: int = 0
    due: int = 0
    arm: int = 0
    pendulum: int = 0
    current: float = 0.0
    tachometer: float = 0.0
    digital: int = 0


class Device(Protocol):
    """What every device does. Voltages are the hardware's, which turns the arm against the angle's sign.

    In the order of use: `open` takes exclusive access with 0 V, the amplifier off and the encoders at zero; `start` begins
    periodic sampling, `read` waits for the next sample and so paces the loop, `write` sets voltage and light, `enable`
    the amplifier. `safe_stop` and `close` may come at any time and any number of times.
    """

    name: str
    real_time: bool
    """Whether the device's time passes by itself; else each reading is one period after the one before."""
    counters: dict[str, int]
    """What the device's own software counted, for the report."""

    def open(self) -> None:
        """Raise UnavailableError or DeviceError where the device cannot be used."""
        ...

    def start(self, period: float) -> None:
        """Begin sampling every `period` [s], with what the device has to cut the voltage by itself armed."""
        ...

    def read(self, timeout: float) -> Sample:
        """Return the newest sample, the same object each time; raise LinkLostError after `timeout` [s]."""
        ...

    def write(self, voltage: float, led: Led) -> None:
        """Set the voltage [V]; raise DeviceError after `safe_stop`."""
        ...

    def enable(self, on: bool) -> None:
        """Switch the amplifier, at the latest with the next voltage; after `safe_stop` it stays off."""
        ...

    def safe_stop(self, reason: str) -> list[str]:
        """Bring the voltage to 0 and the amplifier to off, end sampling; return what failed on the way."""
        ...

    def close(self) -> list[str]:
        """Give the device back; return what failed."""
        ...
