"""The experiments as scenarios: one per key, equal draws for all controllers, files that repeat a run; numbers of a run."""

import math
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from cosim.metrics import evaluate
from cosim.paper import printed
from cosim.paper.study import (
    ANGLE_SPREAD,
    COMPARED,
    EXPERIMENTS,
    FULL,
    GAINS,
    PURPOSE,
    QUICK,
    REFERENCE,
    SAMPLE_TIMES,
    SETS,
    SIGNALS,
    SWING_UP_RANGES,
    UNCERTAIN,
    UNCERTAINTY,
    Key,
    Study,
    draw_changes,
    numbers,
    scenario_name,
    swing_up_changes,
    thinned,
)
from cosim.paper.variants import sweep_name
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from cosim.scenario_system import build_system
from cosim.studies.journal import Journal
from ihc_fmu.pendulum.interface import INTERFACE as CONTROLLER
from plant_fmu.interface import start_values as plant_start_values
from plant_fmu.parameters import QubeParameters

BEYOND = ("IHC 1.5 V", "LC, KF", "IHC, KF")
SEEDS = range(1, 201)


def all_keys(study):
    return [key for keys in study.keys().values() for key in keys]


# Scenarios


def test_the_same_key_gives_the_same_scenario(study, fmus, tiny_size):
    again = Study(Path("elsewhere"), fmus, tiny_size)
    for key in all_keys(study):
        assert study.scenario(key) == study.scenario(key) == again.scenario(key)


def test_different_keys_give_different_scenarios(study):
    scenarios = {study.scenario(key).changed({"name": "any"}).model_dump_json() for key in all_keys(study)}
    assert len(scenarios) == len(all_keys(study))


@pytest.mark.parametrize("size", ["tiny_size", QUICK, FULL], ids=["tiny", "quick", "full"])
def test_names_of_scenarios_are_unique_and_safe_as_file_names(request, size):
    size = request.getfixturevalue(size) if isinstance(size, str) else size
    keys = all_keys(Study(Path(), Path(), size))
    names = [scenario_name(key) for key in keys]
    assert len(set(names)) == len(set(keys)) == len(keys)
    assert len({name.lower() for name in names}) == len(names)  # some file systems know no case
    assert all(re.fullmatch(r"[A-Za-z0-9][\w.-]*", name, re.ASCII) for name in names)
    assert max(map(len, names)) < 100


def test_a_name_says_what_the_run_is():
    key = Key("tilt", "hcs", 1e-4, 60, "IHC, KF", 7)
    assert scenario_name(key) == "tilt_IHC-KF_hcs_0.1ms_G60_draw7"
    assert scenario_name(Key("reference", "ident", 2e-3, 0, "LC", 0)) == "reference_LC_ident_2ms"
    assert (
        scenario_name(Key("chattering", "ident", 1e-3, 0, sweep_name("1.5 V, filter", 0.65), 1))
        == "chattering_IHC-1.5-V-filter-a_min0.65_ident_1ms_draw1"
    )


def test_a_scenario_has_what_its_key_says(study):
    for key in all_keys(study):
        scenario = study.scenario(key)
        assert scenario.name == scenario_name(key)
        assert (scenario.run.step, scenario.run.duration) == (key.step, 10.0)
        assert scenario.plant.parameters == key.parameters
        assert scenario.disturbance.gain == key.gain
        assert scenario.record.outputs == SIGNALS
        assert scenario.controller.start["law"] == ("SMC" if "SMC" in key.variant else key.variant[:3].strip(" ,"))
        drawn = key.draw if key.draw and key.experiment != "swing-ups" else study.base.run.seed
        assert scenario.run.seed == drawn


def test_the_reference_run_is_the_built_in_scenario_with_its_controller(study):
    """Draw 0 draws nothing."""
    base = study.base
    for key in study.keys()["reference"]:
        scenario = study.scenario(key)
        assert scenario.plant == base.plant
        assert (scenario.run, scenario.record) == (base.run, base.record)
        assert scenario.disturbance == base.changed({"disturbance.gain": float(key.gain)}).disturbance
        assert base.controller.start.items() <= scenario.controller.start.items()


