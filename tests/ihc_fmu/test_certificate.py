"""The proof of a design: every check can fail, its margins are invariant, and simulations obey its promises."""

from dataclasses import replace
from fractions import Fraction
from math import log

import mpmath
import numpy as np
import pytest
from scipy.linalg import eigh, expm

from benchmarks.random_systems import drawn
from fmu_export.errors import UserError
from ihc_fmu.block_form import block_form
from ihc_fmu.certificate import CertificateError, certify, is_positive, norm_of, settling_time_bound
from ihc_fmu.design import Design
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.system import System
from tests.ihc_fmu.conftest import chain_of

X_0 = np.array([0.0, 0.1, 0.0, 0.0])


@pytest.mark.parametrize("mu", [0.25, 0.5, 1.0])
def test_norm_decreases_at_the_proven_rate_everywhere(designs, ideal_loop, mu):
    """d||x||_d/dt <= -alpha ||x||_d^(1-mu) at random states over four decades of the norm."""
    loop, rng = ideal_loop(designs[mu]), np.random.default_rng(3)
    for r in 10.0 ** rng.uniform(-2, 2, 200):
        y = loop.on_the_sphere(rng)
        x = loop.dilated(y, r)
        assert loop.norm(x, r) == pytest.approx(r, rel=1e-9)
        rate = loop.rate(x, r)
        assert rate <= -designs[mu].alpha * r ** (1 - mu) * (1 - 1e-6)
        assert rate == pytest.approx(r ** (1 - mu) * loop.rate(y, 1.0), rel=1e-5)  # the motion is homogeneous


@pytest.mark.parametrize("mu", [0.25, 0.5, 1.0])
def test_proven_rate_is_nearly_attained_in_the_worst_direction(designs, ideal_loop, mu):
    """The solver pushes the inequality to its bound, so the test above could not hold with a larger alpha."""
    design = designs[mu]
    closed = design.A + design.B @ design.K + design.alpha * design.form.generator(mu)
    _, vectors = eigh(closed.T @ design.P + design.P @ closed, design.P)
    y = vectors[:, -1]  # of unit length relative to P
    assert ideal_loop(design).rate(y, 1.0) == pytest.approx(-design.alpha, rel=1e-3)


@pytest.mark.parametrize("mu", [0.5, 1.0])
def test_convergence_is_finite_within_the_certified_time(designs, ideal_loop, mu):
    """Four decades of the norm before T = r0^mu/(mu alpha); the linear controller is still far away then."""
    design = designs[mu]
    bound = settling_time_bound(design, X_0)
    assert bound == pytest.approx(norm_of(design, X_0) ** mu / (mu * design.alpha))
    t, x = ideal_loop(design).run(X_0, lambda t, x, r: r < 1e-4)
    assert t + settling_time_bound(design, x) < bound
    assert np.hypot(*x[:2]) < 1e-6
    linear = expm((design.A + design.B @ design.K) * t) @ X_0
    assert np.hypot(*linear[:2]) > 1e-4


def test_pendulum_settles_when_independent_simulations_say(design, ideal_loop):
    """Last times with |q| above 1e-2, 1e-4, 1e-6: 0.89, 1.55, 1.72 s with a_min = 1e-3 (sampled); far later with the LC."""
    levels = np.array([1e-2, 1e-4, 1e-6])
    last, slow = np.zeros(3), np.zeros(3)

    def settled(t, x, r):
        last[np.hypot(x[0], x[1]) > levels] = t
        return r < 1e-3

    ideal_loop(design, a_min=1e-3).run(X_0, settled)
    np.testing.assert_allclose(last, [0.89, 1.55, 1.72], rtol=0.04)
    step, x = expm((design.A + design.B @ design.K) * 0.01), X_0
    for k in range(1300):
        slow[np.hypot(x[0], x[1]) > levels] = 0.01 * k
        x = step @ x
    np.testing.assert_allclose(slow, [2.37, 6.48, 10.6], atol=0.03)


def test_settling_bound_shrinks_with_the_state_and_is_zero_at_the_origin(design):
    assert settling_time_bound(design, np.zeros(4)) == 0.0
    halved = expm(-design.form.generator(1.0) * log(2.0)) @ X_0
    assert settling_time_bound(design, halved) == pytest.approx(settling_time_bound(design, X_0) / 2, rel=1e-9)


@pytest.mark.parametrize(
    ("x", "message"),
    [
        ([0.1, 0.0], r"must be 4 numbers, theta, delta, .*, found shape \(2,\)"),
        ([0.1, 0.0, np.nan, 0.0], "must be finite, found nan for theta_dot"),
        ("far", "must be 4 numbers, .*, found 'far'"),
    ],
)
@pytest.mark.parametrize("function", [norm_of, settling_time_bound])
def test_state_that_is_none_is_refused(design, function, x, message):
    with pytest.raises(UserError, match=f"^x {message}"):
        function(design, x)


def moved_system(d, T):
    inverse = np.linalg.inv(T)
    return System(A=T @ d.A @ inverse, B=T @ d.B, K=d.K @ inverse)


@pytest.mark.parametrize("mu", [0.25, 1.0])
def test_margins_are_the_same_in_all_coordinates(designs, mu):
    d = designs[mu]
    d = replace(d, alpha=0.8 * d.alpha)  # a margin far above rounding
    T = np.random.default_rng(4).normal(size=(4, 4))
    inverse = np.linalg.inv(T)
    moved = Design(moved_system(d, T), inverse.T @ d.P @ inverse, d.mu, d.alpha)
    for name in ("decrease", "monotone", "hurwitz"):
        assert getattr(moved.certificate, name) == pytest.approx(getattr(d.certificate, name), rel=1e-3)
    assert moved.certificate.matched_disturbance == pytest.approx(d.certificate.matched_disturbance, rel=1e-3)


