"""The general controller as it is stepped: the authors' toolbox, closed forms, the pendulum's controller, its rules."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from ihc_fmu.homogeneity import homogeneous_norm
from ihc_fmu.laws import block_state, integrand
from ihc_fmu.pendulum.interface import INTERFACE as PENDULUM
from ihc_fmu.pendulum.unit import IhcControllerUnit
from ihc_fmu.regulator.interface import INTERFACE, Shape
from ihc_fmu.regulator.start_values import Regulator, set_point_matrices
from ihc_fmu.regulator.unit import HomogeneousControllerUnit, Mode
from ihc_fmu.sampled_unit import Fault
from tests.ihc_fmu.blocks import exponents_of, random_system
from tests.ihc_fmu.conftest import chain_of
from tests.ihc_fmu.reference import SYSTEMS
from tests.ihc_fmu.regulator.conftest import OUTPUT_NAMES, H, names, random_regulator, row

EXPLICIT, EXACT = {"discretization": 1, "norm_solver": 2, "a_min": 1e-6, "b_max": 1e6}, {"norm_solver": 2}
LC = {"law": 1}


def unit_of(regulator, **changes):
    return HomogeneousControllerUnit(INTERFACE.start_values({**regulator.values(), **changes}))


def outputs(unit):
    return dict(zip(OUTPUT_NAMES, unit.outputs(), strict=True))


def commands(unit, regulator):
    return np.array(unit.outputs()[: len(regulator.shape.inputs)])


def sampled(regulator, x, **changes):
    """Return the outputs after one sample of the measured state x, and the commands."""
    unit = unit_of(regulator, **changes)
    unit.initialize(0.0, row(x))
    assert unit.step(0.0, regulator.sample_time, row(x)) == []
    return outputs(unit), commands(unit, regulator)


def designed(A, B, T, e, K_0, K, P, mu, h=H, **rest) -> Any:
    """Return the unlimited design of a model whose states are measured, in block coordinates that are given."""
    A, B, T, K_0 = (np.array(M, dtype=float) for M in (A, B, T, K_0))
    inverse = np.linalg.inv(T)
    n, m = B.shape
    shape = Shape(name="plant", states=names("x", n), inputs=names("u", m), outputs=names("x", n))
    N = T @ (A + B @ K_0) @ inverse
    return Regulator(shape=shape, exponents=e, T=T, N=N, B=T @ B, K_0=K_0, K=K, P=P, mu=mu, sample_time=h, **rest)


# The authors' toolbox


def of_toolbox(system, part, K, mu):
    e = exponents_of(system["blocks"][0])
    P = np.array(part["P"])
    return designed(system["A"], system["B"], system["T"], e, part["K0"], K, (P + P.T) / 2, mu)


@pytest.mark.parametrize("name", SYSTEMS)
def test_norm_and_commands_are_those_of_the_authors_toolbox(name):
    system, compared = SYSTEMS[name], 0
    part = system["lpc2hpc"]
    for v in part["vectors"]:
        if v["degree"] > 0:  # a mu below 0 is not for this controller
            continue
        regulator = of_toolbox(system, part, system["K_lin"], -v["degree"])
        x = np.ravel(v["x"])
        values, u = sampled(regulator, x, **EXPLICIT)
        assert values["homogeneous_norm"] == pytest.approx(v["norm"], rel=1e-9)
        np.testing.assert_allclose(u, np.ravel(v["u"]), rtol=1e-9)
        limits = {"norm_solver": 2, "a_min": 0.3, "b_max": 1.0}
        _, clamped = sampled(regulator, x, **limits, discretization=1)
        np.testing.assert_allclose(clamped, np.ravel(v["u_clamped"]), rtol=1e-9)
        _, ahead = sampled(regulator, x, **limits, discretization=2)
        np.testing.assert_allclose(ahead, np.ravel(v["u_semi_implicit"]), rtol=1e-9)
        compared += 1
    assert compared >= 8


@pytest.mark.parametrize("name", SYSTEMS)
def test_integral_action_is_that_of_the_authors_toolbox(name):
    """v' = r^(1-2 mu) K_i y / (y' P G_d y), y = d(-ln r) x, with K_i = -B' P; the toolbox omits the divisor."""
    system = SYSTEMS[name]
    for part in system["hpc_design"]:
        mu = -part["degree"]
        regulator = of_toolbox(system, part, np.array(part["K0"]) + part["K"], mu)
        regulator = replace(regulator, K_i=-np.array(system["B"]).T @ regulator.P)
        for v in part["vectors"]:
            x = np.ravel(v["x"])
            values, u = sampled(regulator, x, **EXPLICIT)
            assert values["homogeneous_norm"] == pytest.approx(v["norm"], rel=1e-9)
            np.testing.assert_allclose(u, np.ravel(v["u"]), rtol=1e-9)
            unit = unit_of(regulator, **EXPLICIT)
            unit.step(0.0, H, row(x))
            G = np.array(part["Gd"])
            y = expm(-np.log(v["norm"]) * G) @ x
            np.testing.assert_allclose(
                np.array(unit.state.v) / H * (y @ regulator.P @ G @ y), np.ravel(v["integrand_hpic"]), rtol=1e-8
            )


