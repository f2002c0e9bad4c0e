"""Why there is no design: what is said instead is true of the mu that it names."""

import re

import numpy as np
import pytest

from cosim.designing import Wish, find
from cosim.errors import UserError
from ihc_fmu.synthesis import degrees, largest_alpha
from ihc_fmu.system import System


def test_without_mu_the_largest_feasible_alpha_is_the_best_of_those_tried():
    system = System(A=np.array([[0.0, 1.0], [0.0, 0.0]]), B=np.array([[0.0], [1.0]]), K=np.array([[-1.0, -0.5]]))
    with pytest.raises(UserError, match="the dual proves that there is no solution with mu = 0.25$") as refused:
        find(system, Wish(alpha=1.0), lambda _: None)
    pattern = r"the largest feasible one is ([\d.]+) 1/s with mu = ([\d.]+), the best of 1, 0.75, 0.5, 0.25;"
    said = re.search(pattern, str(refused.value))
    assert said
    found = {mu: largest_alpha(system, mu) for mu in degrees(system)}
    best = max(found, key=lambda mu: found[mu])
    assert float(said[2]) == best
    assert float(said[1]) == pytest.approx(found[best], rel=1e-3)
    assert found[best] > 1.1 * found[1.0]
