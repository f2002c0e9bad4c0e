"""Scenarios: typed and checked contents, what they mean as a system, and reproducible measurements."""

import math
import shutil
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.errors import UserError
from cosim.fmu_files import start_values_of
from cosim.inputs import DisturbanceSection, Sine
from cosim.judged_signals import evaluation_in, kept_upright
from cosim.metrics import evaluate
from cosim.offsets import random_measurement
from cosim.pendulum import WIRES
from cosim.pendulum_export import export_units
from cosim.plots import law_of
from cosim.scenario import Scenario, built_in_names, load_scenario
from cosim.scenario_files import files
from cosim.scenario_run import run_scenario
from cosim.scenario_system import build_system
from cosim.studies.experiments import check_outputs
from fmu_export.python_fmu import export_python_fmu
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.pendulum.interface import kalman_gains
from ihc_fmu.pendulum.start_values import kalman_values, nominal_values
from ihc_fmu.system import System
from plant_fmu.interface import start_values as plant_start_values
from plant_fmu.parameters import PARAMETER_SETS, QubeParameters

PARAMETER_NUMBERS = {f.name for f in fields(QubeParameters)}

BUILT_IN = [
    "device",
    "device_square_wave",
    "disturbed",
    "paper",
    "square_wave",
    "swing_up",
    "tilt",
    "tilt_ideal",
    "tilt_kalman",
    "tilt_sharp",
    "tilt_sparing",
]

FULL = """
description = "all of it"
[run]
step = 2e-3
duration = 3
order = "parallel"
engine = "fmpy"
seed = 4
[plant]
fmu = "Mine.fmu"
parameters = "hcs"
measurement = "ideal"
start = { delta_0 = 0.2, back_emf = false, encoder_counts = 0, motor_model = "inductance" }
[controller]
design = "mine.json"
other_model = true
start = { law = "LC" }
[disturbance]
input = "pendulum_torque"
gain = 2
sines = [{ amplitude = 3, frequency = 5.0, phase = 0.5 }]
start = 1
[record]
outputs = ["plant.theta"]
every = 4
"""


