"""Sweeps: the same draws for all laws, what the numbers say in closed form, what is written and runs alone, any system."""

import csv
import json
import math
import re

import numpy as np
import pyarrow.parquet
import pytest

import cosim
import ihc_fmu
from cosim.errors import UserError
from cosim.plots import COLOURS
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from cosim.studies.estimates import change
from cosim.studies.journal import Journal
from cosim.studies.numbers import PURPOSE, numbers
from cosim.studies.sweep import Sweep, run_sweep, sweep
from cosim.studies.sweep_files import save, table
from cosim.studies.sweep_pictures import scatter
from cosim.studies.sweep_plan import OWN, plan_sweep
from cosim.studies.sweep_tables import remarks, summary, tables
from tests.cosim.command import journal_rows

VARIED = {"plant.m_p": "normal(0.024,5%)", "controller.a_min": [0.3, 0.6, 1.0]}


@pytest.fixture(scope="module")
def plan(fmus):
    """Make the plan of a sweep of the tilt scenario, short."""

    def make(vary=None, changes=None, **options):
        scenario, folder = load_scenario("tilt")
        scenario = scenario.changed({"run.duration": 0.5, **(changes or {})})
        return plan_sweep(scenario, vary or VARIED, fmus, folder, **{"laws": ["LC", "IHC"], "draws": 4, **options})

    return make


@pytest.fixture(scope="module")
def swept(plan, tmp_path_factory):
    with Journal(tmp_path_factory.mktemp("sweep") / "runs", PURPOSE) as journal:
        return run_sweep(plan(), journal, 1)


def by_hand(plan, **columns):
    """Return a sweep with numbers by law and name; kept, steady and the duration are what they are in a good run."""
    good = {"kept": 1.0, "steady": 1.0, "duration": 10.0, **dict.fromkeys(plan.quantities, 1.0)}
    full = {
        law: {name: np.broadcast_to(np.asarray(value, float), plan.count) for name, value in {**good, **of}.items()}
        for law, of in columns.items()
    }
    return Sweep(plan, full)


# What is drawn


def test_all_laws_see_the_same_draws_and_more_draws_continue_them(plan):
    few, many = plan(draws=3), plan(draws=16)
    for draw in (1, 2, 3):
        lc, ihc = (few.changes(draw, law) for law in ("LC", "IHC"))
        assert {name for name in lc if lc[name] != ihc[name]} == {"controller.start.law"}
        assert many.changes(draw, "LC") == lc
        assert lc["plant.start.noise_seed"] == draw
        assert 0.0 <= lc["plant.start.theta_encoder_offset"] < 1.0
        assert lc["controller.start.a_min"] in VARIED["controller.a_min"]
    assert few.scenario.run.seed is None


def test_what_the_scenario_fixes_and_what_is_varied_is_not_left_to_chance(plan):
    fixed = plan(
        {"plant.delta_encoder_offset": "0..1"}, {"plant.start.theta_encoder_offset": 0.5, "plant.start.noise_seed": 3}
    )
    assert list(fixed.drawn) == ["plant.start.delta_encoder_offset"]
    assert not fixed.seeded
    seeds = plan({"run.seed": [1, 2]})
    assert [seeds.changes(draw, "LC")["run.seed"] for draw in (1, 5)] == [1, 2]
    assert list(seeds.drawn) == ["run.seed"]


def test_lists_alone_make_a_grid_with_the_same_offsets_at_each_point(plan):
    found = plan({"controller.a_min": [0.3, 1.0], "plant.measurement": ["encoders", "ideal"]}, draws=2)
    assert (found.sampling, found.count) == ("grid", 8)
    assert (
        found.values("plant.measurement").tolist()
        == ["encoders"] * 2 + ["ideal"] * 2 + ["encoders"] * 2 + ["ideal"] * 2
    )
    offsets = found.drawn["plant.start.delta_encoder_offset"]
    assert (offsets.reshape(4, 2) == offsets[:2]).all()
    assert plan({"controller.a_min": [0.3, 1.0]}, draws=None).count == 2