# The laws


def test_with_the_pendulums_design_it_commands_what_the_pendulums_controller_does(design, start_values, closed_loop):
    """To the last bit, for every law and norm solver, at the states of a run."""
    run = closed_loop(IhcControllerUnit(PENDULUM.start_values({**start_values, "velocity_source": 2})), 2.0)
    states = np.column_stack([run[name] for name in ("theta_encoder", "delta_encoder", "theta_dot", "delta_dot")])
    states = states[run["mode"] == 3]
    shape = Shape(name="p", states=names("x", 4), inputs=(("voltage", "V"),), outputs=names("x", 4))
    regulator = Regulator(
        shape=shape,
        exponents=[3, 2, 1, 0],
        T=chain_of(design).Phi,
        N=np.eye(4, k=1),
        B=np.eye(4)[:, 3:],
        K_0=-chain_of(design).row[None],
        K=design.k_lin[None],
        P=design.P,
        mu=design.mu,
        sample_time=H,
        lower=np.array([-10.0]),
        upper=np.array([10.0]),
    )
    wide = dict.fromkeys(("capture_level", "capture_angle", "capture_velocity", "fall_back_angle"), 1e3)
    for law, solver, discretization in [("LC", 1, 1), *[("IHC", s, d) for s in (1, 2) for d in (1, 2)]]:
        choice = {"law": law, "norm_solver": solver, "discretization": discretization, "a_min": 0.2}
        pendulum = IhcControllerUnit(PENDULUM.start_values({**start_values, **wide, "velocity_source": 2, **choice}))
        ours = unit_of(regulator, **choice)
        for k, x in enumerate(states.tolist()):
            x[1] = math.remainder(x[1], math.tau)
            pendulum.step(k * H, H, (*x, 0.0))
            ours.step(k * H, H, row(x))
            theirs = pendulum.outputs()
            assert ours.outputs()[0] == theirs[0]
            assert outputs(ours)["homogeneous_norm_used"] == theirs[2]


@pytest.mark.parametrize(("n", "m"), [(1, 1), (3, 2), (6, 1), (16, 8)])
def test_bounds_of_one_are_the_linear_controller_to_the_last_bit(n, m):
    regulator = random_regulator(n, m, 2, set_points=True)
    for solver in (1, 2):
        linear = unit_of(regulator, law=1)
        ours = unit_of(regulator, a_min=1.0, b_max=1.0, norm_solver=solver, discretization=1)
        for k, y in enumerate(np.random.default_rng(n).normal(size=(20, 2))):
            for unit in (linear, ours):
                unit.step(k * H, H, row(y, 0.1 * y))
            assert commands(ours, regulator).tolist() == commands(linear, regulator).tolist()


def test_no_bit_changes_without_set_points():
    regulator = random_regulator(5, 2, 3, set_points=True)
    without = replace(regulator, N_x=np.zeros((5, 3)), N_u=np.zeros((2, 3)))
    units = [unit_of(r, **EXPLICIT) for r in (regulator, without)]
    for k, y in enumerate(np.random.default_rng(0).normal(size=(20, 3))):
        for unit in units:
            unit.step(k * H, H, row(y, regulator.y_eq))
        assert units[0].outputs() == units[1].outputs()


# Equilibrium, limits, modes


def test_at_the_equilibrium_it_commands_the_input_there():
    """With measured outputs and set-points at the equilibrium: all laws, also with filter and integral action."""
    for p in (0, 2):
        regulator = random_regulator(4, 2, p, integral=True, set_points=True)
        unit = unit_of(regulator)
        for k in range(5):
            unit.step(k * H, H, row(regulator.y_eq, regulator.y_eq))
        np.testing.assert_array_equal(commands(unit, regulator), regulator.u_eq)
        at_rest = regulator.x_eq if p else regulator.y_eq
        np.testing.assert_array_equal([outputs(unit)[f"state_estimate_{i}"] for i in (1, 2, 3, 4)], at_rest)


