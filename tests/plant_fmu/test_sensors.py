"""Encoder, noise and delay: bounds of the quantizer, published random numbers, the normal distribution."""

from math import cos, isfinite, log, pi, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest

from plant_fmu.sensors import delay_in_steps, next_gaussian, next_random, quantize

ANGLES = st.floats(-100.0, 100.0)
COUNTS = st.integers(1, 100_000)
OFFSETS = st.floats(0.0, 1.0, exclude_max=True)
INSIDE = st.floats(1e-3, 1 - 1e-3)
reproducible = settings(deadline=None, derandomize=True, database=None)


def gaussians(seed, count):
    numbers = np.empty(count)
    for i in range(count):
        seed, numbers[i] = next_gaussian(seed)
    return numbers


@reproducible
@given(ANGLES, COUNTS, OFFSETS)
def test_reported_angle_is_a_whole_count_within_one_count(angle, counts, offset):
    resolution = 2 * pi / counts
    reported = quantize(angle, counts, offset)
    assert reported / resolution == pytest.approx(round(reported / resolution), abs=1e-6)
    error = (reported - angle) / resolution
    assert offset - 1 - 1e-6 <= error <= offset + 1e-6


@reproducible
@given(ANGLES, ANGLES, COUNTS, OFFSETS)
def test_quantizer_is_monotone(a, b, counts, offset):
    assert quantize(min(a, b), counts, offset) <= quantize(max(a, b), counts, offset)


@reproducible
@given(ANGLES, COUNTS)
def test_offset_of_one_half_reports_the_nearest_count(angle, counts):
    resolution = 2 * pi / counts
    assert abs(quantize(angle, counts, 0.5) - angle) <= resolution * (0.5 + 1e-6)


@reproducible
@given(st.integers(-5000, 5000), INSIDE, COUNTS, OFFSETS)
def test_count_n_spans_from_n_minus_offset_to_the_next(n, inside, counts, offset):
    resolution = 2 * pi / counts
    assert quantize(resolution * (n + inside - offset), counts, offset) == pytest.approx(n * resolution, rel=1e-12)


@reproducible
@given(st.integers(-5000, 5000), INSIDE, st.integers(1, 50_000), OFFSETS)
def test_half_a_turn_more_is_reported_as_half_a_turn_more(n, inside, half, offset):
    angle = pi / half * (n + inside - offset)
    difference = quantize(angle + pi, 2 * half, offset) - quantize(angle, 2 * half, offset)
    assert difference == pytest.approx(pi, rel=1e-9)


@reproducible
@given(ANGLES, OFFSETS)
def test_zero_counts_are_an_ideal_sensor(angle, offset):
    assert quantize(angle, 0, offset) == angle


def test_random_bits_are_the_published_splitmix64_sequence():
    state, draws = 1234567, []
    for _ in range(5):
        state, bits = next_random(state)
        draws.append(bits)
    assert draws == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]


def test_gaussian_number_is_box_muller_of_two_published_draws():
    u, v = ((bits >> 11) / 2**53 for bits in (6457827717110365317, 3203168211198807973))
    state, number = next_gaussian(1234567)
    assert number == pytest.approx(sqrt(-2 * log(u)) * cos(2 * pi * v), rel=1e-12)
    assert next_random(state)[1] == 9817491932198370423


def test_gaussian_numbers_are_standard_normal_and_uncorrelated():
    x = gaussians(seed=1, count=20_000)
    sigma = 1 / np.sqrt(x.size)
    assert abs(x.mean()) < 4 * sigma
    assert abs(x.var() - 1) < 4 * np.sqrt(2) * sigma
    assert abs(np.mean(x[1:] * x[:-1])) < 4 * sigma
    assert kstest(x, "norm").pvalue > 0.01


def test_neighbouring_seeds_give_unrelated_numbers():
    x, y = gaussians(1, 5000), gaussians(2, 5000)
    assert abs(np.corrcoef(x, y)[0, 1]) < 4 / np.sqrt(x.size)


def test_smallest_random_draw_gives_a_finite_gaussian_number():
    state = 2**64 - 0x9E3779B97F4A7C15
    assert next_random(state) == (0, 0)
    _, number = next_gaussian(state)
    assert isfinite(number)
    assert abs(number) <= 8.58  # sqrt(2 ln 2^53)


@reproducible
@given(st.integers(0, 1000), st.floats(1e-5, 0.1))
def test_multiple_of_the_step_is_counted_in_spite_of_rounding(n, step):
    assert delay_in_steps(n * step, step) == n


@pytest.mark.parametrize(("delay", "step"), [(0.0025, 0.001), (0.001, 0.002), (0.0010001, 0.001)])
def test_delay_between_two_steps_is_refused_with_both_numbers(delay, step):
    with pytest.raises(ValueError, match=rf"multiple of .* step, found {delay:g} s with a step of {step:g} s"):
        delay_in_steps(delay, step)
