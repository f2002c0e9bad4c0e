"""A front of several objectives: known functions, choice and verdict by hand, a short search, the command."""

import csv
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.metric_meanings import QUANTITIES
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from cosim.studies import pareto as searching
from cosim.studies.cases import Case, cases_of
from cosim.studies.draws import draw_changes
from cosim.studies.estimates import MeanEstimate
from cosim.studies.journal import Journal
from cosim.studies.numbers import PURPOSE, numbers
from cosim.studies.optimizers import descended, nondominated
from cosim.studies.pareto import pareto
from cosim.studies.pareto_files import save
from cosim.studies.pareto_front import (
    DOMINATED,
    FRONT,
    LC,
    LOST,
    RETUNED,
    RULE,
    Front,
    ParetoPoint,
    Search,
    factors_of,
    objectives_of,
)
from cosim.studies.pareto_judge import WORST, PointJudge
from cosim.studies.ranges import Range
from cosim.studies.tunables import Tunable, TunedController
from cosim.studies.tuning import Grid, Outcome, Point, Tuning, TuningProblem
from tests.cosim.command import ended, finished, journal_rows, started

THREE = objectives_of(["settling", "energy", "variation"], QUANTITIES)
TUNABLES = (Tunable("a_min", Range(0.1, 1.0)), Tunable("b_max", Range(1.0, 5.0)))


def tuned(problem, design):
    """Return the controller of a tuning's scenario."""
    return TunedController(problem.scenario, problem.fmus, problem.folder, design)


# The search, on functions whose front is known


def circle(_generation, points):
    """Distances to two corners, of which the first is out of bounds: the front is the edge from x = 0.25 to 1, y = 0."""
    x, y = points.T
    return np.column_stack([x**2 + y**2, (1.0 - x) ** 2 + y**2]), np.maximum(0.25 - x, 0.0)[:, None]


def test_the_search_finds_the_feasible_front_and_the_same_again():
    first = np.random.default_rng(2).random((16, 2))
    found = nondominated(circle, first, 2, 30, 1)
    assert found[:, 0].min() >= 0.25
    assert found[:, 0].min() < 0.3
    assert found[:, 0].max() > 0.95
    assert found[:, 1].max() < 0.05
    np.testing.assert_array_equal(nondominated(circle, first, 2, 30, 1), found)
    assert not np.array_equal(nondominated(circle, first, 2, 30, 2), found)


def test_a_search_without_a_feasible_point_finds_none():
    found = nondominated(lambda _g, x: (np.ones((len(x), 2)), np.ones((len(x), 1))), np.eye(4, 2), 2, 2, 1)
    assert len(found) == 0


def test_the_descent_ends_near_the_least_value_and_takes_the_same_way_again():
    """A bowl with a wall beside its bottom, in five numbers."""

    def bowl(generation, generations, points):
        seen.append((generation, generations, points))
        return ((points - 0.3) ** 2 @ [1.0, 4.0, 9.0, 1.0, 1.0]) + 100.0 * (points[:, 0] < 0.28)

    ways = []
    for seed in (1, 1, 2):
        seen = []
        descended(bowl, np.full(5, 0.9), 600, seed)
        ways.append(np.vstack([points for *_, points in seen]))
        assert [s[0] for s in seen] == list(range(1, len(seen) + 1))
        assert {s[1] for s in seen} == {38}
    np.testing.assert_allclose(ways[0][-1], 0.3, atol=0.05)
    np.testing.assert_array_equal(ways[0], ways[1])
    assert not np.array_equal(ways[0], ways[2])
    assert ways[0].min() >= 0.0
    assert ways[0].max() <= 1.0


# What is asked for


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["settling", "energy", "variation"], ["settling_time", "energy", "voltage_variation"]),
        (["steady_rms", " integral"], ["steady_rms", "integral_q2"]),
    ],
)
def test_objectives_are_named_by_role_or_metric(names, found):
    assert [q.name for q in objectives_of(names, QUANTITIES)] == found