def test_law_acts_on_the_deviation_from_the_state_at_rest_for_the_set_points():
    regulator = random_regulator(4, 2, set_points=True)
    regulator = replace(regulator, lower=None, upper=None)
    rng = np.random.default_rng(1)
    y, r = rng.normal(size=4), 0.1 * rng.normal(size=4)
    _, u = sampled(regulator, regulator.y_eq + y, **LC)  # set-points beside the equilibrium: row() has 0
    unit = unit_of(regulator, **LC)
    unit.step(0.0, H, row(regulator.y_eq + y, regulator.y_eq + r))
    expected = regulator.K @ (y - regulator.N_x @ r) + regulator.N_u @ r + regulator.u_eq
    np.testing.assert_allclose(commands(unit, regulator), expected, rtol=1e-12)
    assert (u != expected).all()


def test_commands_stay_within_their_limits():
    regulator = replace(
        random_regulator(4, 3), lower=np.array([-1.0, -2.0, -np.inf]), upper=np.array([0.5, np.inf, 3.0])
    )
    rng = np.random.default_rng(2)
    free = replace(regulator, lower=None, upper=None)
    hit = np.zeros(3)
    for _ in range(50):
        x = 10.0 * rng.normal(size=4)
        _, u = sampled(regulator, x)
        _, wanted = sampled(free, x)
        np.testing.assert_array_equal(u, np.clip(wanted, regulator.lower, regulator.upper))
        hit += u != wanted
    assert (hit > 5).all()


def test_idle_controller_commands_0_within_the_limits_and_so_does_one_that_was_never_sampled():
    regulator = replace(random_regulator(4, 3), lower=np.array([-1.0, 0.5, -3.0]), upper=np.array([1.0, 2.0, -0.5]))
    unit = unit_of(regulator, enabled=False)
    assert commands(unit, regulator).tolist() == [0.0, 0.5, -0.5]
    unit.step(0.0, H, row([1.0, 2.0, 3.0, 4.0]))
    assert commands(unit, regulator).tolist() == [0.0, 0.5, -0.5]
    assert outputs(unit)["mode"] == Mode.IDLE
    enabled = unit_of(regulator)
    enabled.set_state(unit.get_state())
    enabled.step(H, H, row([1.0, 2.0, 3.0, 4.0]))
    assert outputs(enabled)["mode"] == Mode.STABILIZING
    assert (commands(enabled, regulator) != [0.0, 0.5, -0.5]).any()


def test_interval_of_algorithm_1_starts_anew_when_the_law_takes_over():
    regulator = random_regulator(3, 1)
    on = {"norm_solver": 1, "a_min": 0.25, "b_max": 4.0, "j_max": 1}
    unit, fresh = unit_of(regulator, **on), unit_of(regulator, **on)
    x = row(regulator.y_eq + 0.01)
    for k in range(8):
        unit.step(k * H, H, x)
    for k, flag in ((8, False), (9, True)):
        following = unit_of(regulator, **on, enabled=flag)
        following.set_state(unit.get_state())
        unit = following
        unit.step(k * H, H, x)
    fresh.step(0.0, H, x)
    assert unit.state.interval == fresh.state.interval


def test_commands_that_are_not_finite_fault_it():
    unit = unit_of(random_regulator(2, 1), lower_1=-0.25, upper_1=-0.125, K_1=1e3, **LC)
    (message,) = unit.step(0.0, H, row([1.7e308, -1.7e308]))
    assert (
        message
        == "fault non_finite_control: the command is not finite; the commands are 0 within their limits until reset"
    )
    values = outputs(unit)
    assert (values["command_1"], values["mode"], values["fault"]) == (-0.125, Mode.FAULT, Fault.NON_FINITE_CONTROL)
    assert unit.step(H, H, row([0.0, 0.0])) == []
    assert outputs(unit)["mode"] == Mode.FAULT


def test_state_passes_through_json():
    regulator = random_regulator(5, 2, 3, integral=True, set_points=True)
    unit, other = unit_of(regulator), unit_of(regulator)
    rng = np.random.default_rng(3)
    for k in range(10):
        unit.step(k * H, H, row(rng.normal(size=3)))
    other.set_state(json.loads(json.dumps(unit.get_state())))
    for k in range(10, 20):
        y = row(rng.normal(size=3))
        unit.step(k * H, H, y)
        other.step(k * H, H, y)
        assert other.outputs() == unit.outputs()


# Integral action