@pytest.fixture
def written(tmp_path):
    """Write a scenario file and return its name."""

    def write(text, name="mine.toml"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return str(tmp_path / name)

    return write


def start_of(system, name):
    return dict(next(c.start for c in system.components if c.name == name))


# Reading


def test_built_in_scenarios_load_and_run(fmus):
    assert built_in_names() == BUILT_IN
    for name in BUILT_IN:
        scenario, folder = load_scenario(name)
        assert (scenario.name, bool(scenario.description)) == (name, True)
        result = run_scenario(scenario.changed({"run.duration": 0.01}), fmus, folder)
        assert result.metadata["complete"]
        assert result.metadata["scenario"]["name"] == name


def test_a_gain_of_no_disturbance_is_refused_where_it_is_set():
    """Else a study of disturbances would be told of a plant that nothing disturbs."""
    with pytest.raises(
        UserError, match=r"disturbance\.gain has no effect in a scenario whose disturbance has no sines"
    ):
        Scenario().changed({"disturbance.gain": 60.0})
    sines = [{"amplitude": 0.02, "frequency": 10.0}]
    assert Scenario().changed({"disturbance.gain": 60.0, "disturbance.sines": sines}).disturbance.gain == 60.0
    assert Scenario().changed({"disturbance.gain": 0.0}).disturbance.gain == 0.0


def test_every_entry_is_read_in_its_type(written, tmp_path):
    scenario, folder = load_scenario(written(FULL))
    assert folder == tmp_path
    assert scenario.model_dump() == {
        "name": "mine",
        "description": "all of it",
        "wires": None,
        "run": {"step": 2e-3, "duration": 3.0, "order": "parallel", "sequence": None, "engine": "fmpy", "seed": 4},
        "plant": {
            "fmu": "Mine.fmu",
            "interface": None,
            "parameters": "hcs",
            "measurement": "ideal",
            "start": {"delta_0": 0.2, "back_emf": False, "encoder_counts": 0, "motor_model": "inductance"},
        },
        "controller": {
            "fmu": "IhcController.fmu",
            "interface": None,
            "design": "mine.json",
            "other_model": True,
            "start": {"law": "LC"},
        },
        "components": {},
        "disturbance": {
            "input": "pendulum_torque",
            "gain": 2.0,
            "sines": ({"amplitude": 3.0, "frequency": 5.0, "phase": 0.5},),
            "start": 1.0,
        },
        "signals": (),
        "animation": (),
        "evaluate": dict.fromkeys(("errors", "controls", "scales", "tolerance", "tolerances")),
        "record": {"outputs": ("plant.theta",), "every": 4},
    }
    start = scenario.plant.start
    assert [type(start[n]) for n in ("delta_0", "back_emf", "encoder_counts")] == [float, bool, int]


def test_an_empty_file_is_a_scenario_of_defaults(written):
    scenario, _ = load_scenario(written(""))
    assert scenario == Scenario(name="mine")
    assert (scenario.run.step, scenario.run.duration, scenario.run.order) == (1e-3, 10.0, "controller-first")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[run]\nstepp = 1e-3", "there is no entry run.stepp; did you mean step?"),
        ("[controler]\n", "there is no entry controler; did you mean controller?"),
        ("[run]\nstep = 'fast'", "run.step must be a number, found 'fast'"),
        ("[run]\nstep = [1e-3]", "run.step must be a number, found [0.001]"),
        ("[run]\nstep = 0", "run.step must be greater than 0, found 0"),
        ("[run]\nstep = -1e-3", "run.step must be greater than 0, found -0.001"),
        ("[run]\nduration = inf", "run.duration must be a finite number, found inf"),
        ("[run]\nduration = nan", "run.duration must be a finite number, found nan"),
        ("[run]\nseed = -1", "run.seed must be greater than or equal to 0, found -1"),
        ("[run]\nseed = 1.5", "run.seed must be a whole number, found 1.5"),
        ("[run]\nseed = 2147483648", "run.seed must be less than 2147483648, found 2147483648"),
        ("[run]\norder = 'plant-first'", "run.order must be 'controller-first' or 'parallel', found 'plant-first'"),
        ("run = 3", "run must be a table, found 3"),
        (
            "[plant]\nparameters = 'idnt'",
            "plant.parameters must be one of matrices, ident, hcs, listed, swapped or a file *.toml, found 'idnt'",
        ),
        ("[plant]\nmeasurement = 'none'", "plant.measurement must be 'encoders' or 'ideal', found 'none'"),
        ("[plant]\nstart = 3", "plant.start must be a table, found 3"),
        (
            "[[signals]]\nkind = 'stp'",
            "signals.0.kind must be one of step, pulse, square, sines, csv, found 'stp'; did you mean step?",
        ),
        ("[[signals]]\nvalue = 1.0", "signals.0.kind is required"),
        (
            "[[signals]]\nkind = 'step'\ninput = 'plant.u'\nvalue = 1\ntime = 'x'",
            "signals.0 (step).time must be a number, found 'x'",
        ),
        ("[controller]\nother_model = 'perhaps'", "controller.other_model must be true or false, found 'perhaps'"),
        ("[disturbance]\ninput = 3", "disturbance.input must be a text, found 3"),
        ("[disturbance]\ngain = inf", "disturbance.gain must be a finite number, found inf"),
        ("[disturbance]\nsines = [{ amplitude = 1 }]", "disturbance.sines.0.frequency is required"),
        (
            "[disturbance]\nsines = [{ amplitude = 1, frequency = nan }]",
            "disturbance.sines.0.frequency must be a finite",
        ),
        ("[record]\nevery = 0", "record.every must be greater than or equal to 1, found 0"),
        ("[record]\noutputs = 'plant.theta'", "record.outputs must be a list, found 'plant.theta'"),
    ],
)
def test_a_wrong_entry_is_one_sentence_with_file_entry_rule_and_value(written, text, problem):
    with pytest.raises(UserError) as refusal:
        load_scenario(written(text))
    sentence = str(refusal.value)
    assert f"mine.toml: {problem}" in sentence
    assert "\n" not in sentence