SEVERAL = {
    f"settling_time[{s}]": dataclasses.replace(QUANTITIES["settling_time"], name=f"settling_time[{s}]") for s in "ab"
}


@pytest.mark.parametrize(
    ("names", "quantities", "sentence"),
    [
        (["settling"], QUANTITIES, "a front needs two or more different objectives, found settling"),
        (["settling", "settling_time"], QUANTITIES, "a front needs two or more different objectives, found settling, "),
        (
            ["settling", "peak"],
            QUANTITIES,
            "an objective must be one of integral, rms, settling, energy, variation, or of ",
        ),
        (
            ["settling", "energy"],
            SEVERAL,
            "several metrics are for settling: settling_time[a], settling_time[b]; name one",
        ),
    ],
)
def test_objectives_that_cannot_be_are_refused_in_a_sentence(names, quantities, sentence):
    with pytest.raises(UserError) as said:
        objectives_of(names, quantities)
    assert str(said.value).startswith(sentence)


def test_limits_are_of_objectives_and_without_any_all_but_the_first_are_limited():
    assert factors_of("--limit", ["energy=1.2", "variation=2"], THREE) == {"energy": 1.2, "voltage_variation": 2.0}
    assert Search(THREE, TUNABLES).bounds == {"energy": 1.0, "voltage_variation": 1.0}
    assert Search(THREE, TUNABLES, {"energy": 1.2}).bounds == {"energy": 1.2}
    for text, sentence in {
        "energy": "--limit takes NAME=FACTOR, found 'energy'",
        "rms=1": "--limit rms is none of the objectives of --pareto: settling_time",
    }.items():
        with pytest.raises(UserError, match=sentence):
            factors_of("--limit", [text], THREE)
    with pytest.raises(UserError, match="--limit names energy twice"):
        factors_of("--limit", ["energy=1", "energy=2"], THREE)


def test_cases_are_given_by_entries_and_objectives_can_be_of_one():
    pushed, away = cases_of(
        [("pushed:disturbance.gain", 60.0), ("pushed:plant.parameters", "hcs")], [("plant.start.delta_0", 0.6)]
    )
    assert pushed == Case("pushed", {"disturbance.gain": 60.0, "plant.parameters": "hcs"})
    assert away == Case("plant.start.delta_0=0.6", {"plant.start.delta_0": 0.6}, rest=True)
    settling, steady = objectives_of(["settling", "rms@pushed"], QUANTITIES, [pushed, away])
    assert (settling.name, settling.case) == ("settling_time", "")
    assert (steady.name, steady.case) == ("steady_rms@pushed", "pushed")
    assert steady.heading == "steady RMS |q|, pushed [rad]"
    assert factors_of("--goal", ["rms@pushed=0.1"], [settling, steady]) == {"steady_rms@pushed": 0.1}


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda: cases_of([("disturbance.gain", 60.0)], []), "--case takes NAME:ENTRY=VALUE with a name of letters"),
        (lambda: cases_of([("a:b.c", 1.0), ("a:b.c", 2.0)], []), "--case gives b.c twice in a"),
        (lambda: cases_of([], [("b.c", 1.0), ("b.c", 1.0)]), "--hold gives the same entry and value twice"),
        (
            lambda: objectives_of(["settling", "rms@push"], QUANTITIES, [Case("pushed")]),
            "the case of 'rms@push' must be one of pushed, found 'push'",
        ),
        (
            lambda: objectives_of(["settling", "rms@a"], QUANTITIES, [Case("a", rest=True)]),
            "the case of 'rms@a' must be given with --case, found 'a'",
        ),
        (lambda: Search(THREE, TUNABLES, goals={"energy": -1.0}), "the goal of energy must be positive and finite"),
        (
            lambda: Search(THREE, TUNABLES[:1], goals={"energy": 1.0}),
            "a search for goals needs two or more numbers to tune, found a_min",
        ),
    ],
)
def test_cases_and_goals_that_cannot_be_are_refused_in_a_sentence(ask, sentence):
    with pytest.raises(UserError) as said:
        ask()
    assert str(said.value).startswith(sentence)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"population": 3}, "population must be at least 4, found 3"),
        ({"held_out": 1}, "held-out must be at least 2, found 1"),
        ({"generations": 0}, "generations must be at least 1, found 0"),
        ({"limits": {"energy": 0.0}}, "the limit of energy must be positive and finite, found 0.0"),
        ({"tunables": ()}, "a front needs numbers to tune, found none"),
    ],
)
def test_a_search_that_means_nothing_is_refused_in_a_sentence(options, sentence):
    with pytest.raises(UserError, match=f"^{sentence}$"):
        Search(**{"objectives": THREE, "tunables": TUNABLES, **options})


