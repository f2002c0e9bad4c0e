"""Adaptive refinement against the full grid, on shapes whose area is known."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.errors import UserError
from cosim.studies.refinement import Cell, Refinement


def refined(inside, axes=2, coarse=8, finest=64):
    """The refinement of a shape in the unit square or on the unit interval; `inside` takes numbers in [0, 1]."""
    found = Refinement(axes, coarse, finest)
    while wanted := found.wanted:
        found.tell({point: bool(inside(*(p / finest for p in point))) for point in wanted})
    return found


def whole(inside, axes=2, finest=64):
    return np.vectorize(inside, otypes=[bool])(*np.meshgrid(*[np.arange(finest + 1) / finest] * axes, indexing="ij"))


def ellipse(x0, y0, a, b, turn):
    c, s = math.cos(turn), math.sin(turn)
    return lambda x, y: ((c * (x - x0) + s * (y - y0)) / a) ** 2 + ((c * (y - y0) - s * (x - x0)) / b) ** 2 <= 1.0


few = settings(deadline=None, max_examples=25)
middle, turns = st.floats(0.2, 0.8), st.floats(0.0, math.pi)


@few
@given(middle, middle, st.floats(0.25, 0.6), st.floats(0.25, 0.6), turns)
def test_an_ellipse_is_that_of_the_full_grid_with_fewer_points(x0, y0, a, b, turn):
    inside = ellipse(x0, y0, a, b, turn)
    found = refined(inside)
    np.testing.assert_array_equal(found.grid(), whole(inside))
    assert len(found.known) < 0.5 * 65**2


@few
@given(middle, middle, st.floats(0.09, 0.15), turns)
def test_a_thin_ellipse_is_followed_where_a_corner_shows_it(x0, y0, b, turn):
    inside = ellipse(x0, y0, 2.0, b, turn)
    np.testing.assert_array_equal(refined(inside).grid(), whole(inside))


@pytest.mark.parametrize("finest", [8, 16, 32, 64, 128])
def test_the_area_lies_between_its_bounds_which_close_with_the_cells(finest):
    found, area = refined(ellipse(0.5, 0.5, 0.4, 0.3, 0.7), finest=finest), math.pi * 0.4 * 0.3
    inner, outer = found.bounds
    assert inner < area < outer
    assert outer - inner < 6.0 / finest
    assert abs(found.share - area) < 0.5 / finest


def test_the_effort_grows_with_the_boundary_not_with_the_area():
    counts = [len(refined(ellipse(0.5, 0.5, 0.4, 0.3, 0.7), finest=finest).known) for finest in (64, 128, 256)]
    assert counts[2] - counts[1] == pytest.approx(2 * (counts[1] - counts[0]), rel=0.1)


def test_a_hole_smaller_than_a_coarse_cell_is_missed_and_a_larger_one_is_not():
    def holed(r):
        return lambda x, y: (x - 0.5625) ** 2 + (y - 0.5625) ** 2 > r**2

    assert refined(holed(0.05)).bounds == (1.0, 1.0)
    inside = holed(0.1)
    np.testing.assert_array_equal(refined(inside).grid(), whole(inside))


def test_a_line_is_halved_at_each_end():
    found = refined(lambda x: 0.2 <= x <= 0.7, axes=1, coarse=8, finest=1024)
    inner, outer = found.bounds
    assert inner < 0.5 < outer
    assert outer - inner == 2 / 1024
    assert len(found.known) == 9 + 2 * 7
    np.testing.assert_array_equal(found.grid(), whole(lambda x: 0.2 <= x <= 0.7, 1, 1024))


def test_what_is_linear_is_interpolated_exactly_and_only_inside():
    def inside(x, y):
        return x + y <= 0.9

    found = refined(inside)
    values = {(i, j): 3.0 * i - 2.0 * j + 1.0 for i, j in found.known}
    middle = found.interpolated(values)
    i, j = np.nonzero(np.isfinite(middle))
    np.testing.assert_allclose(middle[i, j], 3.0 * (i + 0.5) - 2.0 * (j + 0.5) + 1.0)
    corners = whole(inside)
    np.testing.assert_array_equal(
        np.isfinite(middle), corners[:-1, :-1] & corners[1:, :-1] & corners[:-1, 1:] & corners[1:, 1:]
    )


@pytest.mark.parametrize("answer", [True, False])
def test_where_nothing_changes_nothing_is_divided(answer):
    found = refined(lambda _x, _y: answer)
    assert len(found.known) == 81
    assert found.bounds == (float(answer), float(answer))


def test_a_cell_consists_of_its_halves():
    cell = Cell((4, 8), 4)
    assert cell.corners == [(4, 8), (4, 12), (8, 8), (8, 12)]
    assert [part.corner for part in cell.halves] == [(4, 8), (4, 10), (6, 8), (6, 10)]
    assert len(set(cell.border)) == 16


@pytest.mark.parametrize(("coarse", "finest"), [(0, 8), (-4, 8), (1, 8), (8, 4), (8, 12), (8, 24), (3, 2**21)])
def test_numbers_of_cells_that_do_not_fit_are_refused(coarse, finest):
    with pytest.raises(UserError, match="times a power of two") as refusal:
        Refinement(2, coarse, finest)
    assert str(refusal.value).endswith(f"found {finest} and {coarse}")
