"""The largest alpha: known values, a closed form."""

import numpy as np
import pytest

from ihc_fmu.inverse import inverse_design
from ihc_fmu.largest_rate import largest_alpha
from ihc_fmu.lmi import InfeasibleError
from ihc_fmu.options import Options
from tests.ihc_fmu.models import integrator_chain, system


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