@pytest.mark.parametrize("text", ["[run]\nstep = 3e-3\nduration = 1", "[run]\nduration = 1e-4"])
def test_a_duration_that_is_no_multiple_of_the_step_is_refused(written, text):
    with pytest.raises(UserError, match=r"duration must be a multiple of the step, found .* s and 0\.00[13] s"):
        load_scenario(written(text))


def test_what_is_no_toml_is_refused_with_the_place(written, tmp_path):
    with pytest.raises(UserError, match=r"mine\.toml is not TOML: .*line 2"):
        load_scenario(written("[run]\nstep = \n"))
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match=r"bytes\.toml must be text in UTF-8, .* it looks like UTF-16"):
        load_scenario(str(tmp_path / "bytes.toml"))


def test_a_folder_does_not_hide_the_built_in_scenario_of_its_name(tmp_path, monkeypatch):
    (tmp_path / "paper").mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_scenario("paper")[0].disturbance.start == 1.5


def test_a_missing_scenario_is_named_with_those_there_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=r"scenario file mine\.toml does not exist"):
        load_scenario("mine.toml")
    with pytest.raises(UserError, match=rf"built-in scenario 'tlit'; built in: {', '.join(BUILT_IN)}"):
        load_scenario("tlit")
    with pytest.raises(UserError, match="cannot be read: Is a directory"):
        load_scenario(str(tmp_path))


def test_a_file_goes_before_the_built_in_scenario_of_its_name(tmp_path, monkeypatch, written):
    monkeypatch.chdir(tmp_path)
    written('description = "mine"', "tilt")
    assert load_scenario("tilt")[0].description == "mine"
    assert load_scenario("swing_up")[0].name == "swing_up"


# Changing


def test_changes_replace_only_what_they_name():
    scenario, _ = load_scenario("tilt")
    changes = {"run.seed": 9, "plant.parameters": "hcs", "controller.start.law": "LC", "plant.start.delta_0": 0.3}
    changed = scenario.changed(changes)
    assert (changed.run.seed, changed.plant.parameters) == (9, "hcs")
    assert (changed.controller.start, changed.plant.start) == ({"law": "LC"}, {"delta_0": 0.3})
    undone = {"run.seed": 1, "plant.parameters": "none", "controller.start": {}, "plant.start.delta_0": 0.1}
    assert changed.changed(undone) == scenario == load_scenario("tilt")[0]


def test_a_start_value_is_named_without_start_too():
    scenario = load_scenario("tilt")[0].changed({"components": {"other": {"fmu": "QubeServo2.fmu"}}})
    short = {"plant.delta_0": 0.3, "controller.law": "LC", "plant.fmu": "Mine.fmu", "other.m_p": 0.03, "plant.a.b": 1.0}
    assert {name: scenario.entry(name) for name in short} == {
        "plant.delta_0": "plant.start.delta_0",
        "controller.law": "controller.start.law",
        "plant.fmu": "plant.fmu",
        "other.m_p": "components.other.start.m_p",
        "plant.a.b": "plant.start.a.b",
    }
    assert scenario.changed(short) == scenario.changed({scenario.entry(name): v for name, v in short.items()})


@pytest.mark.parametrize(
    ("path", "value", "problem"),
    [
        ("run.durration", 1.0, "there is no entry run.durration; did you mean duration?"),
        ("rum.step", 1.0, "the scenario has no entry 'rum.step'; did you mean run?"),
        ("contrler.start.law", "LC", "the scenario has no entry 'contrler.start.law'; did you mean controller?"),
        ("run.step.size", 1.0, "the scenario has no entry 'run.step.size'"),
        ("stepp", 1.0, "there is no entry stepp"),
        ("run.step", -1.0, "run.step must be greater than 0, found -1.0"),
        ("run.step", math.nan, "run.step must be a finite number, found nan"),
        ("run.duration", 0.0105, "duration must be a multiple of the step, found 0.0105 s and 0.001 s"),
        ("plant.parameters", "mine", "plant.parameters must be one of matrices"),
        ("controller.start", 3, "controller.start must be a table, found 3"),
    ],
)
def test_a_change_is_checked_as_the_file_is(path, value, problem):
    scenario, _ = load_scenario("tilt")
    with pytest.raises(UserError) as refusal:
        scenario.changed({path: value})
    assert problem in str(refusal.value)


# Meaning


