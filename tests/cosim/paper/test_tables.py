"""The study's tables are written and read back, and their numbers are those of the runs."""

import math
from typing import Any

import numpy as np
import pytest

from cosim.paper import printed
from cosim.paper.claims import Judge, Theory
from cosim.paper.figures import sweep_median, swing_up_pairs
from cosim.paper.gains import gain_readings, norm_readings
from cosim.paper.readings import Reading
from cosim.paper.study import COMPARED, GAINS, REFERENCE, Key
from cosim.paper.tables import (
    beyond_table,
    chattering_table,
    claims_table,
    draws_table,
    energy_table,
    gains_tables,
    lmse_table,
    onset_table,
    ranking_cells,
    ranking_names,
    readings_table,
    shares_table,
    swing_ups_table,
)
from cosim.paper.variants import sweep_name
from cosim.paper.verdicts import margin, share_of_wins, verdict_of
from cosim.studies.estimates import Share
from tests.cosim.paper.test_table import cells_of, saved

NAN = math.nan


def rows_of(table) -> list[dict[str, Any]]:
    """Return the table's rows as dictionaries by the columns' names."""
    names = [column.name for column in table.columns]
    assert len(set(names)) == len(names)
    return [dict(zip(names, row, strict=True)) for row in table.rows]


# All tables, from numbers that are the printed ones


@pytest.fixture
def judge(as_printed):
    return Judge(as_printed())


def theory(design):
    return Theory(gain_readings(), norm_readings(design.P), 0.27, 0.0, 0.0, -1.0)


@pytest.fixture
def every_table(judge, study, design):
    runs, without_draws = judge.runs, theory(design)
    ran = {
        r.name: {"kept": 1.0, "steady_rms": 0.01, "energy": 2.0} for r in (*without_draws.gains, *without_draws.norms)
    }
    return [
        claims_table(judge.claims()),
        lmse_table(judge, GAINS[:1], "table_1", "I"),
        lmse_table(judge, GAINS[1:], "table_2", "II"),
        energy_table(judge),
        beyond_table(judge),
        shares_table(runs),
        readings_table([Reading("∫|q|² dt", "rad² s", dict.fromkeys(COMPARED, 11.0))]),
        onset_table(runs, judge),
        swing_ups_table(runs),
        chattering_table(runs, study),
        *gains_tables(without_draws, ran),
        draws_table(runs),
    ]


def test_every_table_is_written_and_read_back(every_table, tmp_path):
    assert len({table.name for table in every_table}) == len(every_table)
    for table in every_table:
        (head, *rows), markdown = saved(table, tmp_path)
        assert head == [column.name for column in table.columns]
        assert len(rows) == len(table.rows) > 0
        for row, cells in zip(rows, table.rows, strict=True):
            for text, cell in zip(row, cells, strict=True):
                if isinstance(cell, bool) or not isinstance(cell, (int, float)):
                    assert text == ("" if cell is None else str(cell))
                else:
                    np.testing.assert_equal(float(text), float(cell))
        lines = [line for line in markdown.splitlines() if line.startswith("|")]
        assert {len(cells_of(line)) for line in lines} == {len(table.columns)}
        assert [cells_of(line) for line in lines[2:]] == table.shown()


def test_the_table_of_claims_is_the_claims(judge):
    claims = judge.claims()
    table = claims_table(claims)
    for row, c in zip(rows_of(table), claims, strict=True):
        assert (row["section"], row["claim"], row["rule"], row["verdict"]) == (c.section, c.text, c.rule, c.verdict)
        assert row["draws"] == (None if c.share is None else str(c.share))
        np.testing.assert_equal([row["printed"], row["ours"]], [c.printed, c.ours])


@pytest.mark.parametrize("gains", [GAINS[:1], GAINS[1:]])
def test_the_tables_of_lmse_give_the_printed_numbers_back(judge, gains):
    rows = rows_of(lmse_table(judge, gains, "table", "title"))
    assert [(row["gain"], row["controller"]) for row in rows] == [(gain, v) for gain in gains for v in COMPARED]
    for row in rows:
        said = printed.LMSE[row["gain"]][row["controller"].rstrip("12")]
        over = margin(said, printed.LMSE[row["gain"]]["LC"])
        assert row["printed"] == row["ours"] == row["median"] == said
        assert row["printed_over_lc"] == row["ours_over_lc"] == row["median_over_lc"] == over
        assert row["kept"] == row["draws"] == 8


