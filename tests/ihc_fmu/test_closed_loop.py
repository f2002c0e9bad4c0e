"""A gain that does not stabilize is refused, with what would."""

import numpy as np
import pytest

from benchmarks.random_systems import drawn
from fmu_export.errors import UserError
from ihc_fmu.inverse import inverse_design
from ihc_fmu.largest_rate import largest_alpha
from tests.ihc_fmu.models import system


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


def test_gain_that_stabilizes_by_rounding_alone_is_refused():
    """Poles placed without convergence: a gain so large that its poles depend on the coordinates."""
    case = drawn(1157)
    with pytest.raises(
        UserError, match=r"^K must stabilize \(A, B\) whatever the rounding: .* in scaled block coordinates"
    ):
        inverse_design(case.system)
