"""Analytic centers: known ones, the same in all coordinates, and what has no inside."""

from typing import Any

import numpy as np
import pytest

from ihc_fmu.barrier import Affine, center, inside

SLOPES = np.array([[[1.0, 0.0], [0.0, 0.0]], [[0.0, 1.0], [1.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]]])
"""Of X = [[v_1, v_2], [v_2, v_3]]."""
UNIT = np.array([1.0, 0.0, 1.0])
ELLIPSE = np.array([[5.0, 2.0], [2.0, 3.0]])


def affine(L, constant, slopes):
    """Return L (constant + slopes v) L'."""
    return Affine(L @ constant @ L.T, L @ slopes @ L.T)


def bounded(L, size=1.0):
    """Return X and the sides X > 0 and X < ELLIPSE, in coordinates y = L x."""
    X = affine(L, np.zeros((2, 2)), SLOPES)
    return X, [X, affine(L, size * ELLIPSE, -SLOPES)]


@pytest.mark.parametrize("gap", [1e-2, 1e-6])
def test_center_is_the_known_one(gap):
    """X < M: t X^-1 + X^-1 = (M - X)^-1 at the center, so that X = M (t + 1)/(t + 2), t = 4/gap."""
    X, sides = bounded(np.eye(2))
    point = center(X, sides, UNIT, gap)
    assert point is not None
    np.testing.assert_allclose(X.at(point), ELLIPSE * (4 / gap + 1) / (4 / gap + 2), rtol=1e-9)
    assert 0.0 < np.linalg.slogdet(ELLIPSE)[1] - np.linalg.slogdet(X.at(point))[1] < gap
    again: Any = center(X, sides, point, gap, near=True)
    np.testing.assert_allclose(again, point, rtol=1e-10)


def test_coordinates_do_not_matter():
    turned = np.array([[1e4, 3e3], [-2e-3, 1e-3]])
    first, second = (np.asarray(center(*bounded(L), UNIT, 1e-6)) for L in (np.eye(2), turned))
    np.testing.assert_allclose(first, second, rtol=1e-9)


def test_a_point_inside_is_found_where_there_is_one():
    X, sides = bounded(np.eye(2), size=1e-2)
    assert inside(X, sides, 1e-3 * UNIT) is not None
    point = inside(X, sides, UNIT)
    assert point is not None
    assert min(np.linalg.eigvalsh(side.at(point))[0] for side in sides) > 0.0
    assert center(X, sides, UNIT, 1e-6) is None
    empty = Affine(-2.0 * ELLIPSE, SLOPES)  # X > 2 M besides
    assert inside(X, [*sides, empty], UNIT) is None
