"""What in a scenario is the pendulum's own: which FMUs are its units, how they are wired, and what follows for them.

A plant FMU is the pendulum where it has all of its parameters and encoders, a controller FMU is its IHC where it has the
design's numbers and the supervisor's; names and files do not count.
"""

from __future__ import annotations

from dataclasses import fields
from functools import lru_cache
from pathlib import Path

from fmu_export.files import FilePath
from ihc_fmu.homogeneity import LARGEST
from ihc_fmu.pendulum.interface import INTERFACE as CONTROLLER
from ihc_fmu.pendulum.interface import VELOCITY_SOURCES, matrix, vector
from plant_fmu.interface import start_values as plant_start_values
from plant_fmu.parameters import QubeParameters

from . import parameter_files
from .errors import UserError
from .start_values import StartValue, StartValues
from .structure import Wire

SAMPLE_TIMES = next(v for v in CONTROLLER.variables if v.name == "sample_time").limits()
"""Bounds of the controller's sample time [s]."""

ANGLES, RATES = ("theta", "delta"), ("theta_dot", "delta_dot")

_VOLTAGE = Wire("controller.voltage", "plant.voltage")
WIRES = {
    "encoders": (*(Wire(f"plant.{name}_encoder", f"controller.{name}") for name in ANGLES), _VOLTAGE),
    "ideal": (*(Wire(f"plant.{name}", f"controller.{name}") for name in (*ANGLES, *RATES)), _VOLTAGE),
}
"""How the two units are wired, by the measurement that the controller gets."""

ALWAYS_CAPTURED = {"swing_up_enabled": False, "capture_level": LARGEST, "capture_velocity": LARGEST}
"""Start values with which the supervisor lets the law act wherever the pendulum is within the capture angle."""

_PLANT = {*(f.name for f in fields(QubeParameters)), "back_emf", *(f"{name}_encoder_offset" for name in ANGLES)}
_CONTROLLER = {*matrix("Phi"), *vector("row"), "velocity_source", "voltage_limit", "capture_level"}


def is_plant(own: StartValues) -> bool:
    """Return whether an FMU with these start values is the pendulum."""
    return own.keys() >= _PLANT


def is_controller(own: StartValues) -> bool:
    """Return whether an FMU with these start values is the pendulum's controller."""
    return own.keys() >= _CONTROLLER


def measured(outputs: list[str], measurement: str) -> dict[str, str]:
    """Return the pendulum's outputs by the names that they have for a controller that gets this measurement."""
    if measurement == "ideal":
        return {name: name for name in outputs}
    return {name: f"{name}_encoder" for name in ANGLES if f"{name}_encoder" in outputs}


def plant_start(parameters: str | None, folder: FilePath | None) -> dict[str, StartValue]:
    """Return the start values of a parameter set, or of a file of one; none for None."""
    return {} if parameters is None else dict(plant_start_values(parameter_files.named_set(parameters, folder)))


def controller_start(
    own: StartValues, scenario_start: StartValues, step: float, design: Path | None, measurement: str
) -> dict[str, StartValue]:
    """Return the controller's start values: those `scenario_start` in the scenario, and those that follow from what it says.

    `own` are those with which it was exported, `step` [s] is the run's.
    """
    start: dict[str, StartValue] = {}
    if own.get("sample_time") == CONTROLLER.step_size:  # not chosen at export
        low, high = SAMPLE_TIMES
        if not low <= step <= high and "sample_time" not in scenario_start:
            raise UserError(
                f"run.step, as the controller's sample time, must lie in [{low:g}, {high:g}] s, found {step:g} s"
            )
        start["sample_time"] = step
    if design is not None:
        start |= _design_values(design, scenario_start.get("voltage_limit", own.get("voltage_limit")))
    if measurement == "ideal":
        start["velocity_source"] = "inputs"
    start |= scenario_start
    source = start.get("velocity_source", own.get("velocity_source"))
    if source in ("kalman", VELOCITY_SOURCES.index("kalman") + 1):
        start = _kalman_values(own, start) | start
    return start


def _design_values(path: Path, voltage_limit: StartValue | None) -> dict[str, StartValue]:
    try:
        status = path.stat()
    except FileNotFoundError:
        raise UserError(f"design file {path} does not exist") from None
    except OSError as error:
        raise UserError(f"design file {path} cannot be read: {error.strerror}") from None
    return _values_of(path, voltage_limit, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=16)  # a design's proof takes longer than a run
def _values_of(path: Path, voltage_limit: StartValue | None, _time: int, _size: int) -> dict[str, StartValue]:
    from ihc_fmu.design import Design  # noqa: PLC0415 - heavy
    from ihc_fmu.pendulum.start_values import design_values  # noqa: PLC0415

    design = Design.load(path)
    return dict(design_values(design) if voltage_limit is None else design_values(design, None, float(voltage_limit)))


def _kalman_values(own: StartValues, start: StartValues) -> dict[str, StartValue]:
    """Return the Kalman filter's gain for sample time and nominal model; nothing where the FMU's own is for them."""
    values = {**own, **start}
    nominal = {name: float(value) for name, value in values.items() if name.startswith("nominal_")}
    time = float(values["sample_time"])
    if own.get("kalman_sample_time") == time and nominal.items() <= own.items():
        return {}
    return _kalman_gain(tuple(nominal.items()), time)


@lru_cache(maxsize=16)  # a Riccati equation
def _kalman_gain(nominal: tuple[tuple[str, float], ...], sample_time: float) -> dict[str, StartValue]:
    from ihc_fmu.pendulum.start_values import kalman_values  # noqa: PLC0415 - heavy

    return dict(kalman_values(dict(nominal), sample_time))
