"""Tuning by the paper's rule: the walk on outcomes made by hand, the LC as its start, what is written, the command."""

import csv
import dataclasses
import itertools
import math
import re
import shutil
import signal
import statistics
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.errors import UserError
from cosim.judged_signals import kept_upright
from cosim.metrics import evaluate
from cosim.results import Result
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from cosim.studies.draws import drawn
from cosim.studies.estimates import change_text
from cosim.studies.journal import Journal
from cosim.studies.numbers import PURPOSE, numbers
from cosim.studies.tuning import (
    MEASURES,
    Grid,
    Outcome,
    Point,
    Tuning,
    TuningProblem,
    _outcome,
    _walk,
    tune,
)
from cosim.studies.tuning_files import save
from ihc_fmu.design import Design
from tests.cosim.command import ended, finished, journal_rows, started

WRITTEN = ["best.json", "best.toml", "landscape.png", "tuning.csv"]


def step(measure, chattering=1.0, kept=3, a_min=1.0):
    return Outcome(Point(1.0, 1.5, a_min, 1.0), measure, chattering, kept, 3)


def stops_at(steps, most=math.inf):
    """Return the index at which the walk stops."""
    found = _walk(steps, most)
    return next(k for k, outcome in enumerate(steps) if outcome is found)


# The rule, on outcomes made by hand


@pytest.mark.parametrize(
    ("measures", "stop"),
    [
        ([5.0], 0),
        ([5.0, 4.0, 3.0], 2),
        ([5.0, 6.0], 0),
        ([5.0, 6.0, 1.0], 0),
        ([5.0, 4.0, 4.5, 1.0], 1),
        ([5.0, 5.0, 1.0], 0),
        ([5.0, 4.0, 4.0, 1.0], 1),
        ([5.0, math.nextafter(5.0, 0.0)], 1),
        ([5.0, math.inf, 1.0], 0),
        ([math.inf, 5.0, 4.0], 2),
        ([math.inf, math.inf, 4.0], 0),
    ],
)
def test_the_walk_goes_on_as_long_as_the_measure_improves(measures, stop):
    assert stops_at([step(measure) for measure in measures]) == stop


def test_the_walk_stops_before_chattering_exceeds_its_limit():
    steps = [step(5.0, 1.0), step(4.0, 2.0), step(3.0, 2.0 + 1e-9), step(2.0, 1.0)]
    assert [stops_at(steps, most) for most in (math.inf, 3.0, 2.0, 1.9, 1.0, 0.5)] == [3, 3, 1, 0, 0, 0]


def test_the_walk_stops_before_a_draw_is_lost_and_goes_on_where_one_is_won():
    assert stops_at([step(5.0), step(4.0), step(3.0, kept=2), step(2.0)]) == 1
    assert stops_at([step(5.0, kept=2), step(4.0, kept=2), step(3.0, kept=3), step(2.0, kept=2)]) == 2


few = st.sampled_from([1.0, 2.0, 3.0, 4.0, math.inf])
walks = st.lists(st.builds(step, few, few, st.integers(0, 3)), min_size=1, max_size=6)


@given(walks, few)
def test_wherever_the_walk_stops_all_before_improved_and_the_next_does_not(steps, most):
    stop = stops_at(steps, most)
    goes_on = [
        b.measure < a.measure and b.chattering <= most and b.kept >= a.kept for a, b in itertools.pairwise(steps)
    ]
    assert all(goes_on[:stop])
    assert stop == len(goes_on) or not goes_on[stop]


def draw(measure=1.0, chattering=2.0, kept=1.0, steady=1.0):
    named = dict.fromkeys(MEASURES, measure) | {"voltage_variation": chattering}
    return {**named, "kept": kept, "steady": steady, "duration": 10.0}


