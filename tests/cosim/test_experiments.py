"""The comparison of the laws: equal to single runs, the same draws for all laws, and what the runs must show."""

import csv
import dataclasses
import hashlib
import json
import math

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.experiments import Comparison, Draw, Study, compare
from cosim.master import SimulationError
from cosim.metrics import NAMES, Metrics, evaluate
from cosim.results import Result
from cosim.scenario import Scenario, load_scenario, run_scenario

SEEDS = (3, 8)
FILTER = {"controller.start.velocity_source": "filter"}


@pytest.fixture(scope="session")
def study():
    scenario, folder = load_scenario("tilt")
    return Study(scenario.changed({"run.duration": 0.3, "plant.start.noise_std": 1e-4}), folder, SEEDS)


@pytest.fixture(scope="session")
def compared(study, fmus):
    """Two laws, two seeds, two threads; and what the progress said."""
    seen = []
    (comparison,) = compare([study], fmus, ("LC", "IHC"), 2, lambda *counts: seen.append(counts))
    return comparison, seen


@pytest.fixture(scope="session")
def single_runs(study, fmus):
    def run(law, seed):
        changed = study.scenario.changed({"controller.start.law": law, "run.seed": seed})
        return run_scenario(changed, fmus, study.folder)

    return {(law, seed): run(law, seed) for law in ("LC", "IHC") for seed in SEEDS}


# The machinery


def test_a_comparison_equals_single_runs(compared, single_runs, same):
    comparison, seen = compared
    assert {(d.law, d.seed): d.metrics.as_dict() for d in comparison.draws} == {
        key: pytest.approx(evaluate(result).as_dict(), rel=0, abs=0, nan_ok=True) for key, result in single_runs.items()
    }
    for law, result in comparison.results.items():
        same(result, single_runs[law, result.metadata["scenario"]["run"]["seed"]])
    assert seen == [(k, 4) for k in (1, 2, 3, 4)]


def test_all_laws_see_the_same_measurement_and_the_typical_draw_is_the_first_laws(compared):
    comparison, _ = compared
    starts = [result.metadata["start_values"]["plant"] for result in comparison.results.values()]
    assert starts[0] == starts[1]
    assert {"theta_encoder_offset", "delta_encoder_offset", "noise_seed"} <= starts[0].keys()
    first = sorted((d for d in comparison.draws if d.law == "LC"), key=lambda d: d.metrics.steady_rms)
    assert comparison.results["IHC"].metadata["scenario"]["run"]["seed"] == first[1].seed
    laws = [result.metadata["start_values"]["controller"]["law"] for result in comparison.results.values()]
    assert laws == [1, 3]


def test_without_seeds_a_scenario_runs_once_as_it_stands(study, fmus, same):
    (comparison,) = compare([Study(study.scenario, study.folder)], fmus, ("SMC",), 1)
    assert [(d.law, d.seed) for d in comparison.draws] == [("SMC", None)]
    alone = run_scenario(study.scenario.changed({"controller.start.law": "SMC"}), fmus, study.folder)
    same(comparison.results["SMC"], alone)


def test_what_a_run_refuses_the_comparison_refuses(study, fmus):
    wrong = Study(study.scenario.changed({"controller.start.a_min": -1.0}), study.folder, SEEDS)
    with pytest.raises(UserError, match=r"controller\.a_min must lie in"):
        compare([wrong], fmus, ("LC",), 1)


def draws(law, *settling, captures=1):
    return [Draw(law, seed, Metrics(t, 1.0, 0.1, 2.0, 3.0, 4.0, t, captures)) for seed, t in enumerate(settling)]


@pytest.mark.parametrize(
    ("settling", "median"),
    [
        ((3.0, 1.0, 2.0), 2.0),
        ((4.0, 1.0, 2.0, 3.0), 2.5),
        ((math.nan, 1.0, 2.0), 2.0),
        ((math.nan, math.nan, 2.0), math.nan),
        ((math.nan, math.nan, 1.0, 2.0), math.nan),
        ((math.nan,), math.nan),
    ],
)
def test_a_draw_that_never_settles_counts_as_infinitely_late(settling, median):
    comparison = Comparison(Scenario(), tuple(draws("LC", *settling) + draws("IHC", 9.0)), {})
    assert comparison.median("LC", "settling_time") == pytest.approx(median, nan_ok=True)
    assert comparison.median("IHC", "settling_time") == 9.0
    assert comparison.median("LC", "energy") == 2.0


def test_saved_tables_are_read_back_exactly(compared, tmp_path, same):
    comparison, _ = compared
    comparison.save(tmp_path)
    rows = list(csv.DictReader((tmp_path / "comparison.csv").open(encoding="utf-8")))
    assert [(r["law"], int(r["seed"])) for r in rows] == [(d.law, d.seed) for d in comparison.draws]
    for row, draw in zip(rows, comparison.draws, strict=True):
        expected = [draw.metrics.as_dict()[n] for n in NAMES]
        np.testing.assert_array_equal([float(row[n]) for n in NAMES], expected)
    about = json.loads((tmp_path / "comparison.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert about["draws"] == 2
    assert Scenario.model_validate(about["scenario"]) == comparison.scenario
    for law, result in comparison.results.items():
        same(Result.load(tmp_path / f"{law}.csv"), result)
        for name in NAMES:
            value = comparison.median(law, name)
            assert about["median"][law][name] == (None if math.isnan(value) else value)


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


def test_never_is_null_in_the_table_of_medians(made_result, tmp_path):
    result = made_result([0.0, 1.0])
    Comparison(Scenario(), tuple(draws("LC", math.nan)), {"LC": result}).save(tmp_path)
    about = json.loads((tmp_path / "comparison.json").read_text(encoding="utf-8"))
    assert (about["median"]["LC"]["settling_time"], about["median"]["LC"]["energy"]) == (None, 2.0)
    assert "LC,0,nan,1.0" in (tmp_path / "comparison.csv").read_text(encoding="utf-8")


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


def test_a_run_that_fails_in_a_worker_fails_the_comparison_with_its_cause(study, fmus):
    wrong = Study(study.scenario.changed({"controller.start.sample_time": 0.0015}), study.folder, SEEDS)
    with pytest.raises(SimulationError, match="sample_time must be a multiple of the communication step") as failure:
        compare([wrong], fmus, ("LC",), 1)
    assert (failure.value.instance, failure.value.time, len(failure.value.result.time)) == ("controller", 0.0, 1)
