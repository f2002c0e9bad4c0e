"""The FMI 2.0 co-simulation slave of the linear plant."""

from __future__ import annotations

from fmu_export.guarded_slave import GuardedSlave

from .interface import INTERFACE
from .unit import LinearPlantUnit


class LinearPlant(GuardedSlave):
    """A linear system with limited inputs and counting sensors; one class for every system."""

    interface = INTERFACE
    unit_class = LinearPlantUnit