@pytest.mark.parametrize(
    ("name", "draws", "measure", "kept"),
    [
        ("integral_q2", [draw(3.0), draw(1.0), draw(2.0)], 2.0, 3),
        ("steady_rms", [draw(1.0), draw(7.0)], 5.0, 2),
        ("integral_q2", [draw(1.0), draw(2.0), draw(0.5, kept=0.0)], 1.5, 2),
        ("integral_q2", [draw(1.0), {}], 1.0, 1),
        ("integral_q2", [draw(1.0), {}, {}], math.inf, 1),
        ("integral_q2", [{}, {}], math.inf, 0),
        ("settling_time", [draw(math.nan), draw(2.0), draw(3.0)], 5.0, 3),
        ("settling_time", [draw(math.nan), draw(math.nan)], math.inf, 2),
        ("steady_rms", [draw(1.0), draw(1.0, steady=0.0)], math.inf, 2),
        ("integral_q2", [draw(1.0), draw(1.0, steady=0.0)], 1.0, 2),
    ],
)
def test_an_outcome_is_a_mean_over_the_draws_that_were_kept(tilt, name, draws, measure, kept):
    found = _outcome(Point(1.0, 1.5, 1.0, 1.0), draws, draws, tilt(measure=name))
    assert (found.measure, found.kept, found.draws) == (pytest.approx(measure), kept, len(draws))
    assert math.isnan(found.over_linear.value) or found.over_linear.value == pytest.approx(0.0)


def test_of_equally_good_stops_the_best_is_nearest_to_the_linear_controller():
    outcomes = [step(1.0, a_min=0.5), step(1.0, a_min=0.8), step(2.0, a_min=1.0), step(0.1, a_min=0.2)]
    tuning = Tuning("energy", {o.point: o for o in outcomes}, tuple(o.point for o in outcomes[:3]), outcomes[2], {})
    assert tuning.best is outcomes[1]


# Refusals


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"a_min": ()}, "a_min must be different positive numbers, found "),
        ({"a_min": (1.0, 0.5, 0.5)}, "a_min must be different positive numbers, found 1.0, 0.5, 0.5"),
        ({"a_min": (1.0, 0.0)}, "a_min must be different positive numbers, found 1.0, 0.0"),
        ({"b_max": (1.0, -2.0)}, "b_max must be different positive numbers, found 1.0, -2.0"),
        ({"b_max": (1.0, math.inf)}, "b_max must be different positive numbers, found 1.0, inf"),
        ({"u_max": (math.nan,)}, "u_max must be different positive numbers, found nan"),
        ({"mu": (0.0, 1.0)}, "mu must be different positive numbers, found 0.0, 1.0"),
        ({"mu": (0.5, 1.5)}, "mu must lie in (0, 1], found 1.5"),
        ({"a_min": (0.9, 0.5)}, "tuning starts at a_min = b_max = 1: "),
        ({"a_min": (1.0, 1.1)}, "tuning starts at a_min = b_max = 1: "),
        ({"b_max": (1.5, 2.0)}, "tuning starts at a_min = b_max = 1: "),
        ({"b_max": (0.9, 1.0)}, "tuning starts at a_min = b_max = 1: "),
    ],
    ids=str,
)
def test_a_grid_that_the_rule_cannot_walk_is_refused_in_a_sentence(values, sentence):
    with pytest.raises(UserError) as refusal:
        Grid(**values)
    assert str(refusal.value).startswith(sentence)


def test_the_grid_without_values_starts_at_the_linear_controller_in_even_steps():
    grid = Grid()
    assert (grid.a_min[0], grid.a_min[-1], grid.b_max[0]) == (1.0, 0.1, 1.0)
    np.testing.assert_allclose(np.diff(grid.a_min), -0.05, atol=1e-12)
    assert list(grid.b_max) == sorted(grid.b_max)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"measure": "peak_voltage"}, f"the measure must be one of {', '.join(MEASURES)}, found 'peak_voltage'"),
        ({"most_chattering": 0.0}, "the limit of chattering must be positive, found 0.0"),
        ({"most_chattering": -1.0}, "the limit of chattering must be positive, found -1.0"),
        ({"most_chattering": math.nan}, "the limit of chattering must be positive, found nan"),
        ({"draws": 0}, "tuning needs at least one draw, found 0"),
    ],
    ids=str,
)
def test_a_problem_that_means_nothing_is_refused_in_a_sentence(fmus, design, values, sentence):
    with pytest.raises(UserError, match=f"^{re.escape(sentence)}$"):
        TuningProblem(*load_scenario("tilt"), fmus, design, **values)


# From the linear controller on


@pytest.fixture(scope="module")
def tilt(fmus, design):
    """Make the problem of the tilt scenario, short, with noise and two draws."""

    def make(changes=None, **options):
        scenario, folder = load_scenario("tilt")
        scenario = scenario.changed({"run.duration": 1.0, "plant.start.noise_std": 1e-4, **(changes or {})})
        return TuningProblem(scenario, folder, fmus, design, **{"draws": 2, **options})

    return make


