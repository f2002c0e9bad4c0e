"""The proof of a design: every check can fail, its margins are invariant, and simulations obey its promises."""

from dataclasses import replace
from math import log

import numpy as np
import pytest
from scipy.linalg import expm

from ihc_fmu.certificate import (
    CertificateError,
    decrease_matrix,
    norm_of,
    relative_eigenvalues,
    settling_time_bound,
)
from ihc_fmu.companion import chain_form, generator
from ihc_fmu.design import Design
from ihc_fmu.homogeneity import homogeneous_norm, norm_polynomial, to_chain
from ihc_fmu.laws import implicit_homogeneous

X_0 = np.array([0.0, 0.1, 0.0, 0.0])


class IdealLoop:
    """x' = A x + b u(x) with the exact norm, its rate of change, and Runge-Kutta steps in proportion to r^mu."""

    def __init__(self, design, a_min=0.0):
        self.design, self.a_min = design, a_min
        self.Pz = to_chain(design.Phi.tolist(), design.P.tolist())

    def norm(self, x):
        return homogeneous_norm(norm_polynomial(self.Pz, (self.design.Phi @ x).tolist()), self.design.mu)

    def velocity(self, x):
        d, r = self.design, max(self.a_min, self.norm(x))
        return d.A @ x + d.b * implicit_homogeneous(d.k_lin, d.kz, d.mu, r, x, d.Phi @ x)

    def rate(self, x):
        """d||x||_d/dt by a central difference along the motion."""
        v = self.velocity(x)
        step = 1e-5 / np.sqrt(v @ self.design.P @ v)
        return (self.norm(x + step * v) - self.norm(x - step * v)) / (2 * step)

    def run(self, x, done):
        """Return the time and state at which `done` is first met; the poles scale with r^-mu, and so does the step."""
        t, f = 0.0, self.velocity
        while not done(x):
            h = 0.01 * max(self.a_min, self.norm(x)) ** self.design.mu
            k1 = f(x)
            k2 = f(x + h / 2 * k1)
            k3 = f(x + h / 2 * k2)
            k4 = f(x + h * k3)
            x, t = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), t + h
            assert t < 20.0
        return t, x


def on_the_sphere(design, rng):
    """A random x with x' P x = 1."""
    direction = rng.normal(size=design.n)
    return np.linalg.solve(np.linalg.cholesky(design.P).T, direction / np.linalg.norm(direction))


@pytest.mark.parametrize("mu", [0.25, 0.5, 1.0])
def test_norm_decreases_at_the_proven_rate_everywhere(designs, mu):
    """d||x||_d/dt <= -alpha ||x||_d^(1-mu) at random states over four decades of the norm."""
    design = designs[mu]
    loop, rng, G = IdealLoop(design), np.random.default_rng(3), generator(design.Phi, mu)
    for _ in range(300):
        y = on_the_sphere(design, rng)
        assert loop.rate(y) <= -design.alpha * (1 - 1e-6)
        r = 10.0 ** rng.uniform(-2, 2)
        x = expm(G * log(r)) @ y
        assert loop.norm(x) == pytest.approx(r, rel=1e-9)
        # the motion is homogeneous too: its rate at d(ln r) y is r^(1-mu) times that at y
        v = expm(-G * log(r)) @ loop.velocity(x) * r**mu
        np.testing.assert_allclose(v, loop.velocity(y), rtol=1e-6, atol=1e-8 * np.abs(v).max())


@pytest.mark.parametrize("mu", [0.25, 0.5, 1.0])
def test_proven_rate_is_nearly_attained_in_the_worst_direction(designs, mu):
    """The solver pushes the inequality to its bound, so the test above could not hold with a larger alpha."""
    design = designs[mu]
    values, vectors = np.linalg.eig(np.linalg.solve(design.P, decrease_matrix(design, design.alpha)))
    y = vectors[:, np.argmax(values.real)].real
    y /= np.sqrt(y @ design.P @ y)
    assert IdealLoop(design).rate(y) == pytest.approx(-design.alpha, rel=1e-3)


@pytest.mark.parametrize("mu", [0.5, 1.0])
def test_convergence_is_finite_within_the_certified_time(designs, mu):
    """Four decades of the norm before T = r0^mu/(mu alpha); the linear controller is still far away then."""
    design = designs[mu]
    bound = settling_time_bound(design, X_0)
    assert bound == pytest.approx(norm_of(design, X_0) ** mu / (mu * design.alpha))
    loop = IdealLoop(design)
    t, x = loop.run(X_0, lambda x: loop.norm(x) < 1e-4)
    assert t + settling_time_bound(design, x) < bound
    linear = expm((design.A + np.outer(design.b, design.k_lin)) * t) @ X_0
    assert np.hypot(*linear[:2]) > 1e-4
    assert np.hypot(*x[:2]) < 1e-6