def test_medians_are_over_the_draws_that_stayed_upright(as_printed):
    """Of the IHC's eight draws: 1 to 8 rad² s, the last three lost; the LC lost the first two."""
    runs = as_printed()
    for key, numbers in runs.items():
        if key.experiment == "swing-up" and key.gain == 0:
            if key.variant == "IHC":
                numbers |= {"integral_q2": float(key.draw), "kept": float(key.draw <= 5)}
            if key.variant == "LC":
                numbers |= {"integral_q2": 10.0, "kept": float(key.draw >= 3)}
    rows = {row["controller"]: row for row in rows_of(lmse_table(Judge(runs), (0,), "table", "title"))}
    assert (rows["IHC"]["median"], rows["IHC"]["kept"], rows["IHC"]["draws"]) == (3.0, 5, 8)
    assert rows["IHC"]["median_over_lc"] == pytest.approx(-60.0)  # of 3, 4, 5 over 10
    assert (rows["LC"]["kept"], rows["LC"]["median_over_lc"]) == (6, 0.0)


def test_without_draws_medians_are_dashes(as_printed):
    runs = {key: numbers for key, numbers in as_printed().items() if key.draw == 0}
    for row in lmse_table(Judge(runs), (0,), "table", "title").shown():
        assert row[-4:] == ["–", "–", "0", "0"]


def test_energy_is_compared_with_the_printed_percentages(judge):
    rows = rows_of(energy_table(judge))
    assert len(rows) == len(GAINS) * len(COMPARED)
    for row in rows:
        if row["gain"] or row["controller"] == "IHC":
            assert row["printed_ihc_over"] is None
            assert row["ours_ihc_over"] == pytest.approx(0.0)
        else:
            assert row["printed_ihc_over"] == {"LC": 1.48, "SMC1": -17.9, "SMC2": -17.9}[row["controller"]]
            assert row["ours_ihc_over"] == pytest.approx(row["printed_ihc_over"])
        assert row["ours_ihc_over_after_capture"] == pytest.approx(row["ours_ihc_over"])
        assert row["energy"] == pytest.approx(10 * row["energy_after_capture"])


@pytest.fixture
def mixed(as_printed):
    """Numbers with random rankings, losses and NaN."""
    rng = np.random.default_rng(4)
    runs = as_printed()
    for numbers in runs.values():
        for name in ("integral_q2", "steady_rms"):
            numbers[name] = NAN if rng.random() < 0.05 else float(rng.integers(1, 6))
        numbers["kept"] = float(rng.random() < 0.85)
    return runs


def test_the_table_of_shares_is_what_comparing_gives(mixed):
    rows = rows_of(shares_table(mixed))
    cells = ranking_cells(mixed)
    assert {key.experiment for keys in cells.values() for key in keys} == {"swing-up", "shipped", "tilt", "onset"}
    assert len(rows) == len(cells) * 3 * 2
    measures = {"LMSE": "integral_q2", "steady RMS": "steady_rms"}
    for row in rows:
        cell = (row["experiment"], row["parameters"], row["step_ms"] / 1e3, row["gain"])
        keys = [key for key in mixed if key[:4] == cell]
        assert keys == cells[cell]
        share = share_of_wins(mixed, keys, "IHC", row["against"], measures[row["measure"]])
        assert (row["wins"], row["draws"], row["verdict"]) == (share.wins, share.draws, verdict_of(share))
        assert [row["share"], row["low"], row["high"]] == [100 * share.value, *(100 * end for end in share.interval)]
        for column, variant in (("kept_ihc", "IHC"), ("kept_other", row["against"])):
            assert row[column] == sum(mixed[key]["kept"] for key in keys if key.variant == variant)
    assert len({row["verdict"] for row in rows}) > 1