# The choice and the verdict, on points made by hand


def point(kind, searched, held=None, half=0.01, a_min=0.5):
    """Return a point with its objectives, those of the LC being 1."""
    held = searched if held is None else held
    over = tuple(MeanEstimate(value - 1.0, half) for value in held)
    values = {} if kind == LC else {"a_min": a_min, "b_max": 2.0}
    return ParetoPoint(kind, values, tuple(searched), tuple(map(MeanEstimate, held)), over, 8, 8)


def front(*points, limits=None, goals=None):
    search = Search(THREE, TUNABLES, limits or {}, goals or {})
    linear = point(LC, (1.0, 1.0, 1.0))
    stop = Outcome(Point(None, None, 1.0, 1.0), 1.0, 1.0, 8, 8)
    rule = Tuning("settling_time", {stop.point: stop}, (stop.point,), stop, {})
    points = (linear, *points)
    return Front(search, points, searching._chosen(points, search, FRONT), rule, True)


def test_the_chosen_point_keeps_the_limits_in_all_draws_and_is_best_where_it_was_searched():
    flattered = point(FRONT, (0.6, 0.9, 0.9), (0.3, 0.9, 0.9))
    best = point(FRONT, (0.5, 1.0, 1.0), (0.55, 0.99, 0.99))
    over = point(FRONT, (0.4, 0.99, 0.99), (0.4, 1.01, 0.99))
    over_before = point(FRONT, (0.4, 1.01, 0.99), (0.4, 0.99, 0.99))
    beaten = point(DOMINATED, (0.2, 0.5, 0.5))
    fallen = point(LOST, (0.1, 0.5, 0.5))
    found = front(flattered, best, over, over_before, beaten, fallen)
    assert found.chosen is best
    assert front(over, over_before).chosen is None
    assert front(flattered, best, over, limits={"energy": 1.1}).chosen is over


def test_the_verdict_says_what_is_gained_or_that_nothing_is():
    gains = front(point(FRONT, (0.5, 0.9, 0.95))).verdict()
    assert gains.startswith(
        "the LC gains: with ∫V² dt at most 1 times the LC's and variation of V at most 1 times the LC's "
    )
    assert "settling -50.0 ± 1.0 % better" in gains
    assert gains.endswith("in 8 draws that the search did not see")
    open_ = front(point(FRONT, (0.995, 0.9, 0.95))).verdict()
    assert open_.startswith("no gain in settling was found: ")
    assert "no point is decidedly better" in open_
    assert "settling -0.5 ± 1.0 % open" in open_
    none = front(point(FRONT, (0.5, 1.5, 0.95)), point(FRONT, (1.5, 1.2, 0.9))).verdict()
    assert none.startswith("the LC does not gain: no point of the front keeps ∫V² dt at most 1 times")
    assert "settling -50.0 ± 1.0 % better, ∫V² dt +20.0 ± 1.0 % worse" in none
    lost = dataclasses.replace(front(point(LOST, (0.5, 0.5, 0.5))), why_none="it does not come to rest").verdict()
    assert lost.endswith("; of the nearest that was found: it does not come to rest")