STEADY = {"run.duration": 8.0}
"""With it the runs end in a steady state."""

FAMILIES = [(mu, u_max) for mu in (0.5, 1.0) for u_max in (1.5, 10.0)]
GRID = Grid(a_min=(0.8, 1.0, 0.4, 0.2), b_max=(1.5, 1.0, 2.0), u_max=(1.5, 10.0), mu=(0.5, 1.0))
"""In no order: the rule brings its own."""


def as_the_rule_says(tuning, grid, most=math.inf):
    """Return where the rule stops for each family, read from the outcomes as the paper's two steps."""
    stops = []
    for mu in grid.mu:
        for u_max in grid.u_max:
            here = Point(mu, u_max, 1.0, 1.0)
            ways = [here._replace(a_min=a) for a in sorted(grid.a_min, reverse=True)], sorted(grid.b_max)
            for point in ways[0][1:]:
                if not better(tuning.outcomes[here], tuning.outcomes[point], most):
                    break
                here = point
            for b_max in ways[1][1:]:
                if not better(tuning.outcomes[here], tuning.outcomes[here._replace(b_max=b_max)], most):
                    break
                here = here._replace(b_max=b_max)
            stops.append(here)
    return tuple(stops)


def better(a, b, most):
    return b.measure < a.measure and b.kept >= a.kept and b.chattering <= most


@pytest.fixture(scope="module")
def kept_runs(tmp_path_factory):
    return tmp_path_factory.mktemp("tuning") / "runs.sqlite"


@pytest.fixture(scope="module")
def tuned(tilt, kept_runs):
    """Return what tuning by a measure finds; all measures share their runs."""

    @cache
    def by(measure, most_chattering=math.inf):
        with Journal(kept_runs, PURPOSE) as journal:
            return tune(tilt(STEADY, measure=measure, most_chattering=most_chattering), GRID, journal, 2)

    return by


@pytest.fixture
def undrawn(monkeypatch):
    """Write no picture: drawing takes longer than the runs."""
    monkeypatch.setattr("cosim.studies.tuning_files.save_figure", lambda *_: None)


def at(problem, point):
    """Return the scenario of a point."""
    designs = problem.designs(Grid(u_max=(point.u_max,), mu=(point.mu,)))
    return problem.base.changed(problem.changes(point, designs[point.mu, point.u_max]))


@pytest.mark.parametrize("name", ["tilt", "swing_up"])
def test_at_a_min_and_b_max_1_every_mu_and_scale_is_the_linear_controller_to_the_last_bit(fmus, design, name):
    scenario, folder = load_scenario(name)
    scenario = scenario.changed({"run.duration": 2.0, "plant.start.noise_std": 1e-4})
    problem = TuningProblem(scenario, folder, fmus, design)
    linear = run_scenario(scenario.changed({"controller.start.law": "LC"}), fmus, folder)
    assert (linear["controller.mode"] == 3).any()
    for family in FAMILIES:
        point = Point(*family, 1.0, 1.0)
        result = run_scenario(
            at(problem, point),
            fmus,
            folder,
        )
        assert result.metadata["start_values"]["controller"]["law"] == 3
        for output in ("plant.theta", "plant.delta", "controller.voltage", "controller.mode"):
            assert result[output].tobytes() == linear[output].tobytes(), (output, family)


def test_every_family_starts_at_the_same_means_those_of_the_linear_controller(tuned, tilt, fmus):
    tuning = tuned("integral_q2")
    problem = tilt(STEADY)
    scenario = problem.scenario.changed({"controller.start.law": "LC"})
    results = [run_scenario(drawn(scenario, draw), fmus, problem.folder) for draw in (1, 2)]
    metrics = [evaluate(result).as_dict() for result in results]
    expected = tuple(statistics.fmean(m[name] for m in metrics) for name in ("integral_q2", "voltage_variation"))
    starts = [tuning.outcomes[Point(*family, 1.0, 1.0)] for family in FAMILIES]
    assert {(o.measure, o.chattering, o.kept, o.draws) for o in (*starts, tuning.linear)} == {(*expected, 2, 2)}


def test_the_design_of_a_point_has_its_mu_and_scale_and_the_given_rest(tilt, design):
    for mu, u_max in FAMILIES:
        found = tilt().designs(Grid(u_max=(u_max,), mu=(mu,)))[mu, u_max]
        assert (found.mu, found.alpha, found.u_max) == (mu, design.alpha, pytest.approx(u_max, rel=1e-9))
        for name in ("A", "b", "k_lin"):
            np.testing.assert_array_equal(getattr(found, name), getattr(design, name))


