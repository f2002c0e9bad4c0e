"""The comparison of the laws: equal to single runs, the same draws for all laws, and what the runs must show."""

import csv
import dataclasses
import hashlib
import json
import math

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.metric_meanings import QUANTITIES
from cosim.metrics import Metrics, evaluate
from cosim.results import Result, SimulationError
from cosim.scenario import Scenario, load_scenario
from cosim.scenario_run import run_scenario
from cosim.studies.comparison import Comparison, Draw
from cosim.studies.draws import drawn
from cosim.studies.experiments import Experiment, run_experiments

FILTER = {"controller.start.velocity_source": "filter"}


@pytest.fixture(scope="session")
def experiment():
    scenario, folder = load_scenario("tilt")
    return Experiment(scenario.changed({"run.duration": 0.3, "plant.start.noise_std": 1e-4}), folder, 2)


@pytest.fixture(scope="session")
def compared(experiment, fmus):
    """Two laws, two draws, two threads; and what the progress said."""
    seen = []
    (comparison,) = run_experiments([experiment], fmus, ("LC", "IHC"), 2, lambda *counts: seen.append(counts))
    return comparison, seen


@pytest.fixture(scope="session")
def single_runs(experiment, fmus):
    def run(law, number):
        return run_scenario(
            drawn(experiment.scenario, number).changed({"controller.start.law": law}), fmus, experiment.folder
        )

    return {(law, number): run(law, number) for law in ("LC", "IHC") for number in (1, 2)}


# The machinery


def test_a_comparison_equals_single_runs(compared, single_runs, same):
    comparison, seen = compared
    assert {(d.law, d.number): d.metrics.as_dict() for d in comparison.draws} == {
        key: pytest.approx(evaluate(result).as_dict(), rel=0, abs=0, nan_ok=True) for key, result in single_runs.items()
    }
    typical = sorted((d for d in comparison.draws if d.law == "LC"), key=lambda d: d.metrics.steady_rms)[1].number
    for law, result in comparison.results.items():
        same(result, single_runs[law, typical])
    assert seen == [(k, 4) for k in (1, 2, 3, 4)]


def test_all_laws_see_the_same_measurement(compared):
    comparison, _ = compared
    starts = [result.metadata["start_values"]["plant"] for result in comparison.results.values()]
    assert starts[0] == starts[1]
    assert {"theta_encoder_offset", "delta_encoder_offset", "noise_seed"} <= starts[0].keys()
    laws = [result.metadata["start_values"]["controller"]["law"] for result in comparison.results.values()]
    assert laws == [1, 3]


def test_without_draws_a_scenario_runs_once_as_it_stands(experiment, fmus, same):
    (comparison,) = run_experiments([Experiment(experiment.scenario, experiment.folder)], fmus, ("SMC",), 1)
    assert [(d.law, d.number) for d in comparison.draws] == [("SMC", None)]
    alone = run_scenario(experiment.scenario.changed({"controller.start.law": "SMC"}), fmus, experiment.folder)
    same(comparison.results["SMC"], alone)


def test_metrics_are_of_every_row_whatever_the_scenario_records(experiment, fmus, compared):
    thinned = Experiment(experiment.scenario.changed({"record.every": 7}), experiment.folder, 1)
    (comparison,) = run_experiments([thinned], fmus, ("LC",), 1)
    assert comparison.draws[0].metrics.energy == compared[0].draws[0].metrics.energy
    assert len(comparison.results["LC"].time) < 60


def test_what_a_run_refuses_the_comparison_refuses(experiment, fmus):
    wrong = Experiment(experiment.scenario.changed({"controller.start.a_min": -1.0}), experiment.folder, 2)
    with pytest.raises(UserError, match=r"controller\.a_min must lie in"):
        run_experiments([wrong], fmus, ("LC",), 1)


def metrics_of(*values):
    return Metrics(dict(zip(QUANTITIES, values, strict=True)), QUANTITIES)


def draws(law, *settling, kept=(), rms=0.1, steady=1.0):
    """Draws of a law that settle when given and keep the pendulum, those in `kept` aside, which say it themselves."""
    kept = dict(enumerate(kept, start=1))
    return [
        Draw(law, n, kept.get(n, True), metrics_of(t, 1.0, rms * n, steady, 2.0 + n, 3.0, 4.0, 0.001, 1))
        for n, t in enumerate(settling, start=1)
    ]


