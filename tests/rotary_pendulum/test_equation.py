"""Eq. (5) against a Lagrangian derivation, the pendulum's exact period, energy, friction, and its own inverse."""

from dataclasses import replace
from functools import cache
from math import cos, log, pi, sin, sqrt
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.special import ellipk

from plant_fmu.parameters import PARAMETER_SETS
from rotary_pendulum import equation
from rotary_pendulum.runge_kutta import rk4_step

SETS = [pytest.param(entry.parameters, id=name) for name, entry in PARAMETER_SETS.items()]
IDENT = PARAMETER_SETS["ident"].parameters
RUBBING = replace(IDENT, T_r=5e-4)
PHYSICAL = ("m_p", "L_p", "J_p", "D_p", "L_r", "J_r", "D_r", "g_p")


@cache
def lagrangian_model():
    """Equations of motion J(q) q'' = r, and the energy, from the kinematics of a rotary arm that carries a pendulum."""
    m_p, L_p, J_p, D_p, L_r, J_r, D_r, g_p = symbols = sp.symbols(" ".join(PHYSICAL), positive=True)
    tau, tau_p, t = sp.symbols("tau tau_p t")
    theta, delta = q = [sp.Function(name)(t) for name in ("theta", "delta")]
    theta_dot, delta_dot = q_dot = [sp.diff(f, t) for f in q]

    across = L_p / 2 * sp.sin(delta)  # the centre of mass beside the arm, against the direction of rotation
    centre = (
        L_r * sp.cos(theta) + across * sp.sin(theta),
        L_r * sp.sin(theta) - across * sp.cos(theta),
        L_p / 2 * sp.cos(delta),
    )
    # As in the paper, J_p counts only for the rotation in the pendulum's own plane, not for that about the motor axis.
    kinetic = (J_r * theta_dot**2 + m_p * sum(sp.diff(r, t) ** 2 for r in centre) + J_p * delta_dot**2) / 2
    potential = m_p * g_p * centre[2]
    dissipation = (D_r * theta_dot**2 + D_p * delta_dot**2) / 2

    states, accelerations = sp.symbols("th de thd ded"), sp.symbols("thdd dedd")
    dynamic = (*(sp.diff(f, t) for f in q_dot), *q_dot, *q)
    plain = dict(zip(dynamic, (*accelerations, *states[2:], *states[:2]), strict=True))
    L = kinetic - potential
    rows = [
        sp.expand((sp.diff(L, v, t) - sp.diff(L, f) + sp.diff(dissipation, v) - force).subs(plain))
        for f, v, force in zip(q, q_dot, (tau, tau_p), strict=True)
    ]
    mass, right = sp.linear_eq_to_matrix(rows, *accelerations)
    total = (kinetic + potential - m_p * g_p * L_p / 2).subs(plain)
    return sp.lambdify((symbols, states, (tau, tau_p)), (mass, right)), sp.lambdify((symbols, states), total)


def physical(p):
    return [getattr(p, name) for name in PHYSICAL]


def random_states(count, seed=7):
    rng = np.random.default_rng(seed)
    return rng.uniform([-4, -4, -30, -30], [4, 4, 30, 30], (count, 4)).tolist(), rng.uniform(-0.1, 0.1, (count, 2))


def steps(p, x, *, tau=0.0, h=2e-3, time=1.0):
    """Yield the states of the pendulum `p` under a torque on its arm, from x on."""
    c = p.coefficients

    def rate(x: Any) -> tuple[float, ...]:
        _, delta, v, w = x
        return v, w, *equation.accelerations(c, delta, v, w, tau, 0.0)

    yield x
    for _ in range(round(time / h)):
        x = rk4_step(rate, x, h)
        yield x


def swing(p, x, **how):
    """Return the last of `steps`."""
    *_, last = steps(p, x, **how)
    return np.array(last)


