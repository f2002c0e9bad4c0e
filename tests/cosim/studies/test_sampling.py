"""Points that runs are drawn at: even, reproducible, continued by more of them."""

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.studies.sampling import grid, points


@pytest.mark.parametrize("sampling", ["sobol", "latin"])
def test_each_of_as_many_slices_has_one_point_in_every_dimension(sampling):
    cube = points(sampling, 5, 64, 7)
    assert cube.shape == (64, 5)
    assert (np.sort((64 * cube).astype(int), axis=0) == np.arange(64)[:, None]).all()


def test_more_points_of_a_sobol_set_begin_with_the_same_ones_and_another_seed_has_others():
    np.testing.assert_array_equal(points("sobol", 4, 300, 1)[:100], points("sobol", 4, 100, 1))
    assert not np.array_equal(points("sobol", 4, 100, 2), points("sobol", 4, 100, 1))


def test_a_grid_has_every_combination_as_often_as_is_asked():
    found = grid([2, 3], 2)
    assert found[:4].tolist() == [[0, 0], [0, 0], [0, 1], [0, 1]]
    assert np.unique(found, axis=0, return_counts=True)[1].tolist() == [2] * 6


def test_a_sobol_set_that_ends_is_named():
    with pytest.raises(UserError, match=r"at most 2\^30 draws"):
        points("sobol", 1, 2**30 + 1, 1)
