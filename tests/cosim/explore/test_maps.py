"""What a click in a map sets, and where the marks of what is set lie."""

import math

import pytest

from cosim.errors import UserError
from cosim.explore.adjustables import controller_of, groups_of
from cosim.explore.maps import FrontMap, RegionMap, commands_of, maps_of
from cosim.metric_meanings import QUANTITIES
from cosim.scenario import load_scenario
from tests.cosim.explore.studied import write_front, write_region

A_MIN, B_MAX, U_MAX = "controller.start.a_min", "controller.start.b_max", "controller.u_max"
DELTA, RATE = "plant.start.delta_0", "plant.start.delta_dot_0"


@pytest.fixture(scope="module")
def page(fmus):
    """The scenario `tilt`, its groups and their members."""
    scenario, folder = load_scenario("tilt")
    groups = groups_of(scenario, fmus, folder, controller_of(scenario, fmus, folder), 10.0)
    return scenario, groups, {m.entry: m for group in groups for m in group.members}


def only_map(page, results):
    """Return the one map that is found in the results."""
    scenario, _, members = page
    (found,), said = maps_of(scenario, members, QUANTITIES, results)
    assert said == []
    return found


def test_a_click_in_a_region_sets_the_initial_state_and_the_mark_is_there(page, tmp_path):
    write_region(tmp_path / "region_tilt")
    drawn = only_map(page, tmp_path)
    assert isinstance(drawn, RegionMap)
    values = drawn.chosen({"run.seed": 3}, {"at": [0.602, 0.2501]})
    assert values == {"run.seed": 3, DELTA: 0.2, RATE: -4.0}  # in steps of about a pixel
    (mark,) = drawn.marks(values, {})
    assert mark["cross"] == pytest.approx([0.6, 0.25])
    assert drawn.marks({DELTA: 2.0}, {}) == [{"cross": None}]
    (panel,) = drawn.drawn()["panels"]
    assert [text for _, text in panel["x"]["ticks"]] == ["−1", "−0.5", "0", "0.5", "1"]
    assert panel["x"]["label"] == "plant.delta_0 [rad]"
    # the middle two of four columns are attracted: the border is their left and right side, in four cells each
    assert panel["lines"][0]["d"].count("V") == 8
    assert panel["shades"]["high"] == "1.25"


def test_a_line_has_its_curves_and_a_click_sets_one_value(page, tmp_path):
    write_region(tmp_path / "region_tilt", ("plant.delta_0",))
    drawn = only_map(page, tmp_path)
    assert drawn.chosen({}, {"at": [0.25, 0.9]}) == {DELTA: -0.5}
    assert drawn.marks({DELTA: 0.5}, {}) == [{"cross": [0.75, None]}]
    (panel,) = drawn.drawn()["panels"]
    assert panel["lines"][0]["d"].startswith("M0.25 ")
    assert (panel["lines"][0]["d"].count("M"), panel["lines"][0]["d"].count("L")) == (1, 2)


@pytest.mark.parametrize(
    "click", [None, {}, {"at": None}, {"at": [0.5]}, {"at": [0.5, "1"]}, {"at": [0.5, math.nan]}, {"key": 0}, "x"]
)
def test_a_click_that_is_none_is_a_sentence(page, tmp_path, click):
    write_region(tmp_path / "region_tilt")
    with pytest.raises(UserError, match="a click must be"):
        only_map(page, tmp_path).chosen({}, click)


def test_a_click_on_a_front_sets_the_points_parameters_and_takes_back_the_others(page, tmp_path):
    write_front(tmp_path / "tune_tilt")
    drawn = only_map(page, tmp_path)
    assert isinstance(drawn, FrontMap)
    (panel,) = drawn.drawn()["panels"]
    assert (panel["title"], panel["x"]["label"], panel["y"]["label"]) == (
        "∫V² dt over settling",
        "settling [s]",
        "∫V² dt [V² s]",
    )
    assert [(p["shape"], p["key"]) for p in panel["points"]] == [("circle", 0), ("circle", 1), ("diamond", None)]
    assert panel["points"][0]["text"].startswith("chosen: settling [s] 1, ∫V² dt [V² s] 0.4; a_min 0.4, b_max 1.5")
    values = drawn.chosen({DELTA: 0.2, A_MIN: 0.7}, {"key": 0})
    assert values == {DELTA: 0.2, A_MIN: 0.4, B_MAX: 1.5, U_MAX: 2.0}
    metrics = {"LC": {"settling_time": 1.7, "energy": 0.43}, "IHC": {"settling_time": 1.1, "energy": 0.65}}
    (mark,) = drawn.marks(values, metrics)
    assert mark["keys"] == [0]
    assert mark["cross"][1] == pytest.approx(0.5, abs=0.02)  # midway from 0.4 to 0.9
    assert drawn.marks({}, {"IHC": {"settling_time": math.nan, "energy": 1.0}}) == [{"cross": None, "keys": []}]
    for click in ({"key": 2}, {"key": -1}, {"key": 9}, {"key": "0"}, {"at": [0, 0]}):
        with pytest.raises(UserError, match="a click must be on a point that has parameters"):
            drawn.chosen({}, click)


def test_what_the_page_cannot_set_is_not_drawn_but_said(page, tmp_path):
    scenario, _, members = page
    write_region(tmp_path / "region_tilt")
    write_front(tmp_path / "tune_tilt")
    for path, old, new in (
        ("region_tilt/region.json", "start.delta_0", "fmu"),
        ("tune_tilt/front.csv", "u_max", "law"),
    ):
        text = (tmp_path / path).read_text(encoding="utf-8")
        (tmp_path / path).write_text(text.replace(old, new), encoding="utf-8")
    maps, said = maps_of(scenario, members, QUANTITIES, tmp_path)
    assert maps == []
    assert said[0].endswith("region.json: the axis plant.fmu is no number that this page sets")
    assert said[1].endswith("front.csv: law is no number that this page sets")


def test_the_commands_by_which_maps_come_are_told(page):
    _, groups, _ = page
    assert commands_of(groups, QUANTITIES, ["LC", "IHC"], ["my run.toml", "--fmus", "."]) == {
        "region of attraction": "qube-ihc region 'my run.toml' --fmus . --over plant.delta_0=-0.5..0.5 "
        "--over plant.delta_dot_0=-5..5",
        "front": "qube-ihc tune 'my run.toml' --fmus . --pareto settling,energy,variation",
    }
    assert list(commands_of(groups, QUANTITIES, ["LC"], ["tilt"])) == ["region of attraction"]
