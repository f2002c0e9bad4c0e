"""An FMU for model exchange behind the ports and steps of one for co-simulation: integrated by SciPy, events included.

x' = f(x, u, t) is solved from one communication point to the next under the held inputs, which jump there: each step begins
with an event. Time events end the integration, state events are where an event indicator changes its sign, and step events
are asked for after each of the solver's steps. DOP853 is a one-step method, which loses nothing at the many restarts; Radau
takes over where the model is stiff.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from fmpy.fmi1 import FMICallException

from fmu_export.files import FilePath

from .fmu import DISCARD, FmuError, Instance, status_text
from .fmu_files import describe
from .model_exchange import ModelInstance
from .start_values import StartValue

if TYPE_CHECKING:
    from scipy.integrate import DOP853, OdeSolver, Radau

Array = np.ndarray

Interface = Literal["CoSimulation", "ModelExchange"]
INTERFACES: tuple[str, ...] = get_args(Interface)
"""The kinds of FMUs, as FMPy names them."""

TOLERANCE = 1e-9
"""Relative tolerance of the integration; the absolute one of a state is this times its nominal value."""

STIFF = 1000
"""Steps of DOP853 in one communication step after which the model counts as stiff."""

MOST_STEPS = 100_000
"""Steps of the solver, and events, in one communication step."""

_EVENT_WIDTH = 4.0 * float(np.finfo(float).eps)
"""How closely the time of a state event is found, relative to the time and to the solver's step."""


def interface_of(path: FilePath, wanted: Interface | None = None) -> Interface:
    """Return how an FMU is run: as `wanted`; None: for co-simulation where it has that. Raises as `describe`."""
    return wanted or ("ModelExchange" if describe(path).coSimulation is None else "CoSimulation")


def opened(name: str, path: FilePath, interface: Interface | None = None) -> Instance:
    """Return an instance of the FMU that can be stepped, see `interface_of`.

    Raises UserError for an FMU without that interface, and as `describe`.
    """
    exchange = interface_of(path, interface) == "ModelExchange"
    return IntegratedInstance(name, Path(path), tolerance=TOLERANCE) if exchange else Instance(name, Path(path))