def test_what_each_experiment_changes(study):
    own = REFERENCE[0]
    scenarios = {
        name: study.scenario(Key(name, own, 1e-3, 60, "LC", 1)) for name in EXPERIMENTS if name != "chattering"
    }
    starts = {name: scenario.disturbance.start for name, scenario in scenarios.items()}
    assert starts == {"reference": 1.5, "swing-up": 1.5, "shipped": 1.1, "tilt": 0.0, "onset": 0.0, "swing-ups": 1.5}
    hanging = {name: abs(float(s.plant.start["delta_0"]) - math.pi) <= ANGLE_SPREAD for name, s in scenarios.items()}
    assert hanging == {name: name != "tilt" for name in scenarios}
    shipped = scenarios["shipped"].controller.start
    assert {name: shipped[name] for name in SWING_UP_RANGES} == {
        name: CONTROLLER.start_values()[name] for name in SWING_UP_RANGES
    }
    own_swing_up = scenarios["swing-up"].controller.start
    assert {n: own_swing_up[n] for n in SWING_UP_RANGES} == {n: study.base.controller.start[n] for n in SWING_UP_RANGES}


def test_all_that_is_compared_takes_over_in_the_same_region(study, fmus):
    """The paper's tables compare laws after the same swing-up: same P and capture, whatever the law."""
    starts = []
    for variant in COMPARED:
        scenario = study.scenario(Key("reference", *REFERENCE, 0, variant, 0))
        start = build_system(scenario, fmus, study.scenarios).components[0].start
        same = {name: value for name, value in start.items() if name.startswith(("P_", "capture_", "swing_up_", "mu"))}
        starts.append(same)
    assert all(start == starts[0] for start in starts)
    assert starts[0].keys() >= {"P_11", "P_44", *SWING_UP_RANGES}


def test_the_designs_are_the_papers_numbers_at_10_V_and_the_default(study, design):
    paper = study.designs["paper.json"]
    assert (paper.mu, paper.alpha, paper.u_max) == (1.0, 1e-3, pytest.approx(10.0, rel=1e-3))
    assert paper.u_max <= 10.0 * (1.0 + 1e-6)
    assert study.designs["default.json"].P.tolist() == design.P.tolist()


# Draws


def plant_start(study, key):
    scenario = study.scenario(key)
    return scenario.plant.start, scenario.run.seed


@pytest.mark.parametrize("experiment", [name for name in EXPERIMENTS if name not in ("reference", "swing-ups")])
def test_a_draw_is_the_same_for_all_controllers_sample_times_and_gains(study, experiment):
    variants = tuple(study.sweep) if experiment == "chattering" else (*COMPARED, *BEYOND)
    for draw in (1, 2, 77):
        keys = [Key(experiment, "ident", h, G, v, draw) for h in SAMPLE_TIMES for G in GAINS for v in variants]
        starts = [plant_start(study, key) for key in keys]
        assert all(start == starts[0] for start in starts)


def test_draws_differ_by_seed_and_the_first_names_none(study):
    draws = [str(plant_start(study, Key("swing-up", *REFERENCE, 0, "LC", draw))) for draw in range(50)]
    assert len(set(draws)) == 50
    assert plant_start(study, Key("swing-up", *REFERENCE, 0, "LC", 0)) == (study.base.plant.start, study.base.run.seed)


@pytest.mark.parametrize("parameters", SETS)
@pytest.mark.parametrize("delta_0", [math.pi, 0.1])
def test_draws_lie_within_their_ranges_and_reach_into_all_of_them(parameters, delta_0):
    """Over 200 draws the outermost ones come within a twentieth of each end, but for a chance of 1e-4 each side."""
    named = plant_start_values(parameters)
    draws = [draw_changes(seed, parameters, delta_0) for seed in SEEDS]
    assert {frozenset(draw) for draw in draws} == {
        frozenset({"run.seed", *(f"plant.start.{n}" for n in ("noise_std", "theta_0", "delta_0", *UNCERTAIN))})
    }
    assert [draw["run.seed"] for draw in draws] == list(SEEDS)
    assert {draw["plant.start.noise_std"] for draw in draws} == {5e-4}

    def reaches(name, centre, spread):
        unit = np.array([(draw[f"plant.start.{name}"] - centre) / spread for draw in draws])
        assert abs(unit).max() <= 1.0 + 1e-9, name
        assert min(unit.max(), -unit.min()) > 0.9, name
        assert abs(unit.mean()) < 4 / math.sqrt(3 * len(draws)), name
        return unit

    units = [reaches("theta_0", 0.0, ANGLE_SPREAD), reaches("delta_0", delta_0, ANGLE_SPREAD)]
    for name in UNCERTAIN:
        value = float(named[name])
        if value:
            units.append(reaches(name, value, UNCERTAINTY * value))
        else:
            assert {draw[f"plant.start.{name}"] for draw in draws} == {0.0}
    correlation = np.corrcoef(units) - np.eye(len(units))
    assert abs(correlation).max() < 5 / math.sqrt(len(draws))  # drawn independently


