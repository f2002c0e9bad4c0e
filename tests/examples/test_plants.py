"""The example plants against Lagrange's equations, the conservation of energy, published numbers and their files."""

from __future__ import annotations

import functools
import shutil
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
import sympy as sp
from fmpy.validation import validate_fmu

from cosim import structure
from cosim.fmu_files import start_values_of
from cosim.linearize import linear_model
from cosim.master import simulate
from cosim.model_match import remarks
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from cosim.scenario_system import build_system
from cosim.system_export import export_system
from cosim.system_file import write
from fmu_export.errors import UserError
from fmu_export.reading import parse_toml
from ihc_fmu.inverse import inverse_design
from ihc_fmu.regulator.interface import INTERFACE, OUTPUTS
from ihc_fmu.regulator.start_values import design_regulator
from ihc_fmu.regulator.unit import HomogeneousControllerUnit
from ihc_fmu.synthesis import chosen_options
from ihc_fmu.system import System

from .conftest import EXAMPLES

g, t = sp.symbols("gravity t")


def energies(name) -> Any:
    """Return coordinates, their rates, kinetic and potential energy, friction's powers by rate, forces by coordinate."""
    return {
        "crane": _crane,
        "arm": _arm,
        "double_pendulum": _double_pendulum,
        "rotorcraft": _rotorcraft,
        "servo": _servo,
    }[name]()


def _coordinates(*names) -> Any:
    q = sp.Matrix([sp.Function(name)(t) for name in names])
    return q, q.diff(t)


def _moving(mass, x, y):
    return mass * (sp.diff(x, t) ** 2 + sp.diff(y, t) ** 2) / 2


def _crane():
    M, m, l, I, b, d = sp.symbols("trolley_mass load_mass length load_inertia rail_friction joint_friction")
    q, v = _coordinates("s", "phi")
    x, y = q[0] + l * sp.sin(q[1]), -l * sp.cos(q[1])
    T = M * v[0] ** 2 / 2 + _moving(m, x, y) + I * v[1] ** 2 / 2
    F = sp.Symbol("force")
    return q, v, T, m * g * y, [F - b * v[0], -d * v[1]], [F]


def _arm():
    m1, m2, l1, c1, c2, I1, I2, b1, b2 = sp.symbols(
        "mass_1 mass_2 length_1 centre_1 centre_2 inertia_1 inertia_2 friction_1 friction_2"
    )
    q, v = _coordinates("p", "q")
    a = q[0] + q[1]
    x1, y1 = c1 * sp.sin(q[0]), c1 * sp.cos(q[0])
    x2, y2 = l1 * sp.sin(q[0]) + c2 * sp.sin(a), l1 * sp.cos(q[0]) + c2 * sp.cos(a)
    T = _moving(m1, x1, y1) + _moving(m2, x2, y2) + I1 * v[0] ** 2 / 2 + I2 * (v[0] + v[1]) ** 2 / 2
    u = sp.symbols("tau_1 tau_2")
    return q, v, T, g * (m1 * y1 + m2 * y2), [u[0] - b1 * v[0], u[1] - b2 * v[1]], list(u)


def _double_pendulum():
    m0, m1, m2, L1, L2, b = sp.symbols("cart_mass mass_1 mass_2 length_1 length_2 rail_friction")
    q, v = _coordinates("s", "a", "b")
    x1, y1 = q[0] + L1 / 2 * sp.sin(q[1]), L1 / 2 * sp.cos(q[1])
    x2 = q[0] + L1 * sp.sin(q[1]) + L2 / 2 * sp.sin(q[2])
    y2 = L1 * sp.cos(q[1]) + L2 / 2 * sp.cos(q[2])
    turning = (m1 * L1**2 * v[1] ** 2 + m2 * L2**2 * v[2] ** 2) / 24
    T = m0 * v[0] ** 2 / 2 + _moving(m1, x1, y1) + _moving(m2, x2, y2) + turning
    F = sp.Symbol("force")
    return q, v, T, g * (m1 * y1 + m2 * y2), [F - b * v[0], 0, 0], [F]


