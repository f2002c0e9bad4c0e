"""Elimination as NumPy has it, and what it refuses."""

from math import nan

import numpy as np
import pytest

from ihc_fmu.linear_algebra import solve


@pytest.mark.parametrize("n", range(1, 8))
def test_elimination_solves_linear_systems(n):
    rng = np.random.default_rng(n)
    M, B = rng.normal(size=(n, n)), rng.normal(size=(n, 2))
    M[0, 0] = 0.0 if n > 1 else 1.0  # needs a row exchange
    np.testing.assert_allclose(solve(M.tolist(), B.tolist()), np.linalg.solve(M, B), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("M", [[[0.0]], [[1.0, 2.0], [2.0, 4.0]], [[1.0, nan], [nan, 1.0]]])
def test_singular_matrix_is_refused(M):
    with pytest.raises(ValueError, match="Phi must be regular"):
        solve(M, [[1.0]] * len(M))