@pytest.mark.parametrize(
    ("vary", "options", "sentence"),
    [
        ({}, {}, None),
        ({"plant.m_p": "±5%", "plant.start.m_p": "±5%"}, {}, "--vary names plant.start.m_p twice"),
        ({"plant.m_p": "±5%"}, {"sampling": "grid"}, "a grid takes lists of values only, and plant.m_p is drawn"),
        (
            {"plant.m_p": "±5%"},
            {"laws": ["LC", "XX"]},
            "--laws must be different ones of LC, SMC, IHC, STA, found LC, XX",
        ),
        ({"plant.m_p": "±5%"}, {"laws": []}, "--laws must be different ones of LC, SMC, IHC, STA, found none"),
        ({"plant.m_p": "±5%"}, {"draws": 0}, "--draws must be a whole number from 1 on, found 0"),
        ({"plant.m_p": "±5%"}, {"draws": 10**13}, "a sweep of 10000000000000 draws needs"),
        (
            {"plant.m_p": "normal(0.024,90%)"},
            {"draws": 256},
            "--vary plant.m_p draws a value that cannot be: m_p must lie in",
        ),
    ],
    ids=str,
)
def test_a_plan_that_cannot_be_is_refused_in_a_sentence(plan, fmus, vary, options, sentence):
    if not vary:
        with pytest.raises(UserError, match="a sweep needs something to vary"):
            plan_sweep(load_scenario("tilt")[0], {}, fmus)
        return
    with pytest.raises(UserError, match=f"^{re.escape(sentence)}"):
        plan(vary, **options)


# What runs


def test_a_draw_run_alone_gives_the_same_numbers_to_the_last_bit(swept):
    for law in ("LC", "IHC"):
        alone = numbers(run_scenario(swept.scenario(law, 3), swept.plan.fmus))
        assert {name: alone[name] for name in alone} == pytest.approx(
            {name: swept.column(law, name)[2] for name in alone}, rel=0.0, abs=0.0, nan_ok=True
        )


def test_an_interrupted_sweep_continues_and_a_changed_scenario_takes_nothing_of_it(plan, tmp_path):
    file, seen = tmp_path / "runs", []

    def interrupt(done, _total):
        if done == 5:
            raise KeyboardInterrupt

    with Journal(file, PURPOSE) as journal:
        with pytest.raises(KeyboardInterrupt):
            run_sweep(plan(), journal, 1, interrupt)
        run_sweep(plan(draws=6), journal, 1, lambda *counts: seen.append(counts))
        assert 5 <= seen[0][0] <= 8  # what was under way is kept too
        assert seen[-1] == (12, 12)
        assert len(journal_rows(file)) == 12
        run_sweep(plan(changes={"plant.start.delta_0": 0.11}), journal, 1)
        assert len(journal_rows(file)) == 12 + 8


def test_a_run_that_an_fmu_ends_counts_as_lost(plan, tmp_path):
    failing = plan({"controller.sample_time": [0.001, 0.0015]})
    with Journal(tmp_path / "runs", PURPOSE) as journal:
        found = run_sweep(failing, journal, 1)
    assert found.failed("LC").tolist() == [False] * 4 + [True] * 4
    assert not found.kept("IHC")[4:].any()
    assert "of these ended by an error of an FMU: LC 4, IHC 4 of 8" in remarks(found)


# What the numbers say


def test_means_changes_and_shares_in_closed_form(plan):
    lost = by_hand(
        plan(),
        LC={"integral_q2": [1.0, 2.0, 3.0, 9.0], "kept": [1, 1, 1, 0], "settling_time": [1.0, math.nan, 3.0, 1.0]},
        IHC={"integral_q2": [2.0, 1.0, 3.0, 4.0], "settling_time": [1.0, math.nan, 2.0, 5.0]},
    )
    assert lost.value("LC", "integral_q2").value == 2.0
    assert lost.value("IHC", "integral_q2").value == 2.5
    assert lost.quantiles("LC", "integral_q2")[1] == 2.0
    assert lost.change("IHC", "integral_q2") == change(np.array([2.0, 1.0, 3.0]), np.array([1.0, 2.0, 3.0]))
    better = lost.better("IHC", "integral_q2")
    assert (better.wins, better.draws, lost.equal("IHC", "integral_q2")) == (2, 4, 1)
    assert lost.value("LC", "settling_time").value == pytest.approx((1.0 + 10.0 + 3.0) / 3.0)
    assert (lost.better("IHC", "settling_time").wins, lost.equal("IHC", "settling_time")) == (2, 2)
    assert lost.worst("LC", "integral_q2", 2) == [4, 3]
    assert lost.worst("IHC", "settling_time", 2) == [2, 4]