def _rotorcraft():
    m, arm, I = sp.symbols("mass arm inertia")
    q, v = _coordinates("x", "z", "pitch")
    u = sp.symbols("F_1 F_2")
    lift = u[0] + u[1]
    T = _moving(m, q[0], q[1]) + I * v[2] ** 2 / 2
    forces = [-lift * sp.sin(q[2]), lift * sp.cos(q[2]), arm * (u[0] - u[1])]
    return q, v, T, m * g * q[1], forces, list(u)


def _servo():
    k, kM, JM, JL, rho, bM, bL, R = sp.symbols(
        "stiffness motor_constant motor_inertia load_inertia ratio motor_friction load_friction resistance"
    )
    q, v = _coordinates("load", "motor")
    V = sp.Symbol("V")
    T = JL * v[0] ** 2 / 2 + JM * v[1] ** 2 / 2
    potential = k * (q[1] / rho - q[0]) ** 2 / 2
    return q, v, T, potential, [-bL * v[0], kM * (V - kM * v[1]) / R - bM * v[1]], [V]


def equations(name, plant) -> Any:
    """Return x, u and x' of Lagrange's equations with the plant's numbers, in symbols."""
    q, v, T, V, forces, u = energies(name)
    lagrangian = T - V
    equation = (lagrangian.diff(v).diff(t) - lagrangian.diff(q)).reshape(len(q), 1) - sp.Matrix(forces)
    acceleration = v.diff(t)
    M = equation.jacobian(acceleration)
    rest = equation.subs(dict.fromkeys(acceleration, 0))
    x = sp.symbols(f"x:{2 * len(q)}")
    named = {**dict(zip(v, x[len(q) :], strict=True)), **dict(zip(q, x[: len(q)], strict=True))}
    numbers = {sp.Symbol(p): getattr(plant, p) for p in plant.parameters}
    M, rest = (part.subs(named).subs(numbers) for part in (M, rest))
    total = (T + V).subs(named).subs(numbers)
    return x, u, sp.Matrix([*x[len(q) :], *M.LUsolve(-rest)]), total


def test_the_equations_are_those_of_lagrange(name, plant_of):
    plant = plant_of(name)
    x, u, rates, _ = equations(name, plant)
    f = sp.lambdify((x, u), list(rates))
    rng = np.random.default_rng(1)
    for _ in range(20):
        at, held = rng.uniform(-2, 2, len(x)).tolist(), rng.uniform(-5, 5, len(u)).tolist()
        np.testing.assert_allclose(plant.rates(at, held), f(at, held), rtol=1e-11, atol=1e-11)


FRICTIONS = {"rail_friction", "joint_friction", "friction_1", "friction_2", "motor_friction", "load_friction"}


def test_energy_is_conserved_without_friction_and_inputs(name, plant_of):
    plant = plant_of(name)
    for friction in FRICTIONS & plant.parameters.keys():
        setattr(plant, friction, 0.0)
    if name == "servo":
        plant.motor_constant = 0.0
    symbols, _, _, total = equations(name, plant)
    energy = sp.lambdify((symbols,), total)
    x = np.linspace(0.3, 1.0, len(plant.states)).tolist()
    first, drift = energy(x), []
    for _ in range(1000):
        x = plant._stepped(x, [0.0] * len(plant.inputs), 1e-3)
        drift.append(abs(energy(x) - first))
    moved = abs(first) + abs(energy(np.zeros(len(x))))
    assert max(drift) < 1e-8 * moved