def test_the_uncertain_parameters_are_all_but_gravity_dry_friction_and_the_unused_inductance():
    physical = {field.name for field in fields(QubeParameters)}
    assert sorted(UNCERTAIN) == sorted(physical - {"g_p", "T_r", "L_m"})


def test_random_swing_ups_are_log_uniform_within_their_ranges():
    draws = [swing_up_changes(seed) for seed in SEEDS]
    for name, (low, high) in SWING_UP_RANGES.items():
        values = np.array([draw[f"controller.start.{name}"] for draw in draws])
        unit = np.log(values / low) / math.log(high / low)
        assert 0.0 <= unit.min() < 0.05, name
        assert 0.95 < unit.max() <= 1.0, name
        assert abs(unit.mean() - 0.5) < 4 / math.sqrt(12 * len(draws)), name
    assert len({str(draw) for draw in draws}) == len(draws)
    assert {len(draw) for draw in draws} == {len(SWING_UP_RANGES)}


def test_random_swing_ups_change_the_swing_up_alone_and_equally_for_both_laws(study):
    for draw in (1, 2):
        lc, ihc = (study.scenario(Key("swing-ups", "ident", 1e-3, 0, law, draw)) for law in ("LC", "IHC"))
        assert lc.plant == ihc.plant == study.base.plant
        assert lc.run == ihc.run
        drawn = {name.rpartition(".")[2]: value for name, value in swing_up_changes(draw).items()}
        for scenario in (lc, ihc):
            assert drawn.items() <= scenario.controller.start.items()


def test_the_built_in_swing_up_lies_within_the_random_ones(study):
    for name, (low, high) in SWING_UP_RANGES.items():
        assert low <= float(study.base.controller.start[name]) <= high, name


# Files


VARIANTS = ("LC", "IHC", "SMC1", "SMC2", *BEYOND)
KEYS = [
    *(Key("reference", *REFERENCE, 200, variant, 0) for variant in VARIANTS),
    *(Key("tilt", parameters, 1e-3, 0, "IHC", 3) for parameters in SETS),
    Key("shipped", "hcs", 2e-3, 60, "SMC2", 4),
    Key("onset", "ident", 1e-3, 200, "IHC, KF", 5),
    Key("swing-ups", "ident", 1e-3, 0, "IHC", 6),
    *(
        Key("chattering", "ident", 1e-3, 0, sweep_name(chain, 0.8), 1)
        for chain in ("10 V, filter", "1.5 V, filter", "1.5 V, Kalman filter")
    ),
]


@pytest.mark.parametrize("key", KEYS, ids=scenario_name)
def test_a_saved_scenario_is_read_back_and_repeats_the_run_to_the_last_bit(study, fmus, same, key):
    scenario = study.scenario(key)
    path = study.save_scenario(key)
    assert path == study.scenarios / f"{scenario.name}.toml"
    loaded, folder = load_scenario(str(path))
    assert loaded == scenario
    short = {"run.duration": 0.04}
    same(
        run_scenario(loaded.changed(short), fmus, folder),
        run_scenario(scenario.changed(short), fmus, study.scenarios),
    )


def test_every_scenario_is_the_same_after_a_file(study, tmp_path):
    elsewhere = Study(tmp_path, study.fmus, study.size)
    for key in all_keys(study)[::3]:
        assert load_scenario(str(elsewhere.save_scenario(key)))[0] == study.scenario(key)
    assert all(file.suffix == ".toml" for file in elsewhere.scenarios.iterdir())


def test_design_files_are_read_back_and_written_the_same_again(study, tmp_path):
    elsewhere = Study(tmp_path, study.fmus, study.size)
    elsewhere.prepare()
    names = sorted(file.name for file in elsewhere.scenarios.iterdir())
    assert names == sorted(study.designs)
    for name in names:
        assert (elsewhere.scenarios / name).read_bytes() == (study.scenarios / name).read_bytes()


# Numbers


TIME = np.arange(10_001) * 1e-3


def test_numbers_of_constant_angles_have_closed_forms(made_result):
    result = made_result(TIME, 0.3, plant_delta=2 * math.pi - 0.4, controller_voltage=2.0)
    values = numbers(result)
    assert {name: values[name] for name in evaluate(result).as_dict()} == pytest.approx(
        evaluate(result).as_dict(), nan_ok=True
    )
    assert values["window_rms"] == pytest.approx(0.5)
    assert (values["window_theta"], values["window_delta"]) == (0.0, pytest.approx(0.0, abs=1e-12))
    assert values["arm_peak"] == 0.3
    assert values["energy_after_capture"] == pytest.approx(40.0)
    assert math.isnan(values["settling_wide"])
    assert values["kept"] == 1.0
    assert all(isinstance(value, float) for value in values.values())