def test_lost_draws_are_told_and_not_hidden(plan):
    found = by_hand(plan(), LC={"kept": [1, 0, 0, 1]}, IHC={"settling_time": [math.nan, 1, 1, 1], "steady": 0.0})
    (_, _, means), *_ = tables(found)
    assert means[-1] == ["kept upright", "2 of 4", "4 of 4"]
    said = remarks(found)
    assert said[0].startswith("pendulum lost: LC 2, IHC 0 of 4; not in the means")
    assert "settling never, in the means counted as 10 s: LC 0, IHC 1 of 4" not in said  # the run's duration is 0.5 s
    assert any(s.startswith("settling never, in the means counted as 0.5 s: LC 0, IHC 1 of 4") for s in said)
    assert any(s.startswith("* not steady: IHC") for s in said)
    assert any("it takes 64 draws that count and differ" in s for s in said)
    assert summary(found)["laws"]["LC"]["kept"] == 2


def test_where_every_draw_is_lost_a_remark_says_so_and_what_to_look_at_in_place_of_tables_and_pictures(plan, tmp_path):
    found = by_hand(plan(), LC={"kept": 0.0}, IHC={"kept": 0.0})
    ((_, _, rows),) = tables(found)
    assert rows == [["kept upright", "0 of 4", "0 of 4"]]
    first, last = remarks(found)
    assert first == "pendulum lost: LC 4, IHC 4 of 4; none is left to compare"
    assert last.startswith("look at one: `qube-ihc run` runs a worst draw (worst_*.toml) alone")
    assert not [path for path in save(found, tmp_path) if path.suffix == ".png"]


def test_the_scatter_picture_marks_what_has_no_number_apart_and_leaves_it_out_of_the_means(plan):
    settling = [1.0, math.nan, 3.0, 5.0]
    drawn = scatter(by_hand(plan(), LC={"settling_time": settling, "kept": [1, 1, 1, 0]}, IHC={}), "settling_time")
    mass, a_min, *_ = drawn.axes
    assert (mass.get_xlabel(), a_min.get_xlabel()) == ("plant.m_p [kg]", "controller.a_min")
    lines = {
        line.get_marker(): np.asarray(line.get_ydata()) for line in mass.lines if line.get_color() == COLOURS["LC"]
    }
    assert lines["^"].tolist() == [10.0]
    assert sorted(lines["o"][np.isfinite(lines["o"])].tolist()) == [1.0, 3.0]
    assert mass.get_ylim()[1] > 10.0
    legend = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert legend == ["LC", "IHC", "never settles: at its duration", "pendulum lost"]


def test_what_decides_is_found_in_the_draws(plan):
    large = plan(draws=256)
    a = large.values("controller.start.a_min")
    found = by_hand(large, LC={}, IHC={"energy": a, "kept": (large.drawn["plant.start.m_p"] < 0.0245).astype(float)})
    decided = found.sensitivities["IHC"]
    assert decided["energy"].deciding()[0][0] == "controller.a_min"
    assert decided["energy"].single["controller.a_min"].value == pytest.approx(1.0)
    assert decided["kept"].deciding()[0][0] == "plant.m_p"
    assert not found.sensitivities["LC"]
    (_, _, rows) = tables(found)[-1]
    assert ["∫V² dt", "–", "controller.a_min 100 ± 0 %"] in rows


# What is written