GOALS = {"settling_time": 0.5, "voltage_variation": 0.8}


def test_with_goals_the_nearest_point_is_chosen_and_each_goal_is_said_to_be_met_or_missed():
    """The largest ratio to a goal counts, in the search's draws: 1.2, 1.1 and 1.25; energy has none."""
    left, near, right = point(FRONT, (0.6, 0.1, 0.7)), point(FRONT, (0.55, 3.0, 0.8)), point(FRONT, (0.3, 0.1, 1.0))
    found = front(left, near, right, point(LOST, (0.1, 0.1, 0.1)), goals=GOALS)
    assert found.chosen is near
    assert not found.met
    assert found.verdict() == (
        "the goals are not met together; the nearest that was found: times the LC's, in 8 draws that the search did not "
        "see: settling 0.55 (goal 0.5, missed); ∫V² dt 3; variation of V 0.8 (goal 0.8)"
    )
    lucky = front(point(FRONT, (0.6, 0.1, 0.7), (0.4, 0.1, 0.7)), goals=GOALS)
    assert lucky.met
    assert lucky.verdict().startswith(
        "the goals are met: times the LC's, in 8 draws that the search did not see: settling"
    )
    limited = front(left, near, right, goals=GOALS, limits={"energy": 2.0})
    assert limited.chosen is left
    assert "∫V² dt 0.1 (limit 2); " in limited.verdict()
    none = front(near, point(LOST, (0.5, 0.5, 0.5)), goals=GOALS, limits={"energy": 2.0}).verdict()
    assert none.startswith(
        "the LC does not gain: no point of the front keeps ∫V² dt at most 2 times the LC's; the least of "
    )
    lost = front(point(LOST, (0.5, 0.5, 0.5)), goals=GOALS).verdict()
    assert lost == (
        "the LC does not gain: no point of the front is left; of the nearest that was found: it loses the plant in the "
        "draws held out"
    )


def test_where_the_chosen_point_is_at_the_end_of_a_range_it_is_said():
    assert front(point(FRONT, (0.5, 0.9, 0.9), a_min=0.1)).at_ends() == ["a_min at 0.1"]
    assert front(point(FRONT, (0.5, 0.9, 0.9))).at_ends() == []


# A short search


GRID = Grid(a_min=(1.0, 0.5), b_max=(1.0,), u_max=(1.5,), mu=(1.0,))
WRITTEN = ["best.json", "best.toml", "front.csv", "front.png"]


@pytest.fixture(scope="module")
def tilt(fmus, design):
    scenario, folder = load_scenario("tilt")
    scenario = scenario.changed({"run.duration": 0.5, "plant.start.noise_std": 1e-4})
    return TuningProblem(scenario, folder, fmus, design, draws=2)


@pytest.fixture(scope="module")
def search(tilt, design):
    over = {"a_min": Range(0.1, 1.0), "b_max": Range(1.0, 4.0), "u_max": Range(0.5, 10.0)}
    tunables = tuple(tuned(tilt, design).tunables(over))
    objectives = objectives_of(["integral", "energy"], QUANTITIES)
    return Search(objectives, tunables, {"energy": 2.0}, population=6, generations=3, held_out=4, seed=3)


@pytest.fixture(scope="module")
def look(tilt, search, design):
    """Look for the front with a journal; return it and what was said."""

    def go(path, progress=None):
        said = []
        with Journal(path, PURPOSE) as journal:
            return pareto(tilt, search, tuned(tilt, design), GRID, journal, 2, progress, said.append), said

    return go


@pytest.fixture(scope="module")
def found(look, tmp_path_factory):
    return look(tmp_path_factory.mktemp("front") / "runs.sqlite")


