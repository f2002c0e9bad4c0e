"""Designs by matrix inequalities: active bounds, limits of alpha, robust terms, any order and units."""

import re
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.random_systems import distance, drawn
from fmu_export.errors import UserError
from ihc_fmu.certificate import CertificateError, settling_time_bound
from ihc_fmu.companion import chain_form, generator
from ihc_fmu.design import Design
from ihc_fmu.lmi import InfeasibleError
from ihc_fmu.pendulum.start_values import default_design
from ihc_fmu.synthesis import Options, chosen_options, direct_design, inverse_design, largest_alpha, largest_alpha_of
from ihc_fmu.system import System
from tests.ihc_fmu.conftest import chain_of


def system(A, b, k_lin=None):
    return System(A=np.array(A, float), B=np.array(b, float), K=None if k_lin is None else np.array(k_lin, float))


def butterworth(n):
    """Return kz that places the poles of a chain of n integrators on the left half circle of 3 1/s."""
    return -np.poly(3 * np.exp(1j * np.pi * (2 * np.arange(1, n + 1) + n - 1) / (2 * n))).real[:0:-1]


def integrator_chain(n):
    return np.eye(n, k=1), np.eye(n)[-1], butterworth(n)


def random_system(n):
    rng = np.random.default_rng(n)
    A, b = rng.normal(size=(n, n)), rng.normal(size=n)
    form = chain_form(A, b)
    return A, b, butterworth(n) @ form.Phi - form.row


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


@pytest.mark.parametrize(("mu", "alpha"), [(0.01, 1.087), (0.25, 0.629), (0.5, 0.437), (0.75, 0.335), (1.0, 0.2715)])
def test_largest_alpha_is_known_and_sharp(paper, mu, alpha):
    """The values were found by an independent bisection over the same inequalities."""
    assert largest_alpha(system(*paper), mu) == pytest.approx(alpha, rel=2e-3)
    if mu >= 0.25:
        assert inverse_design(system(*paper), Options(mu=mu, alpha=0.99 * alpha)).certificate.decrease > 0.0
    with pytest.raises(InfeasibleError, match=f"alpha = {1.01 * alpha:g} 1/s"):
        inverse_design(system(*paper), Options(mu=mu, alpha=1.01 * alpha))


def test_largest_alpha_of_the_double_integrator_with_equal_weights_is_its_decay_rate():
    """As mu -> 0 the inequality asks for P with A_cl' P + P A_cl <= -2 alpha P: the poles' real part."""
    assert largest_alpha(system(*integrator_chain(2)), 1e-5) == pytest.approx(3 / np.sqrt(2), rel=2e-4)


@pytest.mark.parametrize("make", [random_system, integrator_chain])
@pytest.mark.parametrize("n", [1, 2, 3, 5, 6])
def test_systems_of_other_orders_are_designed_and_certified(ideal_loop, make, n):
    A, b, k_lin = make(n)
    alpha = 0.8 * largest_alpha(system(A, b, k_lin))
    design = inverse_design(system(A, b, k_lin), Options(alpha=alpha, u_max=2.0))
    assert design.u_max == pytest.approx(2.0, rel=1e-3)
    assert (ideal_loop(design).worst_rates(0.0, count=50) <= -alpha * (1 - 1e-5)).all()
    np.testing.assert_array_equal(design.k_lin, k_lin)


def test_direct_design_is_certified_and_its_bound_active(paper, ideal_loop):
    """Eq. (9): the gain is free, and reaches an alpha that no P proves for the manufacturer's gain."""
    A, b, _ = paper
    design = direct_design(system(A, b), Options(alpha=1.0, u_max=10.0))
    assert design.u_max == pytest.approx(10.0, rel=1e-3)
    assert design.certificate.decrease > 0.0
    assert np.linalg.eigvals(A + np.outer(b, design.k_lin)).real.max() < 0.0
    assert (ideal_loop(design).worst_rates(0.0, count=100) <= -1.0 * (1 - 1e-5)).all()


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


def test_unstable_linear_controller_is_refused_with_its_pole(paper):
    A, b, _ = paper
    slowest = np.linalg.eigvals(A).real.max()
    for function in (inverse_design, largest_alpha):
        with pytest.raises(ValueError, match=rf"K must stabilize \(A, B\).* {slowest:.4g} 1/s$"):
            function(system(A, b, np.zeros(4)))