def test_pendulum_is_upright_to_a_microradian_when_the_linear_controller_is_not(design):
    """|q| < 1e-6 for good at 1.72 s with a_min = 1e-3, at 10.6 s with the LC; independently simulated before."""
    loop = IdealLoop(design, a_min=1e-3)
    t, x = loop.run(X_0, lambda x: x @ design.P @ x < 1e-13)  # the ellipsoid's |q| is below 1e-6 from here on
    assert np.hypot(*x[:2]) < 1e-6
    assert t == pytest.approx(1.72, abs=0.05)
    closed = design.A + np.outer(design.b, design.k_lin)
    times = np.arange(0.0, 12.0, 0.02)
    step, x = expm(closed * 0.02), X_0
    errors = []
    for _ in times:
        errors.append(np.hypot(*x[:2]))
        x = step @ x
    assert times[np.flatnonzero(np.array(errors) > 1e-6)[-1]] == pytest.approx(10.6, abs=0.1)


def test_settling_bound_shrinks_with_the_state_and_is_zero_at_the_origin(design):
    assert settling_time_bound(design, np.zeros(4)) == 0.0
    halved = expm(-generator(design.Phi, 1.0) * log(2.0)) @ X_0
    assert settling_time_bound(design, halved) == pytest.approx(settling_time_bound(design, X_0) / 2, rel=1e-9)


@pytest.mark.parametrize("mu", [0.25, 1.0])
def test_margins_are_the_same_in_all_coordinates(designs, mu):
    d = designs[mu]
    d = replace(d, alpha=0.8 * d.alpha)  # a margin far above rounding
    T = np.random.default_rng(4).normal(size=(4, 4))
    inverse = np.linalg.inv(T)
    moved = Design(T @ d.A @ inverse, T @ d.b, d.k_lin @ inverse, inverse.T @ d.P @ inverse, d.mu, d.alpha)
    for name in ("decrease", "monotone", "hurwitz"):
        assert getattr(moved.certificate, name) == pytest.approx(getattr(d.certificate, name), rel=1e-5)
    assert moved.certificate.matched_disturbance == pytest.approx(d.certificate.matched_disturbance, rel=1e-3)


def test_margins_have_their_closed_form_for_a_scalar_system():
    """x' = u, k_lin = -3, P = 4: decrease 2 (3 - alpha), monotone 2, and |d| < 3 |x| at |x| = 1/2."""
    d = Design(np.zeros((1, 1)), np.ones(1), np.array([-3.0]), np.array([[4.0]]), mu=1.0, alpha=1.0)
    c = d.certificate
    assert (c.decrease, c.monotone, c.positive, c.hurwitz) == pytest.approx((4.0, 2.0, 1.0, 3.0))
    assert c.identities == 0.0
    assert c.matched_disturbance == pytest.approx(1.5, rel=1e-3)
    assert c.as_dict()["decrease"] == c.decrease
    assert d.u_max == pytest.approx(1.5)


def test_relative_eigenvalues_solve_the_generalized_problem():
    rng = np.random.default_rng(1)
    M, L = rng.normal(size=(5, 5)), rng.normal(size=(5, 5))
    M, P = M + M.T, L @ L.T + np.eye(5)
    expected = np.sort(np.linalg.eigvals(np.linalg.solve(P, M)).real)
    np.testing.assert_allclose(relative_eigenvalues(M, P), expected, rtol=1e-9)


def test_matched_disturbance_is_claimed_only_at_mu_one(designs):
    assert designs[0.5].certificate.matched_disturbance == 0.0
    assert designs[1.0].certificate.matched_disturbance > 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: {"P": d.P - 1.1 * np.linalg.eigvalsh(d.P)[0] * np.eye(4)}, "P > 0 fails"),
        (lambda d: {"P": -d.P}, "P > 0 fails"),
        (lambda d: {"P": d.P + np.triu(d.P, 1)}, "P must be symmetric"),
        (lambda d: {"P": np.diag([1.0, 1.0, 1.0, 1.0])}, r"G_d' P \+ P G_d > 0 fails: margin -"),
        (lambda d: {"alpha": 0.21}, r"\+ alpha \(G_d' P \+ P G_d\) <= 0 fails: margin -.* \(1/s relative to P\)"),
        (lambda d: {"k_lin": -d.k_lin}, r"A \+ b k_lin Hurwitz fails: margin -"),
        (lambda d: {"k_lin": 0.99 * d.k_lin}, "<= 0 fails: margin -"),
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
    """The certificate checks (1) with the given Phi: that of a slightly different A is refused."""
    other = replace(design)
    object.__setattr__(other, "Phi", chain_form(1.001 * design.A, design.b).Phi)
    from ihc_fmu.certificate import certify

    with pytest.raises(CertificateError, match="G_d b = b fail: relative residual|fails: margin"):
        certify(other)