def test_a_scenario_becomes_components_wires_and_start_values(fmus):
    scenario, folder = load_scenario("tilt")
    system = build_system(scenario.changed({"run.step": 2e-3, "controller.start.a_min": 0.7}), fmus, folder)
    assert [(c.name, c.path) for c in system.components] == [
        ("controller", fmus / "IhcController.fmu"),
        ("plant", fmus / "QubeServo2.fmu"),
    ]
    assert start_of(system, "controller") == {"sample_time": 2e-3, "a_min": 0.7}
    assert (tuple(system.wires), tuple(system.signals)) == (WIRES["encoders"], ())


def test_a_step_in_which_the_controller_cannot_sample_is_refused_before_the_run(fmus):
    scenario = load_scenario("tilt")[0].changed({"controller.start.sample_time": 2e-3})
    for step in (1e-3, 4e-3):
        build_system(scenario.changed({"run.step": step, "run.duration": 1.2}), fmus)
    problem = (
        r"^run\.step does not fit the controller: sample_time must be a multiple .* 0\.002 s and .* step of 0\.003 s"
    )
    with pytest.raises(UserError, match=problem):
        build_system(scenario.changed({"run.step": 3e-3, "run.duration": 1.2}), fmus)


@pytest.mark.parametrize("name", PARAMETER_SETS)
def test_parameter_sets_become_start_values_of_the_plant(fmus, name):
    scenario = Scenario().changed({"plant.parameters": name, "plant.start.m_p": 0.03})
    start = start_of(build_system(scenario, fmus), "plant")
    chosen = PARAMETER_SETS[name]
    assert (start["D_r"], start["J_r"], start["back_emf"]) == (
        chosen.parameters.D_r,
        chosen.parameters.J_r,
        chosen.back_emf,
    )
    assert start["m_p"] == 0.03  # what the scenario says goes before the set
    for none in (Scenario(), Scenario().changed({"plant.parameters": "none"})):
        assert start_of(build_system(none, fmus), "plant") == {}


def test_what_was_exported_stays_unless_the_scenario_says_otherwise(design, tmp_path):
    plant = {"m_p": 0.03, "D_r": 1e-4}
    controller = {"sample_time": 2e-3, "velocity_source": "kalman", "nominal_arm_damping": 5e-4, "voltage_limit": 5.0}
    export_units(design, "hcs", output=tmp_path, changes={"plant": plant, "controller": controller})
    design.save(tmp_path / "mine.json")
    for name in built_in_names():
        scenario, folder = load_scenario(name)
        if scenario.controller.design is not None:
            continue  # a tuned one says its controller whole
        system = build_system(scenario, tmp_path, folder)
        said = set(plant_start_values("ident")) if name == "paper" else set()  # whose plant is the paper's
        assert said == start_of(system, "plant").keys() & {*PARAMETER_NUMBERS, "back_emf"}
        assert not {"sample_time", "nominal_arm_damping", *kalman_gains()} & start_of(system, "controller").keys()
    own = start_values_of(tmp_path / "QubeServo2.fmu")
    assert (own["m_p"], own["D_r"], own["J_r"]) == (0.03, 1e-4, PARAMETER_SETS["hcs"].parameters.J_r)
    other = Scenario().changed({"controller.design": "mine.json", "controller.start.sample_time": 1e-3})
    start = start_of(build_system(other, tmp_path, tmp_path), "controller")
    own = start_values_of(tmp_path / "IhcController.fmu")
    assert start["capture_level"] == own["capture_level"] == pytest.approx(0.85 * (5.0 / 1.5) ** 2, rel=1e-3)
    nominal = {name: float(value) for name, value in own.items() if name.startswith("nominal_")}
    kalman = {name: own[name] for name in (*kalman_gains(), "kalman_sample_time")}
    assert kalman == kalman_values(nominal, 2e-3)
    assert {name: start[name] for name in kalman} == kalman_values(nominal, 1e-3)


