"""The FMI 2.0 co-simulation slave of the plant."""

from __future__ import annotations

from fmu_export.guarded_slave import GuardedSlave

from .interface import INTERFACE
from .unit import QubePlant


class QubeServo2(GuardedSlave):
    """The rotary pendulum, its motor and its encoders."""

    interface = INTERFACE
    unit_class = QubePlant
    packages = ("rotary_pendulum",)