@dataclass(eq=False)
class IntegratedInstance(ModelInstance):
    """A model that steps: between steps it is in event mode, where inputs may jump and outputs are up to date."""

    _time: float = 0.0
    _stop_time: float = math.inf
    _size: float = math.inf
    _stiff: bool = False
    _reason: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        n, indicators = self.description.numberOfContinuousStates, self.description.numberOfEventIndicators
        self._states, self._rates = (ctypes.c_double * n)(), (ctypes.c_double * n)()
        self._indicators = (ctypes.c_double * indicators)()
        self._asks_after_steps = bool(self.description.modelExchange.needsCompletedIntegratorStep)  # type: ignore[union-attr]

    def start(self, start: Mapping[str, StartValue], start_time: float, stop_time: float | None) -> None:
        """Instantiate and set the start values, up to initialization mode; None: no stop time."""
        self._time, self._stop_time = start_time, math.inf if stop_time is None else stop_time
        self._size, self._stiff = math.inf, False
        super().start(start, start_time, stop_time)

    def run(self) -> None:
        """Leave initialization mode and make the events of the start."""
        super().run()
        self.update(self._time)

    def stepper(self) -> Callable[[float, float], None]:
        """Return doStep(time, step); it raises FmuError where the FMU or the solver fails."""

        def step(time: float, size: float) -> None:
            # The FMU's time is where its last step ended: it has no way back, not by a rounding either.
            self._go(max(self._time, min(time + size, self._stop_time)))

        return step

    def _go(self, end: float) -> None:
        """Go from event mode to event mode at `end`."""
        begin, left = self._time, MOST_STEPS
        while True:
            event = self.update(self._time)
            self._call("enterContinuousTimeMode", self._fmu.enterContinuousTimeMode)
            left = self._flow(min(end, event), left - 1)
            if left <= 0:
                raise FmuError(
                    f"{self.name}: {MOST_STEPS} steps and events from t = {begin!r} s end at {self._time!r} s{self.cause()}"
                )
            self._call("enterEventMode", self._fmu.enterEventMode)
            if self._time >= end:
                break
        self.update(self._time)

    def _flow(self, target: float, left: int) -> int:
        """Integrate to `target` or the next event, in at most `left` steps; return how many of them are left."""
        if self._time >= target:
            return left
        if not len(self._states):
            self._place(target, np.empty(0))
            return left
        solver = self._solver(target)
        signs = self._signs()
        while solver.status == "running" and left > 0:
            left -= 1
            self._advance(solver)
            event = self._back_to_event(solver, signs)
            if self._completed() or event:
                break
            if MOST_STEPS - left == STIFF and not self._stiff:
                self._stiff = True
                self.messages.append(
                    f"warning: stiff, integrated by Radau from t = {self._time:.6g} s on: DOP853 made {STIFF} steps in one"
                )
                break
        self._size = float(solver.h_abs)
        return left

    def _solver(self, target: float) -> DOP853 | Radau:
        """Return a solver from the present states to `target`."""
        from scipy.integrate import DOP853, Radau  # noqa: PLC0415 - heavy

        count = len(self._states)
        self._call("getContinuousStates", self._fmu.getContinuousStates, self._states, count)
        y = np.array(self._states)
        self._call("getNominalsOfContinuousStates", self._fmu.getNominalsOfContinuousStates, self._rates, count)
        nominals = np.abs(np.array(self._rates))
        nominals[~(np.isfinite(nominals) & (nominals > 0.0))] = 1.0
        assert self.tolerance is not None
        with np.errstate(all="ignore"):
            return (Radau if self._stiff else DOP853)(
                self._derivatives,
                self._time,
                y,
                target,
                rtol=self.tolerance,
                atol=self.tolerance * nominals,  # type: ignore[arg-type] - SciPy takes one for each state
                first_step=min(self._size, target - self._time),
            )

    def _advance(self, solver: OdeSolver) -> None:
        """Make one step of the solver, and bring the FMU to its end."""
        self._reason = ""
        with np.errstate(all="ignore"):
            failure = solver.step()
        if failure is not None:
            why = self._reason or str(failure).rstrip(".").lower()
            raise FmuError(f"{self.name}: no step leads on from t = {self._time!r} s: {why}{self.cause()}")
        self._place(float(solver.t), solver.y)

    def _derivatives(self, time: float, x: Array) -> Array:
        """Return x' at a point; not finite where the FMU discards it, which makes the solver try a shorter step."""
        time, count = float(time), len(self._states)
        self._states[:] = x.tolist()
        try:
            self._fmu.setTime(time)
            self._fmu.setContinuousStates(self._states, count)
            self._fmu.getDerivatives(self._rates, count)
        except FMICallException as error:
            if error.status != DISCARD:
                self.fail(f"{error.function} at t = {time!r} s", error.status)
            self._reason = f"{error.function} at t = {time!r} s returned {status_text(error.status)}"
            return np.full(count, np.nan)
        rates = np.array(self._rates)
        if not np.isfinite(rates).all():
            self._reason = f"the derivatives at t = {time!r} s are not finite"
        return rates

    def _place(self, time: float, x: Array) -> None:
        """Bring the FMU to a point; events are not made."""
        self._time = time
        self._call("setTime", self._fmu.setTime, time)
        if len(x):
            self._states[:] = x.tolist()
            self._call("setContinuousStates", self._fmu.setContinuousStates, self._states, len(x))

    def _signs(self) -> Array:
        """Return which event indicators are positive."""
        count = len(self._indicators)
        if count:
            self._call("getEventIndicators", self._fmu.getEventIndicators, self._indicators, count)
        return np.array(self._indicators) > 0.0

    def _back_to_event(self, solver: OdeSolver, signs: Array) -> bool:
        """Go back to just behind the first sign that differs from `signs`, by bisection; return whether there is one."""
        if not len(signs) or (self._signs() == signs).all():
            return False
        between = solver.dense_output()
        low, high = float(solver.t_old), float(solver.t)  # type: ignore[arg-type]
        width = _EVENT_WIDTH * max(abs(high), high - low)
        while high - low > width:
            middle = 0.5 * (low + high)
            self._place(middle, between(middle))
            low, high = (middle, high) if (self._signs() == signs).all() else (low, middle)
        self._place(high, solver.y if high == solver.t else between(high))
        return True

    def _completed(self) -> bool:
        """Say that a step is over; return whether the FMU asks for an event."""
        if not self._asks_after_steps:
            return False
        event, ends = self._call("completedIntegratorStep", self._fmu.completedIntegratorStep)
        if ends:
            self.refuse_end(self._time)
        return event