def test_only_the_window_from_5_to_7_s_counts_its_ends_included(made_result):
    inside = (TIME >= 5.0) & (TIME <= 7.0)
    theta = np.where(inside, 0.01 * np.sin(math.pi * TIME), 3.0)
    delta = np.where(inside, math.pi + 0.02 * np.cos(math.pi * TIME), 1.0)  # hanging: wrapped to both sides
    values = numbers(made_result(TIME, theta, plant_delta=delta - math.pi))
    assert values["window_theta"] == pytest.approx(0.02, abs=1e-6)
    assert values["window_delta"] == pytest.approx(0.04, abs=1e-6)
    assert values["window_rms"] == pytest.approx(math.sqrt((0.01**2 + 0.02**2) / 2), rel=1e-2)
    assert numbers(made_result(TIME, np.where(inside, 0.0, 3.0)))["window_rms"] == 0.0


def test_peak_and_energy_begin_at_the_capture(made_result):
    """A row's voltage was held over the step that ended there, so that the first step after the capture counts."""
    on = TIME >= 4.0
    theta = np.where(on, -0.5 * np.exp(-(TIME - 4.0)), 2.0)
    values = numbers(
        made_result(TIME, theta, controller_mode=np.where(on, 3, 2), controller_voltage=np.where(on, 1.5, 9.0))
    )
    assert values["capture_time"] == 4.0
    assert values["arm_peak"] == 0.5
    assert values["energy_after_capture"] == pytest.approx(1.5**2 * 6.001)
    assert values["energy"] == pytest.approx(values["energy_after_capture"] + 81.0 * 3.999)


def test_settling_to_the_wider_tolerance(made_result):
    values = numbers(made_result(TIME, np.exp(-TIME)))
    assert values["settling_wide"] == pytest.approx(math.log(10.0), abs=1e-3)
    assert values["settling_time"] == pytest.approx(math.log(50.0), abs=1e-3)


@pytest.mark.parametrize(
    ("mode", "kept"),
    [
        (np.full(10_001, 3), 1.0),
        (np.where(TIME < 4.0, 2, 3), 1.0),
        (np.full(10_001, 2), 0.0),
        (np.where(TIME < 4.0, 3, 2), 0.0),
        (np.where((TIME > 4.0) & (TIME < 5.0), 2, 3), 0.0),
        (np.where(TIME < 9.9995, 3, 4), 0.0),
    ],
    ids=["always", "from 4 s on", "never", "until 4 s", "twice", "a fault at the end"],
)
def test_kept_is_one_takeover_that_lasts(made_result, mode, kept):
    assert numbers(made_result(TIME, controller_mode=mode))["kept"] == kept


def test_a_run_without_capture_has_no_peak_and_no_energy_after_it(made_result):
    values = numbers(made_result(TIME, 2.0, controller_mode=2, controller_voltage=5.0))
    assert (values["arm_peak"], values["energy_after_capture"], values["kept"]) == (0.0, 0.0, 0.0)
    assert math.isnan(values["capture_time"])


@pytest.mark.parametrize(("step", "every"), [(1e-4, 10), (1e-3, 1), (2e-3, 1), (5e-4, 2)])
def test_thinning_keeps_rows_of_a_millisecond(made_result, step, every):
    time = np.arange(101) * step
    result = made_result(time, np.sin(time), controller_mode=np.arange(101))
    thin = thinned(result)
    assert thin.time.tolist() == time[::every].tolist()
    assert thin.signals.keys() == result.signals.keys()
    for name, signal in thin.signals.items():
        assert signal.tolist() == result[name][::every].tolist()
    assert (thin.units, thin.metadata) == (result.units, result.metadata)


# Sizes


