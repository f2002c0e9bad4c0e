"""The fits: what is used is near the printed numbers, a search improves and never worsens, failures are infinite."""

import math

import numpy as np
import pytest

from benchmarks import paper_fits
from cosim.paper.study import QUICK, SWING_UP_RANGES, Study


@pytest.fixture(scope="module")
def study(fmus, tmp_path_factory):
    made = Study(tmp_path_factory.mktemp("fit"), fmus, QUICK)
    made.prepare()
    return made


def used(study):
    return np.array([float(study.base.controller.start[name]) for name in SWING_UP_RANGES])


def test_the_swing_up_in_use_is_near_the_three_printed_numbers(study):
    """Each residual within its unit on average; half the acceleration never captures."""
    assert paper_fits.swing_up_misfit(study, used(study)) < 1.0
    weak = used(study) * np.where(np.array(list(SWING_UP_RANGES)) == "swing_up_acceleration_limit", 0.2, 1.0)
    assert paper_fits.swing_up_misfit(study, weak) == math.inf


def test_the_smc_in_use_is_near_what_is_printed_of_it(study):
    values = np.array(paper_fits.SMC_USED)
    assert paper_fits.smc_misfit(study, values) < 1.0
    assert paper_fits.smc_misfit(study, values * [1, 1, 1, 1, 0.5]) > 3.0
    assert paper_fits.smc_misfit(study, values * [1, 1, 1, 1, 10.0]) > 1000.0


def test_the_search_finds_the_bottom_of_a_bowl_and_keeps_its_best():
    target, seen = np.array([2.0, 30.0, 0.5]), []

    def bowl(values):
        seen.append(float(np.sum(np.log(values / target) ** 2)))
        return seen[-1]

    best, least = paper_fits.search(bowl, np.array([1.0, 10.0, 1.0]), 600, np.random.default_rng(1))
    np.testing.assert_allclose(best, target, rtol=0.05)
    assert least == min(seen)
    assert len(seen) == 601


def test_a_search_is_the_same_for_the_same_seed():
    start, bowl = np.array([1.0, 2.0]), lambda values: float(np.sum(values))
    first, second = (paper_fits.search(bowl, start, 20, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(first[0], second[0])


def test_random_starts_lie_in_their_ranges_and_hopeless_ones_are_refused():
    ranges = [(1.0, 2.0), (10.0, 1000.0)]
    start = paper_fits.random_start(lambda values: float(values[0]), ranges, 50, np.random.default_rng(0))
    assert 1.0 <= start[0] < 1.1
    assert 10.0 <= start[1] <= 1000.0
    with pytest.raises(paper_fits.UserError, match="none of 3 random starts"):
        paper_fits.random_start(lambda _: math.inf, ranges, 3, np.random.default_rng(0))


def test_the_command_prints_both_misfits(study, capsys):
    fmus = study.folder / "fmus"
    fmus.symlink_to(study.fmus)
    assert paper_fits.main(["smc", "--tries", "2", "--folder", str(study.folder)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("misfit: 0.")
    assert [line.split()[-2] for line in text.splitlines()[1:]] == [f"{v:.4g}" for v in paper_fits.SMC_USED]
