"""Designs without a linear controller: their bound, any rate."""

import numpy as np
import pytest

from ihc_fmu.direct import direct_design
from ihc_fmu.options import Options
from tests.ihc_fmu.models import system


def test_direct_design_is_certified_and_its_bound_active(paper, ideal_loop):
    """Eq. (9): the gain is free, and reaches an alpha that no P proves for the manufacturer's gain."""
    A, b, _ = paper
    design = direct_design(system(A, b), Options(alpha=1.0, u_max=10.0))
    assert design.u_max == pytest.approx(10.0, rel=1e-3)
    assert design.certificate.decrease > 0.0
    assert np.linalg.eigvals(A + np.outer(b, design.k_lin)).real.max() < 0.0
    assert (ideal_loop(design).worst_rates(0.0, count=100) <= -1.0 * (1 - 1e-5)).all()


@pytest.mark.parametrize("alpha", [0.001, 0.1, 10.0, 100.0])
def test_direct_design_serves_any_rate(paper, alpha):
    """Five decades of alpha for the pendulum, whose own fastest pole is at 16 1/s."""
    A, b, _ = paper
    design = direct_design(system(A, b), Options(alpha=alpha, u_max=10.0))
    assert design.alpha == alpha
    assert design.u_max <= 10.0 * (1 + 1e-3)
    assert design.certificate.hurwitz > alpha  # every w_i is at least 1


def test_a_direct_design_without_a_bound_is_refused(paper):
    with pytest.raises(ValueError, match="a direct design needs u_max"):
        direct_design(system(*paper[:2]), Options(u_max=None, delta_max=0.1))