MEASURES_HERE = ["integral_q2", "energy", "voltage_variation"]


@pytest.mark.parametrize(("measure", "most"), [*((m, math.inf) for m in MEASURES_HERE), ("integral_q2", 5.0)])
def test_tuning_tries_all_points_and_stops_where_the_rule_says(tuned, measure, most):
    tuning = tuned(measure, most)
    assert tuning.stops == as_the_rule_says(tuning, GRID, most * tuning.linear.chattering)
    lowest = [stop._replace(b_max=1.0) for stop in tuning.stops]
    expected = {Point(*family, a_min, 1.0) for family in FAMILIES for a_min in GRID.a_min}
    expected |= {point._replace(b_max=b_max) for point in lowest for b_max in GRID.b_max}
    assert set(tuning.outcomes) == expected
    assert all(point == outcome.point for point, outcome in tuning.outcomes.items())
    assert tuning.best.measure == min(tuning.outcomes[stop].measure for stop in tuning.stops)
    assert tuning.best.point in tuning.stops
    assert tuning.best.measure <= tuning.linear.measure * (1 + 1e-12)
    assert tuning.best.chattering <= most * tuning.linear.chattering


def test_the_tests_of_the_rule_see_all_that_it_can_do(tuned):
    """Some families stop inside the list of a_min, some at its end, some raise b_max, and the limit changes a stop."""
    stops = [stop for measure in MEASURES_HERE for stop in tuned(measure).stops]
    assert {stop.a_min for stop in stops} >= {1.0, 0.2}
    assert any(stop.a_min in (0.8, 0.4) for stop in stops)
    assert any(stop.b_max > 1.0 for stop in stops)
    assert tuned("integral_q2", 5.0).stops != tuned("integral_q2").stops


def test_an_outcome_is_the_mean_of_single_runs(tuned, tilt, fmus):
    problem, point = tilt(STEADY), Point(1.0, 10.0, 0.4, 1.0)
    scenario = at(problem, point)
    found = [numbers(run_scenario(drawn(scenario, draw), fmus, problem.folder)) for draw in range(1, problem.draws + 1)]
    outcome = tuned("integral_q2").outcomes[point]
    assert outcome.measure == statistics.fmean(n["integral_q2"] for n in found)
    assert outcome.chattering == statistics.fmean(n["voltage_variation"] for n in found)
    assert outcome.kept == sum(n["kept"] for n in found) == 2


def test_progress_counts_each_stage_and_a_second_call_takes_all_from_the_journal(tuned, tilt, kept_runs):
    first, seen = tuned("energy"), []
    size = kept_runs.stat().st_size
    with Journal(kept_runs, PURPOSE) as journal:
        tuning = tune(tilt(STEADY, measure="energy"), GRID, journal, 2, lambda *said: seen.append(said))
    assert kept_runs.stat().st_size == size
    assert dataclasses.replace(tuning, designs={}) == dataclasses.replace(first, designs={})
    raised = [point for point in tuning.outcomes if point.b_max > 1.0]
    assert seen == [("lowering a_min", 32, 32), ("raising b_max", 2 * len(raised), 2 * len(raised))]


def test_the_numbers_of_a_run_are_its_metrics_and_whether_it_kept_upright(made_result):
    time, mode = np.arange(0.0, 1.0, 0.1), np.full(10, 3)
    for modes, kept in ((mode, 1.0), (np.where(time > 0.5, 2, 3), 0.0), (np.where(abs(time - 0.5) < 0.05, 2, 3), 0.0)):
        result = made_result(time, 0.1, controller_mode=modes)
        found, metrics = numbers(result), evaluate(result).as_dict()
        assert set(found) == {*metrics, "kept", "steady", "duration"}
        assert found["kept"] == float(kept_upright(result)) == kept
        np.testing.assert_array_equal([found[name] for name in metrics], list(metrics.values()))


