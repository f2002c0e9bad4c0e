"""How claims are decided: Wilson's interval, rankings over draws, tolerances."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, norm

from cosim.paper.study import Key
from cosim.paper.verdicts import Claim, margin, share_of_wins, tolerance, verdict_of
from cosim.studies.estimates import Share

NAN, INF = math.nan, math.inf


def tallies():
    """Draw (wins, draws)."""
    return st.integers(1, 2000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


# Shares


def wilson(wins, n):
    z, p = float(norm.ppf(0.975)), wins / n
    middle, half = p + z**2 / (2 * n), z * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return (middle - half) / (1 + z**2 / n), (middle + half) / (1 + z**2 / n)


@given(tallies())
def test_the_interval_is_wilsons(tally):
    share = Share(*tally)
    assert share.interval == pytest.approx(wilson(*tally), abs=1e-12)
    assert share.value == tally[0] / tally[1]
    assert share.interval[0] <= share.value + 1e-12
    assert share.value <= share.interval[1] + 1e-12


@given(tallies())
def test_what_holds_one_way_does_not_hold_the_other_way(tally):
    wins, draws = tally
    other = {"holds": "does not hold", "does not hold": "holds", "undecided": "undecided"}
    assert verdict_of(Share(draws - wins, draws)) == other[verdict_of(Share(wins, draws))]


def test_four_draws_of_one_kind_decide_and_three_do_not():
    """All wins: the interval begins at n/(n + z²), above a half for n > z² = 3.84."""
    assert Share(4, 4).interval == pytest.approx((4 / (4 + norm.ppf(0.975) ** 2), 1.0))
    assert [verdict_of(Share(n, n)) for n in (1, 3, 4, 200)] == ["undecided", "undecided", "holds", "holds"]
    assert [verdict_of(Share(0, n)) for n in (1, 3, 4, 200)] == ["undecided"] * 2 + ["does not hold"] * 2


@pytest.mark.parametrize("n", [2, 10, 200, 10_000])
def test_half_of_the_draws_decide_nothing(n):
    assert verdict_of(Share(n // 2, n)) == "undecided"


@given(tallies())
def test_a_verdict_is_the_score_test_against_one_half(tally):
    """Wilson's interval excludes 1/2 where |2w - n| > z sqrt(n): of 200 draws 114 decide, 113 do not."""
    wins, draws = tally
    distance = abs(2 * wins - draws) - float(norm.ppf(0.975)) * math.sqrt(draws)
    assert (verdict_of(Share(wins, draws)) == "undecided") == (distance <= 0.0)
    assert [verdict_of(Share(wins, 200)) for wins in (86, 87, 113, 114)] == [
        "does not hold",
        *["undecided"] * 2,
        "holds",
    ]


def test_without_draws_a_share_is_open():
    share = Share(0, 0)
    assert (share.interval, verdict_of(share)) == ((0.0, 1.0), "undecided")
    assert math.isnan(share.value)
    assert str(share) == "no draw decides"
    assert str(Share(7, 10)) == "7 of 10 (40 to 89 %)"


def test_the_interval_contains_the_truth_in_19_of_20_studies():
    """Exactly, by the sum over the binomial distribution; on average over p, and not much less at the worst of them."""
    n, truths = 200, np.linspace(0.05, 0.95, 91)
    low, high = np.transpose([Share(k, n).interval for k in range(n + 1)])
    coverage = [float(binom.pmf(range(n + 1), n, p) @ ((low <= p) & (p <= high))) for p in truths]
    assert np.mean(coverage) == pytest.approx(0.95, abs=0.005)
    assert min(coverage) > 0.92


def test_seeded_studies_seldom_decide_between_equals_and_see_a_clear_difference():
    rng = np.random.default_rng(1)
    by_wins = [verdict_of(Share(k, 200)) for k in range(201)]
    equals = Counter(by_wins[k] for k in rng.binomial(200, 0.5, 20_000))
    assert equals["undecided"] / 20_000 == pytest.approx(0.95, abs=0.01)
    assert {by_wins[k] for k in rng.binomial(200, 0.75, 200)} == {"holds"}


# Rankings


def cell(**pairs):
    """Return the runs of draws 1, 2, ... from pairs (numbers of A, numbers of B)."""
    runs = {}
    for draw, (a, b) in enumerate(pairs.values(), start=1):
        for variant, numbers in (("A", a), ("B", b)):
            runs[Key("swing-up", "ident", 1e-4, 0, variant, draw)] = numbers
    return runs


def kept(value):
    return {"cost": value, "kept": 1.0}


def lost(value):
    return {"cost": value, "kept": 0.0}


