"""Designs by matrix inequalities: an independent solution, active bounds, limits of alpha, robust terms, files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fmu_export.errors import UserError
from ihc_fmu.certificate import CertificateError
from ihc_fmu.companion import chain_form, generator
from ihc_fmu.design import Design
from ihc_fmu.lmi import InfeasibleError
from ihc_fmu.pendulum.start_values import default_design
from ihc_fmu.synthesis import Options, direct_design, inverse_design, largest_alpha
from ihc_fmu.system import System
from tests.ihc_fmu.conftest import chain_of

# An independent solution of the same matrix inequalities: mu = 1, alpha = 0.2 1/s, beta = 0.1, |k x| <= u_max.
P_UMAX_1P5 = [
    [2.1488205077834017, -23.215181761620986, 2.0378689019254588, -2.3617632416162984],
    [-23.21518176162098, 281.6316858194104, -22.960417628716524, 27.838461069848385],
    [2.0378689019254597, -22.96041762871653, 1.9888797633816009, -2.3104099917876617],
    [-2.3617632416162984, 27.838461069848385, -2.310409991787661, 2.8334190590014003],
]
P_UMAX_10 = [
    [0.04834846142512654, -0.5223415896364721, 0.045852050293322816, -0.0531396729363667],
    [-0.5223415896364721, 6.3367129309367325, -0.5166093966461217, 0.6263653740715885],
    [0.04585205029332282, -0.5166093966461219, 0.04474979467608601, -0.051984224815222385],
    [-0.05313967293636671, 0.6263653740715888, -0.05198422481522238, 0.06375192882753151],
]
# Section V of the paper, printed
PRINTED_K = [-113.4482, -108.1254, -13.7505, -0.2833]
PRINTED_P = [
    [0.1304, 0.0053, 0.0213, 0.0844],
    [0.0053, 0.1729, 0.0344, 0.1168],
    [0.0213, 0.0344, 0.3037, 0.2127],
    [0.0844, 0.1168, 0.2127, 0.3930],
]


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


def test_default_design_is_the_independent_solution(design):
    np.testing.assert_allclose(design.P, P_UMAX_1P5, rtol=1e-3)
    np.testing.assert_allclose(design.scaled_to(u_max=10.0).P, P_UMAX_10, rtol=1e-3)
    assert (design.mu, design.alpha) == (1.0, 0.2)


def test_gain_is_the_linear_one_plus_the_row_of_the_chain(design):
    """Eq. (10) in the coordinates of x."""
    np.testing.assert_allclose(design.K_h[0], [2.0, -24.677, 1.9998, -2.5], rtol=1e-4)
    np.testing.assert_allclose(
        np.linalg.solve(chain_of(design).Phi.T, design.K_h[0]),
        [-11344.7997, -11343.5853, -1113.4123, -23.42865],
        rtol=1e-8,
    )
    np.testing.assert_allclose(
        design.K_h[0], np.linalg.solve(chain_of(design).Phi.T, design.K_h[0]) @ chain_of(design).Phi, rtol=1e-9
    )


def test_printed_gain_is_not_that_of_the_printed_equation(design):
    assert np.abs(design.K_h[0] - PRINTED_K).max() > 80.0


@pytest.mark.parametrize("k", ["printed", "eq. (10)"])
@pytest.mark.parametrize("coordinates", ["x", "z"])
def test_printed_matrix_fails_the_printed_inequality(design, coordinates, k):
    """Inequality (11) at mu = 1, alpha = 1e-3, for P in pendulum or chain coordinates, with either gain."""
    gain = np.array(PRINTED_K) if k == "printed" else design.K_h[0]
    P, Phi = np.array(PRINTED_P), chain_of(design).Phi
    P = Phi.T @ P @ Phi if coordinates == "z" else P
    M = design.A - np.outer(design.b, chain_of(design).row) + np.outer(design.b, gain) + 1e-3 * generator(Phi, 1.0)
    assert np.linalg.eigvals(np.linalg.solve(P, M.T @ P + P @ M)).real.max() > 1.0
    with pytest.raises(CertificateError):
        Design(system(design.A, design.b, gain - chain_of(design).row), P, mu=1.0, alpha=1e-3)


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


def test_rescaling_meets_its_rule_and_keeps_the_proof(design):
    for scaled in (design.scaled_to(u_max=7.0), design.scaled_to(index=1, bound=0.3)):
        assert scaled.certificate.decrease == pytest.approx(design.certificate.decrease, rel=1e-3)
        np.testing.assert_allclose(scaled.P / scaled.P[0, 0], design.P / design.P[0, 0], rtol=1e-9)
    assert design.scaled_to(u_max=7.0).u_max == pytest.approx(7.0, rel=1e-9)
    assert design.scaled_to(index=1, bound=0.3).extent[1] == pytest.approx(0.3, rel=1e-9)


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ({}, "needs one rule"),
        ({"index": 1}, "needs one rule"),
        ({"u_max": 1.0, "index": 1, "bound": 1.0}, "needs one rule"),
        ({"u_max": -1.0}, "must be positive and finite, found -1.0"),
        ({"u_max": np.nan}, "must be positive and finite"),
    ],
)
def test_rescaling_without_a_rule_is_refused(design, rule, message):
    with pytest.raises(ValueError, match=message):
        design.scaled_to(**rule)


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


def test_disturbance_within_the_certificate_never_makes_the_norm_grow(design, ideal_loop):
    bound = design.certificate.matched_disturbance
    assert bound > 0.005
    assert (ideal_loop(design).worst_rates(0.999 * bound, count=300) < 0.0).all()
    assert (ideal_loop(design).worst_rates(2 * design.u_max, count=300) > 0.0).any()  # so the check can fail


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
            "; K seems to be in the order (angle, rate, angle, rate), unlike A",
        ),
        (
            lambda A, b, k: (A, b, -k[[0, 2, 1, 3]]),
            "; K seems to be in the order (angle, rate, angle, rate) and the sign of u = -K x, unlike A",
        ),
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


def test_requests_that_no_design_can_meet_are_refused(paper, design):
    A, b, k_lin = paper
    with pytest.raises(ValueError, match="must be controllable"):
        inverse_design(system(-np.eye(4), b, np.zeros(4)))
    with pytest.raises(ValueError, match=r"K must have 1 rows of 4 numbers to fit B and A, found shape \(1, 3\)"):
        inverse_design(system(A, b, k_lin[:3]))
    with pytest.raises(ValueError, match=r"one of 0\.\.3, found 4"):
        inverse_design(system(A, b, k_lin), Options(delta_max=0.1, index=4))
    with pytest.raises(ValueError, match="a direct design needs u_max"):
        direct_design(system(A, b), Options(u_max=None, delta_max=0.1))
    with pytest.raises(ValueError, match=r"P must be of shape \(4, 4\) to fit A, found shape \(2, 2\)"):
        Design(system(A, b, k_lin), np.eye(2), 1.0, 0.1)
    with pytest.raises(ValueError, match="cannot be rescaled"):
        Design(system(A, b, k_lin), design.P, 1.0, 0.1, psi=1e-12).scaled_to(u_max=1.0)


# Files


def test_design_survives_its_file_to_the_last_bit(design, tmp_path):
    path = tmp_path / "new" / "design.json"
    design.save(path)
    loaded = Design.load(path)
    assert loaded.system.as_dict() == design.system.as_dict()
    for field in ("P", "mu", "alpha", "psi", "d_max", "tau", "method", "certificate"):
        np.testing.assert_array_equal(getattr(loaded, field), getattr(design, field), err_msg=field)
    assert loaded.to_json() == design.to_json() == path.read_text(encoding="utf-8")
    assert [p.name for p in path.parent.iterdir()] == ["design.json"]


def test_derived_numbers_in_a_file_are_computed_anew(design):
    data = json.loads(design.to_json())
    data["derived"] = {"K_0": [0.0] * 4}
    np.testing.assert_array_equal(Design.from_json(json.dumps(data)).K_h, design.K_h)


def tampered(design, **changes):
    data = json.loads(design.to_json())
    data["system"] |= {name: changes.pop(name) for name in ("A", "B", "K") if name in changes}
    data |= changes
    return json.dumps({name: value for name, value in data.items() if value is not ...})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"P": np.eye(4).tolist()}, "P .* fails: margin"),
        ({"alpha": 0.3}, "<= 0 fails: margin"),
        ({"K": [2.0, -10.0, 2.0, -2.5]}, "Hurwitz fails"),
        ({"P": ...}, r"missing \['P'\]"),
        ({"more": 1}, r"unknown \['more'\]"),
        ({"format": "qube-ihc design 3"}, "the format must be 'qube-ihc design 2', found 'qube-ihc design 3'"),
        ({"alpha": "0.2"}, "alpha must be a number"),
        ({"B": [[1.0], [2.0]]}, "B must have 4 rows to fit A, found shape"),
        ({"A": [[0.0, None], [0.0, 0.0]]}, "A must be rows of numbers"),
        ({"system": [1]}, "a system must be a table of entries"),
    ],
)
def test_file_that_proves_nothing_is_refused_by_name(design, tmp_path, changes, message):
    path = tmp_path / "design.json"
    path.write_text(tampered(design, **changes), encoding="utf-8")
    with pytest.raises(ValueError, match=message) as refusal:
        Design.load(path)
    assert str(path) in str(refusal.value)
    assert isinstance(refusal.value, CertificateError) == ("fails" in message)


@pytest.mark.parametrize(("text", "message"), [("P = 1", "not JSON"), ("[1, 2]", "found 'list'"), ("{}", "found None")])
def test_text_that_is_no_design_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        Design.from_json(text)


@pytest.mark.parametrize("tau", [0.0, -1.0, float("nan"), float("inf")])
def test_multiplier_that_proves_nothing_is_refused(design, tau):
    with pytest.raises(ValueError, match="tau must be positive and finite, found"):
        replace(design, d_max=1.0, tau=tau)


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


def test_what_is_certified_cannot_be_changed(design, paper):
    P = design.P.copy()
    made = Design(system(*paper), P=P, mu=design.mu, alpha=design.alpha)
    P[0, 0] = 0.0
    assert made.P[0, 0] == design.P[0, 0]
    with pytest.raises(ValueError, match="read-only"):
        made.P[0, 0] = 0.0


@pytest.mark.parametrize(
    "rule", [{"u_max": 0.0}, {"u_max": -1.0}, {"index": 4, "bound": 1.0}, {"index": 1, "bound": 0.0}]
)
def test_impossible_scale_is_refused(design, rule):
    with pytest.raises(ValueError, match="must be"):
        design.scaled_to(**rule)


def test_a_design_does_not_depend_on_those_before_it():
    """A journal knows runs by their design's numbers, so that the same call must give the same bytes."""
    default = default_design()
    first, other, again = (
        inverse_design(default.system, Options(mu=mu, alpha=default.alpha)) for mu in (1.0, 0.5, 1.0)
    )
    assert first.to_json() == again.to_json() != other.to_json()