def comparison_of(*of_laws):
    return Comparison(Scenario(), tuple(draw for of_law in of_laws for draw in of_law), {})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda found: found.value("LC", "energie"),
            r"the metric must be one of .*, found 'energie'; did you mean energy",
        ),
        (lambda found: found.value("PID", "energy"), "the law must be one of LC, IHC, found 'PID'"),
        (lambda found: found.change("IHC", "PID", "energy"), "the law must be one of LC, IHC, found 'PID'"),
        (lambda found: found.kept(None), "the law must be one of LC, IHC, found None"),
    ],
)
def test_a_law_or_metric_that_was_not_compared_is_named(call, message):
    with pytest.raises(UserError, match=f"^{message}"):
        call(comparison_of(draws("LC", 1.0), draws("IHC", 1.0)))


NEVER = math.nan


@pytest.mark.parametrize(
    ("settling", "value"),
    [((3.0, 1.0, 2.0), 2.0), ((NEVER, 1.0, 1.0), 4.0), ((NEVER, NEVER, 2.0, 2.0), 6.0), ((NEVER,), NEVER)],
)
def test_a_draw_that_never_settles_counts_the_runs_duration(settling, value):
    found = comparison_of(draws("LC", *settling))
    assert found.value("LC", "settling_time").value == pytest.approx(value, nan_ok=True)
    said = "never settled, counted as 10 s: LC" in " ".join(found.remarks())
    assert said == (len(settling) > 1 and any(map(math.isnan, settling)))


def test_the_steady_state_is_a_root_mean_square_and_energy_a_mean():
    found = comparison_of(draws("LC", 1.0, 1.0, 1.0))
    assert found.value("LC", "steady_rms").value == pytest.approx(0.1 * math.sqrt(14 / 3))
    assert found.value("LC", "energy").value == 4.0


def test_a_lost_pendulum_is_counted_and_not_averaged():
    found = comparison_of(draws("LC", 1.0, 2.0, 3.0, kept=(True, False)), draws("IHC", 4.0, 5.0, 9.0, kept=(False,)))
    assert (found.kept("LC"), found.value("LC", "settling_time").value) == (2, 2.0)
    assert found.change("IHC", "LC", "settling_time").value == pytest.approx(2.0)  # the third draw alone
    assert found.remarks() == ["pendulum lost, and not in the means unless in all draws: LC 1, IHC 1 of 3"]
    lost = comparison_of(draws("LC", 1.0, 2.0, kept=(False, False)))
    assert (lost.kept("LC"), lost.value("LC", "settling_time").value) == (0, 1.5)


@pytest.mark.parametrize(("trend", "steady"), [(1.0, True), (2.5, False), (math.nan, False)])
def test_without_a_steady_state_none_is_compared_and_the_reader_is_told(trend, steady):
    found = comparison_of(draws("LC", 1.0, 1.0), draws("IHC", 1.0, 1.0, rms=0.05, steady=trend))
    assert [found.steady(law) for law in ("LC", "IHC")] == [True, steady]
    for name in ("steady_rms", "voltage_variation"):
        assert math.isnan(found.change("IHC", "LC", name).value) != steady
    assert not math.isnan(found.change("IHC", "LC", "energy").value)
    assert any("* not steady: |q| of IHC has a trend" in remark for remark in found.remarks()) != steady


def test_a_quarter_of_the_draws_may_look_unsteady_by_chance():
    many = draws("LC", *[1.0] * 8)
    for loose, steady in ((2, True), (3, False)):
        mixed = [
            dataclasses.replace(d, metrics=Metrics({**d.metrics.values, "steady_trend": 2.0}, QUANTITIES))
            for d in many[:loose]
        ]
        assert comparison_of([*mixed, *many[loose:]]).steady("LC") == steady


def test_zero_is_not_compared_with_zero():
    found = comparison_of(draws("LC", 1.0, 1.0, rms=1e-5), draws("IHC", 1.0, 1.0, rms=1e-18))
    assert math.isnan(found.change("IHC", "LC", "steady_rms").value)