def test_a_design_for_another_model_meets_no_plant(design, tmp_path):
    order = [0, 2, 1, 3]
    mixed_system = design.system.changed(A=design.A[np.ix_(order, order)], B=design.B[order], K=design.K[:, order])
    mixed = replace(design, system=mixed_system, P=design.P[np.ix_(order, order)])
    message = "its states are in the order theta, theta_dot, delta, delta_dot, not theta, delta, theta_dot, delta_dot"
    with pytest.raises(UserError, match=f"{message}; --other-model"):
        export_units(mixed, output=tmp_path / "none")
    assert not (tmp_path / "none").exists()
    export_units(mixed, output=tmp_path, other_model=True)
    with pytest.raises(UserError, match=f"{message}; controller.other_model"):
        build_system(Scenario(), tmp_path)
    assert build_system(Scenario().changed({"controller.other_model": True}), tmp_path).components
    double_integrator = System(A=np.eye(2, k=1), B=np.array([0.0, 1.0]), K=np.array([-1.0, -2.0]))
    two = inverse_design(double_integrator, Options(alpha=0.1))
    with pytest.raises(UserError, match=r"takes designs of 4 states and 1 input, found 2 and 1$"):
        export_units(two, output=tmp_path)


def test_ideal_measurement_wires_the_true_state(fmus):
    scenario = Scenario().changed({"plant.measurement": "ideal", "run.duration": 0.01, "plant.start.theta_dot_0": 0.5})
    system = build_system(scenario, fmus)
    assert start_of(system, "controller")["velocity_source"] == "inputs"
    ends = {(w.source, w.target) for w in system.wires}
    states = ("theta", "delta", "theta_dot", "delta_dot")
    assert ends == {(f"plant.{s}", f"controller.{s}") for s in states} | {("controller.voltage", "plant.voltage")}
    result = run_scenario(scenario, fmus)
    seen, true = result["controller.theta_dot_estimate"], result["plant.theta_dot"]
    assert seen[1:].tolist() == true[:-1].tolist()  # sampled at the start of the step


def test_the_kalman_gain_follows_sample_time_and_nominal_model(fmus):
    def gain(**changes):
        scenario = Scenario().changed({n.replace("__", "."): v for n, v in changes.items()})
        start = start_of(build_system(scenario, fmus), "controller")
        return {name: value for name, value in start.items() if name.startswith("kalman")}

    nominal = nominal_values(PARAMETER_SETS["ident"].parameters)
    kalman = {"controller__start__velocity_source": "kalman"}
    assert gain() == {}
    assert gain(**kalman) == {}  # the FMU's own is for these
    assert gain(**kalman, run__step=2e-3) == pytest.approx(kalman_values(nominal, 2e-3), rel=1e-9)
    heavier = {"nominal_gravity_torque": 2 * nominal["nominal_gravity_torque"]}
    found = gain(**kalman, controller__start__nominal_gravity_torque=heavier["nominal_gravity_torque"])
    assert found == pytest.approx(kalman_values(nominal | heavier, 1e-3), rel=1e-9)
    name = next(iter(found))
    assert gain(**kalman, **{f"controller__start__{name}": 0.5})[name] == 0.5


def test_a_seed_draws_the_measurement(fmus):
    own = start_values_of(fmus / "QubeServo2.fmu")
    draws = [random_measurement(own, seed) for seed in range(50)]
    assert draws == [random_measurement(own, seed) for seed in range(50)]
    offsets = np.array([[d["theta_encoder_offset"], d["delta_encoder_offset"]] for d in draws])
    assert len(np.unique(offsets)) == 100
    assert ((offsets >= 0.0) & (offsets < 1.0)).all()
    assert abs(offsets.mean() - 0.5) < 4 * math.sqrt(1 / 12 / 100)
    seeded = start_of(build_system(Scenario().changed({"run.seed": 7}), fmus), "plant")
    assert {n: seeded[n] for n in draws[7]} == draws[7]
    assert not draws[7].keys() & start_of(build_system(Scenario(), fmus), "plant").keys()


def test_seeds_give_reproducible_and_different_measurements(fmus):
    def measured(seed):
        short = {"run.duration": 0.02, "plant.start.noise_std": 1e-3, "run.seed": seed}
        return run_scenario(load_scenario("tilt")[0].changed(short), fmus)["plant.theta_encoder"].tolist()

    assert measured(1) == measured(1) != measured(2)