@pytest.mark.parametrize(
    ("turn", "hint"),
    [
        (lambda A, b, k: (A, b, -k), "; -K does: the law is u = +K x here, not u = -K x"),
        (lambda A, b, k: (A, -b, k), "; -K does: the law is u = +K x here, not u = -K x"),
        (
            lambda A, b, k: (A, b, k[[0, 2, 1, 3]]),
            "; K seems to be in the order (x1, x3, x2, x4), unlike A",
        ),
        (
            lambda A, b, k: (A, b, -k[[0, 2, 1, 3]]),
            "; K seems to be in the order (x1, x3, x2, x4) and the sign of u = -K x, unlike A",
        ),
        (lambda A, b, k: (A, b, k[[1, 0, 2, 3]]), "; K seems to be in the order (x2, x1, x3, x4), unlike A"),
        (lambda A, b, k: (A, b, np.ones(4)), " 1/s"),
    ],
)
def test_a_gain_that_does_not_stabilize_is_refused_with_what_would(paper, turn, hint):
    with pytest.raises(UserError) as refusal:
        inverse_design(system(*turn(*map(np.array, paper))))
    assert str(refusal.value).endswith(hint)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mu": 0.0}, r"mu must lie in \(0, 1\], found 0.0"),
        ({"mu": 1.1}, r"mu must lie in \(0, 1\], found 1.1"),
        ({"alpha": 0.0}, "alpha must be positive and finite"),
        ({"psi": -1.0}, "psi must be non-negative and finite, found -1.0"),
        ({"d_max": np.inf}, "d_max must be non-negative and finite, found inf"),
        ({"d_max": 0.1, "mu": 0.5}, "only at mu = 1, found mu = 0.5"),
        ({"u_max": None}, "needs a rule"),
        ({"u_max": 0.0}, "u_max must be positive and finite, found 0.0"),
        ({"delta_max": -1.0}, "delta_max must be positive and finite, found -1.0"),
        ({"beta": 1.0}, r"beta must lie in \(0, 1\), found 1.0"),
    ],
)
def test_contradictory_options_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Options(**changes)


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
    for limit in (1e-12, 1e308):
        given = system(A, b, k_lin).changed(lower=[-limit], upper=[limit])
        with pytest.raises(
            ValueError,
            match=rf"^limits must leave a room of 2e-09 to 2e.09 .*, found {re.escape(f'{limit:g}')} for u1$",
        ):
            chosen_options(given, 1.0, 0.1)
    with pytest.raises(ValueError, match="a direct design needs u_max"):
        direct_design(system(A, b), Options(u_max=None, delta_max=0.1))


@pytest.mark.parametrize(("n", "mu"), [(6, 1.0), (7, 1.0), (7, 0.2)])
def test_high_orders_are_designed(n, mu):
    """Integrator chains with poles -2, -3, ...; the designs prove themselves."""
    A, b, k_lin = np.eye(n, k=1), np.eye(n)[-1], -np.poly(-np.arange(2.0, 2.0 + n))[::-1][:-1]
    alpha = 0.5 * largest_alpha(system(A, b, k_lin), mu)
    found = inverse_design(system(A, b, k_lin), Options(mu=mu, alpha=alpha, u_max=10.0))
    assert found.u_max == pytest.approx(10.0, rel=1e-3)


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


def test_gain_that_stabilizes_by_rounding_alone_is_refused():
    """Poles placed without convergence: a gain so large that its poles depend on the coordinates."""
    case = drawn(1157)
    with pytest.raises(
        UserError, match=r"^K must stabilize \(A, B\) whatever the rounding: .* in scaled block coordinates"
    ):
        inverse_design(case.system)


# Any order, number of inputs and units

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


@pytest.mark.parametrize("alpha", [0.001, 0.1, 10.0, 100.0])
def test_direct_design_serves_any_rate(paper, alpha):
    """Five decades of alpha for the pendulum, whose own fastest pole is at 16 1/s."""
    A, b, _ = paper
    design = direct_design(system(A, b), Options(alpha=alpha, u_max=10.0))
    assert design.alpha == alpha
    assert design.u_max <= 10.0 * (1 + 1e-3)
    assert design.certificate.hurwitz > alpha  # every w_i is at least 1


def test_bound_of_each_input_is_kept(rotorcraft_like):
    """Of several bounds each holds, and one is reached."""
    bounds = np.array([0.5, 20.0])
    design = inverse_design(rotorcraft_like, Options(alpha=0.05, u_max=bounds.tolist()))
    assert (design.u_max <= bounds * (1 + 1e-6)).all()
    assert (design.u_max / bounds).max() == pytest.approx(1.0, rel=1e-3)
    with pytest.raises(UserError, match="u_max must be a number, or one for each input, found 3 for 2 inputs"):
        inverse_design(rotorcraft_like, Options(u_max=[1.0, 2.0, 3.0]))