def test_the_full_study_has_enough_draws_everywhere():
    """200 draws see a share of 0.6 with 80 % chance; every set and the three sample times appear, each with all laws."""
    assert FULL.draws >= 200
    keys = Study(Path(), Path(), FULL).keys()
    assert FULL.sample_times == FULL.other_sample_times == SAMPLE_TIMES == (1e-4, 1e-3, 2e-3)
    assert {key.parameters for key in keys["tilt"]} == {key.parameters for key in keys["shipped"]} == set(SETS)
    assert set(SETS) == {"matrices", "ident", "hcs", "listed", "swapped"}
    cells = {}
    for experiment in ("swing-up", "shipped", "tilt", "onset"):
        for key in keys[experiment]:
            cells.setdefault((key[:4], key.variant), []).append(key.draw)
    assert all(draws == list(range(1, 201)) for draws in cells.values())
    for cell in {cell for cell, _ in cells}:
        assert {variant for other, variant in cells if other == cell} >= set(COMPARED)
    assert {key.step for key in keys["swing-up"]} == set(SAMPLE_TIMES)
    assert {key.gain for key in keys["swing-up"]} == {0, 1, 60, 200} == set(GAINS)
    assert {key.variant for key in keys["swing-up"]} == set(VARIANTS)
    assert FULL.a_mins[0] == QUICK.a_mins[0] == 1.0
    assert list(FULL.a_mins) == sorted(FULL.a_mins, reverse=True)
    assert 0.0 < FULL.a_mins[-1] <= 0.3


def test_the_quick_study_asks_the_same_questions_with_fewer_draws():
    quick, full = (Study(Path(), Path(), size).keys() for size in (QUICK, FULL))
    assert quick.keys() == full.keys() == EXPERIMENTS.keys()
    for experiment in quick:
        assert quick[experiment]
        assert set(quick[experiment]) <= set(full[experiment]) or experiment == "chattering"
    assert quick["reference"] == full["reference"]
    assert 10 * sum(map(len, quick.values())) < sum(map(len, full.values()))


@pytest.mark.parametrize("size", [QUICK, FULL], ids=["quick", "full"])
def test_every_ranking_has_both_controllers_and_the_reference_conditions_their_draws(size):
    keys = Study(Path(), Path(), size).keys()
    everything = {key for some in keys.values() for key in some}
    for key in everything:
        if key.experiment in ("swing-up", "shipped", "tilt", "onset", "swing-ups"):
            other = "IHC" if key.variant == "LC" else "LC"
            assert key._replace(variant=other) in everything
    for gain in GAINS:
        draws = [key for key in keys["swing-up"] if key[:4] == ("swing-up", *REFERENCE, gain)]
        assert len({key.draw for key in draws}) == size.draws


def test_every_run_of_the_full_study_has_a_valid_scenario(study):
    full = replace(study, size=FULL)
    for keys in full.keys().values():
        for key in keys[:: max(1, len(keys) // 40)]:
            assert full.scenario(key).name == scenario_name(key)


# Runs


def test_numbers_come_from_the_run_and_then_from_the_journal(study, tmp_path):
    key = Key("tilt", "ident", 2e-3, 0, "LC", 1)
    seen = []
    path = tmp_path / "runs.sqlite"
    with Journal(path, PURPOSE) as journal:
        first = study.run([key], journal, lambda *counts: seen.append(counts))
    expected = numbers(run_scenario(study.scenario(key), study.fmus, study.scenarios))
    assert first == {key: pytest.approx(expected, rel=0, abs=0, nan_ok=True)}
    content = path.read_bytes()
    with Journal(path, PURPOSE) as journal:
        again = study.run([key], journal)
    assert again == {key: pytest.approx(expected, rel=0, abs=0, nan_ok=True)}
    assert path.read_bytes() == content
    assert seen == [(0, 1), (1, 1)]


def test_pictures_are_the_runs_themselves_in_rows_of_a_millisecond(study, same):
    key = Key("reference", *REFERENCE, 0, "LC", 0)
    (pictured,) = study.pictures([key]).values()
    result = run_scenario(study.scenario(key), study.fmus, study.scenarios)
    same(pictured, thinned(result))
    assert len(pictured.time) == 10_001
    assert set(pictured.signals) == set(SIGNALS)
    assert pictured["controller.voltage"].max() <= 10.0


def test_the_reference_run_takes_over_when_the_paper_says_and_needs_no_draw(study):
    """The swing-up is a fit to three printed numbers: this is what it was fitted to."""
    keys = [Key("reference", *REFERENCE, 0, law, 0) for law in ("LC", "IHC")]
    lc, ihc = (numbers(result) for result in study.pictures(keys).values())
    assert lc["capture_time"] == ihc["capture_time"] == pytest.approx(printed.SWITCH_TIME, abs=0.1)
    assert lc["integral_q2"] == pytest.approx(11.23, rel=0.01)
    assert ihc["integral_q2"] / lc["integral_q2"] == pytest.approx(11.06 / 11.23, abs=0.003)
    assert lc["kept"] == ihc["kept"] == 1.0