def test_a_design_file_is_found_beside_the_scenario(fmus, design, design_file, written, tmp_path):
    design_file("mine.json", P=(design.P * 4.0).tolist())
    scenario, folder = load_scenario(written('[controller]\ndesign = "mine.json"\nstart = { mu = 0.5 }'))
    start = start_of(build_system(scenario, fmus, folder), "controller")
    assert (start["P_12"], start["k_lin_2"], start["mu"]) == (design.P[0, 1] * 4.0, design.k_lin[1], 0.5)
    with pytest.raises(UserError, match=r"design file .*mine\.json does not exist"):
        build_system(scenario, fmus, tmp_path / "elsewhere")


def test_an_fmu_beside_the_scenario_goes_before_the_folder(fmus, tmp_path):
    shutil.copy(fmus / "QubeServo2.fmu", tmp_path)
    paths = {c.name: c.path for c in build_system(Scenario(), fmus, tmp_path).components}
    assert paths == {"plant": tmp_path / "QubeServo2.fmu", "controller": fmus / "IhcController.fmu"}
    paths = {c.name: c.path for c in build_system(Scenario(), fmus).components}
    assert paths["plant"] == fmus / "QubeServo2.fmu"
    shutil.copy(fmus / "IhcController.fmu", tmp_path / "QubeServo2.fmu")
    with pytest.raises(
        UserError, match=r"QubeServo2\.fmu are different FMUs; --fmus .* takes the one beside the scenario"
    ):
        build_system(Scenario(), fmus, tmp_path)
    assert files(Scenario(), tmp_path, tmp_path).fmus["plant"] == tmp_path / "QubeServo2.fmu"


def test_a_step_that_is_no_sample_time_is_named(fmus):
    with pytest.raises(
        UserError, match=r"run\.step, as the controller's sample time, must lie in \[1e-06, 1\] s, found 10 s"
    ):
        build_system(Scenario().changed({"run.step": 10.0, "run.duration": 100.0}), fmus)


def test_another_fmu_takes_the_plants_place(fmus, tiny_slave, tmp_path):
    export_python_fmu(tiny_slave, tmp_path / "Mine.fmu")
    changes = {"plant.fmu": "Mine.fmu", "plant.parameters": None, "run.duration": 0.01}
    with pytest.raises(
        UserError,
        match="no output of the controller has the name of an input of the plant",
    ):
        run_scenario(Scenario().changed(changes), fmus, tmp_path)


# Disturbance


@given(
    gain=st.floats(-100, 100),
    sines=st.lists(st.tuples(*[st.floats(-10, 10)] * 3), max_size=3),
    time=st.floats(0, 100),
)
def test_the_disturbance_is_a_gain_times_a_sum_of_sines(gain, sines, time):
    terms = tuple(Sine(amplitude=a, frequency=f, phase=p) for a, f, p in sines)
    found = DisturbanceSection(input="pendulum_torque", gain=gain, sines=terms).at(time)  # type: ignore[call-arg]
    assert found == pytest.approx(gain * sum(a * math.sin(f * time + p) for a, f, p in sines), abs=1e-9)


def test_a_disturbance_is_zero_before_its_start_and_keeps_its_phase():
    section = DisturbanceSection(sines=(Sine(amplitude=2.0, frequency=3.0),), start=1.5)  # type: ignore[call-arg]
    assert section.at(1.4999) == 0.0
    assert section.at(1.5) == 2.0 * math.sin(4.5)


@pytest.mark.parametrize("engine", ["native", "fmpy"])
def test_disturbances_ahead_are_those_of_each_step(fmus, engine):
    """Two runs share the values computed ahead; a third with another gain, and the same runs alone, do not differ."""
    scenario, folder = load_scenario("disturbed")
    runs = [
        run_scenario(
            scenario.changed(
                {"run.engine": engine, "run.duration": 0.2, "disturbance.gain": gain, "record.outputs": None}
            ),
            fmus,
            folder,
        )
        for gain in (60.0, 60.0, 200.0)
    ]
    np.testing.assert_array_equal(runs[0]["plant.theta"], runs[1]["plant.theta"])
    assert (runs[0]["plant.theta"][2:] != runs[2]["plant.theta"][2:]).any()
    signal = next(iter(build_system(scenario, fmus, folder).signals))
    ahead = signal.ahead(0.25, 1e-3, 7, 5)
    assert list(ahead) == [signal.function(0.25 + k * 1e-3) for k in range(7, 12)]


