"""A design: the default one against an independent solution, its scale, its file, what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ihc_fmu.certificate import CertificateError
from ihc_fmu.companion import generator
from ihc_fmu.design import Design
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


def test_disturbance_within_the_certificate_never_makes_the_norm_grow(design, ideal_loop):
    bound = design.certificate.matched_disturbance
    assert bound > 0.005
    assert (ideal_loop(design).worst_rates(0.999 * bound, count=300) < 0.0).all()
    assert (ideal_loop(design).worst_rates(2 * design.u_max, count=300) > 0.0).any()  # so the check can fail


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


def test_what_is_certified_cannot_be_changed(design, paper):
    P = design.P.copy()
    made = Design(system(*paper), P=P, mu=design.mu, alpha=design.alpha)
    P[0, 0] = 0.0
    assert made.P[0, 0] == design.P[0, 0]
    with pytest.raises(ValueError, match="read-only"):
        made.P[0, 0] = 0.0


def test_numbers_that_do_not_fit_are_refused(design, paper):
    with pytest.raises(ValueError, match=r"P must be of shape \(4, 4\) to fit A, found shape \(2, 2\)"):
        Design(system(*paper), np.eye(2), 1.0, 0.1)
    with pytest.raises(ValueError, match="cannot be rescaled"):
        Design(system(*paper), design.P, 1.0, 0.1, psi=1e-12).scaled_to(u_max=1.0)


@pytest.mark.parametrize(
    "rule", [{"u_max": 0.0}, {"u_max": -1.0}, {"index": 4, "bound": 1.0}, {"index": 1, "bound": 0.0}]
)
def test_impossible_scale_is_refused(design, rule):
    with pytest.raises(ValueError, match="must be"):
        design.scaled_to(**rule)