def test_a_point_whose_fmu_fails_is_infinitely_bad_not_the_end(tilt, tmp_path, fmus):
    """A bearing so stiff that the solver's step is unstable: every run fails, which is kept."""
    problem = tilt({"plant.start.D_r": 1.0})
    with Journal(tmp_path / "runs", PURPOSE) as journal:
        with pytest.raises(
            UserError, match="the LC, which in this scenario keeps the pendulum upright in 0 of 2 draws"
        ):
            tune(problem, Grid(a_min=(1.0, 0.5), u_max=(3.0,), mu=(1.0,)), journal, 2)
        assert list(journal.known.values()) == [{}] * 4


@pytest.mark.parametrize(
    "changes",
    [
        {"disturbance.sines": [{"amplitude": 20.0, "frequency": 5.0}]},
        {"plant.start.delta_0": 1.5, "run.duration": 0.2},
    ],
    ids=["falls", "has not captured"],
)
def test_a_scenario_in_which_the_linear_controller_does_not_balance_is_refused_in_a_sentence(tilt, tmp_path, changes):
    with (
        Journal(tmp_path / "runs", PURPOSE) as journal,
        pytest.raises(UserError, match="the LC, which in this scenario keeps the pendulum upright in 0 of 2") as said,
    ):
        tune(tilt(changes), Grid((1.0,), (1.0,), (3.0,), (1.0,)), journal, 2)
    assert "\n" not in str(said.value)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"measure": "settling_time"}, "the LC, which in this scenario has no settling_time yet at the end of a run"),
        ({"measure": "steady_rms"}, "the LC, which in this scenario has no steady_rms yet at the end of a run"),
        ({"measure": "voltage_variation"}, "has no voltage_variation yet at the end of a run"),
        ({"most_chattering": 2.0}, "in steady state, which the LC in this scenario does not reach"),
    ],
    ids=str,
)
def test_a_measure_that_the_linear_controller_does_not_have_is_refused_with_that_reason(tilt, tmp_path, options, why):
    with Journal(tmp_path / "runs", PURPOSE) as journal, pytest.raises(UserError) as said:
        tune(tilt(**options), Grid((1.0,), (1.0,), (3.0,), (1.0,)), journal, 2)
    assert str(said.value).endswith(why)


# What is written


def best_again(folder, problem, **changes):
    """Run best.toml as it was written with each draw; return the means of measure and chattering."""
    scenario, beside = load_scenario(str(folder / "best.toml"))
    assert beside == folder
    found = [
        numbers(run_scenario(drawn(scenario.changed(changes), draw), problem.fmus, beside))
        for draw in range(1, problem.draws + 1)
    ]
    return tuple(
        pytest.approx(statistics.fmean(n[name] for n in found)) for name in (problem.measure, "voltage_variation")
    )


@pytest.mark.parametrize("measure", ["integral_q2", "energy"])
def test_the_best_scenario_runs_from_where_it_was_written_and_gives_the_tuned_numbers(
    tuned, tilt, tmp_path, undrawn, measure
):
    tuning, problem = tuned(measure), tilt(STEADY, measure=measure)
    paths = save(tuning, problem, tmp_path / "new folder")
    assert sorted(path.name for path in paths) == WRITTEN
    assert best_again(tmp_path / "new folder", problem) == (tuning.best.measure, tuning.best.chattering)
    scenario, _ = load_scenario(str(tmp_path / "new folder" / "best.toml"))
    best = tuning.best.point
    assert scenario.controller.start == {"law": "IHC", "a_min": best.a_min, "b_max": best.b_max}
    assert (scenario.run, scenario.plant) == (problem.scenario.run, problem.scenario.plant)
    found = Design.load(tmp_path / "new folder" / "best.json")
    assert (found.mu, found.u_max) == (best.mu, pytest.approx(best.u_max, rel=1e-9))


def test_the_table_holds_every_point_exactly_and_marks_the_stops(tuned, tilt, tmp_path, undrawn):
    tuning = tuned("energy")
    save(tuning, tilt(measure="energy"), tmp_path)
    rows = list(csv.DictReader((tmp_path / "tuning.csv").open(encoding="utf-8")))
    points = [Point(*(float(row[name]) for name in Point._fields)) for row in rows]
    assert len(points) == len(tuning.outcomes)
    for point, row in zip(points, rows, strict=True):
        o = tuning.outcomes[point]
        assert (float(row["energy"]), float(row["voltage_variation"])) == (o.measure, o.chattering)
        assert (int(row["kept"]), int(row["draws"])) == (o.kept, o.draws)
    stops = [point for point, row in zip(points, rows, strict=True) if row["stop"] == "1"]
    assert sorted(stops) == sorted(tuning.stops)
    keys = [(mu, u_max, -a_min, b_max) for mu, u_max, a_min, b_max in points]
    assert keys == sorted(keys)


