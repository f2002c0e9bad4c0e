"""Systems for the tests of the linear plant, and its unit in Python for a system."""

from __future__ import annotations

import numpy as np

from fmu_export.shown import Showing
from ihc_fmu.system import System
from plant_fmu.linear.interface import INTERFACE, MOST_INPUTS, MOST_OUTPUTS, MOST_STATES
from plant_fmu.linear.start_values import linear_plant_values, shown_interface
from plant_fmu.linear.unit import LinearPlantUnit

CRANE = System(
    name="crane",
    A=np.array([[0, 1, 0, 0], [0, -0.5, 2.4, 0], [0, 0, 0, 1], [0, -1.1, -27.0, -0.1]]),
    B=np.array([[0], [1.0], [0], [2.2]]),
    C=np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]]),
    states=("position [m]", "velocity [m/s]", "angle [rad]", "rate [rad/s]"),  # type: ignore[arg-type]
    inputs=("force [N]",),  # type: ignore[arg-type]
    outputs=("position [m]", "angle_sensor [rad]"),  # type: ignore[arg-type]
    lower=np.array([-5.0]),
    upper=np.array([4.0]),
    resolutions=np.array([1e-3, 0.0]),
    sample_time=2e-3,
)

OSCILLATOR = System(A=np.array([[0.0, 1.0], [-4.0, 0.0]]), B=np.array([[0.0], [1.0]]), name="oscillator")


def random_system(seed: int) -> System:
    """Return a system of n = 1..16, m = 1..8, p = 1..16, fast and slow, with limits, sensors and an equilibrium."""
    rng = np.random.default_rng(seed)
    n, m, p = seed % 16 + 1, seed % 8 + 1, int(rng.integers(1, 17))
    units = 10.0 ** rng.uniform(-3, 3, size=n)
    A = rng.normal(size=(n, n)) - 1.5 * np.sqrt(n) * np.eye(n)
    kept = rng.random((n, n)) < 0.8
    return System(
        A=10 ** rng.uniform(-1, 3) * np.where(kept, A, 0.0) * units[:, None] / units,
        B=rng.normal(size=(n, m)) * units[:, None],
        C=rng.normal(size=(p, n)) / units,
        lower=np.where(rng.random(m) < 0.5, -np.inf, -1.0),
        upper=np.where(rng.random(m) < 0.5, np.inf, 1.5),
        resolutions=rng.choice([0.0, 1e-3, 0.1], size=p),
        x_eq=rng.normal(size=n) * units * (rng.random() < 0.5),
        u_eq=0.5 * rng.uniform(-1, 1, size=m),
        y_eq=rng.normal(size=p),
    )


def plant_of(system: System, **changes: float) -> LinearPlantUnit:
    """Return the plant of a system, with changes to the start values of its FMU."""
    shown = shown_interface(system)
    start = shown.start_values(changes)
    return LinearPlantUnit(Showing(INTERFACE, shown).compiled_values(start, linear_plant_values(system)))


def inputs_of(u=(), d=()):
    """Return all compiled inputs and disturbances, those not given 0."""
    return (*u, *(0.0,) * (MOST_INPUTS - len(u)), *d, *(0.0,) * (MOST_INPUTS - len(d)))


def measured(plant: LinearPlantUnit) -> tuple[float, ...]:
    """Return the outputs that the model has."""
    return plant.outputs()[: len(plant.C)]


def states(plant: LinearPlantUnit) -> tuple[float, ...]:
    """Return the true states."""
    return plant.outputs()[MOST_OUTPUTS : MOST_OUTPUTS + len(plant.A)]


def derivatives(plant: LinearPlantUnit) -> tuple[float, ...]:
    """Return the states' derivatives."""
    first = MOST_OUTPUTS + MOST_STATES
    return plant.outputs()[first : first + len(plant.A)]
