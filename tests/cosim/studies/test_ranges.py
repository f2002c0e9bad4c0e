"""Ranges on the command line."""

import pytest

from cosim.errors import UserError
from cosim.studies.ranges import Range, range_of


def test_a_range_is_two_numbers_with_two_dots():
    assert range_of("-1..2.5e0", "--over a") == Range(-1.0, 2.5)
    assert Range(-1.0, 3.0).at(0.25) == 0.0


@pytest.mark.parametrize("text", ["1", "1..", "..2", "2..1", "1..1", "nan..1", "0..inf", "a..b", "0..1..2", ""])
def test_another_text_is_refused(text):
    with pytest.raises(UserError, match=r"--over a takes a range LOW\.\.HIGH .* found '"):
        range_of(text, "--over a")