def test_a_scenario_with_points_that_fall_is_written_and_drawn(tuned, tilt, tmp_path):
    tuning = tuned("integral_q2")
    fallen = max(tuning.outcomes.values(), key=lambda o: o.measure)
    lost = dataclasses.replace(fallen, measure=math.inf, chattering=math.inf, kept=0)
    save(dataclasses.replace(tuning, outcomes={**tuning.outcomes, fallen.point: lost}), tilt(), tmp_path)
    assert ",inf,0,2," in (tmp_path / "tuning.csv").read_text(encoding="utf-8")
    assert sorted(path.name for path in tmp_path.iterdir()) == WRITTEN
    assert (tmp_path / "landscape.png").read_bytes().startswith(b"\x89PNG")


SMALL = Grid(a_min=(1.0, 0.5), b_max=(1.0,), u_max=(3.0,), mu=(1.0,))


@pytest.mark.parametrize(
    "changes",
    [
        {"controller.start.velocity_source": "kalman", "controller.start.norm_solver": "exact"},
        {"controller.start.a_min": 0.3, "controller.start.b_max": 1.5, "controller.start.law": "LC"},
        {"run.engine": "fmpy", "run.order": "parallel", "run.duration": 0.2},
        {"run.step": 5e-4, "plant.measurement": "ideal"},
        {"disturbance.sines": [{"amplitude": 0.5, "frequency": 20.0}]},
        {"controller.design": "own.json"},
    ],
    ids=str,
)
def test_the_best_scenario_gives_the_tuned_numbers_whatever_the_scenario_sets(tilt, tmp_path, undrawn, changes):
    problem = tilt(changes)
    with Journal(tmp_path / "runs.sqlite", PURPOSE) as journal:
        tuning = tune(problem, SMALL, journal, 2)
    save(tuning, problem, tmp_path)
    assert best_again(tmp_path, problem) == (tuning.best.measure, tuning.best.chattering)


@pytest.mark.parametrize("name", ["mu", "k_lin_2", "P_14", "capture_level"])
def test_start_values_that_the_design_decides_are_refused(tilt, name):
    with pytest.raises(UserError, match=rf"^tuning decides controller\.start\.{name} by its design; .* --design$"):
        tilt({f"controller.start.{name}": 0.5})


def test_a_design_that_cannot_be_rescaled_is_refused(fmus, design):
    with pytest.raises(UserError, match="psi and d_max"):
        TuningProblem(*load_scenario("tilt"), fmus, dataclasses.replace(design, psi=1e-9))


def test_the_best_scenario_finds_the_fmus_that_the_tuned_one_found(fmus, design, tmp_path, undrawn):
    mine = tmp_path / "mine"
    shutil.copytree(fmus, mine)
    (mine / "mine.toml").write_text("[run]\nduration = 0.1\n[plant.start]\ndelta_0 = 0.1\n", encoding="utf-8")
    problem = TuningProblem(*load_scenario(str(mine / "mine.toml")), tmp_path / "nowhere", design, draws=1)
    with Journal(tmp_path / "runs.sqlite", PURPOSE) as journal:
        tuning = tune(problem, SMALL, journal, 1)
    save(tuning, problem, tmp_path / "out")
    assert best_again(tmp_path / "out", problem) == (tuning.best.measure, tuning.best.chattering)


# The command

OPTIONS = [
    "--measure",
    "--most-chattering",
    "--a-min",
    "--b-max",
    "--u-max",
    "--mu",
    "--draws",
    "--design",
    "--workers",
]
TINY = ("--a-min", "1,0.8,0.6,0.4", "--b-max", "1,1.5", "--u-max", "3", "--mu", "1", "--draws", "4", "--workers", "1")


