"""The real QUBE-Servo 2, or Quanser's virtual twin of it, through Quanser's own Python package.

The package is not on PyPI and is imported when a device is opened, so that nothing else depends on it. Its buffers are
typed arrays, made once here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from .device import (
    AMPLIFIER_FAULT,
    LED_STOPPED,
    RETRIES,
    STALL_DETECTED,
    STALL_ERROR,
    DeviceError,
    Led,
    Sample,
    UnavailableError,
)
from .guards import digital_reason

CARD = "qube_servo2_usb"
IDENTIFIERS = {"qube": "0", "qlabs": "0@tcpip://localhost:18921?nagle='off'"}

WATCHDOG = 0.06
"""The board sets 0 V by itself where it has not heard from the loop for this long [s]."""

BUFFER = 1
"""Samples that the board's reader keeps: a late loop gets the newest, and learns how many it has missed."""

INFINITE = 0x7FFFFFFF
"""As the number of samples: until stopped."""

_U32 = np.uint32
_MOTOR, _AMPLIFIER = np.array([0], _U32), np.array([0], _U32)
_CURRENT, _ENCODERS = np.array([0], _U32), np.array([0, 1], _U32)
_DIGITAL_INPUTS, _TACHOMETER = np.array([0, 1, 2], _U32), np.array([14000], _U32)
_LIGHT = np.array([11000, 11001, 11002], _U32)
_BITS = (AMPLIFIER_FAULT, STALL_DETECTED, STALL_ERROR)

_ADVICE = {
    -107: "the driver of the board was not found; reinstall the Quanser software",
    -108: "no board was found; plug in its USB cable and its power supply, and switch it on",
    -109: "the board is in use by another program; close it",
    -111: "samples were lost in the board's buffer; lower the rate",
    -150: "the board cannot sample this fast; lower the rate",
    -843: "the board did not answer in time; check the USB cable, plug it into the machine and not into a hub",
    -1029: "the board is not connected any more; check its USB cable",
    -1073: "the board is open in another program; close it; after a crash on Linux, remove /dev/shm/sem.qube_servo2_usb*",
}

_EXPIRED = "the board's watchdog expired: it had not heard from the loop in time and set 0 V"

_WATCHDOG_ERRORS, _NO_CLEAR = range(-599, -590), -599
"""What the board says where it has no such call of the watchdog; without the one to clear it, none can have expired."""


def sdk() -> Any:
    """Return Quanser's module `quanser.hardware`; raise UnavailableError that says which part of the SDK is missing."""
    try:
        from quanser import hardware  # type: ignore[import-not-found] # noqa: PLC0415
        from quanser.hardware.enumerations import BufferOverflowMode  # type: ignore[import-not-found] # noqa: F401, PLC0415
    except ImportError as error:
        raise UnavailableError(
            f"Quanser's Python package is not installed in this environment ({error}); install the Quanser SDK, then the "
            "Python wheels in its folder (quanser_common, quanser_hardware, ...) with pip: see docs/hil.md"
        ) from None
    except OSError as error:
        raise UnavailableError(
            f"Quanser's Python package is there, but its library is not ({error}); install the Quanser SDK or the QUARC "
            "runtime for this system: see docs/hil.md"
        ) from None
    return hardware