def test_saved_tables_are_read_back_exactly(compared, tmp_path, same):
    comparison, _ = compared
    comparison.save(tmp_path)
    rows = list(csv.DictReader((tmp_path / "comparison.csv").open(encoding="utf-8")))
    assert [(r["law"], int(r["draw"]), r["kept"]) for r in rows] == [(d.law, d.number, "1") for d in comparison.draws]
    for row, draw in zip(rows, comparison.draws, strict=True):
        expected = [draw.metrics.as_dict()[n] for n in QUANTITIES]
        np.testing.assert_array_equal([float(row[n]) for n in QUANTITIES], expected)
        start = drawn(comparison.scenario, draw.number).plant.start
        assert all(float(row[name]) == start[name] for name in ("theta_encoder_offset", "delta_encoder_offset"))
    about = json.loads((tmp_path / "comparison.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert about["draws"] == 2
    assert Scenario.model_validate(about["scenario"]) == comparison.scenario
    for law, result in comparison.results.items():
        same(Result.load(tmp_path / f"{law}.csv"), result)
        for name in comparison.shown:
            found = comparison.value(law, name)
            expected = [None if math.isnan(v) else v for v in (found.value, found.half_width)]
            assert about["laws"][law][name] == expected
    assert about["laws"]["LC"]["settling_time"] == [None, None]


def test_a_comparison_names_its_files_and_leaves_nothing_of_an_earlier_one(compared, tmp_path):
    comparison, _ = compared
    comparison.save(tmp_path)
    for mine in ("mine.csv", "LC.csv"):
        (tmp_path / mine).write_text("mine", encoding="utf-8")
    fewer = dataclasses.replace(comparison, results={"IHC": comparison.results["IHC"]})

    def fail(folder):
        (folder / "angles.png").write_bytes(b"picture")
        raise UserError(f"{folder / 'angles.png'} cannot be drawn")

    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(UserError, match=f"^{tmp_path}/angles.png cannot be drawn$"):
        fewer.save(tmp_path, fail)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    fewer.save(tmp_path, lambda folder: (folder / "angles.png").write_bytes(b"picture"))
    about = json.loads((tmp_path / "comparison.json").read_text(encoding="utf-8"))
    expected = ["IHC.csv", "IHC.json", "angles.png", "comparison.csv"]
    assert list(about["files"]) == expected
    assert all(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == d for name, d in about["files"].items())
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == sorted([*expected, "comparison.json", "LC.csv", "mine.csv"])  # LC.json is gone, what is mine is not


# What the laws do


def test_with_the_true_state_the_homogeneous_law_settles_long_before_the_linear_one(fmus):
    scenario, folder = load_scenario("tilt_ideal")

    def settling(law):
        changes = {"controller.start.law": law, "run.duration": 3.0}
        return evaluate(run_scenario(scenario.changed(changes), fmus, folder)).settling_time

    assert settling("LC") == pytest.approx(1.74, abs=0.05)
    assert settling("IHC") == pytest.approx(0.73, abs=0.05)


@pytest.fixture(scope="session")
def swing_ups(fmus):
    scenario, folder = load_scenario("swing_up")

    def run(law, seed):
        changes = {"controller.start.law": law, "run.seed": seed, "run.duration": 7.0, **FILTER}
        return evaluate(run_scenario(scenario.changed(changes), fmus, folder))

    return {law: [run(law, seed) for seed in (1, 2, 3, 4)] for law in ("LC", "IHC")}


def test_the_swing_up_captures_once_and_soon(swing_ups):
    for found in (*swing_ups["LC"], *swing_ups["IHC"]):
        assert found.captures == 1
        assert 0.3 < found.capture_time < 1.5


def test_with_encoders_and_filter_the_homogeneous_law_rests_closer_to_upright(swing_ups):
    rest = {law: np.mean([found.steady_rms for found in all_found]) for law, all_found in swing_ups.items()}
    assert rest["IHC"] < rest["LC"] < 0.02


def test_a_run_that_fails_in_a_worker_fails_the_comparison_with_its_cause(experiment, fmus):
    wrong = Experiment(experiment.scenario.changed({"plant.start.measurement_delay": 0.0015}), experiment.folder, 2)
    with pytest.raises(SimulationError, match="measurement_delay must be a multiple of the communication") as failure:
        run_experiments([wrong], fmus, ("LC",), 1)
    assert (failure.value.instance, failure.value.time, len(failure.value.result.time)) == ("plant", 0.0, 1)
