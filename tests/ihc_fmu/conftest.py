"""Shared by the controller's tests: the paper's system, designs, the authors' reference, units and closed loops."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from ihc_fmu.companion import chain_form, weights
from ihc_fmu.homogeneity import chain, homogeneous_norm, norm_polynomial
from ihc_fmu.inverse import inverse_design
from ihc_fmu.laws import chain_design, implicit_homogeneous
from ihc_fmu.options import Options
from ihc_fmu.pendulum import interface
from ihc_fmu.pendulum.paper_system import PAPER_A, PAPER_B, PAPER_K_LIN, paper_system
from ihc_fmu.pendulum.start_values import controller_start_values, default_design
from ihc_fmu.pendulum.unit import IhcControllerUnit
from plant_fmu import interface as plant_interface
from plant_fmu.parameters import parameter_set
from plant_fmu.unit import QubePlant

PLANT_OUTPUTS = [v.name for v in plant_interface.INTERFACE.calculated]
CONTROLLER_OUTPUTS = [v.name for v in interface.INTERFACE.calculated]
SEEN_BY_CONTROLLER = [PLANT_OUTPUTS.index(n) for n in ("theta_encoder", "delta_encoder", "theta_dot", "delta_dot")]


def chain_of(design):
    """Return the chain form of a design for one input."""
    return chain_form(design.A, design.b)


def chain_gain(design):
    """Return the homogeneous gain in the chain form, shape (n,)."""
    return np.linalg.solve(chain_of(design).Phi.T, design.k_lin + chain_of(design).row)


class IdealLoop:
    """x' = A x + b (u + d) under the law of a design with its exact norm, not below `a_min`.

    Norms are searched from a guess: 1 on the unit sphere, the last value during a simulation.
    """

    def __init__(self, design, a_min=0.0):
        self.design, self.a_min = design, a_min
        form = chain_of(design)
        self.Phi = form.Phi
        self.law = chain_design(
            form.Phi.tolist(), form.row.tolist(), design.k_lin.tolist(), design.P.tolist(), design.mu
        )

    def on_the_sphere(self, rng):
        """Return a random x with x' P x = 1."""
        direction = rng.normal(size=self.design.n)
        return np.linalg.solve(np.linalg.cholesky(self.design.P).T, direction / np.linalg.norm(direction))

    def dilated(self, x, r):
        """Return d(ln r) x, through chain coordinates."""
        d = self.design
        return np.linalg.solve(self.Phi, r ** weights(d.n, d.mu) * (self.Phi @ x))

    def norm(self, x, guess=1.0):
        d = self.design
        return homogeneous_norm(norm_polynomial(self.law.Pz, (self.Phi @ x).tolist(), chain(d.n), d.mu), d.mu, guess)

    def velocity(self, x, r, disturbance=0.0):
        """Return x' for the norm r in the law."""
        d, r = self.design, max(self.a_min, r)
        return d.A @ x + d.b * (implicit_homogeneous(self.law, r, x, self.Phi @ x)[0] + disturbance)

    def rate(self, x, r, disturbance=0.0):
        """Return d||x||_d/dt at x with ||x||_d = r, by a central difference along the motion."""
        v = self.velocity(x, r, disturbance)
        step = 1e-5 / np.linalg.norm(np.linalg.cholesky(self.design.P).T @ self.dilated(v, 1 / r))
        return (self.norm(x + step * v, r) - self.norm(x - step * v, r)) / (2 * step)

    def worst_rates(self, disturbance, count):
        """Return the larger d||x||_d/dt under +-`disturbance` [V] at random x with norms in [0.1, 10]; mu = 1."""
        rng, rates = np.random.default_rng(11), []
        for r in 10.0 ** rng.uniform(-1, 1, count):
            x = self.dilated(self.on_the_sphere(rng), r)
            rates.append(max(self.rate(x, r, disturbance), self.rate(x, r, -disturbance)))
        return np.array(rates)

    def run(self, x, done):
        """Return the time and state where `done(t, x, ||x||_d)`; the poles scale with r^-mu, and so do the RK4 steps."""
        t, r = 0.0, self.norm(x)
        while not done(t, x, r):
            h = 0.01 * max(self.a_min, r) ** self.design.mu
            k1 = self.velocity(x, r)
            y = x + h / 2 * k1
            k2 = self.velocity(y, self.norm(y, r))
            y = x + h / 2 * k2
            k3 = self.velocity(y, self.norm(y, r))
            y = x + h * k3
            k4 = self.velocity(y, self.norm(y, r))
            x, t = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), t + h
            r = self.norm(x, r)
            assert t < 20.0
        return t, x


@pytest.fixture(scope="session")
def ideal_loop():
    return IdealLoop


@pytest.fixture(scope="session")
def paper():
    """A, b and k_lin as printed in section V of the paper."""
    return np.array(PAPER_A), np.array(PAPER_B), np.array(PAPER_K_LIN)


@pytest.fixture(scope="session")
def design():
    return default_design()


@pytest.fixture(scope="session")
def designs(design):
    """Designs for the paper's system by mu, with alpha at two thirds of the largest feasible one or more."""
    alphas = {0.25: 0.5, 0.5: 0.35}
    return {mu: inverse_design(paper_system(), Options(mu=mu, alpha=alpha)) for mu, alpha in alphas.items()} | {
        1.0: design
    }


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
    """Run controller and plant at 1 ms; return their outputs by name, sampled before each step of the plant.

    `set_point` gives the arm's at a time.
    """

    def run(unit, seconds, parameters="ident", changes=None, h=1e-3, set_point=lambda time: 0.0):
        plant_values = plant_interface.start_values(parameters) | (changes or {})
        plant = QubePlant(plant_interface.INTERFACE.start_values(plant_values))
        seen = plant.outputs()
        unit.initialize(0.0, (*[seen[i] for i in SEEN_BY_CONTROLLER], set_point(0.0)))
        rows = []
        for k in range(round(seconds / h)):
            unit.step(k * h, h, (*[seen[i] for i in SEEN_BY_CONTROLLER], set_point(k * h)))
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
