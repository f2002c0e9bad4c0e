"""The controller of any linear model in C.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

from fmu_export.native_unit import NativeUnit

from ..native_core import CONSTANTS, FOLDER, HEADERS
from .interface import INPUTS, INTERFACE, OUTPUTS, STATES
from .unit import HomogeneousControllerUnit

NATIVE = NativeUnit(
    interface=INTERFACE,
    twin=HomogeneousControllerUnit,
    folder=FOLDER,
    stem="homogeneous_controller",
    prefix="regulator",
    common=HEADERS,
    constants={**CONSTANTS, "REGULATOR_STATES": STATES, "REGULATOR_INPUTS": INPUTS, "REGULATOR_OUTPUTS": OUTPUTS},
)