def test_the_fmu_linearizes_to_the_jacobian_of_the_equations(name, plant_of, fmu_of, tmp_path):
    system = system_of(name)
    plant = plant_of(name)
    x, u, rates, _ = equations(name, plant)
    at = dict(zip((*x, *u), (*system.x_eq, *system.u_eq), strict=True))
    A = np.array(rates.jacobian(x).subs(at), dtype=float)
    B = np.array(rates.jacobian(u).subs(at), dtype=float)
    start = {"encoder_counts": 0.0} if name == "servo" else {}
    outputs = [] if system.measures_state else [q.name for q in system.outputs]
    model = linear_model(fmu_of(name), [q.name for q in system.inputs], outputs, start=start)
    for one in (model, system):  # the file that is shipped is what comes out
        np.testing.assert_allclose(one.A, A, rtol=1e-8, atol=1e-8 * np.abs(A).max())
        np.testing.assert_allclose(one.B, B, rtol=1e-8, atol=1e-8 * np.abs(B).max())
    np.testing.assert_array_equal(model.C, system.C)
    assert (model.states, model.inputs, model.outputs) == (system.states, system.inputs, system.outputs)
    assert model.error < 1e-8
    shipped = EXAMPLES / name / f"{name}.toml"
    again = Path(shutil.copy(shipped, tmp_path))
    write(again, model)
    one, other = (parse_toml(path.read_text(encoding="utf-8"), path) for path in (again, shipped))
    assert one.keys() == other.keys()
    assert one.get("equilibrium", {}).keys() == other.get("equilibrium", {}).keys()


TILTED = {
    "crane": [-0.5, 0.3, 0.0, 0.0],
    "arm": [0.2, -0.2, 0.0, 0.0],
    "double_pendulum": [0.0, 0.1, -0.1, 0.0, 0.0, 0.0],
    "rotorcraft": [1.0, 1.0, 0.2, 0.0, 0.0, 0.0],
    "servo": [-1.0, -20.0, 0.0, 0.0],
}


def system_of(name) -> Any:
    return System.load(EXAMPLES / name / f"{name}.toml")


@functools.cache
def regulator(name):
    """Return the controller of an example's design; where the file measures outputs, it is given the states instead."""
    system = system_of(name)
    if not system.measures_state:
        system = system.changed(C=None, outputs=(), resolutions=None, deviations=None, set_points=(), y_eq=system.x_eq)
    return design_regulator(inverse_design(system, chosen_options(system, mu=1.0).options))


def settled_after(law, controller, plant, x_eq, tilt):
    """Return after how many steps of 6 s the nonlinear plant stays within 1e-3 of the equilibrium, and how near it ends."""
    unit = HomogeneousControllerUnit(INTERFACE.start_values({**controller.values(), "law": law}))
    m, x, left, h = len(plant.inputs), x_eq + tilt, 0, controller.sample_time

    def row(y):
        return tuple(map(float, (*y, *np.zeros(2 * OUTPUTS - len(y)))))

    unit.initialize(0.0, row(x))
    for k in range(6000):
        unit.step(k * h, h, row(x))
        u = unit.outputs()[:m]
        assert (controller.lower <= u).all()
        assert (controller.upper >= u).all()
        x = np.array(plant._stepped(x.tolist(), list(u), h))
        left = k + 1 if np.abs(x - x_eq).max() > 1e-3 else left
    return left, np.abs(x - x_eq).max()


def test_the_homogeneous_controller_brings_the_nonlinear_plant_to_rest_sooner_than_the_linear_one(name, plant_of):
    controller, plant = regulator(name), plant_of(name)
    linear, _ = settled_after("LC", controller, plant, controller.x_eq, TILTED[name])
    homogeneous, rest = settled_after("IHC", controller, plant, controller.x_eq, TILTED[name])
    assert 500 < homogeneous < 0.85 * linear
    assert rest < 1e-4


def test_controller_and_plant_run_together_as_fmus(name, plant_of, fmu_of, tmp_path):
    design = inverse_design(system_of(name), chosen_options(system_of(name), mu=1.0).options)
    export_system(design, tmp_path)
    shutil.copy(fmu_of(name), tmp_path)
    scenario, _ = load_scenario(str(EXAMPLES / name / f"{name}_run.toml"))
    result = run_scenario(scenario, tmp_path, tmp_path)
    assert result.metadata["messages"] == {}
    plant, start = plant_of(name), scenario.plant.start
    signals = np.array([result[f"plant.{state}"] for state in plant.states])
    assert signals[:, 0].tolist() == [start.get(f"{state}_0", 0.0) for state in plant.states]
    assert np.abs(signals[:, -1]).max() < (1e-3 if design.system.measures_state else 0.02)
    _check_judgement(scenario, design.system, plant, tmp_path)