def test_the_figure_of_shares_shows_the_lmse_against_the_lc(mixed):
    rows = [row for row in rows_of(shares_table(mixed)) if (row["against"], row["measure"]) == ("LC", "LMSE")]
    names = ranking_names(mixed)
    assert [share for _, share in names] == [Share(row["wins"], row["draws"]) for row in rows]
    assert len({name for name, _ in names}) == len(names)
    assert "swing-up, ident, 0.1 ms, G = 60" in dict(names)


def test_a_cell_in_which_all_is_lost_is_no_draw(mixed):
    keys = [key for key in mixed if key.experiment == "tilt" and key.parameters == "listed"]
    for key in keys:
        mixed[key] = {}  # an FMU ended these runs
    rows = [r for r in rows_of(shares_table(mixed)) if (r["experiment"], r["parameters"]) == ("tilt", "listed")]
    assert {(row["draws"], row["verdict"], row["kept_ihc"]) for row in rows} == {(0, "no draw", 0)}
    assert {math.isnan(row["share"]) for row in rows} == {True}


def test_onset_medians_are_of_its_draws(as_printed):
    runs = as_printed()
    for key, numbers in runs.items():
        if key.experiment == "onset":
            numbers |= {"integral_q2": key.gain + key.draw, "kept": float(key.draw != 8)}
    rows = rows_of(onset_table(runs, Judge(runs)))
    assert [(row["gain"], row["controller"]) for row in rows] == [(gain, v) for gain in (60, 200) for v in COMPARED]
    for row in rows:
        assert row["from_start"] == row["gain"] + 4.0
        assert row["from_capture"] == row["printed"]
        assert (row["kept"], row["draws"]) == (7, 8)


def swing_up_numbers(runs, draws):
    """Put (LMSE of LC, of IHC, arm's peak, capture time, kept by LC, by IHC) of each draw into `runs`."""
    for draw, (lc, ihc, peak, capture, kept_lc, kept_ihc) in enumerate(draws, start=1):
        for law, lmse, kept in (("LC", lc, kept_lc), ("IHC", ihc, kept_ihc)):
            key = Key("swing-ups", "ident", 1e-3, 0, law, draw)
            runs[key] = {"integral_q2": lmse, "arm_peak": peak, "capture_time": capture, "kept": kept}
    return runs


def test_swing_ups_are_grouped_by_the_printed_lmse_capture_and_swing_of_the_arm():
    draws = [
        (11.0, 10.89, 1.4, 1.5, 1, 1),  # near the printed LMSE, early, wide swing: -1 %
        (11.0, 11.11, 0.5, 2.5, 1, 1),  # near, late: +1 %
        (5.0, 4.5, 2.0, 1.0, 1, 1),  # far: -10 %
        (5.0, 5.5, 0.1, 1.0, 1, 1),  # far: +10 %
        (11.0, 1.0, 3.0, 1.5, 0, 1),  # lost
        (11.0, 1.0, 3.0, 1.5, 1, 0),
    ]
    runs = swing_up_numbers({}, draws)
    assert [draw for draw, _, _ in swing_up_pairs(runs)] == [1, 2, 3, 4]
    rows = rows_of(swing_ups_table(runs))
    assert [(row["count"], row["wins"]) for row in rows] == [(4, 2), (2, 1), (1, 1), (2, 2)]
    every, _, early, wide = rows
    assert every["median"] == pytest.approx(0.0, abs=1e-12)
    assert [every["low"], every["high"]] == pytest.approx(np.quantile([-10, -1, 1, 10], [0.1, 0.9]))
    assert every["arm_peak"] == pytest.approx((0.5 + 1.4) / 2)
    assert [early["low"], early["median"], early["high"]] == pytest.approx([-1.0] * 3)
    assert wide["share"] == str(Share(2, 2))


def test_no_swing_up_that_both_kept_gives_dashes():
    rows = swing_ups_table(swing_up_numbers({}, [(11.0, 11.0, 1.0, 1.0, 0, 1)])).shown()
    assert {tuple(row[1:3]) for row in rows} == {("0", "0")}
    assert {tuple(row[4:]) for row in rows} == {("–",) * 4}