def test_integral_action_stands_still_where_its_command_is_limited():
    """Only that entry whose command is beyond the limit that it moves to; the others go on."""
    regulator = random_regulator(4, 2, mu=0.5, integral=True)
    regulator = replace(
        regulator, u_eq=np.zeros(2), y_eq=np.zeros(4), lower=np.full(2, -np.inf), upper=np.full(2, np.inf)
    )
    x = np.random.default_rng(4).normal(size=4)
    _, wanted = sampled(regulator, x)
    unit = unit_of(regulator)
    unit.step(0.0, H, row(x))
    rates = np.array(unit.state.v)
    deeper = np.sign(rates[0]) * np.inf
    for limit, stands in ((wanted[0] - np.sign(rates[0]), True), (wanted[0] + np.sign(rates[0]), False)):
        side = "upper" if deeper > 0 else "lower"
        bounds = getattr(regulator, side).copy()
        bounds[0] = limit
        limited = unit_of(replace(regulator, **{side: bounds}))
        limited.step(0.0, H, row(x))
        assert (limited.state.v[0] == 0.0) is stands
        assert limited.state.v[1] == rates[1]


def test_integral_action_takes_away_a_constant_error():
    """A double integrator under a constant disturbance at mu = 0.5: without it an error stays, with it none does."""
    A, B, mu = np.eye(2, k=1), np.array([[0.0], [1.0]]), 0.5
    P = np.array([[1.2, 0.5], [0.5, 0.6]])
    regulator = designed(A, B, np.eye(2), [1, 0], np.zeros((1, 2)), [[-4.0, -3.0]], P, mu, h=0.01)
    discrete = expm(0.01 * np.block([[A, B], [np.zeros((1, 3))]]))

    def end(K_i):
        unit, x = unit_of(replace(regulator, K_i=K_i), norm_solver=2, a_min=0.7, discretization=1), np.zeros(2)
        for k in range(6000):
            unit.step(k * 0.01, 0.01, row(x))
            x = discrete[:2, :2] @ x + discrete[:2, 2] * (unit.outputs()[0] + 0.8)
        return x

    assert abs(end(np.zeros((1, 2)))[0]) > 0.05
    assert np.abs(end(np.array([[-0.5, -0.6]]))).max() < 1e-3


# Estimates


