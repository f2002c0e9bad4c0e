"""Shared by the controller's tests: the paper's system, designs, the authors' reference, units and closed loops."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from ihc_fmu import interface
from ihc_fmu.design import PAPER_A, PAPER_B, PAPER_K_LIN, Options, inverse_design
from ihc_fmu.start_values import controller_start_values, default_design
from ihc_fmu.unit import IhcControllerUnit
from plant_fmu import interface as plant_interface
from plant_fmu.parameters import parameter_set
from plant_fmu.unit import QubePlant

PLANT_OUTPUTS = [v.name for v in plant_interface.INTERFACE.of("output")]
CONTROLLER_OUTPUTS = [v.name for v in interface.INTERFACE.of("output")]
SEEN_BY_CONTROLLER = [PLANT_OUTPUTS.index(n) for n in ("theta_encoder", "delta_encoder", "theta_dot", "delta_dot")]


@pytest.fixture(scope="session")
def paper():
    """A, b and k_lin as printed in section V of the paper."""
    return np.array(PAPER_A), np.array(PAPER_B), np.array(PAPER_K_LIN)


@pytest.fixture(scope="session")
def design():
    return default_design()


@pytest.fixture(scope="session")
def designs(paper, design):
    """Designs for the paper's system by mu, with alpha at two thirds of the largest feasible one or more."""
    alphas = {0.25: 0.5, 0.5: 0.35}
    return {mu: inverse_design(*paper, Options(mu=mu, alpha=alpha)) for mu, alpha in alphas.items()} | {1.0: design}


@pytest.fixture(scope="session")
def hcs_cases():
    """Two models with states, norms and controls computed by the authors' toolbox; see data/README.md."""
    path = Path(__file__).with_name("data") / "hcs_reference.json"
    return {case["name"]: case for case in json.loads(path.read_text(encoding="utf-8"))["cases"]}


@pytest.fixture(scope="session")
def start_values(design):
    return controller_start_values(design)


@pytest.fixture(scope="session")
def controller(start_values):
    """Make a controller of the default design with some start values changed."""
    return lambda **changes: IhcControllerUnit(interface.INTERFACE.start_values(start_values | changes))


@pytest.fixture(scope="session")
def closed_loop():
    """Run controller and plant at 1 ms; return their outputs by name, sampled before each step of the plant."""

    def run(unit, seconds, parameters="ident", changes=None, h=1e-3):
        plant_values = plant_interface.start_values(parameters) | (changes or {})
        plant = QubePlant(plant_interface.INTERFACE.start_values(plant_values))
        seen = plant.outputs()
        unit.initialize(0.0, tuple(seen[i] for i in SEEN_BY_CONTROLLER))
        rows = []
        for k in range(round(seconds / h)):
            unit.step(k * h, h, tuple([seen[i] for i in SEEN_BY_CONTROLLER]))
            commanded = unit.outputs()
            rows.append(seen + commanded)
            plant.step(k * h, h, (commanded[0], 0.0, 0.0))
            seen = plant.outputs()
        columns = np.array(rows, float).T
        return dict(zip([*PLANT_OUTPUTS, *CONTROLLER_OUTPUTS], columns, strict=True))

    return run


@pytest.fixture(scope="session")
def parameters_of():
    return lambda name: parameter_set(name).parameters


@pytest.fixture(scope="session")
def error_norm():
    """Return |q| = hypot(theta, delta) of a closed loop, delta from the nearest upright position."""
    return lambda run: np.hypot(run["theta"], [math.remainder(delta, math.tau) for delta in run["delta"]])