@pytest.fixture
def undrawn(monkeypatch):
    """Write no picture: drawing takes longer than the runs."""
    for name in ("tuning_files", "pareto_files"):
        monkeypatch.setattr(f"cosim.studies.{name}.save_figure", lambda *_: None)


def test_the_front_is_judged_on_draws_that_the_search_did_not_see(found, tilt, search):
    front, (said,) = found
    assert said.startswith("12 runs in ")
    assert "the generations that follow are up to 24 runs, about " in said
    assert set(tilt.held_out(4)).isdisjoint(tilt.numbers)
    assert front.random
    kinds = [p.kind for p in front.points]
    assert (kinds[0], kinds.count(LC)) == (LC, 1)
    assert kinds.count(RULE) == len(front.rule.way) >= 1
    best = min(front.of(FRONT), key=lambda p: p.held_out[0].value)
    scenario = tilt.base.changed(dict(best.setting.changes))
    runs = [
        numbers(run_scenario(scenario.changed(draw_changes(scenario, n)), tilt.fmus, tilt.folder)) for n in range(5, 9)
    ]
    for q, value in zip(search.objectives, best.held_out, strict=True):
        assert value.value == pytest.approx(np.mean([run[q.name] for run in runs]), rel=1e-12)
    pairs = [tuple(e.value for e in p.held_out) for p in front.of(FRONT)]
    assert not any(a[0] <= b[0] and a[1] <= b[1] and a != b for a in pairs for b in pairs)


def test_an_interrupted_search_goes_on_and_finds_the_same_front(found, look, tilt, tmp_path, undrawn):
    def interrupt(what, done, _total):
        if what == "generation 2 of 3" and done == 5:
            raise KeyboardInterrupt

    journal = tmp_path / "runs.sqlite"
    with pytest.raises(KeyboardInterrupt):
        look(journal, interrupt)
    cut = journal_rows(journal)
    front, _ = look(journal)
    assert journal_rows(journal)[: len(cut)] == cut
    tables = []
    for name, one in (("whole", found[0]), ("cut", front)):
        save(one, tilt, tmp_path / name)
        tables.append((tmp_path / name / "front.csv").read_bytes())
    assert tables[0] == tables[1]
    size = len(journal_rows(journal))
    assert look(journal)[1] == []  # nothing is run again, so that nothing can be predicted
    assert len(journal_rows(journal)) == size


def test_a_point_that_loses_the_plant_is_infeasible_and_so_is_one_out_of_reach(found, tilt, search, design, tmp_path):
    def draw(kept=1.0, energy=1.0):
        return {"kept": kept, "steady": 1.0, "duration": 1.0, "integral_q2": 1.0, "energy": energy}

    with Journal(tmp_path / "runs", PURPOSE) as journal:
        judge = PointJudge(tilt, search, tuned(tilt, design), journal, 1)
        judge.linear, judge.reach = {"": [draw(), draw()]}, [4.0, 4.0]
        assert judge.searched({"": [draw(energy=2.0), draw(energy=4.0)]}) == (pytest.approx([0.0, math.log(3.0)]), 0.0)
        violations = [judge.searched({"": draws})[1] for draws in ([draw(energy=9.0)] * 2, [draw(), {}], [{}, {}])]
        assert 0.0 < violations[0] < 1.0 < violations[1] < violations[2] == WORST
        judge.linear = {"": [draw(), draw(kept=0.0)]}
        assert judge.searched({"": [draw(), {}]})[1] == 0.0  # the LC loses one too


