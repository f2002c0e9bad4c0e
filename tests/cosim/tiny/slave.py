"""A tiny FMU for tests of the master: it passes its inputs on, counts its calls, and warns or fails when told to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fmu_export.guarded_slave import GuardedSlave
from fmu_export.variables import Interface, Variable


class TinyUnit:
    """y = gain u of the last step; `warn_at` and `fail_at` count calls from 1, 0 is never."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = values
        self.state: dict[str, Any] = {"y": 0.0, "time_seen": -1.0, "calls": 0, "whole_out": 0, "flag_out": False}

    def initialize(self, time: float, inputs: tuple[float, ...]) -> list[str]:
        self.state["y"] = self.values["gain"] * inputs[0]
        return []

    def step(self, time: float, step: float, inputs: tuple[Any, ...]) -> list[str]:
        u, whole, flag = inputs
        calls = self.state["calls"] + 1
        if calls == self.values["fail_at"]:
            raise RuntimeError(f"told to fail in call {calls}")
        self.state |= {"y": self.values["gain"] * u, "time_seen": time, "calls": calls}
        self.state |= {"whole_out": whole, "flag_out": flag}
        return [f"told to warn, 100 % done %d, gain {self.values['gain']:g}"] if calls == self.values["warn_at"] else []

    def outputs(self) -> tuple[Any, ...]:
        return tuple(self.state.values())

    def get_state(self) -> dict[str, Any]:
        return dict(self.state)

    def set_state(self, state: Mapping[str, Any]) -> None:
        self.state = dict(state)


class Tiny(GuardedSlave):
    interface = Interface(
        name="Tiny",
        description="passes its inputs on",
        variables=(
            Variable("u", "input", "goes to y", "V", start=0.0),
            Variable("whole", "input", "goes to whole_out", type="Integer", variability="discrete", start=0),
            Variable("flag", "input", "goes to flag_out", type="Boolean", variability="discrete", start=False),
            Variable("y", "output", "gain times u", "V"),
            Variable("time_seen", "output", "time of the last call", "s"),
            Variable("calls", "output", "number of calls", type="Integer", variability="discrete"),
            Variable("whole_out", "output", "whole of the last call", type="Integer", variability="discrete"),
            Variable("flag_out", "output", "flag of the last call", type="Boolean", variability="discrete"),
            Variable("gain", "parameter", "y/u", variability="fixed", start=1.0),
            Variable("warn_at", "parameter", "call", type="Integer", variability="fixed", start=0, min=0),
            Variable("fail_at", "parameter", "call", type="Integer", variability="fixed", start=0, min=0),
        ),
        step_size=1e-3,
        stop_time=1.0,
        variable_step=True,
    )
    unit_class = TinyUnit