@pytest.fixture
def said(monkeypatch, tmp_path):
    """Run the command line in this process in a fresh folder; return (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        done = ended(*arguments, cwd=tmp_path)
        return done.returncode, done.stdout, done.stderr.strip()

    return run


def test_help_names_every_option_and_measure(said):
    code, out, _ = said("tune", "--help")
    missing = [name for name in (*OPTIONS, *MEASURES, "--output", "--fmus", "--set") if name not in out]
    assert (code, missing) == (0, [])


def test_the_command_writes_prints_and_repeats_itself_to_the_byte(elsewhere, said, undrawn, fmus, design):
    arguments = ("tune", "tilt", *TINY, "--set", "run.duration=0.5")
    code, _, err = said(*arguments)
    folder = Path("results/tune_tilt")
    assert (code, err) == (0, "")
    table, runs = (folder / "tuning.csv").read_bytes(), (folder / "runs.sqlite").read_bytes()
    rows = list(csv.DictReader(table.decode().splitlines()))
    assert len(journal_rows(folder / "runs.sqlite")) == 4 * len(rows)

    scenario, beside = load_scenario("tilt")
    problem = TuningProblem(scenario.changed({"run.duration": 0.5}), beside, fmus, design, draws=4)
    with Journal(elsewhere / "other.sqlite", PURPOSE) as journal:
        tuning = tune(problem, Grid((1.0, 0.8, 0.6, 0.4), (1.0, 1.5), (3.0,), (1.0,)), journal, 2)
    save(tuning, problem, elsewhere / "other")
    assert table == (elsewhere / "other" / "tuning.csv").read_bytes()

    (folder / "tuning.csv").unlink()
    done = finished(started(*arguments, cwd=elsewhere))  # with its picture
    out = done.stdout
    assert (done.returncode, done.stderr.strip()) == (0, "")
    assert sorted(path.name for path in folder.iterdir()) == sorted([*WRITTEN, "runs.sqlite"])
    assert all(f"wrote {folder / name}" in out for name in WRITTEN)
    assert (folder / "tuning.csv").read_bytes() == table
    assert (folder / "runs.sqlite").read_bytes() == runs
    stop, linear = tuning.outcomes[tuning.stops[0]], tuning.linear
    change = change_text(stop.over_linear)
    shown = [
        f"{linear.measure:.4g}",
        f"{stop.measure:.4g}",
        change,
        f"{stop.chattering:.4g}",
        "4/4",
        "[rad² s]",
        "[V/s]",
    ]
    assert [text for text in shown if text not in out] == []
    assert ("smallest a_min tried, 0.4" in out) == (tuning.best.point.a_min == 0.4)


def test_a_longer_list_goes_on_from_the_kept_runs(elsewhere, said, undrawn):
    arguments = ("tune", "tilt", *TINY, "--set", "run.duration=0.2", "--b-max", "1", "-o", "here")
    counts = []
    for a_min, draws in (("1,0.8", 1), ("1,0.8", 2), ("1,0.8,0.6", 2), ("1,0.8,0.6", 2)):
        code, _, err = said(*arguments, "--a-min", a_min, "--draws", draws)
        assert (code, err) == (0, "")
        counts.append(len(journal_rows(Path("here/runs.sqlite"))))
    assert counts == [2, 4, 6, 6]


def test_the_commands_design_decides_the_best_one(elsewhere, said, undrawn, design):
    dataclasses.replace(design, alpha=0.1).save(elsewhere / "mine.json")
    arguments = (*TINY, "--set", "run.duration=0.2", "--a-min", "1", "--b-max", "1", "--u-max", "2", "--mu", "0.5")
    code, _, err = said("tune", "tilt", *arguments, "--design", "mine.json", "-o", "out")
    assert (code, err) == (0, "")
    found = Design.load(elsewhere / "out" / "best.json")
    assert (found.alpha, found.mu, found.u_max) == (0.1, 0.5, pytest.approx(2.0))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--a-min", "1,x"), "--a-min takes numbers separated by commas, found '1,x'"),
        (("--b-max", ""), "--b-max takes numbers separated by commas, found ''"),
        (("--u-max", "3,"), "--u-max takes numbers separated by commas, found '3,'"),
        (("--a-min", "0.9,0.5"), "tuning starts at a_min = b_max = 1"),
        (("--a-min", "1,nan"), "a_min must be different positive numbers, found 1.0, nan"),
        (("--mu", "2"), "mu must lie in (0, 1], found 2.0"),
        (("--u-max", "-1"), "u_max must be different positive numbers, found -1.0"),
        (("--measure", "elegance"), "the measure must be one of integral_q2, steady_rms, "),
        (("--most-chattering", "0"), "the limit of chattering must be positive, found 0.0"),
        (("--most-chattering", "nan"), "the limit of chattering must be positive, found nan"),
        (("--design", "nowhere.json"), "design file nowhere.json does not exist"),
        (("--set", "run.durration=1"), "tilt: there is no entry run.durration; did you mean duration?"),
    ],
    ids=str,
)
def test_a_mistake_is_one_sentence(said, tmp_path, fmus, arguments, sentence):
    code, _, err = said("tune", "tilt", "--fmus", fmus, *arguments)
    assert (code, len(err.splitlines())) == (2, 1)
    assert err.startswith(f"error: {sentence}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments", [("--draws", "0"), ("--draws", "x"), ("--workers", "0"), ("--most-chattering", "x")]
)
def test_a_wrong_flag_ends_with_code_2(said, tmp_path, arguments):
    code, _, err = said("tune", "tilt", *arguments)
    assert code == 2
    assert arguments[0].removeprefix("--") in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--fmus", "nowhere"), r"FMU nowhere.(QubeServo2|IhcController)\.fmu does not exist; `qube-ihc export` makes"),
        (("--set", "controller.start.lwa=1"), "controller has no variable named 'lwa'; did you mean law"),
        (
            ("--set", "plant.start.delta_0=1.5", "--draws", "1"),
            "tuning starts from the LC, which in this scenario keeps the pendulum upright in 0",
        ),
    ],
    ids=str,
)
def test_what_only_the_runs_can_tell_is_one_sentence_too(elsewhere, said, arguments, sentence):
    code, _, err = said("tune", "tilt", *TINY, "--set", "run.duration=0.2", *arguments)
    assert (code, len(err.splitlines())) == (2, 1)
    assert re.match(f"error: {sentence}", err)


def test_without_fmus_nothing_is_written(said, tmp_path):
    assert said("tune", "tilt", *TINY)[0] == 2
    assert list(tmp_path.iterdir()) == []


def test_a_journal_that_is_something_else_is_refused_and_stays(elsewhere, said):
    path = elsewhere / "results" / "tune_tilt" / "runs.sqlite"
    path.parent.mkdir(parents=True)
    path.write_text('{"mine": 1}\n', encoding="utf-8")
    code, _, err = said("tune", "tilt", *TINY)
    assert (code, len(err.splitlines())) == (2, 1)
    assert "runs.sqlite is not a journal of finished runs" in err
    assert path.read_text(encoding="utf-8") == '{"mine": 1}\n'


def test_ctrl_c_keeps_the_finished_runs_and_the_next_call_goes_on_from_there(elsewhere, said, undrawn):
    arguments = ("tune", "tilt", *TINY, "--set", "run.duration=40")
    journal = elsewhere / "results" / "tune_tilt" / "runs.sqlite"
    process = started(*map(str, arguments), cwd=elsewhere)
    try:
        end = time.monotonic() + 60.0
        while not journal_rows(journal):
            assert time.monotonic() < end
            assert process.poll() is None, process.communicate()
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=10)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert "interrupted; finished runs are kept, and the same command goes on from there" in err
    assert "Traceback" not in err
    assert list(journal.parent.iterdir()) == [journal]
    cut = journal_rows(journal)

    code, _, err = said(*arguments)
    assert (code, err) == (0, "")
    whole = journal_rows(journal)
    assert whole[: len(cut)] == cut
    rows = list(csv.DictReader((journal.parent / "tuning.csv").open(encoding="utf-8")))
    assert len(cut) < len(whole) == 4 * len(rows)

    assert said(*arguments, "-o", "uninterrupted")[0] == 0
    assert (elsewhere / "uninterrupted" / "tuning.csv").read_bytes() == (journal.parent / "tuning.csv").read_bytes()


def test_the_best_scenario_runs_by_the_command(elsewhere, said, undrawn):
    assert said("tune", "tilt", *TINY, "--set", "run.duration=0.3", "--draws", "1")[0] == 0
    start = drawn(load_scenario("tilt")[0], 1).plant.start
    offsets = [part for name in start if name != "delta_0" for part in ("--set", f"plant.start.{name}={start[name]!r}")]
    assert said("run", "results/tune_tilt/best.toml", "--no-plot", *offsets)[0] == 0
    result = Result.load(elsewhere / "results" / "best.csv")
    rows = list(csv.DictReader((elsewhere / "results" / "tune_tilt" / "tuning.csv").open(encoding="utf-8")))
    (stop,) = [row for row in rows if row["stop"] == "1"]
    assert evaluate(result).integral_q2 == float(stop["integral_q2"])