def _check_judgement(scenario, system, plant, folder):
    """The plant and its linear model fit without a remark, others of its kind fit, wires of another sign or order do not."""

    def built(**changes):
        return build_system(scenario.changed({n.replace("__", "."): v for n, v in changes.items()}), folder, folder)

    assert remarks(built()) == remarks(built(plant__fmu=f"{system.name}_linear_plant.fmu", plant__start={})) == []
    rng = np.random.default_rng(4)
    for _ in range(3):
        drawn = {name: value * rng.uniform(0.8, 1.2) for name, (value, *_) in plant.parameters.items()}
        built(plant__start=drawn)
    y, u = ([q.name for q in quantities] for quantities in (system.outputs, system.inputs))
    there = [f"plant.{name} -> controller.{name}" for name in y]
    back = [f"controller.{name} -> plant.{name}" for name in u]
    swapped = [f"plant.{y[1 - i] if i < 2 else name} -> controller.{name} * 1.05" for i, name in enumerate(y)]
    crossed = [f"controller.{name} -> plant.{other}" for name, other in zip(u, reversed(u), strict=True)]
    other = "model than the plant's, as it is wired: "
    opposite = f"{other}the sign of {u[0]} is the opposite"
    cases = [
        ([f"{there[0]} * -1", *there[1:], *back], f"the sign of {y[0]} is the opposite"),
        ([*there, *(f"{wire} * 0.001" for wire in back)], f"{', '.join(u)} acts? in thousandths of "),
        ([*swapped, *back], f"its (outputs|states) are in the order {y[1]}, {y[0]}"),
        *([([*there, *crossed], f"its inputs are in the order {u[1]}, {u[0]}, not {u[0]}, {u[1]}")] if u[1:] else []),
    ]
    problems = [(wires, other + problem) for wires, problem in cases]
    for wires, problem in [*problems, ([*there, f"{back[0]} * -1", *back[1:]], opposite)]:
        with pytest.raises(UserError, match=f"the controller was designed for another {problem}"):
            built(wires=wires)


def test_the_servos_poles_are_the_published_ones():
    poles = np.sort_complex(np.linalg.eigvals(System.load(EXAMPLES / "servo" / "servo.toml").A))
    np.testing.assert_allclose(poles, [-9.79, -0.705 - 7.31j, -0.705 + 7.31j, 0.0], atol=6e-3)


def test_the_fmu_is_valid_has_units_and_steps_as_the_class_does(name, plant_of, fmu_of):
    path, plant = fmu_of(name), plant_of(name)
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    units = {v.name: v.unit for v in description.modelVariables}
    for quantity, (_, unit, _) in (plant.states | plant.inputs | plant.parameters).items():
        assert units[quantity] == unit
    start = {f"{state}_0": value for state, value in zip(plant.states, TILTED[name], strict=True)}
    result = simulate(structure.SystemStructure([structure.Component("plant", path, start)]), 0.01, 0.02)
    x, held = TILTED[name], [quantity[0] for quantity in plant.inputs.values()]
    for row in zip(*(result[f"plant.{state}"] for state in plant.states), strict=True):
        assert row == pytest.approx(x, abs=1e-13)
        for _ in range(10):
            x = plant._stepped(x, held, 1e-3)


def test_the_scenario_is_of_this_plant_and_begins_beside_the_equilibrium(name, fmu_of):
    scenario, _ = load_scenario(str(EXAMPLES / name / f"{name}_run.toml"))
    assert (scenario.plant.fmu, scenario.controller.fmu) == (f"{name}.fmu", f"{name}_controller.fmu")
    system = system_of(name)
    initial = {f"{q.name}_0" for q in system.states}
    assert scenario.plant.start.keys() <= initial <= start_values_of(fmu_of(name)).keys()
    assert scenario.run.step == system.sample_time
