"""Options contradict themselves in words."""

import numpy as np
import pytest

from ihc_fmu.options import Options


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
