"""The loop: measure, step the controller FMU, command, log; begun with checks and ended at 0 V, whatever happens."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ihc_fmu.pendulum.supervisor import Mode

from ..errors import UserError
from ..fmu import FmuError
from ..interrupts import second_ends
from ..judged_signals import STABILIZING
from ..results import Result, versions
from ..signals import STOPPING
from ..structure import Component, Signal
from . import checks, driven
from .controller import ControllerFmu
from .device import LED_BALANCE, LED_IDLE, LED_STOPPED, LED_SWING_UP, Device, DeviceError
from .guards import STALL_VOLTAGE, Action, Guard
from .log import RowLog, percentiles, rows_of, to_result
from .realtime import undisturbed
from .scaling import HALF_TURN, RESOLUTION
from .settings import Ending, Settings, Stopped
from .simulated import HARD_LIMIT

READ_TIMEOUT = 0.1
"""How long the loop waits for a sample [s] before the link counts as lost."""

LEDS: Mapping[int, tuple[float, float, float]] = {
    Mode.IDLE: LED_IDLE,
    Mode.SWING_UP: LED_SWING_UP,
    Mode.STABILIZING: LED_BALANCE,
}
"""The device's light by the controller's mode."""


@dataclass(frozen=True)
class HardwareRun:
    """How a run ended: `reason` in words, `stop` its kind, `failures` what failed while stopping, the log, the signal."""

    reason: str
    stop: Ending
    failures: tuple[str, ...]
    result: Result
    signal: int = 0


@contextmanager
def stop_signals() -> Iterator[list[int]]:
    """Collect SIGINT, SIGTERM and SIGHUP in a list; the loop looks at it after each sample."""
    received: list[int] = []
    earlier = {number: signal.signal(number, lambda n, _: received.append(n)) for number in STOPPING}
    try:
        yield received
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)


class Loop:
    """One run of a controller on a device."""

    def __init__(
        self,
        device: Device,
        component: Component,
        settings: Settings,
        path: Path,
        metadata: Mapping[str, Any] | None = None,
        say: Callable[[str], None] = lambda _text: None,
        signals: Sequence[Signal] = (),
    ) -> None:
        """Check the controller and make the log, `path` with the suffix .rows; `say` is told each stage.

        `signals` act on inputs of the controller. Raises UserError for values of theirs that may not be.
        """
        self.device, self.settings, self.say = device, settings, say
        self.controller = ControllerFmu(component, settings.period, driven.names_of([s.target for s in signals]))
        self.steps = round(settings.duration * settings.rate)
        self.metadata = {
            "versions": dict(versions()),
            "fmus": {
                "controller": {
                    "file": component.path.name,
                    "model": self.controller.instance.description.modelName,
                    "guid": self.controller.instance.description.guid,
                }
            },
            "start_values": {"controller": self.controller.start},
            "order": "controller-first",
            "step": settings.period,
            "every": 1,
            "complete": False,
            **(metadata or {}),
        }
        self.metadata["hil"] = {
            "device": device.name,
            "rate": settings.rate,
            "limits": asdict(settings.limits),
            **self.metadata.get("hil", {}),
        }
        self.log = RowLog(path.with_suffix(".rows"), self.controller.layout, self.steps + 1, self.metadata)
        try:
            values = driven.values_of(signals, settings.period, self.steps)
            driven.check(values, self.controller.instance, settings.limits, settings.period)
        except BaseException:
            self.log.discard()
            raise
        self.controller.follow(values)
        self.guard = Guard(
            settings.limits,
            settings.period,
            stop_on_misses=settings.stop_on_misses,
            stop_on_fall=settings.on_fall == "stop",
        )
        self.notes: list[str] = []
        self._stopping = threading.Lock()
        self._stopped = False

    def run(self) -> HardwareRun:
        """Run to the end, stop the device, and return what came of it; the log's file stays until the result is safe.

        Raises UnavailableError or DeviceError where the device cannot be opened, and UserError where the controller cannot
        be started; whatever happens later is the report's reason.
        """
        failures: list[str] = []
        surprise: BaseException | None = None
        with stop_signals() as received, second_ends(self._last_resort):
            try:
                self._open()
                with undisturbed(real_time=self.device.real_time and self.settings.real_time) as self.notes:
                    reason, kind = "", "fault"
                    try:
                        self._execute(received)
                    except Stopped as stopped:
                        reason, kind = str(stopped), stopped.kind
                    except (DeviceError, FmuError, UserError) as error:
                        reason, kind = str(error), "fault"
                    except BaseException as error:
                        reason, kind, surprise = f"internal error: {error!r}", "fault", error
                    failures += self._stop(reason)
            finally:
                failures += self.device.close()
                self.controller.close()
        number = received[0] if kind == "signal" else 0
        report = HardwareRun(reason, kind, tuple(failures), self._result(reason, kind, failures), number)
        if surprise is not None:
            raise surprise
        return report

    def _open(self) -> None:
        try:
            self.controller.rehearse()
            self.controller.prepare()
            self.device.open()
        except FmuError as error:
            self.log.discard()
            raise UserError(str(error)) from None
        except BaseException:
            self.log.discard()
            raise

    def _stop(self, reason: str) -> list[str]:
        with self._stopping:  # by one thread, and once
            if self._stopped:
                return []
            try:
                return self.device.safe_stop(reason)
            except Exception as error:  # the log must be written whatever happens here
                return [f"the stop itself failed: {error!r}"]
            finally:
                self._stopped = True

    def _last_resort(self) -> str:
        """Stop the device from another thread, where this one hangs in a call, before the process is ended."""
        failures = self._stop("ended while the controller was computing")
        how = "; ".join(failures) if failures else "the device is at 0 V"
        return f"{how}; the rows are in {self.log.path}, the next run into its folder makes a result of them"

    def _execute(self, received: list[int]) -> None:
        settings, device = self.settings, self.device
        device.start(settings.period)
        self.say(f"the device is open; it must rest for {settings.still:g} s")
        checks.verify_still(device, settings, received)
        device.enable(True)
        if settings.sign_test:
            self.say("sign test at low voltage")
            checks.sign_test(device, settings, received)
        self.say("running")
        self._loop(received)

    def _loop(self, received: list[int]) -> None:
        device, controller = self.device, self.controller
        read, write, check, append = device.read, device.write, self.guard.check, self.log.append
        command, get_outputs, mode_of = controller.command, controller.outputs, controller.mode
        now = time.perf_counter_ns
        hold, limit, stop = Action.HOLD, Action.LIMIT, Action.STOP
        sample = read(READ_TIMEOUT)
        woke = now()
        first, last = sample.tick, sample.tick + self.steps
        outputs = controller.begin(RESOLUTION * -sample.arm, RESOLUTION * (sample.pendulum - HALF_TURN))
        mode, u, applied, led = mode_of(outputs), 0.0, 0.0, LED_IDLE
        earlier = 0.0, 0.0, -1  # what the controller was stepped with, and the sample's number

        def log(latency: int, step_time: int, steps: int) -> None:
            raw = sample.arm, sample.pendulum, sample.digital, sample.current, sample.tachometer
            append(sample.tick, sample.due, woke, latency, step_time, steps, *raw, applied, *outputs)

        while True:
            theta, delta = RESOLUTION * -sample.arm, RESOLUTION * (sample.pendulum - HALF_TURN)
            action, reason = check(sample, theta, delta, stabilizing=mode == STABILIZING)
            ended = _ending(sample.tick >= last, received, reason if action is stop else "")
            if ended is not None:
                log(0, 0, 0)
                raise ended
            try:
                before = now()
                steps = 0
                if action is not hold:
                    number, steps = sample.tick - first, 1
                    if number - earlier[2] > 1:
                        steps += controller.catch_up(earlier, theta, delta, number - earlier[2])
                    earlier = theta, delta, number
                    u = command(theta, delta, number)
                    if not -HARD_LIMIT <= u <= HARD_LIMIT:
                        raise Stopped(f"the controller commands {u} V, beyond ±{HARD_LIMIT:g} V or not a number")
                    if action is limit:
                        u = min(STALL_VOLTAGE, max(-STALL_VOLTAGE, u))
                after = now()
                write(-u, led)
            except BaseException:
                log(0, 0, 0)  # what the controller made of this sample was never in force
                raise
            done = now()
            log(done - woke, after - before, steps)
            applied = u
            if steps:
                outputs = get_outputs()
                mode = mode_of(outputs)
                led = LEDS.get(mode, LED_STOPPED)
                if controller.faulted(mode):
                    raise Stopped("the controller has given up: " + "; ".join(controller.instance.messages[-1:]))
            sample = read(READ_TIMEOUT)
            woke = now()

    def _result(self, reason: str, kind: str, failures: list[str]) -> Result:
        """Return the log as a result, with how the run ended."""
        self.log.buffer.flush()
        layout, _, rows = rows_of(self.log.path.read_bytes(), self.log.path)
        metadata = {**self.metadata, "complete": kind == "complete"}
        metadata["hil"] = {
            **self.metadata["hil"],
            "reason": reason,
            "stop": kind,
            "failures": failures,
            "warnings": dict(self.guard.warnings),
            "environment": list(self.notes),
            "missed": self.guard.missed,
            "dropped": self.guard.dropped,
            "counters": dict(self.device.counters),
        }
        messages = self.controller.instance.messages
        if messages:
            metadata["messages"] = {"controller": messages}
        result = to_result(layout, rows, metadata)
        if len(rows):
            metadata["hil"]["timing"] = timing(result)
        return Result(result.time, result.signals, result.units, metadata)


def _ending(over: bool, received: list[int], reason: str) -> Stopped | None:
    """Return how the run ends at this sample; a fault comes before a signal and the end of the duration."""
    if reason:
        return Stopped(reason)
    if received:
        return Stopped(f"stopped by {signal.Signals(received[0]).name}", "signal")
    return Stopped("the duration is over", "complete") if over else None


def timing(result: Result) -> dict[str, dict[str, float]]:
    """Return percentiles [s] over the run of lateness, and of latency (sample to command) and the controller's part of it
    where it was stepped once.
    """
    stepped = result["hil.steps"] == 1
    return {
        "lateness": percentiles(result["hil.lateness"]),
        "latency": percentiles(result["hil.latency"][stepped]),
        "step_time": percentiles(result["hil.step_time"][stepped]),
    }