def test_chattering_is_a_median_over_draws_in_which_a_lost_pendulum_is_infinite(study):
    chain, runs = "1.5 V, filter", {}
    rows = {1: (3.0, 1), 2: (1.0, 1), 3: (9.0, 0), 4: (2.0, 1), 5: (8.0, 1)}
    for draw, (value, kept) in rows.items():
        for h in (1e-3, 2e-3):
            key = Key("chattering", "ident", h, 0, sweep_name(chain, 0.8), draw)
            runs[key] = {"integral_q2": value, "kept": kept if h == 1e-3 else 0}
    assert sweep_median(runs, chain, 0.8, 1e-3, "integral_q2") == 3.0  # of 1, 2, 3, 8, infinite
    assert math.isnan(sweep_median(runs, chain, 0.8, 2e-3, "integral_q2"))


def test_chattering_is_tabled_over_that_of_the_lc_for_each_chain_step_and_a_min(judge, study, tiny_size):
    runs = {
        key: {**n, "voltage_variation": 2.0 if key.variant.endswith("a_min 1") else 5.0} if "chatt" in key[0] else n
        for key, n in judge.runs.items()
    }
    rows = rows_of(chattering_table(runs, study))
    assert len(rows) == 3 * len(tiny_size.sample_times) * len(tiny_size.a_mins)
    assert {row["chain"] for row in rows} == {"10 V, filter", "1.5 V, filter", "1.5 V, Kalman filter"}
    assert {row["step_ms"] / 1e3 for row in rows} == set(tiny_size.sample_times)
    assert {(row["a_min"], row["over_lc"]) for row in rows} == {(1.0, 1.0), (0.8, 2.5)}


def test_the_tables_of_k_and_P_leave_out_numbers_of_a_lost_pendulum(design):
    without_draws = theory(design)
    ran = {
        r.name: {"kept": float(i > 3), "steady_rms": 0.01, "energy": 2.0}
        for readings in (without_draws.gains, without_draws.norms)
        for i, r in enumerate(readings)
    }
    for table, readings in zip(
        gains_tables(without_draws, ran), (without_draws.gains, without_draws.norms), strict=True
    ):
        rows = rows_of(table)
        assert [row["reading"] for row in rows] == [reading.name for reading in readings]
        assert [row["kept"] for row in rows] == [i > 3 for i in range(len(rows))]
        assert [(row["steady_rms"], row["energy"]) for row in rows[:4]] == [(None, None)] * 4
        assert (rows[4]["steady_rms"], rows[4]["energy"]) == (0.01, 2.0)
    k_table, p_table = gains_tables(without_draws, ran)
    assert [row["stable"] for row in rows_of(k_table)] == [False] * 4 + [True] * 2
    assert [row["solves"] for row in rows_of(p_table)] == [False] * 4 + [True]
    assert rows_of(k_table)[4]["K"] == "[2, -30, 2, -2.6]"


def test_readings_are_tabled_over_the_printed_lc_and_over_the_lc():
    reading = Reading("name", "unit", {"LC": 2 * 11.23, "IHC": 11.23, "SMC1": 1.0, "SMC2": 2.0})
    (row,) = rows_of(readings_table([reading]))
    assert (row["ratio"], row["ihc_over_lc"]) == (2.0, -50.0)
    assert [row[v.lower()] for v in COMPARED] == [reading.values[v] for v in COMPARED]


def test_the_table_of_runs_has_every_number_under_its_key(mixed):
    lost = Key("tilt", "listed", 1e-3, 0, "LC", 1)
    mixed[lost] = {}
    table = draws_table(mixed)
    assert len(table.rows) == len(mixed)
    for row in rows_of(table):
        key = Key(*(row[name] for name in Key._fields))
        for name in ("integral_q2", "steady_rms", "kept"):
            np.testing.assert_equal(row[name], mixed[key].get(name, NAN))
    assert Key("reference", *REFERENCE, 0, "LC", 0) in mixed


def test_controllers_beyond_the_paper_are_tabled_for_each_gain(judge, study):
    rows = rows_of(beyond_table(judge))
    assert [(row["gain"], row["controller"]) for row in rows] == [(gain, v) for gain in GAINS for v in study.variants]
    for row in rows:
        for name in ("integral_q2", "steady_rms", "settling_wide", "settling_time", "energy", "voltage_variation"):
            assert row[name] == judge.value(row["controller"], name, row["gain"])