def test_files_tables_and_worst_draws_that_run_alone(swept, tmp_path):
    folder = tmp_path / "out"
    paths = save(swept, folder, "energy", 2)
    assert sorted(path.name for path in paths) == sorted(path.name for path in folder.iterdir())
    rows = list(csv.DictReader((folder / "sweep.csv").open()))
    stored = pyarrow.parquet.read_table(folder / "sweep.parquet").to_pylist()
    assert len(rows) == len(stored) == 8
    for row, kept, draw, law in zip(rows, stored, [1, 1, 2, 2, 3, 3, 4, 4], ["LC", "IHC"] * 4, strict=True):
        assert (row["draw"], row["law"]) == (str(draw), law) == (str(kept["draw"]), kept["law"])
        assert float(row["energy"]) == kept["energy"] == swept.column(law, "energy")[draw - 1]
        assert float(row["plant.m_p"]) == kept["plant.m_p"] == swept.plan.drawn["plant.start.m_p"][draw - 1]
    told = json.loads((folder / "sweep.json").read_text())["worst"]
    for law in ("LC", "IHC"):
        column = swept.column(law, "energy")
        assert [one["energy"] for one in told[law]] == sorted(column, reverse=True)[:2]
        for one in told[law]:
            scenario, place = load_scenario(folder / one["file"])
            assert numbers(run_scenario(scenario, swept.plan.fmus, place))["energy"] == one["energy"]


def test_files_of_others_stay(swept, tmp_path):
    (tmp_path / "sweep.parquet").write_bytes(b"PAR1 of somebody else PAR1")
    with pytest.raises(UserError, match="was not written by qube-ihc and stays"):
        save(swept, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.parquet"]


def test_texts_of_lists_stand_in_the_table(plan):
    found = by_hand(plan({"plant.measurement": ["encoders", "ideal"]}, draws=1), LC={}, IHC={})
    assert table(found).column("plant.measurement").to_pylist() == ["encoders"] * 2 + ["ideal"] * 2


# Any system


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    A, B, K = [[0, 1], [4, 0]], [[0], [1]], [[-8, -4]]
    system = ihc_fmu.System(A=A, B=B, K=K, states=("angle [rad]", "rate [rad/s]"), name="arm")
    return cosim.export(ihc_fmu.synthesize(system), folder)


def test_any_system_is_swept_from_python(arm, tmp_path):
    seen = []
    options = {"draws": 8, "laws": ["LC", "IHC"], "workers": 1, "journal": tmp_path / "runs"}
    with pytest.raises(UserError, match="nothing moves in the scenario as it stands"):
        sweep(arm[2], {"plant.angle_0": "0.05..0.2"}, **options)
    options["changes"] = {"plant.start.angle_0": 0.1}
    found = sweep(arm[2], {"plant.angle_0": "0.05..0.2"}, progress=lambda *counts: seen.append(counts), **options)
    assert seen[-1] == (16, 16)
    assert found.better("IHC", "settling_time[plant.angle]").wins == 8
    assert any("nothing besides is left to chance" in remark for remark in remarks(found))
    assert [path.name for path in save(found, tmp_path / "out", worst=0)][-1] == "sweep.json"


def test_a_controller_without_a_choice_of_laws_is_swept_as_it_is(arm, repacked, tmp_path):
    plant, controller, _ = arm
    rename = {"modelDescription.xml": lambda text: text.replace('name="law"', 'name="own_law"')}
    other = repacked(controller, rename)
    (tmp_path / plant.name).write_bytes(plant.read_bytes())
    files = {"plant.fmu": plant.name, "controller.fmu": other.name}
    scenario = cosim.Scenario().changed({**files, "run.duration": 0.5, "plant.start.angle_0": 0.1})
    found = sweep(scenario, {"plant.angle_0": [0.1, 0.2]}, fmus=tmp_path, workers=1)
    assert found.plan.laws == (OWN,)
    assert found.kept(OWN).tolist() == [True, True]
    with pytest.raises(UserError, match="no enumeration `law`"):
        sweep(scenario, {"plant.angle_0": [0.1, 0.2]}, fmus=tmp_path, laws=["LC"])