def test_margins_have_their_closed_form_for_a_scalar_system():
    """x' = u, k_lin = -3, P = 4: decrease 2 (3 - alpha), monotone 2, and |d| < 3 |x| at |x| = 1/2."""
    d = Design(System(A=np.zeros((1, 1)), B=np.ones(1), K=np.array([-3.0])), np.array([[4.0]]), mu=1.0, alpha=1.0)
    c = d.certificate
    assert (c.decrease, c.monotone, c.positive, c.hurwitz) == pytest.approx((4.0, 2.0, 1.0, 3.0))
    assert c.identities == 0.0
    assert c.matched_disturbance == pytest.approx(1.5, rel=1e-3)
    assert c.as_dict()["decrease"] == c.decrease
    assert d.u_max == pytest.approx(1.5)


def test_definiteness_is_decided_without_rounding():
    """Eigenvalues 2 and 2^-200 or -2^-200, which no double tells apart."""
    tiny = Fraction(1, 2**200)
    for sign in (1, -1):
        M = [[1 + sign * tiny, 1 - sign * tiny], [1 - sign * tiny, 1 + sign * tiny]]
        assert is_positive([[Fraction(entry) for entry in row] for row in M]) == (sign > 0)
    assert not is_positive([[Fraction(0)]])


def test_matched_disturbance_is_claimed_only_at_mu_one(designs):
    assert designs[0.5].certificate.matched_disturbance == 0.0
    assert designs[1.0].certificate.matched_disturbance > 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: {"P": d.P - 1.1 * np.linalg.eigvalsh(d.P)[0] * np.eye(4)}, "P > 0 fails"),
        (lambda d: {"P": -d.P}, "P > 0 fails"),
        (lambda d: {"P": d.P + np.triu(d.P, 1)}, "P must be symmetric"),
        (
            lambda d: {"P": chain_of(d).Phi.T @ (np.ones((4, 4)) + 0.01 * np.eye(4)) @ chain_of(d).Phi},
            r"G_d' P \+ P G_d > 0 fails: margin -",
        ),
        (
            lambda d: {"alpha": 0.21},
            r"^\(A \+ B K\)' P \+ P \(A \+ B K\) \+ alpha \(G_d' P \+ P G_d\) <= 0 fails: margin -.* \(1/s r",
        ),
        (lambda d: {"system": d.system.changed(K=-d.K)}, r"A \+ B K Hurwitz fails: margin -"),
        (lambda d: {"system": d.system.changed(K=0.99 * d.K)}, "<= 0 fails: margin -"),
        (lambda d: {"psi": 1e-3}, r"\+ disturbance terms <= 0 fails: margin -"),
        (lambda d: {"d_max": 0.02}, r"\+ disturbance terms <= 0 fails: margin -"),
    ],
)
def test_every_claim_that_does_not_hold_is_refused_with_its_margin(design, change, message):
    with pytest.raises(CertificateError, match=message):
        replace(design, **change(design))


def test_proof_for_one_degree_is_none_for_another(designs):
    with pytest.raises(CertificateError, match="fails: margin"):
        replace(designs[0.25], mu=1.0)


def test_dilation_of_another_system_breaks_the_identities(design):
    """Eq. (1) is checked with the coordinates that the controller gets: that of an arm with more damping is refused."""
    other = replace(design, alpha=0.1)
    damped = design.A - np.diag([0.0, 0.0, 1e-3, 0.0])
    object.__setattr__(other, "form", block_form(damped, design.B))
    with pytest.raises(CertificateError, match=r"= -mu A_0 and G_d B = B fail: relative residual .*, allowed 1e-08"):
        certify(other)


def largest_proven(design):
    """Return the largest alpha that P proves, (A + B K)' P + P (A + B K) + alpha (G_d' P + P G_d) <= 0, in 40 digits."""
    with mpmath.workdps(40):
        A, B, K, P, G = (
            mpmath.matrix(M.tolist()) for M in (design.A, design.B, design.K, design.P, generator_of(design))
        )
        closed, monotone = P * (A + B * K), P * G
        L = mpmath.inverse(mpmath.cholesky(monotone + monotone.T))
        return float(min(mpmath.eigsy(-L * (closed + closed.T) * L.T, eigvals_only=True)))


def generator_of(design):
    return design.form.generator(design.mu)


@pytest.mark.parametrize("seed", [5, 9, 13, 31, 38])
def test_one_part_in_a_billion_beyond_the_proof_is_refused(seed):
    """Two and three inputs: alpha, or a gain, wrong by 1e-9 of what P proves; as much within it is accepted."""
    case = drawn(seed, units=False)
    design = inverse_design(case.system, Options(alpha=case.alpha, u_max=case.u_max.tolist()))
    alpha = largest_proven(design)
    assert design.alpha < alpha
    assert replace(design, alpha=alpha * (1 - 1e-9)).certificate.decrease > 0.0
    with pytest.raises(CertificateError, match="<= 0 fails: margin"):
        replace(design, alpha=alpha * (1 + 1e-9))


def test_margin_of_zero_is_refused_and_the_next_number_is_not():
    """x' = u in the plane, u = -3 x, P = I: 6 - 2 alpha must be positive, decided for the doubles as they are."""
    plane = System(A=np.zeros((2, 2)), B=np.eye(2), K=-3.0 * np.eye(2))
    assert Design(plane, np.eye(2), mu=1.0, alpha=float(np.nextafter(3.0, 0.0))).certificate.decrease > 0.0
    with pytest.raises(CertificateError, match=r"<= 0 fails: margin .* must be positive"):
        Design(plane, np.eye(2), mu=1.0, alpha=3.0)