def test_a_scenario_written_as_toml_is_read_back_as_it_was(written):
    scenario, _ = load_scenario(written(FULL))
    again, _ = load_scenario(written(scenario.to_toml(), "again.toml"))
    assert again.model_copy(update={"name": "mine"}) == scenario
    for name in BUILT_IN:
        given = load_scenario(name)[0]
        assert load_scenario(written(given.to_toml(), f"{name}.toml"))[0] == given


def test_the_disturbance_acts_on_the_plants_input(fmus):
    """At rest hanging down with the controller off, a constant disturbance is all there is: i = d/R_m."""
    changes = {
        "run.duration": 1e-3,
        "controller.start.enabled": False,
        "disturbance.sines": [{"amplitude": 0.5, "frequency": 0.0, "phase": math.pi / 2}],
        "disturbance.gain": 3.0,
    }
    result = run_scenario(Scenario().changed(changes), fmus)
    applied = 8.4 * result["plant.current"][-1] + 0.042 * result["plant.theta_dot"][-1]
    assert applied == pytest.approx(1.5, rel=1e-12)
    turned = run_scenario(Scenario().changed({**changes, "disturbance.input": "pendulum_torque"}), fmus)
    assert turned["plant.delta"][-1] != math.pi
    assert build_system(Scenario().changed({**changes, "disturbance.gain": 0.0}), fmus).signals == []


# The arm's set-point


@pytest.mark.parametrize("law", ["LC", "IHC"])
def test_the_arm_follows_a_square_wave_and_is_judged_against_it(fmus, law):
    scenario, folder = load_scenario("square_wave")
    result = run_scenario(scenario.changed({"controller.start.law": law, "run.duration": 9.0}), fmus, folder)
    point, theta, t = result["controller.theta_setpoint"], result["plant.theta"], result.time
    assert set(point[t < 1.0]) == {0.0}
    assert (set(point[(t > 1.0) & (t <= 5.0)]), set(point[t > 5.0])) == ({0.3}, {-0.3})
    for end, wanted in ((5.0, 0.3), (9.0, -0.3)):
        assert abs(np.mean(theta[(t > end - 1.0) & (t <= end)]) - wanted) < 0.05
    q = np.hypot(theta - point, result["plant.delta"])
    assert evaluate(result).values["integral_q2"] == pytest.approx(np.trapezoid(q**2, t), rel=1e-12)
    assert kept_upright(result)
    assert law_of(result) == law


def test_an_arm_held_at_a_start_value_is_judged_against_that(fmus):
    held = {"controller.start.theta_setpoint": 0.2, "plant.start.delta_0": 0.0, "plant.start.theta_0": 0.2}
    for outputs, arm in (
        (None, "plant.theta"),
        (["plant.theta_encoder", "plant.delta_encoder"], "plant.theta_encoder"),
    ):
        more = () if outputs is None else ("controller.voltage", "controller.mode")
        record = {"record.outputs": None if outputs is None else [*outputs, *more]}
        result = run_scenario(Scenario().changed({**held, **record, "run.duration": 1.0, "run.seed": 1}), fmus)
        error = evaluation_in(result).errors[0]
        assert (error.signal, error.constant) == (arm, 0.2)
        assert evaluate(result).values["settling_time"] == 0.0


def test_a_set_point_that_is_not_recorded_is_missed_by_the_metrics(fmus):
    scenario, folder = load_scenario("square_wave")
    record = ["plant.theta", "plant.delta", "controller.voltage", "controller.mode"]
    with pytest.raises(UserError, match=r"the metrics need controller\.theta_setpoint"):
        check_outputs(scenario.changed({"record.outputs": record}), fmus, folder)


def test_the_file_is_named_with_a_duration_that_does_not_fit(written):
    with pytest.raises(UserError, match=r"mine\.toml: .*duration must be a multiple of the step, found 10000\.001 s"):
        load_scenario(written("[run]\nstep = 3e-3\nduration = 10000.001"))