def test_the_chosen_point_is_written_as_a_scenario_that_gives_its_numbers(found, tilt, search, tmp_path):
    front = found[0]
    assert front.chosen is not None
    paths = save(front, tilt, tmp_path / "out")
    assert sorted(path.name for path in paths) == WRITTEN
    assert (tmp_path / "out" / "front.png").read_bytes().startswith(b"\x89PNG")
    scenario, beside = load_scenario(str(tmp_path / "out" / "best.toml"))
    runs = [numbers(run_scenario(scenario.changed(draw_changes(scenario, n)), tilt.fmus, beside)) for n in range(5, 9)]
    found = [np.mean([run[q.name] for run in runs]) for q in search.objectives]
    assert found == pytest.approx([e.value for e in front.chosen.held_out], rel=1e-12)
    rows = list(csv.DictReader((tmp_path / "out" / "front.csv").open(encoding="utf-8")))
    assert [row["kind"] for row in rows if row["chosen"] == "1"] == [FRONT]
    (row,) = (row for row in rows if row["chosen"] == "1")
    assert {name: float(row[name]) for name in front.chosen.values} == front.chosen.values
    assert float(row["energy over LC"]) == front.chosen.over_linear[1].value
    assert len(rows) == len(front.points)


def test_the_linear_controller_is_tuned_as_freely_and_judged_beside(found, tilt, search, design, tmp_path):
    """Its points change K only, keep the limits as the chosen one does, and none of them is beaten by another."""
    with Journal(tmp_path / "runs.sqlite", PURPOSE) as journal:
        controller = tuned(tilt, design)
        front = pareto(tilt, dataclasses.replace(search, linear=True), controller, GRID, journal, 2)
    own = front.of(RETUNED)
    assert own
    assert all(set(p.values) == {"k_lin_1", "k_lin_2", "k_lin_3", "k_lin_4"} for p in own)
    assert {p.setting.changes["controller.start.law"] for p in own if p.setting is not None} == {"LC"}
    assert not any(searching._better(a, b) for a in own for b in own)
    assert [p.held_out for p in front.of(FRONT)] == [p.held_out for p in found[0].of(FRONT)]
    assert front.retuned is not None
    assert front.chosen is not None
    best, over = front.retuned
    assert best.held_out[1].value <= 2.0 * front.linear.held_out[1].value
    assert over[0].value == pytest.approx(front.chosen.held_out[0].value / best.held_out[0].value - 1.0)
    assert front.over_retuned().startswith("over the LC at its own best tuning, K and filter as free")
    assert found[0].over_retuned() == ""
    save(front, tilt, tmp_path / "out")
    kinds = [row["kind"] for row in csv.DictReader((tmp_path / "out" / "front.csv").open(encoding="utf-8"))]
    assert kinds.count("retuned LC") == len(own)


@pytest.fixture(scope="module")
def goals(tilt, search):
    """Twice the LC's energy at half its integral, with a push and another start, against the LC with the true state."""
    cases = cases_of(
        [("pushed:disturbance.gain", 60.0), ("pushed:disturbance.sines", [{"amplitude": 0.02, "frequency": 10.0}])],
        [("plant.start.delta_0", 0.12)],
    )
    return dataclasses.replace(
        search,
        objectives=objectives_of(["integral", "energy", "integral@pushed"], QUANTITIES, cases),
        limits={},
        goals={"integral_q2": 0.5, "energy": 2.0, "integral_q2@pushed": 0.5},
        cases=cases,
        reference={"plant.measurement": "ideal"},
        generations=2,
    )


