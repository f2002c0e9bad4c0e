"""From designs and models to the controller FMU's parameters and back."""

import numpy as np
import pytest

from ihc_fmu.design import Design
from ihc_fmu.inverse import inverse_design
from ihc_fmu.pendulum.interface import INTERFACE, matrix, upper_triangle, vector
from ihc_fmu.pendulum.paper_system import paper_system
from ihc_fmu.pendulum.start_values import controller_start_values, design_values, nominal_values
from ihc_fmu.sliding_mode import fitted_smc, linear_pole_smc
from ihc_fmu.system import System
from plant_fmu.parameters import PARAMETER_SETS
from tests.ihc_fmu.conftest import chain_gain, chain_of

# x' P x of the same controller with |k x| <= 10 V on the unit ball, an independent solution of the inequalities
P_UMAX_10 = np.array(
    [
        [0.04834846142512654, -0.5223415896364721, 0.045852050293322816, -0.0531396729363667],
        [-0.5223415896364721, 6.3367129309367325, -0.5166093966461217, 0.6263653740715885],
        [0.04585205029332282, -0.5166093966461219, 0.04474979467608601, -0.051984224815222385],
        [-0.05313967293636671, 0.6263653740715888, -0.05198422481522238, 0.06375192882753151],
    ]
)


def test_default_design_is_the_paper_controller(design, paper):
    A, b, k_lin = paper
    for actual, expected in ((design.A, A), (design.b, b), (design.k_lin, k_lin)):
        np.testing.assert_array_equal(actual, expected)
    np.testing.assert_allclose(design.P, inverse_design(paper_system()).P, rtol=1e-4)


def test_every_value_is_a_parameter_of_the_interface_within_its_rule(start_values):
    parameters = {v.name for v in INTERFACE.of("parameter")}
    assert set(start_values) <= parameters
    assert INTERFACE.start_values(start_values).items() >= start_values.items()


def test_matrices_and_gains_arrive_entry_by_entry(design, start_values, controller):
    """Read back by name, and as the unit assembles them: in chain coordinates they are the design's."""
    np.testing.assert_array_equal(np.reshape([start_values[n] for n in matrix("Phi")], (4, 4)), chain_of(design).Phi)
    P = np.zeros((4, 4))
    P[np.triu_indices(4)] = [start_values[n] for n in upper_triangle("P")]
    np.testing.assert_array_equal(P + np.triu(P, 1).T, design.P)
    for name, expected in (("k_lin", design.k_lin), ("row", chain_of(design).row)):
        assert [start_values[n] for n in vector(name)] == expected.tolist()
    unit = controller()
    np.testing.assert_allclose(unit.design.Kz[0], chain_gain(design), rtol=1e-10)
    np.testing.assert_allclose(chain_of(design).Phi.T @ unit.design.K_0z[0], -chain_of(design).row, atol=1e-12)
    np.testing.assert_allclose(
        chain_of(design).Phi.T @ np.array(unit.design.Pz) @ chain_of(design).Phi, design.P, rtol=1e-9
    )
    assert unit.mu == 1.0


def test_sliding_mode_is_the_fitted_one_unless_another_is_given(design, start_values):
    fitted, other = fitted_smc(design.A, design.b), linear_pole_smc(design.A, design.b, design.k_lin)
    for values, smc in ((start_values, fitted), (design_values(design, other), other)):
        assert [values[n] for n in vector("smc_c")] == smc.c.tolist()
        assert [values[n] for n in vector("smc_k")] == smc.k_eq.tolist()
        assert values["smc_rho"] == smc.rho


@pytest.mark.parametrize("u_max", [1.5, 10.0])
def test_capture_region_does_not_depend_on_the_scale_of_p(design, u_max):
    """x' P x < level is x' P_10 x < 0.85 for each scale: there |k x| stays below 92 % of 10 V."""
    scaled = design.scaled_to(u_max=u_max)
    level = design_values(scaled)["capture_level"]
    np.testing.assert_allclose(scaled.P / level, P_UMAX_10 / 0.85, rtol=2e-3)
    assert np.sqrt(level) * scaled.u_max == pytest.approx(9.2, abs=0.03)


def test_capture_region_shrinks_with_the_voltage_limit(design):
    ratio = design_values(design, voltage_limit=5.0)["capture_level"] / design_values(design)["capture_level"]
    assert ratio == pytest.approx(0.25)


@pytest.mark.parametrize("name", list(PARAMETER_SETS))
def test_nominal_coefficients_follow_from_the_pendulums_constants(design, name):
    p = PARAMETER_SETS[name].parameters
    expected = {
        "arm_inertia": p.J_r + p.m_p * p.L_r**2,
        "pendulum_inertia": p.J_p + p.m_p * p.L_p**2 / 4,
        "swing_inertia": p.m_p * p.L_p**2 / 4,
        "coupling": p.m_p * p.L_p * p.L_r / 2,
        "gravity_torque": p.m_p * p.g_p * p.L_p / 2,
        "arm_damping": p.D_r,
        "pendulum_damping": p.D_p,
        "torque_per_volt": p.k_m / p.R_m,
        "motor_damping": p.k_m**2 / p.R_m,
    }
    values = nominal_values(p)
    assert values == pytest.approx({f"nominal_{key}": value for key, value in expected.items()})
    assert controller_start_values(design, name).items() >= values.items()


def test_design_of_another_order_is_refused():
    system = System(A=np.eye(2, k=1), B=np.array([0.0, 1.0]), K=np.array([-2.0, -3.0]))
    double_integrator = Design(system, np.array([[5.0, 1.0], [1.0, 1.0]]), 1.0, 1e-3)
    with pytest.raises(ValueError, match=r"takes designs of 4 states and 1 input, found 2 and 1$"):
        design_values(double_integrator)


def test_unknown_nominal_set_is_refused_with_the_known_ones(design):
    with pytest.raises(ValueError, match=r"must be one of .*ident.*, found 'idnt'"):
        controller_start_values(design, "idnt")