@pytest.mark.parametrize("p", SETS)
def test_accelerations_equal_the_lagrangian_derivation(p):
    equations, _ = lagrangian_model()
    c = p.coefficients
    for x, tau in zip(*random_states(200), strict=True):
        mass, right = equations(physical(p), x, tau)
        expected = np.linalg.solve(mass, right).ravel()
        accelerations = equation.accelerations(c, x[1], x[2], x[3], *tau)
        # relative to the norm: a single component may vanish by cancellation
        assert np.linalg.norm(accelerations - expected) <= 1e-11 * np.linalg.norm(expected)


@pytest.mark.parametrize("p", SETS)
def test_energy_equals_the_lagrangian_derivation_and_is_zero_upright(p):
    _, total = lagrangian_model()
    c = p.coefficients
    for x in random_states(100)[0]:
        assert equation.energy(c, *x[1:]) == pytest.approx(total(physical(p), x), rel=1e-12, abs=1e-15)
    assert equation.energy(c, 0.0, 0.0, 0.0) == 0.0
    assert equation.energy(c, pi, 0.0, 0.0) == pytest.approx(-p.m_p * p.g_p * p.L_p, rel=1e-14)


@pytest.mark.parametrize("p", SETS)
def test_energy_is_conserved_over_ten_seconds_without_damping(p):
    p = replace(p, D_p=0.0, D_r=0.0)
    energies = [equation.energy(p.coefficients, *x[1:]) for x in steps(p, (0.3, 0.5, 2.0, -1.0), h=1e-3, time=10.0)]
    assert max(energies) - min(energies) < 1e-6 * 2 * p.coefficients.gravity


def test_dry_friction_alone_takes_energy_and_never_adds_any():
    p = replace(RUBBING, D_p=0.0, D_r=0.0)
    c = p.coefficients
    energies = [equation.energy(c, *x[1:]) for x in steps(p, (0.3, 2.0, 5.0, -1.0), h=2e-4, time=4.0)]
    assert max(np.diff(energies)) < 1e-10 * c.gravity
    assert energies[-1] < energies[0] - 0.5 * c.gravity


def test_spinning_arm_slows_down_as_the_separated_equation_says():
    """J v' = -T_r v/(v + v_s) has v + v_s ln v = v_0 + v_s ln v_0 - T_r t/J."""
    p = replace(RUBBING, m_p=1e-12, D_r=0.0)  # the pendulum weighs nothing
    v_s, v_0, h = equation.FRICTION_SPEED, 2.0, 1e-3
    for time in (0.05, 0.2, 0.25):
        v = swing(p, (0.0, 0.0, v_0, 0.0), h=h, time=time)[2]
        assert 0.0 < v < v_0
        assert v + v_s * log(v) == pytest.approx(v_0 + v_s * log(v_0) - p.T_r * time / p.J_r, abs=1e-7)


def test_torque_below_the_dry_friction_only_creeps():
    """The torque tau and the friction T_r v/(v + v_s) balance at v = v_s tau/(T_r - tau)."""
    tau = 0.3 * RUBBING.T_r
    p = replace(RUBBING, D_r=0.0)
    x = swing(p, (0.0, pi, 0.0, 0.0), tau=tau, time=8.0)
    assert x[2] == pytest.approx(equation.FRICTION_SPEED * 0.3 / 0.7, rel=1e-6)


def test_plant_without_dry_friction_is_the_papers_to_the_last_bit():
    c = IDENT.coefficients
    for (_, delta, v, w), (tau, tau_p) in zip(*random_states(500), strict=True):
        s, k = sin(delta), cos(delta)
        j_11, j_12, sk = c.J_11 + c.zeta_4 * s * s, -c.varpi_2 * k, c.zeta_4 * s * k
        r_1 = tau - (2.0 * sk * w + c.D_r) * v - c.varpi_2 * s * w * w
        r_2 = tau_p + sk * v * v - c.D_p * w + c.gravity * s
        determinant = j_11 * c.J_22 - j_12 * j_12
        expected = (c.J_22 * r_1 - j_12 * r_2) / determinant, (j_11 * r_2 - j_12 * r_1) / determinant
        assert equation.accelerations(c, delta, v, w, tau, tau_p) == expected


