"""The logarithm of a matrix against the exponential function, whatever its size, units and structure."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from cosim.matrix_logarithm import logarithm


@pytest.mark.parametrize("n", [1, 2, 5, 9])
def test_it_undoes_the_exponential_function(n):
    rng = np.random.default_rng(n)
    sizes = 10.0 ** rng.uniform(-3.0, 3.0, n)
    for A in (rng.normal(size=(n, n)) / n, 1e-6 * rng.normal(size=(n, n)), 2.5 * np.eye(n, k=1), np.diag([-30.0] * n)):
        for units in (np.ones((n, n)), sizes / sizes[:, None]):
            np.testing.assert_allclose(
                logarithm(expm(A * units)) / units, A, rtol=0, atol=1e-11 * np.abs(A).max() + 1e-15
            )


@pytest.mark.parametrize("M", [np.diag([1.0, -1.0]), np.zeros((2, 2)), np.full((2, 2), np.nan)])
def test_a_matrix_without_one_gives_none(M):
    assert np.isnan(logarithm(M)).all()
