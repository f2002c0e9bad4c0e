"""Axes with their ticks, and pictures, borders and lines in shares of them."""

import math

import numpy as np
import pytest

from cosim.explore.map_drawing import Scale, image, outline, polyline, scale_of


def test_a_wide_axis_is_logarithmic_with_few_ticks():
    scale = Scale("x", 0.01, 1000.0, logarithmic=True)
    assert (scale.share(0.01), scale.share(1000.0), scale.share(0.0)) == (0.0, pytest.approx(1.0), -math.inf)
    assert [text for _, text in scale.drawn()["ticks"]] == ["0.01", "0.1", "1", "10", "100", "1000"]
    assert [text for _, text in Scale("x", 0.2, 7.0, logarithmic=True).drawn()["ticks"]] == [
        "0.2",
        "0.5",
        "1",
        "2",
        "5",
    ]


def test_an_axis_has_room_around_its_points_and_is_logarithmic_over_more_than_a_decade():
    near, wide = scale_of([1.0, 2.0], "x"), scale_of([0.1, 10.0], "x")
    assert (near.low, near.high, near.logarithmic) == (pytest.approx(0.94), pytest.approx(2.06), False)
    assert (wide.low, wide.high, wide.logarithmic) == (
        pytest.approx(0.0759, abs=1e-4),
        pytest.approx(13.18, abs=1e-2),
        True,
    )
    assert (scale_of([3.0], "x").low, scale_of([0.0], "x").high) == (1.5, 1.0)
    assert not scale_of([-1.0, 20.0], "x").logarithmic


def test_borders_and_lines_are_drawn_with_y_down():
    assert outline(np.array([[True, True], [False, False]])) == "M0.5 1V0.5M0.5 0.5V0"
    assert polyline([(0.0, 0.0), (0.5, 1.0), (0.6, math.nan), (1.0, 0.5)]) == "M0 1L0.5 0M1 0.5"


def test_a_picture_is_png_and_not_larger_than_is_seen():
    assert image(np.full((4, 4), math.nan)).startswith("data:image/png;base64,iVBOR")
    assert len(image(np.zeros((2048, 2048)))) < 20_000
