"""The loop: measure, step the controller FMU, command, log; begun with checks and ended at 0 V, whatever happens."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..fmu import FmuError, Instance
from ..interrupts import second_ends
from ..metrics import STABILIZING
from ..native_loop import NativeLoop
from ..results import Result, versions
from ..signals import STOPPING
from ..structure import Component
from . import checks
from .device import LED_BALANCE, LED_IDLE, LED_STOPPED, LED_SWING_UP, Device, DeviceError
from .guards import STALL_VOLTAGE, Action, Guard
from .log import Layout, RowLog, percentiles, rows_of, to_result
from .realtime import undisturbed
from .scaling import HALF_TURN, RESOLUTION
from .settings import Ending, Settings, Stopped
from .simulated import HARD_LIMIT

READ_TIMEOUT = 0.1
"""How long the loop waits for a sample [s] before the link counts as lost."""

MOST_CAUGHT_UP = 10
"""Missed samples that the controller is given afterwards, at most."""

LEDS = {1: LED_IDLE, 2: LED_SWING_UP, STABILIZING: LED_BALANCE}
"""The device's light by the controller's mode."""


@dataclass(frozen=True)
class Report:
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


class Controller:
    """The controller FMU with its buffers: what the loop calls, and nothing else in between."""

    def __init__(self, component: Component, period: float) -> None:
        self.instance = instance = Instance("controller", Path(component.path))
        for name, causality, unit in (("theta", "input", "rad"), ("delta", "input", "rad"), ("voltage", "output", "V")):
            instance.require(name, causality, unit)
        self.start = instance.checked_start(component.start)
        sample_time = self.start.get("sample_time", period)
        if not math.isclose(float(sample_time), period, rel_tol=1e-9):
            raise UserError(f"controller.sample_time must be the loop's period, {period:g} s, found {sample_time:g} s")
        outputs = instance.outputs()
        if texts := instance.texts():
            instance.messages.append(f"warning: String outputs are not recorded: {', '.join(texts)}")
        self.layout = Layout(
            tuple(v.name for v in outputs if v.type == "Real"),
            tuple(v.name for v in outputs if v.type != "Real"),
            {v.name: v.unit or "1" for v in outputs},
        )
        self.period = period
        self._mode = self.layout.integers.index("mode") if "mode" in self.layout.integers else None
        self._fault_mode = instance.item("mode", "fault")
        if "mode" in self.layout.units and self._fault_mode is None:
            raise UserError(
                f"{component.path}: mode must be an Enumeration with the item fault, by which the controller gives up, "
                f"found {instance.variables['mode'].type}"
            )

    def rehearse(self) -> None:
        """Do once all that a run calls, for a pendulum that hangs at rest, so that nothing of it fails with a motor on.

        Raises FmuError, and UserError for a voltage that no controller may command. An FMU that can be instantiated only
        once in a process is left alone.
        """
        unit = self.instance.description.coSimulation
        assert unit is not None
        if unit.canBeInstantiatedOnlyOncePerProcess:
            return
        earlier = list(self.instance.messages)
        try:
            self.prepare()
            self.begin(0.0, -math.pi)
            voltage = self.command(0.0, -math.pi)
            self.outputs()
        finally:
            self.close()
        self.instance.messages[:] = earlier
        if not -HARD_LIMIT <= voltage <= HARD_LIMIT:
            raise UserError(f"the controller commands {voltage} V at rest, beyond ±{HARD_LIMIT:g} V or not a number")

    def prepare(self) -> None:
        """Instantiate and initialize up to the first measurement."""
        self.instance.start(self.start, 0.0, None)
        (self._inputs,) = self.instance.ports(("theta", "delta"), "Set")
        (self._voltage,) = self.instance.ports(("voltage",), "Get")
        self._outputs = self.instance.ports((*self.layout.reals, *self.layout.integers), "Get")
        nothing = np.empty((0, 0))
        self._c_loop = NativeLoop(
            [self.instance],
            [[self._inputs]],
            [[self._voltage]],
            [[]],
            [[]],
            ([], nothing),
            ([], nothing.astype(np.int64)),
            nothing[:, :0],
        )
        self._step = self._c_loop.stepper(self.period)

    def begin(self, theta: float, delta: float) -> tuple[float, ...]:
        """Give the first measurement and leave initialization; return the outputs."""
        self._inputs.values[0], self._inputs.values[1] = theta, delta
        self.instance.transfer([self._inputs])
        self.instance.run()
        return self.outputs()

    def command(self, theta: float, delta: float) -> float:
        """Run one sample; return its voltage [V]."""
        values = self._inputs.values
        values[0], values[1] = theta, delta
        if self._step():
            failure = self._c_loop.failure()
            assert failure is not None
            self.instance.fail(failure[1], failure[2])
        return self._voltage.values[0]

    def catch_up(self, earlier: tuple[float, float], theta: float, delta: float, periods: int) -> int:
        """Run the samples that were missed since the measurement `earlier`, `periods` ago, on the line to the new one.

        So the controller's clock and its filters stay right. Returns how many: all but the new one, at most MOST_CAUGHT_UP.
        """
        missed = min(periods - 1, MOST_CAUGHT_UP)
        for k in range(1, missed + 1):
            share = k / (missed + 1)
            self.command(earlier[0] + share * (theta - earlier[0]), earlier[1] + share * (delta - earlier[1]))
        return missed

    def outputs(self) -> tuple[float, ...]:
        """Return all outputs in the order of the layout."""
        self.instance.transfer(self._outputs)
        return tuple(value for port in self._outputs for value in port.values)

    def mode(self, outputs: tuple[float, ...]) -> int:
        """Return the mode among the outputs; 0 for a controller without one."""
        return 0 if self._mode is None else int(outputs[len(self.layout.reals) + self._mode])

    def faulted(self, mode: int) -> bool:
        """Whether `mode` says that the controller has given up."""
        return mode == self._fault_mode

    def close(self) -> None:
        """Free the instance."""
        self.instance.close()


class Loop:
    """One run of a controller on a device."""

    def __init__(
        self,
        device: Device,
        component: Component,
        settings: Settings,
        path: Path,
        about: Mapping[str, Any] | None = None,
        say: Callable[[str], None] = lambda _text: None,
    ) -> None:
        """Check the controller and make the log, `path` with the suffix .rows; `say` is told each stage."""
        self.device, self.settings, self.say = device, settings, say
        self.controller = Controller(component, settings.period)
        self.steps = round(settings.duration * settings.rate)
        self.about = {
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
            **(about or {}),
        }
        self.about["hil"] = {
            "device": device.name,
            "rate": settings.rate,
            "limits": asdict(settings.limits),
            **self.about.get("hil", {}),
        }
        self.log = RowLog(path.with_suffix(".rows"), self.controller.layout, self.steps + 1, self.about)
        self.guard = Guard(
            settings.limits,
            settings.period,
            stop_on_misses=settings.stop_on_misses,
            stop_on_fall=settings.on_fall == "stop",
        )
        self.notes: list[str] = []
        self._stopping = threading.Lock()
        self._stopped = False

    def run(self) -> Report:
        """Run to the end, stop the device, and return what came of it; the log's file stays until `Report.result` is safe.

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
        report = Report(reason, kind, tuple(failures), self._result(reason, kind, failures), number)
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
        last = sample.tick + self.steps
        outputs = controller.begin(RESOLUTION * -sample.arm, RESOLUTION * (sample.pendulum - HALF_TURN))
        mode, u, applied, led = mode_of(outputs), 0.0, 0.0, LED_IDLE
        stepped_at, earlier = sample.tick - 1, (0.0, 0.0)  # when the controller was stepped, and with what

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
                    steps = 1
                    if sample.tick - stepped_at > 1:
                        steps += controller.catch_up(earlier, theta, delta, sample.tick - stepped_at)
                    stepped_at, earlier = sample.tick, (theta, delta)
                    u = command(theta, delta)
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
        about = {**self.about, "complete": kind == "complete"}
        about["hil"] = {
            **self.about["hil"],
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
            about["messages"] = {"controller": messages}
        result = to_result(layout, rows, about)
        if len(rows):
            about["hil"]["timing"] = timing(result)
        return Result(result.time, result.signals, result.units, about)


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
