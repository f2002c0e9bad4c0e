"""A design's controller as an object: `controller(y)` advances it by one sample and returns the inputs of the plant.

It is the unit that the controller's FMU holds, with the FMU's names and start values; nothing is computed here.

    >>> import numpy as np
    >>> from ihc_fmu import Controller, System, synthesize
    >>> A, B, h = np.array([[0.0, 1.0], [4.0, 0.0]]), np.array([[0.0], [1.0]]), 1e-3
    >>> pendulum = System(A=A, B=B, states=("angle [rad]", "rate [rad/s]"), inputs=("torque [N.m]",), sample_time=h)
    >>> controller = Controller(synthesize(pendulum.with_lqr([1.0, 1.0], [1.0])), a_min=0.05)
    >>> x = np.array([0.1, 0.0])
    >>> for _ in range(4000):
    ...     x = x + h * (A @ x + B @ controller(x))
    >>> controller.mode, bool(abs(x).max() < 1e-6)
    ('stabilizing', True)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fmu_export.errors import UserError
from fmu_export.shown import Showing
from fmu_export.variables import Interface, Value, did_you_mean

from .design import Design
from .estimation import estimator
from .observer import homogeneous_observer
from .quantity import vector
from .regulator.interface import INTERFACE, MODES, OUTPUTS, numbered
from .regulator.start_values import LinearFilter, Regulator, design_regulator
from .regulator.unit import HomogeneousControllerUnit
from .sampled_unit import FAULTS

Array = np.ndarray


def resampled(design: Design, sample_time: Value | str | None) -> Design:
    """Return the design with another sample time [s] of its system, None: with its own; UserError for one that is none."""
    if sample_time is None:
        return design
    time = INTERFACE.by_name["sample_time"].check(sample_time)
    if time == design.system.sample_time:
        return design
    return replace(design, system=design.system.changed(sample_time=time))


def regulator_of(design: Design) -> Regulator:
    """Return all numbers of a design's controller: where states are not measured, with the estimator of its system.

    Raises UserError where there is no estimator, and as `design_regulator`.
    """
    if design.system.measures_state:
        return design_regulator(design)
    return design_regulator(design, _kalman(design) if design.system.observer is None else homogeneous_observer(design))


def _kalman(design: Design) -> LinearFilter:
    kalman = estimator(design)
    C, counts = np.asarray(design.system.C), np.asarray(design.system.resolutions)
    return LinearFilter(F=kalman.F, G=kalman.G, C=C, M=kalman.M, decay=kalman.decay, counts=counts)


class Controller:
    """The controller of a design, sample by sample.

    Quantities are absolute, as the plant has them. `values` are the start values in force, by name; `messages` what the
    controller has said since its beginning, faults above all.

    Parameters
    ----------
    design
        The certified design.
    **start
        Start values of its FMU by their names there: parameters (`a_min=0.2`, `law="LC"`, `force_upper=5.0`) and set-points
        (`position_setpoint=0.5`).

    Raises
    ------
    UserError
        For a name or a value that the FMU does not have or admit, and where there is no estimator.

    Examples
    --------
    >>> from ihc_fmu import Controller, Design, System
    >>> names = {"states": ("position [m]", "velocity [m/s]"), "inputs": ("force [N]",), "set_points": ("position",)}
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], **names)
    >>> controller = Controller(Design(cart, P=[[1, 0.5], [0.5, 0.3]], mu=1.0, alpha=0.5), force_upper=10.0)
    >>> u = controller([-0.25, 0.0])
    >>> u.round(2).tolist(), round(controller.norm, 6), controller.mode
    ([3.97], 0.5, 'stabilizing')
    >>> controller.set(position_setpoint=0.75)
    >>> controller([-0.25, 0.0]).round(2).tolist()  # a deviation of 1 m: about the linear law
    [3.98]
    >>> controller.reset()
    """

    def __init__(self, design: Design, **start: Value | str) -> None:
        self.design = resampled(design, start.get("sample_time"))
        interface, self._hidden = regulator_of(self.design).exported()
        self._showing = Showing(INTERFACE, interface)
        self.values = interface.start_values(start)
        self._unit = self._made()
        self.reset()

    @property
    def interface(self) -> Interface:
        """The variables of the controller's FMU."""
        return self._showing.interface

    def __repr__(self) -> str:
        told = ", ".join(f"{name} = {self.values[name]}" for name in ("sample_time", "a_min", "b_max"))
        return f"<Controller: {self.design.system.name}, {told}, {self.mode} after {self.samples} samples>"

    def __call__(self, y: ArrayLike) -> Array:
        """Return the plant's inputs u (m,) for its measured outputs y (p,), held for one sample time.

        Values that are not finite latch a fault, and u is then 0 within its limits. Raises UserError for another length.
        """
        inputs = (*self._measured(y), *self._set_points())
        if self.samples == 0:
            self._unit.initialize(0.0, inputs)
        time = self.samples * self._unit.sample_time
        said = self._unit.step(time, self._unit.sample_time, inputs)
        self.messages += [f"t = {time:.9g} s: {self._showing.sentence(text)}" for text in said]
        self.samples += 1
        return np.array(self._unit.state.commands)

    def set(self, **changes: Value | str) -> None:
        """Change set-points and tunable parameters from the next sample on; the state stays.

        Parameters
        ----------
        **changes
            Values by name.

        Raises
        ------
        UserError
            For what does not exist, cannot change during a run, or does not admit the value; nothing is changed then.
        """
        known = {v.name: v for v in self.interface.variables if v.causality == "input" or v.variability == "tunable"}
        for name in changes:
            if name not in known:
                raise UserError(f"{name!r} cannot be set during a run{did_you_mean(name, known)}")
        before, unit = self.values, self._unit
        try:
            self.values = {**before, **{name: known[name].check(value) for name, value in changes.items()}}
            self._unit = self._made()
        except UserError:
            self.values, self._unit = before, unit
            raise
        self._unit.set_state(unit.get_state())

    def reset(self) -> None:
        """Begin anew: no sample taken, no fault; set-points and parameters stay."""
        self._unit = self._made()
        self.samples = 0
        self.messages: list[str] = []

    @property
    def norm(self) -> float:
        """The homogeneous norm of the deviation at the last sample; 0 before the first."""
        return self._unit.state.norm

    @property
    def mode(self) -> str:
        """`idle`, `stabilizing` or `fault`."""
        return MODES[self._unit.state.mode - 1]

    @property
    def fault(self) -> str:
        """Why the controller has stopped: `none`, `non_finite_input` or `non_finite_control`."""
        return FAULTS[self._unit.state.fault - 1]

    @property
    def estimate(self) -> Array:
        """The states (n,) that the law used at the last sample."""
        return np.array(self._unit.state.x) + self._unit.x_eq

    @property
    def disturbance(self) -> Array:
        """What the Kalman filter takes for disturbances of the inputs (m,); 0 without one."""
        return np.array(self._unit.state.d)

    @property
    def integral(self) -> Array:
        """The integral action v (m,), part of u; 0 without one."""
        return np.array(self._unit.state.v)

    def _made(self) -> HomogeneousControllerUnit:
        try:
            return HomogeneousControllerUnit(self._showing.compiled_values(self.values, self._hidden))
        except UserError as error:
            raise UserError(self._showing.sentence(str(error))) from None

    def _measured(self, y: ArrayLike) -> list[float]:
        outputs = self.design.system.outputs
        return [*vector("y", y, outputs).tolist(), *[0.0] * (OUTPUTS - len(outputs))]

    def _set_points(self) -> list[float]:
        """Return the set-points of the compiled table; those that are not shown stay at the equilibrium."""
        return [self._unit.values[name] for name in numbered("setpoint", OUTPUTS)]