@pytest.mark.parametrize(
    ("a", "b", "wins", "draws"),
    [
        (kept(1.0), kept(2.0), 1, 1),
        (kept(2.0), kept(1.0), 0, 1),
        (kept(1.0), kept(1.0), 0, 0),
        (lost(0.1), kept(9.0), 0, 1),
        (kept(9.0), lost(0.1), 1, 1),
        (lost(1.0), lost(2.0), 0, 0),
        (kept(NAN), kept(9.0), 0, 1),
        (kept(9.0), kept(NAN), 1, 1),
        (kept(NAN), kept(NAN), 0, 0),
        (kept(NAN), lost(1.0), 0, 0),
        ({}, kept(9.0), 0, 1),
        (kept(9.0), {}, 1, 1),
        ({}, {}, 0, 0),
        ({"kept": 1.0}, kept(9.0), 0, 1),
    ],
    ids=str,
)
def test_a_draw_is_won_by_the_smaller_number_of_a_pendulum_that_stayed_up(a, b, wins, draws):
    runs = cell(only=(a, b))
    assert share_of_wins(runs, list(runs), "A", "B", "cost") == Share(wins, draws)


def test_draws_are_counted_over_all_keys_of_the_cell_and_only_those():
    runs = cell(
        first=(kept(1.0), kept(2.0)),
        second=(kept(3.0), kept(2.0)),
        third=(kept(1.0), lost(0.0)),
        fourth=(kept(5.0), kept(5.0)),
        fifth=(lost(0.0), lost(0.0)),
        sixth=(kept(1.0), kept(4.0)),
    )
    keys = list(runs)
    assert share_of_wins(runs, keys, "A", "B", "cost") == Share(3, 4)
    assert share_of_wins(runs, [key for key in keys if key.draw < 3], "A", "B", "cost") == Share(1, 2)
    assert share_of_wins(runs, [], "A", "B", "cost") == Share(0, 0)


@given(st.lists(st.tuples(*[st.sampled_from([{}, kept(1.0), kept(2.0), kept(NAN), lost(0.0)])] * 2), max_size=20))
def test_what_one_loses_the_other_wins(pairs):
    runs = cell(**{f"draw {i}": pair for i, pair in enumerate(pairs)})
    one, two = share_of_wins(runs, runs, "A", "B", "cost"), share_of_wins(runs, runs, "B", "A", "cost")
    assert one.draws == two.draws == one.wins + two.wins


# Claims


def claim(ours, low=NAN, high=NAN, **rest):
    return Claim("section", "text", 1.0, ours, rest.pop("unit", "s"), low, high, **rest)


@pytest.mark.parametrize(
    ("ours", "low", "high", "verdict"),
    [
        (1.0, 1.0, 2.0, "holds"),
        (2.0, 1.0, 2.0, "holds"),
        (math.nextafter(1.0, 0.0), 1.0, 2.0, "does not hold"),
        (math.nextafter(2.0, 3.0), 1.0, 2.0, "does not hold"),
        (NAN, 1.0, 2.0, "does not hold"),
        (-1e9, -INF, 4.0, "holds"),
        (4.1, -INF, 4.0, "does not hold"),
        (NAN, -INF, 4.0, "does not hold"),
        (1e9, 4.0, INF, "holds"),
        (3.9, 4.0, INF, "does not hold"),
        (0.0, 0.0, 0.0, "holds"),
        (1e-300, 0.0, 0.0, "does not hold"),
    ],
)
def test_a_value_holds_within_its_tolerance_ends_included(ours, low, high, verdict):
    assert claim(ours, low, high).verdict == verdict
    assert claim(ours, low, high, share=Share(0, 200)).verdict == verdict  # the share only informs


@pytest.mark.parametrize("share", [Share(200, 200), Share(100, 200), Share(0, 200), Share(0, 0)])
def test_a_ranking_is_decided_by_the_draws_whatever_the_run_without_draws_says(share):
    assert {claim(ours, share=share).verdict for ours in (-9.0, 0.0, 9.0, NAN)} == {verdict_of(share)}


def test_a_claim_with_neither_tolerance_nor_draws_has_no_verdict():
    with pytest.raises(ValueError, match="'text' needs a tolerance or draws"):
        _ = claim(1.0).verdict


def test_the_rule_says_what_the_verdict_needs():
    assert claim(0.0, -INF, 4.0).rule == "at most 4 s"
    assert claim(0.0, 1e-3, INF, unit="1/s").rule == "at least 0.001 1/s"
    assert claim(0.0, -2.51381, -0.5138, unit="%").rule == "-2.514 to -0.5138 %"
    assert claim(0.0, 0.25, 0.75, unit="1").rule == "0.25 to 0.75"
    assert claim(0.0, share=Share(1, 2)).rule == "more than half of the draws"


def test_a_margin_is_the_excess_in_percent():
    assert margin(3.0, 2.0) == 50.0
    assert margin(1.0, 2.0) == -50.0
    assert margin(2.0, 2.0) == 0.0


@given(st.floats(-100, 100))
def test_a_margin_is_reproduced_within_half_of_itself_but_at_least_one_percentage_point(value):
    width = max(1.0, abs(value) / 2)
    assert tolerance(value) == pytest.approx((value - width, value + width))