@pytest.fixture
def rotorcraft_like():
    """Two chains of two and three integrators that pull at each other."""
    A = np.eye(5, k=1) - np.eye(5)[:, [2]] @ np.eye(5)[[1]] + 0.1 * np.ones((5, 5))
    B = np.zeros((5, 2))
    B[1, 0] = B[4, 1] = 1.0
    return System(A=A, B=B).with_lqr(np.ones(5), np.ones(2))


# Options that nobody gave


def test_options_are_chosen_from_the_system_with_reasons(paper):
    limited = system(*paper).changed(lower=[-10.0], upper=[6.0], u_eq=[1.0])
    choice = chosen_options(limited)
    assert choice.options.mu == 1.0
    assert choice.options.alpha == pytest.approx(0.2715 / 2, rel=0.02)
    assert choice.options.u_max == [2.5]  # half of 6 - 1
    assert [reason.split(" ")[0] for reason in choice.reasons] == ["mu", "alpha", "u_max"]
    assert choice.reasons[2].startswith("u_max = 2.5: ")
    assert inverse_design(limited, choice.options).u_max == pytest.approx(2.5, rel=1e-3)


def test_alpha_is_chosen_under_the_options_given():
    """Half of the largest one with which d_max is rejected, which is about where designs end to be found."""
    given = system(*integrator_chain(2)).changed(K=[[-1.0, -2.0]])
    choice = chosen_options(given, u_max=[0.3], d_max=0.2)
    design = inverse_design(given, choice.options, start=choice.start)
    assert largest_alpha_of(design, choice.options) == pytest.approx(2 * design.alpha, rel=0.02)
    assert "half of the largest one that rejects |d| <= 0.2, found to about 1 %" in choice.reasons[1]
    for factor, holds in ((1.95, True), (2.05, False)):
        with nullcontext() if holds else pytest.raises(InfeasibleError, match="no P proves the rejection"):
            inverse_design(given, replace(choice.options, alpha=factor * design.alpha))
    with pytest.raises(
        InfeasibleError, match=r"^no P proves the rejection of \|d\| <= 0.5 for any alpha down to 2.9e-06"
    ):
        chosen_options(given, u_max=[0.3], d_max=0.5)
    psi = chosen_options(given, u_max=[0.3], psi=1e6)
    assert inverse_design(given, psi.options, start=psi.start).psi == 1e6


def test_degree_is_lowered_for_an_alpha_that_the_highest_one_does_not_allow(paper):
    """The largest alpha is 0.27 at mu = 1, 0.33 at 0.75, 0.44 at 0.5, 0.63 at 0.25."""
    assert chosen_options(system(*paper), alpha=0.4).options.mu == 0.5
    assert chosen_options(system(*paper), alpha=0.2).options.mu == 1.0


def test_what_was_found_for_a_choice_and_a_design_is_used_again(paper):
    """A design from the search of its choice is the same, and its own P leads to the same largest alpha as a new search."""
    choice = chosen_options(system(*paper))
    said, again = [], []
    first = inverse_design(system(*paper), choice.options, said.append, choice.start)
    second = inverse_design(system(*paper), choice.options, again.append)
    assert (len(said), bool(again)) == (0, True)
    np.testing.assert_allclose(first.P, second.P, rtol=1e-6)
    assert largest_alpha_of(first, Options()) == pytest.approx(largest_alpha(system(*paper)), rel=1e-4)
    other = Options(mu=1.0, alpha=0.26, u_max=1.5, beta=0.6)
    assert inverse_design(system(*paper), other, start=choice.start).certificate.monotone > 1.2


def test_what_is_given_stays(paper):
    choice = chosen_options(system(*paper), mu=0.5, alpha=0.1, u_max=[3.0], beta=0.2)
    assert choice.options == Options(mu=0.5, alpha=0.1, u_max=[3.0], beta=0.2)
    assert choice.reasons == ()
    assert chosen_options(system(*paper), mu=1.0, alpha=0.1, delta_max=0.1).options.u_max is None


def test_search_tells_how_it_goes(paper):
    said = []
    inverse_design(system(*paper), Options(), said.append)
    assert said
    assert all(line.startswith("at mu = ") for line in said)
