"""The number of substeps."""

from math import ceil

from hypothesis import given, settings
from hypothesis import strategies as st

from plant_fmu.integrator import substeps

LENGTHS = st.floats(1e-6, 1.0)
reproducible = settings(deadline=None, derandomize=True, database=None)


@reproducible
@given(LENGTHS, LENGTHS)
def test_substeps_are_the_fewest_that_are_short_enough(step, largest):
    n = substeps(step, largest)
    assert isinstance(n, int)
    assert n >= 1
    assert step / n <= largest * (1 + 2e-9)
    assert n == 1 or step / (n - 1) > largest


@reproducible
@given(st.integers(1, 100_000), LENGTHS)
def test_a_multiple_is_divided_exactly_in_spite_of_rounding(n, largest):
    assert substeps(n * largest, largest) == n
    assert substeps(n * largest * (1 + 1e-12), largest) == n


@reproducible
@given(st.integers(1, 10_000), st.floats(0.01, 0.99), LENGTHS)
def test_a_remainder_needs_one_substep_more(n, remainder, largest):
    assert substeps((n + remainder) * largest, largest) == n + 1 == ceil(n + remainder)
