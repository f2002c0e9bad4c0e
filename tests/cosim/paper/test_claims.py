"""How claims are judged: Wilson's interval, rankings over draws, tolerances; the printed numbers agree with themselves."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, norm

from cosim.paper import printed
from cosim.paper.claims import VARIANTS_OF_LAW, Claim, Judge, Share, Theory, margin, share_of_wins, tolerance
from cosim.paper.gains import K_LIN, GainReading, NormReading, gain_readings, norm_readings
from cosim.paper.study import COMPARED, GAINS, REFERENCE, Key
from cosim.scenario import load_scenario

NAN, INF = math.nan, math.inf
VERDICTS = {"holds", "does not hold", "undecided"}
LESS_ENERGY = "“less control energy” than LC (section V; Table I says more)"


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
    assert Share(draws - wins, draws).verdict == other[Share(wins, draws).verdict]


def test_four_draws_of_one_kind_decide_and_three_do_not():
    """All wins: the interval begins at n/(n + z²), above a half for n > z² = 3.84."""
    assert Share(4, 4).interval == pytest.approx((4 / (4 + norm.ppf(0.975) ** 2), 1.0))
    assert [Share(n, n).verdict for n in (1, 3, 4, 200)] == ["undecided", "undecided", "holds", "holds"]
    assert [Share(0, n).verdict for n in (1, 3, 4, 200)] == ["undecided"] * 2 + ["does not hold"] * 2


@pytest.mark.parametrize("n", [2, 10, 200, 10_000])
def test_half_of_the_draws_decide_nothing(n):
    assert Share(n // 2, n).verdict == "undecided"


@given(tallies())
def test_a_verdict_is_the_score_test_against_one_half(tally):
    """Wilson's interval excludes 1/2 where |2w - n| > z sqrt(n): of 200 draws 114 decide, 113 do not."""
    wins, draws = tally
    distance = abs(2 * wins - draws) - float(norm.ppf(0.975)) * math.sqrt(draws)
    assert (Share(wins, draws).verdict == "undecided") == (distance <= 0.0)
    assert [Share(wins, 200).verdict for wins in (86, 87, 113, 114)] == ["does not hold", *["undecided"] * 2, "holds"]


def test_without_draws_a_share_is_open():
    share = Share(0, 0)
    assert (share.interval, share.verdict) == ((0.0, 1.0), "undecided")
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
    by_wins = [Share(k, 200).verdict for k in range(201)]
    equals = Counter(by_wins[k] for k in rng.binomial(200, 0.5, 20_000))
    assert equals["undecided"] / 20_000 == pytest.approx(0.95, abs=0.01)
    assert {by_wins[k] for k in rng.binomial(200, 0.75, 200)} == {"holds"}


# Rankings


def cell(**pairs):
    """Return (found, keys) of draws 1, 2, ... from pairs (numbers of A, numbers of B)."""
    found = {}
    for draw, (a, b) in enumerate(pairs.values(), start=1):
        for variant, numbers in (("A", a), ("B", b)):
            found[Key("swing-up", "ident", 1e-4, 0, variant, draw)] = numbers
    return found


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
    found = cell(only=(a, b))
    assert share_of_wins(found, list(found), "A", "B", "cost") == Share(wins, draws)


def test_draws_are_counted_over_all_keys_of_the_cell_and_only_those():
    found = cell(
        first=(kept(1.0), kept(2.0)),
        second=(kept(3.0), kept(2.0)),
        third=(kept(1.0), lost(0.0)),
        fourth=(kept(5.0), kept(5.0)),
        fifth=(lost(0.0), lost(0.0)),
        sixth=(kept(1.0), kept(4.0)),
    )
    keys = list(found)
    assert share_of_wins(found, keys, "A", "B", "cost") == Share(3, 4)
    assert share_of_wins(found, [key for key in keys if key.draw < 3], "A", "B", "cost") == Share(1, 2)
    assert share_of_wins(found, [], "A", "B", "cost") == Share(0, 0)


@given(st.lists(st.tuples(*[st.sampled_from([{}, kept(1.0), kept(2.0), kept(NAN), lost(0.0)])] * 2), max_size=20))
def test_what_one_loses_the_other_wins(pairs):
    found = cell(**{f"draw {i}": pair for i, pair in enumerate(pairs)})
    one, two = share_of_wins(found, found, "A", "B", "cost"), share_of_wins(found, found, "B", "A", "cost")
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
    assert {claim(ours, share=share).verdict for ours in (-9.0, 0.0, 9.0, NAN)} == {share.verdict}


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


# The printed numbers (typed here from the paper once more)


