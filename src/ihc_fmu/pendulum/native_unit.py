"""The controller in C.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

from fmu_export.native_unit import NativeUnit
from rotary_pendulum.c_header import CONSTANTS as PENDULUM
from rotary_pendulum.c_header import HEADER

from ..native_core import CONSTANTS, FOLDER, HEADERS
from .interface import INTERFACE, ORDER
from .unit import IhcControllerUnit

NATIVE = NativeUnit(
    interface=INTERFACE,
    twin=IhcControllerUnit,
    folder=FOLDER,
    stem="ihc_controller",
    prefix="ihc",
    common=(*HEADERS, HEADER),
    constants={**CONSTANTS, **PENDULUM, "IHC_ORDER": ORDER},
)
