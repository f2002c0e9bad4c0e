"""The FMI 2.0 co-simulation slave of the controller."""

from __future__ import annotations

from fmu_export.guarded_slave import GuardedSlave

from .interface import INTERFACE
from .unit import IhcControllerUnit


class IhcController(GuardedSlave):
    """Swing-up, capture, and the linear, sliding mode or implicit homogeneous law."""

    interface = INTERFACE
    unit_class = IhcControllerUnit
    packages = ("rotary_pendulum",)