def test_the_printed_tables_are_the_papers():
    assert {gain: (row["IHC"], row["LC"], row["SMC"]) for gain, row in printed.LMSE.items()} == {
        0: (11.06, 11.23, 11.43),
        1: (11.08, 11.26, 11.47),
        60: (11.14, 11.83, 11.85),
        200: (11.47, 12.14, 12.13),
    }
    assert printed.ENERGY_OVER == {"LC": 0.0148, "SMC": -0.179}
    assert (printed.MU, printed.ALPHA, printed.A_MIN, printed.B_MAX, printed.J_MAX) == (1.0, 1e-3, 0.88, 1.0, 3)
    assert printed.K.tolist() == [-113.4482, -108.1254, -13.7505, -0.2833]
    assert printed.P[0].tolist() == [0.1304, 0.0053, 0.0213, 0.0844]
    assert printed.P.diagonal().tolist() == [0.1304, 0.1729, 0.3037, 0.3930]
    np.testing.assert_array_equal(printed.P, printed.P.T)
    assert np.linalg.eigvalsh(printed.P).min() > 0.0


def test_the_papers_text_states_the_margins_of_its_table():
    """1.5 % less than LC and 3.23 % less than SMC: the second is cut off, not rounded."""
    lmse = printed.LMSE[0]
    assert margin(lmse["IHC"], lmse["LC"]) == pytest.approx(-1.5, abs=0.05)
    assert math.trunc(100 * margin(lmse["IHC"], lmse["SMC"])) / 100 == -3.23


def test_the_built_in_scenario_is_the_papers():
    scenario, _ = load_scenario("paper")
    assert [sine.model_dump(exclude_defaults=True) for sine in scenario.disturbance.sines] == list(printed.SINES)
    assert (scenario.disturbance.start, scenario.disturbance.gain) == (printed.SWITCH_TIME, 0.0)
    assert (scenario.run.step, scenario.run.duration) == (printed.SAMPLE_TIME, 10.0)
    assert scenario.plant.start["delta_0"] == math.pi


# All claims


def test_numbers_that_are_the_printed_ones_confirm_everything_but_the_papers_contradiction(as_printed):
    """Section V says “less control energy” than LC, the text below Table I says 1.48 % more."""
    claims = Judge(as_printed()).claims()
    assert {c.text for c in claims if c.verdict != "holds"} == {LESS_ENERGY}
    assert [c.verdict for c in claims if c.text == LESS_ENERGY] == ["does not hold"]
    for c in claims:
        if not math.isnan(c.printed) and "within" not in c.text:
            assert c.ours == pytest.approx(c.printed, rel=1e-9, abs=1e-9), c.text


def test_every_claim_can_hold_and_can_fail(as_printed):
    """Three times or a third of all numbers of its first run, in the run without draws and in the draws."""
    base = as_printed()
    for index, c in enumerate(Judge(base).claims()):
        first = c.runs[0]
        verdicts = {c.verdict}
        for factor in (3.0, 1.0 / 3.0):
            found = {
                key: {name: value if name == "kept" else factor * value for name, value in numbers.items()}
                if key.variant == first.variant and key.gain == first.gain
                else numbers
                for key, numbers in base.items()
            }
            changed = Judge(found).claims()[index]
            assert (changed.section, changed.text) == (c.section, c.text)
            verdicts.add(changed.verdict)
        assert {"holds", "does not hold"} <= verdicts, c.text


def test_a_claim_about_values_follows_the_run_without_draws_and_a_ranking_the_draws(as_printed):
    """Doubling the IHC's LMSE in one of the two leaves the other kind of claim as it was."""

    def verdicts(experiment):
        found = {
            key: {**n, "integral_q2": 2 * n["integral_q2"]} if key[0] == experiment and key.variant == "IHC" else n
            for key, n in as_printed().items()
        }
        return {c.text: c.verdict for c in Judge(found).claims() if c.section == "Table I"}

    assert verdicts("reference")["LMSE of IHC relative to LC"] == "does not hold"
    assert verdicts("reference")["LMSE of IHC below LC"] == "holds"
    assert verdicts("swing-up")["LMSE of IHC relative to LC"] == "holds"
    assert verdicts("swing-up")["LMSE of IHC below LC"] == "does not hold"


def test_a_controller_that_loses_every_draw_loses_its_rankings(as_printed):
    found = {k: {**n, "kept": float(k.variant != "IHC" or k.draw == 0)} for k, n in as_printed().items()}
    rankings = [c for c in Judge(found).claims() if math.isnan(c.low) and "IHC" in c.text]
    assert {c.verdict for c in rankings} == {"does not hold"}


