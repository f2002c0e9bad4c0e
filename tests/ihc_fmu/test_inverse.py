"""Designs from a linear controller: active bounds, robust terms, any order and units (of direct designs too)."""

import numpy as np
import pytest

from benchmarks.random_systems import distance, drawn
from fmu_export.errors import UserError
from ihc_fmu.certificate import CertificateError, settling_time_bound
from ihc_fmu.companion import generator
from ihc_fmu.design import Design
from ihc_fmu.direct import direct_design
from ihc_fmu.inverse import inverse_design
from ihc_fmu.largest_rate import largest_alpha
from ihc_fmu.options import Options
from ihc_fmu.pendulum.start_values import default_design
from ihc_fmu.system import System
from tests.ihc_fmu.conftest import chain_of
from tests.ihc_fmu.models import integrator_chain, random_system, system


@pytest.mark.parametrize("u_max", [0.5, 1.5, 10.0])
def test_voltage_bound_is_active(paper, u_max):
    """The largest unit ball uses all of |k x| <= u_max: the maximum over the ellipsoid, at x = P^-1 k' / u_max."""
    design = inverse_design(system(*paper), Options(u_max=u_max))
    x = np.linalg.solve(design.P, design.K_h[0]) / u_max
    assert x @ design.P @ x == pytest.approx(1.0, rel=1e-4)
    assert design.K_h[0] @ x == pytest.approx(u_max, rel=1e-4)
    assert design.u_max == pytest.approx(u_max, rel=1e-4)


@pytest.mark.parametrize("index", [0, 1])
def test_state_bound_is_active(paper, index):
    design = inverse_design(system(*paper), Options(u_max=None, delta_max=0.2, index=index))
    assert design.extent[index] == pytest.approx(0.2, rel=1e-4)
    assert np.sqrt(np.linalg.inv(design.P)[index, index]) == pytest.approx(0.2, rel=1e-4)


def test_of_two_bounds_both_hold_and_one_is_active(paper):
    design = inverse_design(system(*paper), Options(u_max=1.5, delta_max=0.05))
    assert design.extent[1] <= 0.05 * (1 + 1e-6)
    assert design.u_max <= 1.5 * (1 + 1e-6)
    assert max(design.extent[1] / 0.05, design.u_max / 1.5) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("make", [random_system, integrator_chain])
@pytest.mark.parametrize("n", [1, 2, 3, 5, 6])
def test_systems_of_other_orders_are_designed_and_certified(ideal_loop, make, n):
    A, b, k_lin = make(n)
    alpha = 0.8 * largest_alpha(system(A, b, k_lin))
    design = inverse_design(system(A, b, k_lin), Options(alpha=alpha, u_max=2.0))
    assert design.u_max == pytest.approx(2.0, rel=1e-3)
    assert (ideal_loop(design).worst_rates(0.0, count=50) <= -alpha * (1 - 1e-5)).all()
    np.testing.assert_array_equal(design.k_lin, k_lin)


def test_design_with_state_dependent_disturbance_has_the_term_of_remark_3(paper):
    """(A_0 + b k)' P + P (A_0 + b k) + alpha (...) + psi I <= 0, and ten times that psi is refused."""
    options = Options(u_max=10.0, alpha=0.1, psi=1e-3)
    design = inverse_design(system(*paper), options)
    closed = design.A + np.outer(design.b, design.k_lin) + 0.1 * generator(chain_of(design).Phi, 1.0)
    M = closed.T @ design.P + design.P @ closed
    assert np.linalg.eigvalsh(M + 1e-3 * np.eye(4))[-1] <= 0.0
    assert np.linalg.eigvalsh(M + 1e-2 * np.eye(4))[-1] > 0.0
    with pytest.raises(CertificateError, match=r"\+ disturbance terms <= 0 fails"):
        Design(system(*paper), P=design.P, mu=1.0, alpha=0.1, psi=1e-2)


def test_design_for_a_matched_disturbance_decreases_at_its_rate_under_the_worst_sign(paper, ideal_loop):
    design = inverse_design(system(*paper), Options(u_max=10.0, alpha=0.05, d_max=0.03))
    assert design.certificate.matched_disturbance > 0.03
    assert (ideal_loop(design).worst_rates(0.03, count=300) <= -0.05 * (1 - 1e-5)).all()


