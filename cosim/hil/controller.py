"""The controller FMU as the loop calls it: start values that fit, buffers made once, and a rehearsal before a run."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import UserError
from ..fmu import RECORDED, Instance
from ..native_loop import NativeLoop
from ..structure import Component
from . import driven
from .log import Layout
from .simulated import HARD_LIMIT

MOST_CAUGHT_UP = 10
"""Missed samples that the controller is given afterwards, at most."""

MEASURED = ("theta", "delta")
"""The controller's inputs that are measured [rad]."""


class ControllerFmu:
    """The controller FMU with its buffers: what the loop calls, and nothing else in between.

    `inputs` are those that signals drive besides the measured ones; `follow` gives their values. Raises UserError for an
    FMU, start values or inputs that do not fit.
    """

    def __init__(self, component: Component, period: float, inputs: Sequence[str] = ()) -> None:
        self.instance = instance = Instance("controller", Path(component.path))
        for name, causality, unit in (("theta", "input", "rad"), ("delta", "input", "rad"), ("voltage", "output", "V")):
            instance.require(name, causality, unit)
        self.inputs = tuple(inputs)
        self._check_inputs()
        self._values: driven.Driven = {}
        self.start = instance.checked_start(component.start)
        sample_time = self.start.get("sample_time", period)
        if not math.isclose(float(sample_time), period, rel_tol=1e-9):
            raise UserError(f"controller.sample_time must be the loop's period, {period:g} s, found {sample_time:g} s")
        recorded = [*instance.outputs(), *(instance.variables[name] for name in self.inputs)]
        if texts := instance.texts():
            instance.messages.append(f"warning: String outputs are not recorded: {', '.join(texts)}")
        self.layout = Layout(
            tuple(v.name for v in recorded if v.type == "Real"),
            tuple(v.name for v in recorded if v.type != "Real"),
            {v.name: v.unit or "1" for v in recorded},
        )
        self.period = period
        self._mode = self.layout.integers.index("mode") if "mode" in self.layout.integers else None
        self._fault_mode = instance.item("mode", "fault")
        if "mode" in self.layout.units and self._fault_mode is None:
            raise UserError(
                f"{component.path}: mode must be an Enumeration with the item fault, by which the controller gives up, "
                f"found {instance.variables['mode'].type}"
            )

    def _check_inputs(self) -> None:
        """Raise UserError for driven inputs that are none, are measured, or are named twice."""
        for name in self.inputs:
            variable = self.instance.variable(name)
            if variable.causality != "input" or variable.type not in RECORDED:
                raise UserError(
                    f"a signal acts on an input that is a number or a Boolean, and controller.{name} is an "
                    f"{variable.causality} of type {variable.type}"
                )
            if name in MEASURED or self.inputs.count(name) > 1:
                raise UserError(f"the input controller.{name} must have one source, found another besides the signal")

    def follow(self, values: driven.Driven) -> None:
        """Give the driven inputs' values, one for each sample's number; `prepare` takes them."""
        self._values = values

    def rehearse(self) -> None:
        """Do once all that a run calls, for a pendulum that hangs at rest, so that nothing of it fails with a motor on.

        The driven inputs have their first values, then the smallest and the largest of each.

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
            for number in (0, *driven.notable(self._values)):
                voltage = self.command(0.0, -math.pi, number)
                if not -HARD_LIMIT <= voltage <= HARD_LIMIT:
                    raise UserError(
                        f"the controller commands {voltage} V at rest, beyond ±{HARD_LIMIT:g} V or not a number"
                    )
            self.outputs()
        finally:
            self.close()
        self.instance.messages[:] = earlier

    def prepare(self) -> None:
        """Instantiate and initialize up to the first measurement."""
        self.instance.start(self.start, 0.0, None)
        self._ports = ports = self.instance.ports((*MEASURED, *self.inputs), "Set")
        self._angles = ports[0].values
        slots = {name: (port.values, i) for port in ports for i, name in enumerate(port.names)}
        self._drives = [(*slots[name], self._values[name]) for name in self.inputs]
        voltage = self.instance.ports(("voltage",), "Get")
        self._voltage = voltage[0].values
        self._outputs = self.instance.ports([v.name for v in self.instance.outputs()], "Get")
        slots |= {name: (port.values, i) for port in self._outputs for i, name in enumerate(port.names)}
        self._recorded = _views([slots[name] for name in (*self.layout.reals, *self.layout.integers)])
        self._c_loop = NativeLoop([self.instance], [ports], [voltage], [[]], [[]])
        self._step = self._c_loop.stepper(self.period)

    def begin(self, theta: float, delta: float) -> tuple[float, ...]:
        """Give the first measurement and leave initialization; return the outputs."""
        self._angles[0], self._angles[1] = theta, delta
        for values, index, table in self._drives:
            values[index] = table[0]
        self.instance.transfer(self._ports)
        self.instance.run()
        return self.outputs()

    def command(self, theta: float, delta: float, number: int) -> float:
        """Run a sample with the driven inputs' values of sample `number`; return its voltage [V]."""
        angles = self._angles
        angles[0], angles[1] = theta, delta
        for values, index, table in self._drives:
            values[index] = table[number]
        if self._step():
            failure = self._c_loop.failure()
            assert failure is not None
            self.instance.fail(failure[1], failure[2])
        return self._voltage[0]

    def catch_up(self, earlier: tuple[float, float, int], theta: float, delta: float, periods: int) -> int:
        """Run the samples that were missed since the one `earlier`, `periods` ago, on the line to the new measurement.

        So the controller's clock and its filters stay right. The driven inputs have the values of the earlier sample, given
        as (theta, delta, number). Returns how many: all but the new one, at most MOST_CAUGHT_UP.
        """
        missed = min(periods - 1, MOST_CAUGHT_UP)
        from_theta, from_delta, number = earlier
        for k in range(1, missed + 1):
            share = k / (missed + 1)
            self.command(from_theta + share * (theta - from_theta), from_delta + share * (delta - from_delta), number)
        return missed

    def outputs(self) -> tuple[float, ...]:
        """Return all outputs, and the driven inputs as they are in force, in the order of the layout."""
        self.instance.transfer(self._outputs)
        return tuple(value for view in self._recorded for value in view)

    def mode(self, outputs: tuple[float, ...]) -> int:
        """Return the mode among the outputs; 0 for a controller without one."""
        return 0 if self._mode is None else int(outputs[len(self.layout.reals) + self._mode])

    def faulted(self, mode: int) -> bool:
        """Whether `mode` says that the controller has given up."""
        return mode == self._fault_mode

    def close(self) -> None:
        """Free the instance."""
        self.instance.close()


def _views(slots: Sequence[tuple[ctypes.Array, int]]) -> list[ctypes.Array]:
    """Return arrays over the slots of buffers in their order, as few as there can be: one for neighbours."""
    begins = [k for k, (array, i) in enumerate(slots) if not k or slots[k - 1] != (array, i - 1)]
    ends = [*begins[1:], len(slots)]
    views = []
    for begin, end in zip(begins, ends, strict=False):
        array, first = slots[begin]
        kind: Any = array._type_
        views.append((kind * (end - begin)).from_buffer(array, first * ctypes.sizeof(kind)))
    return views
