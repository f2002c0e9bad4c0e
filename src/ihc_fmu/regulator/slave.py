"""The FMI 2.0 co-simulation slave of the controller of any linear model."""

from __future__ import annotations

from fmu_export.guarded_slave import GuardedSlave

from .interface import INTERFACE
from .unit import HomogeneousControllerUnit


class HomogeneousController(GuardedSlave):
    """The linear or implicit homogeneous law with its estimator; one class for every design."""

    interface = INTERFACE
    unit_class = HomogeneousControllerUnit
