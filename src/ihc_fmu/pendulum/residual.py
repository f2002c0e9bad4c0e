"""What the encoders leave of the pendulum's loop: `ihc_fmu.residual` with its own estimators, about upright."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi, sqrt
from typing import Any

import numpy as np

from fmu_export.errors import UserError
from fmu_export.variables import Value
from plant_fmu.linearization import linearize as linearize_plant
from plant_fmu.parameters import ParameterSet, parameter_set

from ..design import Design
from ..regulator.start_values import LinearFilter
from ..residual import Residual, SampledController, Sensors, ball, filtered, gain_at, held, residual_of
from .interface import DISCRETIZATIONS, INTERFACE, LAWS, VELOCITY_SOURCES, kalman_gains
from .kalman import linearize
from .nominal_model import nominal_model
from .start_values import controller_start_values
from .velocity import BIAS_DECAY, filter_decay

Array = np.ndarray

COUNTS = 2048
"""Of the device's encoders, per turn."""


def residual_set(
    design: Design,
    changes: Mapping[str, Value] | None = None,
    plant: str | ParameterSet = "ident",
    counts: int = COUNTS,
) -> Residual:
    """Return where the pendulum of a parameter set ends under LC or IHC; states theta, delta, theta', delta'.

    `changes` to the controller's start values: `law`, `a_min`, `discretization`, `velocity_source` (kalman or filter),
    `sample_time`, `voltage_limit`, ... as in a scenario. Raises UserError for others than these laws and estimators, and as
    `residual_of`.
    """
    values: dict[str, Any] = INTERFACE.start_values(controller_start_values(design, changes=changes))
    law, source = LAWS[values["law"] - 1], VELOCITY_SOURCES[values["velocity_source"] - 1]
    if law not in ("LC", "IHC"):
        raise UserError(f"the residual set is that of a law that is linear near the origin, LC or IHC, found {law}")
    h, a_min = float(values["sample_time"]), 1.0 if law == "LC" else float(values["a_min"])
    semi_implicit = law == "IHC" and DISCRETIZATIONS[values["discretization"] - 1] == "semi_implicit"
    K = gain_at(design, a_min, h if semi_implicit else 0.0)
    A, b = linearize_plant(parameter_set(plant).parameters)
    F, G = held(A, b[:, None], h)
    controller = _kalman(values, K, h) if source == "kalman" else _velocities(values, source, K, h)
    q = np.full(2, 2.0 * pi / counts if counts else 0.0)
    region = np.zeros((1, 4)) if law == "LC" else ball(design, a_min)
    room = np.array([float(values["voltage_limit"])])
    return residual_of(F, G, np.eye(2, 4), controller, Sensors(q, np.zeros(2)), region, room)


def angle_rms(found: Residual) -> float:
    """Return the root mean square of |q| = hypot(theta, delta), the metric `steady_rms` [rad]."""
    return sqrt(float((found.rms[:2] ** 2).sum()))


def _kalman(values: Mapping[str, Any], K: Array, h: float) -> SampledController:
    """Return the law on the Kalman filter's estimates, of whose biases only the pendulum's is estimated."""
    if values["kalman_count_weight"] != 1.0:
        raise UserError(
            "the residual set is that of a linear filter, kalman_count_weight = 1, found "
            f"{values['kalman_count_weight']:g}"
        )
    A, b = linearize(nominal_model(values))
    F, G = held(A, b[:, None], h)
    M = np.array([values[name] for name in kalman_gains()], dtype=float).reshape(6, 2)
    M = np.insert(M, 5, 0.0, axis=0)
    f = LinearFilter(F=F, G=G, C=np.eye(2, 4), M=M, decay=float(np.exp(-BIAS_DECAY * h)))
    return filtered(f, K, compensated=bool(values["compensate_disturbance"]))


def _velocities(values: Mapping[str, Any], source: str, K: Array, h: float) -> SampledController:
    """Return the law on measured angles and the velocity filter, v = w (y - lag), lag <- decay lag + (1 - decay) y."""
    if source != "filter":
        raise UserError(f"the residual set is that of counted angles: velocity_source kalman or filter, found {source}")
    cutoff = float(values["velocity_filter_cutoff"])
    decay, unit, none = filter_decay(cutoff, h), np.eye(2), np.zeros((2, 2))
    X, Y = np.vstack([none, -cutoff * unit]), np.vstack([unit, cutoff * unit])
    return SampledController(decay * unit, (1.0 - decay) * unit, K @ X, K @ Y, X, Y)