def test_without_draws_rankings_are_undecided_and_values_judged(as_printed):
    claims = Judge({key: numbers for key, numbers in as_printed().items() if key.draw == 0}).claims()
    assert {c.verdict for c in claims if math.isnan(c.low)} == {"undecided"}
    assert {c.verdict for c in claims if not math.isnan(c.low)} == {"holds"}


def test_other_conditions_draws_decide_nothing(as_printed):
    """Only draws from hanging down, in the reference's set and at its sample time, count for the paper's tables."""
    found = as_printed()
    for key in list(found):
        if key.experiment != "reference":
            elsewhere = key._replace(step=2e-3) if key.experiment == "swing-up" else key
            found[elsewhere] = found.pop(key)
    assert {c.verdict for c in Judge(found).claims() if math.isnan(c.low)} == {"undecided"}


def test_claims_are_complete(as_printed):
    found = as_printed()
    claims = Judge(found).claims()
    assert {c.verdict for c in claims} <= VERDICTS
    names = [(c.section, c.text) for c in claims]
    assert len(set(names)) == len(names)
    assert {c.section for c in claims} == {
        "Table I",
        *(f"Table II, G = {gain}" for gain in (1, 60, 200)),
        "Energy",
        "Figures 3 and 4",
        "Table II, growth",
    }
    for c in claims:
        assert c.runs
        assert all(key in found and key.draw == 0 and key[1:3] == REFERENCE for key in c.runs)
        assert math.isnan(c.low) == math.isnan(c.high)
        assert math.isnan(c.low) or c.low <= c.high
    printed_values = [c for c in claims if c.text in {f"LMSE of {variant}" for variant in COMPARED}]
    assert len(printed_values) == len(GAINS) * len(COMPARED)
    assert [variant for variants in VARIANTS_OF_LAW.values() for variant in variants] == list(COMPARED)
    assert {"LMSE of IHC relative to LC", "LMSE of IHC below LC"} <= {c.text for c in claims if c.main}


# Claims without draws


def theory(design, **changes):
    numbers = {"largest_alpha": 0.27, "same_as_linear": 0.0, "listed_off": 0.0, "listed_pole": -1.0}
    return Theory(**{"gains": gain_readings(), "norms": norm_readings(design.P), **numbers, **changes})


def verdicts(theory):
    return {c.text.partition(":")[0]: c.verdict for c in theory.claims()}


MODEL, LISTED = "the listed parameters give the printed A, b", "the LC stabilizes the listed parameters"
SUM, GAIN = "the printed k is k_lin + row, eq. (10)", "some reading of the printed k stabilizes A, b"
SOLVES, ALPHA = "some reading of the printed P solves eq. (11)", "eq. (11) has a solution at the printed α"
SAME = "a_min = b_max = 1 is the LC"


def test_the_printed_k_and_P_do_nothing_they_should_and_the_rest_can_hold(design):
    found = verdicts(theory(design))
    held, failed = (MODEL, LISTED, ALPHA, SAME), (SUM, GAIN, SOLVES)
    assert found == dict.fromkeys(held, "holds") | dict.fromkeys(failed, "does not hold")


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        (MODEL, "listed_off", 0.0011),
        (LISTED, "listed_pole", 0.1),
        (ALPHA, "largest_alpha", 0.9e-3),
        (SAME, "same_as_linear", 1e-12),
    ],
)
def test_claims_about_model_and_design_can_fail(design, text, name, value):
    before, after = (verdicts(theory(design, **changes)) for changes in ({}, {name: value}))
    assert {changed for changed in after if after[changed] != before[changed]} == {text}
    assert after[text] == "does not hold"


def test_a_stabilizing_reading_of_the_printed_k_would_make_its_claim_hold(design):
    gains = gain_readings()
    gains[2] = GainReading(gains[2].name, K_LIN, np.array([-1.0, -2.0]), {})
    assert verdicts(theory(design, gains=gains))[GAIN] == "holds"


def test_a_printed_P_that_solves_would_make_its_claim_hold_and_the_solved_one_does_not_count(design):
    norms = norm_readings(design.P)
    assert norms[-1].solves
    one = norms[1]
    norms[1] = NormReading(one.name, one.P, 0.2, 0.3, {})
    assert verdicts(theory(design, norms=norms))[SOLVES] == "holds"


def test_the_largest_difference_between_the_printed_k_and_eq_10_is_that_of_its_first_entry(design):
    (found,) = (c for c in theory(design).claims() if c.text.startswith(SUM))
    assert found.ours == pytest.approx(2.0 + 113.4482, abs=1e-9)  # row has no first entry