def test_arrays_of_states_have_the_accelerations_of_each():
    c = RUBBING.coefficients
    states, torques = random_states(50)
    (_, delta, v, w), (tau, tau_p) = np.transpose(states), np.transpose(torques)
    accelerations = equation.solve(c, np.sin(delta), np.cos(delta), v, w, tau, tau_p)  # type: ignore[arg-type]
    expected = [equation.accelerations(c, *x[1:], *t) for x, t in zip(states, torques, strict=True)]
    np.testing.assert_allclose(np.transpose(accelerations), expected, rtol=1e-12)


def test_pendulum_on_a_heavy_arm_has_the_period_of_the_elliptic_integral():
    p = replace(IDENT, J_r=1e9, D_p=0.0, D_r=0.0)
    amplitude = 2.0
    omega = sqrt(p.m_p * p.g_p * p.L_p / 2 / (p.J_p + p.m_p * p.L_p**2 / 4))
    period = 4 * ellipk(sin(amplitude / 2) ** 2) / omega
    start = (0.0, pi - amplitude, 0.0, 0.0)
    half, whole = (swing(p, start, h=period / 2000, time=time) for time in (period / 2, period))
    np.testing.assert_allclose(half, (0.0, pi + amplitude, 0.0, 0.0), atol=1e-8)
    np.testing.assert_allclose(whole, start, atol=1e-8)


def test_quarter_turn_pendulum_adds_its_lumped_inertia_to_the_arm():
    c = IDENT.coefficients
    zeta, psi = IDENT.m_p * IDENT.L_p**2, IDENT.m_p * IDENT.L_r**2
    theta_ddot, delta_ddot = equation.accelerations(c, pi / 2, 0.0, 0.0, 0.01, 0.0)
    assert theta_ddot == pytest.approx(0.01 / (IDENT.J_r + psi + zeta / 4), rel=1e-12)
    assert delta_ddot == pytest.approx(IDENT.m_p * IDENT.g_p * IDENT.L_p / 2 / (IDENT.J_p + zeta / 4), rel=1e-12)


def test_coupling_accelerates_the_upright_pendulum_with_the_arm():
    theta_ddot, delta_ddot = equation.accelerations(IDENT.coefficients, 0.0, 0.0, 0.0, 0.01, 0.0)
    zeta_4 = IDENT.m_p * IDENT.L_p**2 / 4
    assert delta_ddot / theta_ddot == pytest.approx(
        IDENT.m_p * IDENT.L_p * IDENT.L_r / 2 / (IDENT.J_p + zeta_4), rel=1e-12
    )


@pytest.mark.parametrize("p", [*SETS, pytest.param(RUBBING, id="dry friction")])
def test_torque_of_the_inverse_gives_the_wanted_acceleration(p):
    c = p.coefficients
    for (_, delta, v, w), (wanted, _) in zip(*random_states(100), strict=True):
        tau = equation.arm_torque(c, delta, v, w, 1e3 * wanted)
        acceleration, _ = equation.accelerations(c, delta, v, w, tau, 0.0)
        assert acceleration == pytest.approx(1e3 * wanted, abs=1e-9)


@pytest.mark.parametrize(("varpi_2", "regular"), [(0.0, True), (1.0 - 1e-8, True), (1.0 - 1e-11, False), (1.5, False)])
def test_inertia_matrix_is_regular_where_its_determinant_is_more_than_rounding(varpi_2, regular):
    c = IDENT.coefficients._replace(J_11=1.0, J_22=1.0, varpi_2=varpi_2)
    assert equation.is_regular(c) == regular
