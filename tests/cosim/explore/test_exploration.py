"""The scenario behind the page: what is shown is what a run gives, and what is written runs to the same."""

import pytest

import cosim
from cosim.errors import UserError
from cosim.explore import exploration
from cosim.explore.exploration import Exploration, NotWantedError, Wanted
from cosim.scenario import load_scenario
from cosim.tables import side_by_side


@pytest.fixture
def explored(fmus):
    """Make an exploration of a built-in scenario, short."""

    def make(name="tilt", **changes):
        scenario, folder = load_scenario(name)
        return Exploration(scenario.changed({"run.duration": 0.5, **changes}), folder, fmus)

    return make


MU, SCALE = "controller.mu", "controller.u_max"


def shown(explored, values=None):
    return explored.outcome(Wanted(["LC", "IHC"], values or {}), lambda: True)


def test_what_is_shown_is_what_the_runs_give(explored, fmus):
    set_up = explored()
    changes = {"controller.start.a_min": 0.3, "plant.start.delta_0": 0.05}
    outcome = shown(set_up, changes)
    assert outcome.headings == ["", "LC", "IHC", "IHC over LC"]
    runs = [
        cosim.run(set_up.base.changed({**changes, "controller.start.law": law}), fmus=fmus) for law in ("LC", "IHC")
    ]
    cells = {row[0]: row[1:] for row in side_by_side([cosim.evaluate(run) for run in runs])}
    rows = {row[0]: row[1:3] for row in outcome.rows}
    assert rows.pop("kept upright") == ["yes", "yes"]
    assert rows == {name: cells[name] for name in rows}
    assert {"settling [s]", "∫|q|² dt [rad² s]", "∫V² dt [V² s]"} <= rows.keys()
    assert [chart["label"] for chart in outcome.drawn["charts"]][:2] == ["arm θ [rad]", "pendulum δ [rad]"]
    assert "between" in outcome.drawn["charts"][0]["text"]


def test_mu_and_the_scale_of_p_are_the_ihcs_alone(explored):
    set_up = explored("tilt_ideal")
    before = shown(set_up)
    after = shown(set_up, {MU: 0.5, SCALE: 3.0})
    pairs = [(row[1:3], other[1:3]) for row, other in zip(before.rows, after.rows, strict=True) if row[0][0] == "∫"]
    assert [lc == same for (lc, _), (same, _) in pairs] == [True] * len(pairs)
    assert [ihc != other for (_, ihc), (_, other) in pairs] == [True] * len(pairs)


@pytest.mark.parametrize(
    "values",
    [
        {"controller.start.a_min": 0.3, "run.seed": 7},
        {MU: 0.7, SCALE: 2.0, "controller.start.voltage_limit": 8.0},
        {"controller.disturbance_noise": 0.6},
    ],
)
def test_what_is_written_runs_to_the_same(values, explored, fmus, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    set_up = explored("tilt_kalman")
    outcome = shown(set_up, values)
    assert set_up.write("mine.toml", values).endswith(f"it runs by: qube-ihc run mine.toml --fmus '{fmus}'")
    metrics = cosim.evaluate(cosim.run("mine.toml", fmus=fmus))
    assert [row[2] for row in shown(set_up).rows] != [row[2] for row in outcome.rows]
    assert {row[0]: row[2] for row in outcome.rows}["∫|q|² dt [rad² s]"] == f"{metrics.integral_q2:.4g}"
    assert set_up.write("mine", values)  # its own file is replaced


def test_a_file_of_somebody_else_stays_and_nothing_is_written_beside_it(explored, tmp_path):
    set_up = explored()
    (tmp_path / "mine.toml").write_text("mine", encoding="utf-8")
    with pytest.raises(UserError, match="was not written by qube-ihc and stays"):
        set_up.write("mine", {SCALE: 2.0}, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]
    with pytest.raises(UserError, match="the name must be a plain one"):
        set_up.write("../mine", {}, tmp_path)
    with pytest.raises(UserError, match="a_min must lie in"):
        set_up.write("other", {"controller.start.a_min": -5.0}, tmp_path)
    assert not (tmp_path / "other.toml").exists()


def test_what_lies_beside_the_scenario_goes_along_but_not_over_another_file(elsewhere, tmp_path_factory):
    (elsewhere / "beside").mkdir()
    for fmu in (elsewhere / "fmus").glob("*.fmu"):
        fmu.rename(elsewhere / "beside" / fmu.name)
    (elsewhere / "beside" / "own.toml").write_text("[run]\nduration = 0.1\n", encoding="utf-8")
    scenario, folder = load_scenario(elsewhere / "beside" / "own.toml")
    set_up = Exploration(scenario, folder, elsewhere / "fmus")
    target = tmp_path_factory.mktemp("target")
    set_up.write("mine", {}, target)
    assert sorted(path.name for path in target.iterdir()) == ["IhcController.fmu", "QubeServo2.fmu", "mine.toml"]
    (target / "QubeServo2.fmu").write_bytes(b"another")
    with pytest.raises(UserError, match=r"is another file than .* and stays"):
        set_up.write("mine", {}, target)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"controller.start.a_min": -1.0}, r"a_min must lie in \[1e-06, 1e\+12\]"),
        ({MU: 1.5}, r"mu must lie in \(0, 1\], found 1.5"),
        ({"controller.bias_noise": -1.0}, "bias_noise must be positive and finite, found -1"),
        ({"controller.k_lin_1": -3.0}, r"K must stabilize \(A, B\)"),
        ({"run.seed": -3}, "run.seed must be greater than or equal to 0, found -3"),
    ],
)
def test_a_value_that_cannot_be_is_a_sentence(explored, values, sentence):
    with pytest.raises(UserError, match=sentence):
        shown(explored(), values)


def test_a_run_that_is_not_wanted_any_more_is_given_up(explored, monkeypatch):
    monkeypatch.setattr(exploration, "PATIENCE", 0.0)
    with pytest.raises(NotWantedError):
        explored().outcome(Wanted(["LC"], {"run.duration": 100.0}), lambda: False)
