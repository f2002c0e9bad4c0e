"""What a sample of the controller costs in C: IHC by Algorithm 1 or with the exact norm, against LC (controller_step.c).

Measured twice on the angles and velocities of a recorded closed loop: the whole `ihc_step`, which whatever the law also
filters the velocities, computes the exact homogeneous norm (an output) and decides the mode; and the bare laws.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.compiled import compiled
from fmu_export.native_unit import struct_initializer
from fmu_export.variables import Value
from ihc_fmu.pendulum.interface import MODES
from ihc_fmu.pendulum.native_unit import NATIVE as CONTROLLER
from ihc_fmu.pendulum.start_values import kalman_values

SMALL_A_MIN = 0.1
"""An a_min that lets Algorithm 1 follow the norm near the origin, so that it bisects."""

AS_THE_GENERAL_ONE = {"norm_solver": "exact", "discretization": "semi_implicit"}
"""How the controller of any linear model is by default."""

VARIANTS = {
    "LC": {"law": "LC", "norm_solver": "algorithm1"},
    "ALGORITHM1": {"law": "IHC", "norm_solver": "algorithm1"},
    "EXACT": {"law": "IHC", "norm_solver": "exact"},
    "MEASURED": {"law": "IHC", **AS_THE_GENERAL_ONE, "velocity_source": "inputs"},
    "KALMAN": {"law": "IHC", **AS_THE_GENERAL_ONE, "velocity_source": "kalman"},
}
"""Names in the C program, and what each has besides the start values."""


class ControllerStep:
    """The program, with the controller's start values compiled in, and the sequence that it runs on."""

    def __init__(self, controller: Mapping[str, Value], rows: np.ndarray) -> None:
        """Take `rows` from `Monolithic.run`; the samples in the stabilizing mode are used."""
        self._library = _library(controller)
        values = CONTROLLER.interface.start_values(controller)
        self.a_min, self.sample_time = float(values["a_min"]), float(values["sample_time"])
        stabilizing = rows["controller.mode"][1:] == MODES.index("stabilizing") + 1
        measured, estimated = rows[:-1][stabilizing], rows[1:][stabilizing]  # a sample is made of the row before
        self.count = len(measured)
        angles = [measured[f"plant.{name}_encoder"] for name in ("theta", "delta")]
        velocities = [estimated[f"controller.{name}_dot_estimate"] for name in ("theta", "delta")]
        self.x = np.ascontiguousarray(np.column_stack([*angles, *velocities]))
        self._norm = estimated["controller.homogeneous_norm"]

    @property
    def about(self) -> str:
        """A line on the sequence."""
        norm = np.percentile(self._norm, [5, 50, 95])
        return (
            f"homogeneous norm there (5, 50, 95 %): {norm[0]:.3g}, {norm[1]:.3g}, {norm[2]:.3g}; a_min {self.a_min:g}"
        )

    def cases(self) -> dict[str, Callable[[], float]]:
        """Return what is measured by name; each call returns ns per sample. Whole steps and bare laws begin with LC."""
        a_min, small = self.a_min, SMALL_A_MIN
        return {
            "whole step, LC": lambda: self._whole(0),
            "whole step, IHC, Algorithm 1, j_max 3": lambda: self._whole(1),
            "whole step, IHC, exact norm": lambda: self._whole(2),
            "bare law, LC": lambda: self._bare("linear_law"),
            f"bare law, IHC, Algorithm 1, a_min {a_min:g}": lambda: self._bare("algorithm1_law", a_min),
            f"bare law, IHC, Algorithm 1, a_min {small:g}": lambda: self._bare("algorithm1_law", small),
            f"bare law, IHC, exact norm, a_min {a_min:g}": lambda: self._bare("exact_law", a_min),
        }

    def twins(self) -> dict[str, Callable[[], float]]:
        """Return whole steps with what the controller of any linear model does too."""
        return {
            "IhcController, velocities measured": lambda: self._whole(3),
            "IhcController, Kalman filter": lambda: self._whole(4),
        }

    def _whole(self, variant: int) -> float:
        start = time.perf_counter()
        stabilizing = self._library.whole_steps(variant, self.x.ctypes.data, self.count)
        seconds = time.perf_counter() - start
        if stabilizing < self.count - 1:  # the first sample may decide to capture
            raise RuntimeError(f"only {stabilizing} of {self.count} samples were in the stabilizing mode")
        return 1e9 * seconds / self.count

    def _bare(self, name: str, *a_min: float) -> float:
        start = time.perf_counter()
        total = getattr(self._library, name)(self.x.ctypes.data, self.count, *a_min)
        seconds = time.perf_counter() - start
        if not np.isfinite(total) or total == 0.0:
            raise RuntimeError(f"{name} returned {total}")
        return 1e9 * seconds / self.count


def _library(controller: Mapping[str, Value]) -> ctypes.CDLL:
    header = '#include "ihc_controller.h"\n'
    kalman = kalman_values(controller, float(controller["sample_time"]))
    for name, changes in VARIANTS.items():
        values = CONTROLLER.interface.start_values({**controller, **kalman, **changes})
        header += f"static const ihc_params {name} = {struct_initializer(CONTROLLER, values)};\n"
    library = compiled("controller_step", CONTROLLER.core, header)
    library.whole_steps.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_long]
    library.whole_steps.restype = ctypes.c_long
    library.linear_law.argtypes = [ctypes.c_void_p, ctypes.c_long]
    for call in (library.algorithm1_law, library.exact_law):
        call.argtypes = [ctypes.c_void_p, ctypes.c_long, ctypes.c_double]
    for call in (library.linear_law, library.algorithm1_law, library.exact_law):
        call.restype = ctypes.c_double
    return library