def test_the_search_goes_on_towards_the_goals_and_is_judged_in_each_case(tilt, goals, design, tmp_path):
    stages, said = [], []
    problem = dataclasses.replace(tilt, scenario=tilt.scenario.changed({"run.duration": 6.0}))
    with Journal(tmp_path / "runs.sqlite", PURPOSE) as journal:
        front = pareto(
            problem,
            goals,
            tuned(problem, design),
            GRID,
            journal,
            2,
            lambda what, *_: stages.append(what),
            said.append,
        )
    assert dict.fromkeys(s for s in stages if "generation" in s) == dict.fromkeys(
        ["generation 1 of 2", "generation 2 of 2", "towards the goals, generation 1 of 1"]
    )
    assert front.chosen is not None
    assert front.chosen.setting is not None
    scenario = problem.base.changed(dict(front.chosen.setting.changes))
    linear = problem.base.changed({"controller.start.law": "LC", "plant.measurement": "ideal"})
    for base, p in ((scenario, front.chosen), (linear, front.linear)):
        for q, value in zip(goals.objectives, p.held_out, strict=True):
            changes = next((c.changes for c in goals.cases if c.name == q.case), {})
            drawn = [base.changed({**changes, **draw_changes(base, n)}) for n in range(5, 9)]
            runs = [numbers(run_scenario(one, problem.fmus, problem.folder)) for one in drawn]
            assert value.value == pytest.approx(np.mean([run[q.quantity.name] for run in runs]), rel=1e-12)
    assert all(
        front.search.beyond(p.searched, front.linear.searched)
        >= front.search.beyond(front.chosen.searched, front.linear.searched)
        for p in front.of(FRONT)
    )


def test_a_point_must_come_to_rest_from_where_it_is_held_whatever_the_linear_controller_does(
    tilt, goals, design, tmp_path
):
    with Journal(tmp_path / "runs", PURPOSE) as journal:
        judge = PointJudge(tilt, goals, tuned(tilt, design), journal, 1)
    (held,) = (case for case in goals.cases if case.rest)
    fine = {"kept": 1.0, "steady": 1.0, "duration": 1.0, "integral_q2": 1.0, "energy": 1.0, "capture_time": 0.002}
    rest, astray = {**fine, "settling_time": 0.2}, {**fine, "settling_time": math.nan}
    late = {**rest, "capture_time": 0.3}
    judge.reach = [math.inf] * 3
    judge.linear = {"": [fine, fine], "pushed": [fine, fine], held.name: [astray, astray]}
    for draws, violation in (([rest, rest], 0.0), ([rest, astray], 1.0 + 0.5 / 3), ([late, {}], 1.0 + 1.0 / 3)):
        runs = {"": [fine, fine], "pushed": [fine, fine], held.name: draws}
        assert judge.violation(runs, judge.linear) == pytest.approx(violation)
        assert judge.violation(runs, judge.linear, found=False) == 0.0


def test_why_a_point_is_infeasible_is_said(tilt, goals, design, tmp_path):
    with Journal(tmp_path / "runs", PURPOSE) as journal:
        judge = PointJudge(tilt, goals, tuned(tilt, design), journal, 1)
    fine = {"kept": 1.0, "steady": 1.0, "duration": 1.0, "integral_q2": 1.0, "energy": 1.0, "capture_time": 0.002}
    fine |= {"settling_time": 0.2}
    good = {"": [fine, fine], "pushed": [fine, fine], "plant.start.delta_0=0.12": [fine, fine]}
    judge.reach, judge.linear = [4.0] * 3, good
    for changes, said in (
        ({}, ""),
        (
            {"plant.start.delta_0=0.12": [fine, {}]},
            "it does not come to rest from plant.start.delta_0=0.12 in 1 of 2 draws",
        ),
        ({"pushed": [{}, {}]}, "it loses the plant in the case pushed in 2 draws more than the LC, of 2"),
        ({"": [{**fine, "energy": 9.0}] * 2}, "its ∫V² dt is more than 4 times the LC's"),
    ):
        why = judge.why_not({**good, **changes}, judge.linear)
        assert why.startswith(said)
        assert bool(why) == bool(said)


@pytest.mark.parametrize("entry", ["controller.start.law", "plant.start.delta_0", "disturbance.gain"])
def test_the_linear_controller_of_the_comparison_is_one_on_the_same_plant(tilt, goals, design, tmp_path, entry):
    asked = dataclasses.replace(goals, reference={entry: 1})
    with Journal(tmp_path / "runs", PURPOSE) as journal:
        judge = PointJudge(tilt, asked, tuned(tilt, design), journal, 1)
        with pytest.raises(UserError, match=f"the same law on the same plant.*found {entry}"):
            judge.begin(lambda _done, _total: None)


