"""`hil --check`: installation, controller, board, signs, timing; what is wrong, and what to do."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np

from ..errors import UserError
from ..fmu import FmuError
from ..interrupts import second_ends
from ..structure import Component, Signal
from . import checks, driven
from .controller import ControllerFmu
from .device import LED_IDLE, Device, DeviceError
from .log import percentiles
from .loop import READ_TIMEOUT, stop_signals
from .quanser import QuanserDevice, sdk
from .realtime import undisturbed
from .settings import Settings, Stopped

TIMED = 2.0
"""How long the timing is measured [s]."""
CONTROLLER_STEPS = 2000
SHARE = 0.5
"""Share of a period that the controller may need in 99 of 100 steps."""

Verdict = Literal["ok", "note", "wrong"]
Finding = tuple[Verdict, str]
"""Whether all is well, well enough, or not, and what was found."""


def diagnose(
    device: Device, component: Component, settings: Settings, signals: Sequence[Signal] = ()
) -> Iterator[Finding]:
    """Yield what is found, step by step; the device is stopped and closed at the end, and nothing follows a dead end.

    `signals` are those of the run on the controller's inputs.
    """
    if isinstance(device, QuanserDevice):
        try:
            sdk()
        except UserError as error:
            yield "wrong", str(error)
            return
        yield "ok", "Quanser's package and library are there"
    try:
        with second_ends():
            yield _controller(component, settings, signals)
    except (UserError, FmuError) as error:
        yield "wrong", str(error)
        return
    with stop_signals() as received, second_ends(lambda: "; ".join(device.safe_stop("the check was ended"))):
        try:
            device.open()
            yield "ok", f"{device.name}: open, amplifier off, no fault reported"
            with undisturbed(real_time=device.real_time and settings.real_time) as notes:
                for note in notes:
                    yield "note" if note.startswith(("no ", "memory not")) else "ok", note
                yield from _device(device, settings, received)
        except (UserError, DeviceError, Stopped) as error:
            yield "wrong", str(error)
        finally:
            for failure in (*device.safe_stop("the check is over"), *device.close()):
                yield "wrong", failure


def _controller(component: Component, settings: Settings, signals: Sequence[Signal]) -> Finding:
    controller = ControllerFmu(component, settings.period, driven.names_of([s.target for s in signals]))
    samples = round(settings.duration * settings.rate)
    values = driven.values_of(signals, settings.period, samples)
    driven.check(values, controller.instance, settings.limits, settings.period)
    controller.follow(values)
    controller.prepare()
    try:
        controller.begin(0.0, -np.pi)
        times = []
        for k in range(CONTROLLER_STEPS):
            before = time.perf_counter_ns()
            controller.command(0.0, -np.pi + 1e-3 * (k % 7), k % samples)
            times.append((time.perf_counter_ns() - before) * 1e-9)
    finally:
        controller.close()
    p99 = percentiles(times)["p99"]
    share = f"{p99 / settings.period:.0%} of the period"
    text = f"the controller {component.path.name} needs {1e6 * p99:.0f} us a step (p99), {share}"
    enough = p99 <= SHARE * settings.period
    return (
        "ok" if enough else "wrong",
        text if enough else f"{text}; lower the rate, or use the native FMU (`qube-ihc export`)",
    )


def _device(device: Device, settings: Settings, received: list[int]) -> Iterator[Finding]:
    device.start(settings.period)
    checks.verify_still(device, settings, received)
    yield "ok", f"arm and pendulum rest for {settings.still:g} s"
    yield _timing(device, settings)
    device.enable(True)
    signs = checks.measure_signs(device, settings, received)
    problem = signs.problem()
    moved = f"{signs.voltage:g} V turn the arm by {signs.arm:+d} counts and the pendulum by {signs.pendulum:+d}"
    if problem:
        yield "wrong", problem
    else:
        yield "ok", f"signs: {moved}, as they should"


def _timing(device: Device, settings: Settings) -> Finding:
    ticks, woke = [], []
    for _ in range(round(TIMED * settings.rate)):
        sample = device.read(READ_TIMEOUT)
        woke.append(time.perf_counter_ns())
        ticks.append(sample.tick)
        device.write(0.0, LED_IDLE)
    count = ticks[-1] - ticks[0]
    missed = count + 1 - len(ticks)
    values = percentiles(np.diff(woke) * 1e-9)
    intervals = ", ".join(f"{1e6 * values[name]:.0f} us ({name})" for name in ("p50", "p99.9", "max"))
    text = f"{settings.rate:g} Hz: {missed} of {count} periods missed; from sample to sample {intervals}"
    most = settings.limits.missed_share * count
    if missed > most:
        return "wrong", f"{text}; a run would be stopped beyond {most:.0f}: lower the rate, or get real-time scheduling"
    return "ok", text