def test_requests_that_no_design_can_meet_are_refused(paper):
    A, b, k_lin = paper
    with pytest.raises(ValueError, match="must be controllable"):
        inverse_design(system(-np.eye(4), b, np.zeros(4)))
    with pytest.raises(ValueError, match=r"K must have 1 row of 4 numbers to fit B and A, found shape \(1, 3\)"):
        inverse_design(system(A, b, k_lin[:3]))
    with pytest.raises(ValueError, match=r"one of 0\.\.3, found 4"):
        inverse_design(system(A, b, k_lin), Options(delta_max=0.1, index=4))
    with pytest.raises(ValueError, match=r"^u_max must be a number, or one for each input, found 2 for 1 input$"):
        inverse_design(system(A, b, k_lin), Options(u_max=[1.0, 2.0]))


@pytest.mark.parametrize(("n", "mu"), [(6, 1.0), (7, 1.0), (7, 0.2)])
def test_high_orders_are_designed(n, mu):
    """Integrator chains with poles -2, -3, ...; the designs prove themselves."""
    A, b, k_lin = np.eye(n, k=1), np.eye(n)[-1], -np.poly(-np.arange(2.0, 2.0 + n))[::-1][:-1]
    alpha = 0.5 * largest_alpha(system(A, b, k_lin), mu)
    design = inverse_design(system(A, b, k_lin), Options(mu=mu, alpha=alpha, u_max=10.0))
    assert design.u_max == pytest.approx(10.0, rel=1e-3)


@pytest.mark.parametrize("alpha", [0.2, 0.5, 0.7, 1.0])
def test_nearly_linear_designs_are_found(paper, alpha):
    assert inverse_design(system(*paper), Options(mu=0.01, alpha=alpha)).certificate.decrease > 0.0


def test_a_design_does_not_depend_on_those_before_it():
    """A journal knows runs by their design's numbers, so that the same call must give the same bytes."""
    default = default_design()
    first, other, again = (
        inverse_design(default.system, Options(mu=mu, alpha=default.alpha)) for mu in (1.0, 0.5, 1.0)
    )
    assert first.to_json() == again.to_json() != other.to_json()


def test_search_tells_how_it_goes(paper):
    said = []
    inverse_design(system(*paper), Options(), said.append)
    assert said
    assert all(line.startswith("at mu = ") for line in said)


DRAWN = (1, 3, 5, 9, 11, 12, 13, 19, 26, 29, 31, 78)
"""Seeds of n = 2..8, m = 1..3, all three kinds of systems and both of gains, with a largest unit ball for their alpha;
flat ones among them: lambda_min/lambda_max of P is 1e-12 for that of 29."""


def designed(method, case):
    design = method(case.system, Options(alpha=case.alpha, u_max=case.u_max.tolist()))
    assert "not maximized" not in design.method
    return design


@pytest.mark.parametrize("method", [inverse_design, direct_design])
@pytest.mark.parametrize("seed", DRAWN)
def test_units_of_states_inputs_and_time_do_not_matter(method, seed):
    """States and inputs in units of 1e-4..1e4, time of 1e-3..1e3: the same design, certified, its bound reached."""
    here, plain = drawn(seed), drawn(seed, units=False)
    d, e = designed(method, here), designed(method, plain)
    for design, case in ((d, here), (e, plain)):
        assert (design.u_max / case.u_max).max() == pytest.approx(1.0, rel=1e-5)
        assert design.certificate.decrease > 0.0
    assert distance(d, e, here) < max(1e-6, 1e-16 / e.certificate.positive)
    x = np.random.default_rng(seed).normal(size=d.n)
    in_time = settling_time_bound(d, here.units * x) * here.omega
    assert in_time == pytest.approx(settling_time_bound(e, x), rel=1e-5)


@pytest.fixture
def rotorcraft_like():
    """Two chains of two and three integrators that pull at each other."""
    A = np.eye(5, k=1) - np.eye(5)[:, [2]] @ np.eye(5)[[1]] + 0.1 * np.ones((5, 5))
    B = np.zeros((5, 2))
    B[1, 0] = B[4, 1] = 1.0
    return System(A=A, B=B).with_lqr(np.ones(5), np.ones(2))


def test_bound_of_each_input_is_kept(rotorcraft_like):
    """Of several bounds each holds, and one is reached."""
    bounds = np.array([0.5, 20.0])
    design = inverse_design(rotorcraft_like, Options(alpha=0.05, u_max=bounds.tolist()))
    assert (design.u_max <= bounds * (1 + 1e-6)).all()
    assert (design.u_max / bounds).max() == pytest.approx(1.0, rel=1e-3)
    with pytest.raises(UserError, match="u_max must be a number, or one for each input, found 3 for 2 inputs"):
        inverse_design(rotorcraft_like, Options(u_max=[1.0, 2.0, 3.0]))
