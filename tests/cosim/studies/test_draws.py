"""Draws: even in the unit square, the same whatever their number; estimates: closed forms and their coverage."""

import math

import numpy as np
import pytest
from scipy import stats

from cosim.scenario import Scenario
from cosim.studies.draws import drawn, encoder_offsets
from cosim.studies.estimates import change, mean, rms_change, root_mean_square


def test_offsets_are_a_net_and_more_draws_begin_with_the_same():
    points = np.array(encoder_offsets(32))
    assert encoder_offsets(8) == encoder_offsets(32)[:8]
    assert encoder_offsets(1) == encoder_offsets(32)[:1]
    for rows, columns in ((32, 1), (16, 2), (8, 4), (4, 8), (1, 32)):  # one point in each box: a (0, 5, 2)-net
        boxes = {(int(a * rows), int(b * columns)) for a, b in points}
        assert len(boxes) == 32


def test_a_draw_sets_offsets_and_noise_but_what_the_scenario_says_stays():
    found = drawn(Scenario().changed({"run.seed": 3, "plant.start.delta_encoder_offset": 0.25}), 3)
    assert found.plant.start == {
        "theta_encoder_offset": encoder_offsets(4)[2][0],
        "delta_encoder_offset": 0.25,
        "noise_seed": 3,
    }
    assert found.run.seed is None


def test_estimates_have_their_closed_forms():
    values = np.array([1.0, 2.0, 3.0, 6.0])
    half = stats.t.ppf(0.975, 3) * math.sqrt(14 / 3) / 2
    assert (mean(values).value, mean(values).half_width) == (3.0, pytest.approx(half))
    assert root_mean_square(values).value == pytest.approx(math.sqrt(50 / 4))
    assert math.isnan(mean(values[:1]).half_width)
    assert math.isnan(mean(values[:0]).value)


def test_what_a_draw_does_to_both_cancels():
    base = np.array([1.0, 5.0, 2.0, 9.0])
    for found in (change(0.8 * base, base), rms_change(0.8 * base, base)):
        assert (found.value, found.half_width, found.decided) == (pytest.approx(-0.2), pytest.approx(0.0), -1)
    assert change(base[::-1], base).decided == 0
    assert math.isnan(change(base, 0.0 * base).value)


@pytest.mark.parametrize("estimate", [change, rms_change])
def test_the_interval_of_a_change_covers_it_as_often_as_it_says(estimate):
    rng, hits = np.random.default_rng(1), 0
    for _ in range(400):
        common = rng.lognormal(sigma=0.3, size=32)
        found = estimate(0.9 * common * rng.lognormal(sigma=0.2, size=32), common * rng.lognormal(sigma=0.2, size=32))
        hits += abs(found.value + 0.1) <= found.half_width
    assert 0.91 < hits / 400 < 0.98