class QuanserDevice:
    """A board behind Quanser's hardware-in-the-loop interface; its sampling clock paces the loop."""

    real_time = True

    def __init__(self, kind: str = "qube", *, watchdog: bool = True, identifier: str | None = None) -> None:
        self.kind, self.identifier = kind, identifier or IDENTIFIERS[kind]
        self.name = (
            f"QUBE-Servo 2 ({self.identifier})" if kind == "qube" else f"virtual QUBE-Servo 2 ({self.identifier})"
        )
        self.counters: dict[str, int] = {"buffer overflows": 0}
        self._watchdog_wanted, self._watchdog = watchdog, False
        self._card: Any = None
        self._task: Any = None
        self._error: Any = None
        self._sample = Sample()
        self._stopped = False
        self._led: Led | None = None
        self._overflows = 0
        self._voltage, self._digital_out, self._light = np.zeros(1), np.zeros(1, np.int8), np.zeros(3)
        self._current, self._counts = np.zeros(1), np.zeros(2, np.int32)
        self._digital, self._tachometer = np.zeros(3, np.int8), np.zeros(1)

    def open(self) -> None:
        """Take the board: 0 V, amplifier off, counts at zero; raise UnavailableError or DeviceError with advice."""
        hardware = sdk()
        self._error = hardware.HILError
        card = hardware.HIL()
        try:
            card.open(CARD, self.identifier)
        except self._error as error:
            raise UnavailableError(self._text("opening the board", error)) from None
        self._card = card
        if self._watchdog_wanted:
            self._tried("stopping an earlier program's watchdog", card.watchdog_stop)
            self._watchdog_call("clearing the watchdog", card.watchdog_clear, harmless=_NO_CLEAR)
        self._call("setting 0 V", card.write_analog, _MOTOR, 1, self._voltage)
        self._call("switching the amplifier off", card.write_digital, _AMPLIFIER, 1, self._digital_out)
        self._call("reading the digital inputs", card.read_digital, _DIGITAL_INPUTS, 3, self._digital)
        reason = digital_reason(self._bits())
        if reason:
            raise DeviceError(reason)
        self._call("zeroing the encoders", card.set_encoder_counts, _ENCODERS, 2, np.zeros(2, np.int32))

    def start(self, period: float) -> None:
        """Start the reader task, and the watchdog with 0 V, amplifier off and a red light as what it falls back to."""
        from quanser.hardware import Clock  # type: ignore[import-not-found] # noqa: PLC0415
        from quanser.hardware.enumerations import BufferOverflowMode  # type: ignore[import-not-found] # noqa: PLC0415

        card = self._card
        if self._watchdog_wanted:
            set_analog, set_digital = (
                card.watchdog_set_analog_expiration_state,
                card.watchdog_set_digital_expiration_state,
            )
            self._watchdog_call("the watchdog's voltage", set_analog, _MOTOR, 1, np.zeros(1))
            self._watchdog_call("the watchdog's amplifier state", set_digital, _AMPLIFIER, 1, np.zeros(1, np.int32))
            self._tried(  # the light is no matter of safety, and boards may refuse it
                "the watchdog's light",
                lambda: card.watchdog_set_other_expiration_state(_LIGHT, 3, np.array(LED_STOPPED)),
            )
        groups = (_CURRENT, 1, _ENCODERS, 2, _DIGITAL_INPUTS, 3, _TACHOMETER, 1)
        self._task = self._call("making the reader task", card.task_create_reader, BUFFER, *groups)
        mode = BufferOverflowMode.OVERWRITE_ON_OVERFLOW if self.kind == "qube" else BufferOverflowMode.SYNCHRONIZED
        self._call("setting the overflow mode", card.task_set_buffer_overflow_mode, self._task, mode)
        rate = 1.0 / period
        self._call("starting the reader task", card.task_start, self._task, Clock.HARDWARE_CLOCK_0, rate, INFINITE)
        if self._watchdog_wanted:
            self._watchdog_call("starting the watchdog", card.watchdog_start, WATCHDOG)
            self._watchdog = True
        self._sample.tick = -1
        self._read_task, self._get_overflows = card.task_read, card.task_get_buffer_overflows

    def read(self, timeout: float) -> Sample:
        """Wait for the board's next sample. The wait is the library's; an unplugged board ends it with an error."""
        try:
            got = self._read_task(self._task, 1, self._current, self._counts, self._digital, self._tachometer)
            overflows = self._get_overflows(self._task)
        except self._error as error:
            self._fail("reading", error, after_expiry=True)
        if got < 1:
            raise DeviceError("the board has stopped sampling")
        lost = overflows - self._overflows
        if lost:
            self._overflows = overflows
            self.counters["buffer overflows"] += lost
        s = self._sample
        s.tick += 1 + lost
        s.arm, s.pendulum = int(self._counts[0]), int(self._counts[1])
        s.current, s.tachometer = float(self._current[0]), float(self._tachometer[0])
        s.digital = self._bits()
        return s

    def write(self, voltage: float, led: Led) -> None:
        """Set the voltage and, where it changes, the light; tell the watchdog that the loop lives."""
        if self._stopped:
            raise DeviceError("the device has been stopped")
        if not math.isfinite(voltage):
            raise DeviceError(f"the voltage must be finite, found {voltage}")
        card = self._card
        self._voltage[0] = voltage
        try:
            card.write_analog(_MOTOR, 1, self._voltage)
            if self._watchdog and not card.watchdog_reload():
                raise DeviceError(_EXPIRED)
            if led != self._led:
                self._led = led
                self._light[:] = led
                card.write_other(_LIGHT, 3, self._light)
        except self._error as error:
            self._fail("setting the voltage", error, after_expiry=True)

    def enable(self, on: bool) -> None:
        """Switch the amplifier; raise DeviceError after `safe_stop`."""
        if self._stopped:
            raise DeviceError("the device has been stopped")
        self._digital_out[0] = on
        self._call("switching the amplifier", self._card.write_digital, _AMPLIFIER, 1, self._digital_out)

    def safe_stop(self, reason: str) -> list[str]:
        """0 V, amplifier off and a red light, by one call or else each alone; then watchdog and task end."""
        card = self._card
        if card is None or self._stopped:
            return []
        self._stopped = True
        zero, off, red = np.zeros(1), np.zeros(1, np.int8), np.array(LED_STOPPED)
        failures = []
        at_once = self._tried(
            "writing 0 V", lambda: card.write(_MOTOR, 1, None, 0, _AMPLIFIER, 1, _LIGHT, 3, zero, None, off, red)
        )
        if at_once and not self._expired():  # an expired watchdog has set 0 V, and refuses all writing
            failures += self._tried("setting 0 V", lambda: card.write_analog(_MOTOR, 1, zero))
            failures += self._tried("switching the amplifier off", lambda: card.write_digital(_AMPLIFIER, 1, off))
            self._tried("setting the light", lambda: card.write_other(_LIGHT, 3, red))
        if self._watchdog:
            self._watchdog = False
            failures += self._tried("stopping the watchdog", card.watchdog_stop)
        if self._task is not None:
            task, self._task = self._task, None
            failures += self._tried("stopping the task", lambda: card.task_stop(task))
            failures += self._tried("deleting the task", lambda: card.task_delete(task))
        return failures

    def close(self) -> list[str]:
        """Stop where that has not been done, and give the board back."""
        if self._card is None:
            return []
        failures = self.safe_stop("closing")
        card, self._card = self._card, None
        return failures + self._tried("closing the board", card.close)

    def _bits(self) -> int:
        return sum(bit for bit, value in zip(_BITS, self._digital.tolist(), strict=True) if value)

    def _expired(self) -> bool:
        """Whether the watchdog has expired, as far as the board still says."""
        if not self._watchdog:
            return False
        try:
            return bool(self._card.watchdog_is_expired())
        except self._error:
            return False

    def _call(self, what: str, call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except self._error as error:
            self._fail(what, error)

    def _watchdog_call(self, what: str, call: Callable[..., Any], *arguments: Any, harmless: int = 0) -> None:
        try:
            call(*arguments)
        except self._error as error:
            if error.error_code == harmless:
                return
            if error.error_code in _WATCHDOG_ERRORS:
                raise UnavailableError(
                    f"{self._text(what, error)}; this board has no usable watchdog: --no-watchdog runs without it, and then "
                    "a program that dies leaves its last voltage on the motor"
                ) from None
            self._fail(what, error)

    def _tried(self, what: str, call: Callable[[], object]) -> list[str]:
        """Do `call`, at most RETRIES times more where it fails; return the last failure as text, or nothing."""
        failure = ""
        for _ in range(1 + RETRIES):
            try:
                call()
            except Exception as error:  # whatever it is, the next step of the stop must follow
                failure = self._text(what, error)
            else:
                return []
        return [failure]

    def _fail(self, what: str, error: Any, *, after_expiry: bool = False) -> NoReturn:
        """Raise DeviceError with advice; the board has no error of its own for an expired watchdog."""
        if after_expiry and self._expired():
            raise DeviceError(_EXPIRED) from None
        raise DeviceError(self._text(what, error)) from None

    def _text(self, what: str, error: Any) -> str:
        if not isinstance(error, self._error):
            return f"{what}: {error!r}"
        advice = _ADVICE.get(error.error_code)
        return f"{what}: {error.get_error_message()} (error {error.error_code})" + (f"; {advice}" if advice else "")
