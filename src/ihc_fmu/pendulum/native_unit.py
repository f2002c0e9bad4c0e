"""The controller in C.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

from pathlib import Path

from fmu_export.native_unit import NativeUnit
from rotary_pendulum.c_header import HEADER

from .interface import INTERFACE
from .unit import IhcControllerUnit

CORE_HEADERS = ("homogeneous.h", "sample_clock.h", "sample_clock_fmu.h")
"""What both controllers are built on."""

NATIVE = NativeUnit(
    interface=INTERFACE,
    twin=IhcControllerUnit,
    folder=Path(__file__).parent.parent / "native",
    stem="ihc_controller",
    prefix="ihc",
    common=(*CORE_HEADERS, HEADER),
)