def test_a_case_of_what_the_tuning_decides_is_refused(tilt, goals, design, tmp_path):
    asked = dataclasses.replace(goals, cases=(*goals.cases, Case("mild", {"controller.start.a_min": 0.5})))
    with (
        Journal(tmp_path / "runs", PURPOSE) as journal,
        pytest.raises(
            UserError, match=r"a case must not change what the tuning decides, found controller\.start\.a_min"
        ),
    ):
        pareto(tilt, asked, tuned(tilt, design), GRID, journal, 2)


def test_an_objective_that_the_linear_controller_lacks_is_refused(tilt, search, design, tmp_path):
    asked = dataclasses.replace(search, objectives=objectives_of(["integral", "rms"], QUANTITIES), limits={})
    with (
        Journal(tmp_path / "runs", PURPOSE) as journal,
        pytest.raises(UserError, match="the LC, which in this scenario has no steady_rms yet at the end of a run"),
    ):
        pareto(tilt, asked, tuned(tilt, design), GRID, journal, 2)


# The command

TINY = ("--a-min", "1,0.5", "--b-max", "1", "--u-max", "1.5", "--mu", "1", "--draws", "2", "--held-out", "4")
SMALL = (*TINY, "--population", "6", "--generations", "2", "--workers", "1", "--set", "run.duration=0.3")


def test_the_command_prints_and_writes_the_front_and_says_when_none_keeps_the_limits(elsewhere):
    arguments = ("tune", "tilt", "--pareto", "integral,energy", *SMALL)
    done = finished(started(*arguments, "--limit", "energy=3", cwd=elsewhere))
    assert (done.returncode, done.stderr) == (0, "")
    folder = Path("results/tune_tilt")
    for name in WRITTEN:
        assert f"wrote {folder / name}" in done.stdout
    assert "the front, 4 draws that the search did not see; change over the LC" in done.stdout
    assert "chosen: a_min " in done.stdout
    assert "the LC gains: with ∫V² dt at most 3 times the LC's" in done.stdout
    done = ended(*arguments, "--limit", "energy=0.001", cwd=elsewhere)
    assert (done.returncode, done.stderr) == (0, "")
    assert "the LC does not gain: no point of the front keeps ∫V² dt at most 0.001 times the LC's" in done.stdout
    assert f"removed {folder / 'best.toml'}" in done.stdout
    assert sorted(path.name for path in (elsewhere / folder).iterdir()) == ["front.csv", "front.png", "runs.sqlite"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ("--limit", "energy=1"),
            "--over, --gain, --linear, --limit, --goal, --case, --hold, --reference, --population, --generations, --held",
        ),
        (("--pareto", "settling,energy", "--measure", "energy"), "--measure and --most-chattering are for the rule"),
        (("--pareto", "settling,elegance"), "an objective must be one of integral, rms, settling, energy, variation"),
        (("--pareto", "settling,energy", "--population", "2"), "population must be at least 4, found 2"),
        (("--pareto", "settling,energy", "--over", "controller.lwa=1..2"), "controller.lwa cannot be tuned"),
    ],
)
def test_a_mistake_is_one_sentence(tmp_path, fmus, arguments, sentence):
    done = ended("tune", "tilt", "--fmus", fmus, *arguments, cwd=tmp_path)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert done.stderr.startswith(f"error: {sentence}")
    assert list(tmp_path.iterdir()) == []


def test_without_the_optimizer_the_extra_is_named(elsewhere, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pymoo.algorithms.moo.nsga2", None)
    done = ended("tune", "tilt", "--pareto", "integral,energy", *SMALL, cwd=elsewhere)
    assert (done.returncode, done.stderr) == (2, 'error: tune --pareto needs pymoo: pip install "qube-ihc[pareto]"\n')