def test_filter_is_the_predictor_corrector():
    """x- = F x + G (u + d), innovation y - C x- - b-, all corrected by M; u is the limited command of the sample before."""
    regulator = random_regulator(5, 2, 3)
    regulator = replace(regulator, lower=np.full(2, -0.4), upper=np.full(2, 0.4), u_eq=np.array([0.1, -0.2]))
    f, unit = regulator.filter, unit_of(regulator, compensate_disturbance=True)
    rng = np.random.default_rng(5)
    x, d, b, u = None, np.zeros(2), np.zeros(3), np.zeros(2)
    for k in range(30):
        y = rng.normal(size=3)
        unit.step(k * H, H, row(regulator.y_eq + y))
        if x is None:
            x = np.linalg.pinv(f.C) @ y
        else:
            x, b = f.F @ x + f.G @ (u - regulator.u_eq + d), 0.999 * b
            e = y - f.C @ x - b
            x, d, b = x + f.M[:5] @ e, d + f.M[5:7] @ e, b + f.M[7:] @ e
        values = outputs(unit)
        np.testing.assert_allclose([values[f"state_estimate_{i}"] for i in range(1, 6)], x + regulator.x_eq, rtol=1e-9)
        np.testing.assert_allclose([values[f"disturbance_estimate_{i}"] for i in (1, 2)], d, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose([values[f"bias_estimate_{i}"] for i in (1, 2, 3)], b, rtol=1e-9, atol=1e-15)
        u = commands(unit, regulator)
    assert set(np.abs(u)) == {0.4}


def test_disturbance_estimates_are_subtracted_where_wanted():
    regulator = replace(random_regulator(5, 2, 3), lower=None, upper=None)
    on, off = (unit_of(regulator, compensate_disturbance=flag) for flag in (True, False))
    y = row(np.random.default_rng(6).normal(size=3))
    for unit in (on, off):
        unit.step(0.0, H, y)
    off.set_state(on.get_state())
    for unit in (on, off):
        unit.step(H, H, y)
    d = np.array(on.state.d)
    assert (d != 0.0).all()
    np.testing.assert_allclose(commands(off, regulator) - commands(on, regulator), d, rtol=1e-9)


def test_filter_that_leaves_the_numbers_faults_and_keeps_its_estimates():
    regulator = random_regulator(4, 2, 2)
    regulator = replace(regulator, filter=replace(regulator.filter, M=1e4 * regulator.filter.M))
    unit = unit_of(regulator)
    unit.step(0.0, H, row([1.0, 2.0]))
    before = outputs(unit)
    (message,) = unit.step(H, H, row([1.7e308, -1.7e308]))
    assert "non_finite_control" in message
    assert {k: v for k, v in outputs(unit).items() if "estimate" in k} == {
        k: v for k, v in before.items() if "estimate" in k
    }


# Set-points


def test_set_points_are_held_by_the_states_and_inputs_at_rest():
    rng = np.random.default_rng(7)
    A, B, C = rng.normal(size=(6, 6)), rng.normal(size=(6, 3)), rng.normal(size=(4, 6))
    N_x, N_u = set_point_matrices(A, B, C, (0, 2, 3))
    assert not N_x[:, 1].any()
    r = np.array([1.0, 5.0, -2.0, 0.5])
    np.testing.assert_allclose(A @ N_x @ r + B @ N_u @ r, 0.0, atol=1e-9)
    np.testing.assert_allclose((C @ N_x @ r)[[0, 2, 3]], r[[0, 2, 3]], rtol=1e-9)


def test_set_points_that_cannot_be_held_are_refused():
    """The velocity of a double integrator, and more outputs than inputs; what is fixed at rest is named."""
    A, B = np.eye(2, k=1), np.array([[0.0], [1.0]])
    lags = -np.diag([1.0, 2.0])  # at rest x1 = u and x2 = u / 2
    for A_of, B_of, held, said in (
        (A, B, (1,), "found v: at rest v stays where"),
        (A, B, (0, 1), "found x, v: at rest v stays where"),
        (lags, np.ones((2, 1)), (0, 1), r"found x, v: at rest - 0.5 x \+ v stays where"),
    ):
        with pytest.raises(ValueError, match=rf"^set_points must be outputs .* together, {said}"):
            set_point_matrices(A_of, B_of, np.eye(2), held, ("x", "v"))


def test_first_norm_is_that_of_the_first_measurement():
    regulator = random_regulator(4, 2, 2, set_points=True)
    unit = unit_of(regulator)
    y, r = np.array([1.0, -0.5]), np.array([0.1, 0.2])
    unit.initialize(5.0, row(regulator.y_eq + y, regulator.y_eq + r))
    state = block_state(unit.design, (np.linalg.pinv(regulator.filter.C) @ y - regulator.N_x @ r).tolist())
    assert outputs(unit)["homogeneous_norm"] == pytest.approx(homogeneous_norm(state.polynomial, 1.0), rel=1e-9)
    silent = unit_of(regulator)
    silent.initialize(0.0, row([math.nan, 0.0]))
    assert outputs(silent)["homogeneous_norm"] == 0.0


def test_integrand_is_its_formula_with_the_matrix_exponential():
    for n, m, mu in ((3, 1, 0.5), (6, 3, 0.25), (9, 2, 0.4)):
        system = random_system(n, m, mu)
        K_i, x = -system.B.T @ system.P, np.random.default_rng(n).normal(size=n)
        design = system.design()
        Kiz = (K_i @ np.linalg.inv(system.T)).tolist()
        for r in (0.3, 1.0, 2.0):
            y = expm(-system.generator() * math.log(r)) @ x
            expected = r ** (1 - 2 * mu) * K_i @ y
            quotient = (y @ system.P @ y) / (y @ system.P @ system.generator() @ y)
            for free, factor in ((False, 1.0), (True, quotient)):
                rate = integrand(design, Kiz, r, block_state(design, x.tolist()), free)
                np.testing.assert_allclose(rate, factor * expected, rtol=1e-8)


def test_integral_action_is_linear_where_the_law_is():
    """At a limit of the norm and with the LC v' = r^(1-2 mu) K_i d(-ln r) x without a quotient: at r = 1 K_i x."""
    regulator = replace(random_regulator(4, 2, mu=0.5, integral=True), lower=None, upper=None)
    x = 5.0 * np.random.default_rng(8).normal(size=4)
    for choice in ({"law": 1}, {"a_min": 1.0, "b_max": 1.0}, {"a_min": 0.5, "b_max": 1.0}):
        unit = unit_of(regulator, norm_solver=2, discretization=1, **choice)
        unit.step(0.0, H, row(regulator.y_eq + x))
        assert outputs(unit)["homogeneous_norm"] > 1.0
        np.testing.assert_allclose(np.array(unit.state.v), H * regulator.K_i @ x, rtol=1e-9)
