"""The closed loop as one C program, compiled for this machine: the limit that co-simulation is measured against."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping

import numpy as np

from benchmarks.compiled import compiled
from fmu_export.native_unit import NativeUnit, struct_initializer
from fmu_export.variables import Value
from ihc_fmu.pendulum.native_unit import NATIVE as CONTROLLER
from plant_fmu.native_unit import NATIVE as PLANT


class Monolithic:
    """The program, with the start values of both units compiled in."""

    def __init__(self, plant: Mapping[str, Value], controller: Mapping[str, Value]) -> None:
        header = '#include "ihc_controller.h"\n#include "qube_servo2.h"\n'
        for unit, name, changes in ((PLANT, "PLANT", plant), (CONTROLLER, "CONTROLLER", controller)):
            values = unit.interface.start_values(changes)
            header += f"static const {unit.prefix}_params {name} = {struct_initializer(unit, values)};\n"
        self._run = compiled("monolithic", PLANT.core | CONTROLLER.core, header).run
        self._run.argtypes = [ctypes.c_long, ctypes.c_double, ctypes.c_void_p]
        self._run.restype = ctypes.c_long
        self.row = np.dtype([("time", "f8"), *_fields(CONTROLLER), *_fields(PLANT)], align=True)

    def run(self, steps: int, step: float) -> np.ndarray:
        """Return the rows of a run, `controller.voltage` and so on as the names of their columns."""
        rows = np.empty(steps + 1, self.row)
        failed = self._run(steps, step, rows.ctypes.data)
        if failed:
            raise RuntimeError(f"step {failed} failed")
        return rows


def _fields(unit: NativeUnit) -> list[tuple[str, str]]:
    instance = "plant" if unit is PLANT else "controller"
    return [(f"{instance}.{v.name}", "f8" if v.type == "Real" else "i4") for v in unit.interface.calculated]
