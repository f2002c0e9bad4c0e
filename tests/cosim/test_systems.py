"""Any system in a scenario: a cart, a tank in degrees Celsius, two masses, under names and units of others."""

import csv
import json
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are

from cosim.errors import UserError
from cosim.fmu_files import start_values_of
from cosim.judged_signals import evaluation_in
from cosim.metric_meanings import quantities_of
from cosim.metrics import evaluate
from cosim.overlay import compared, lay
from cosim.results import Result
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario, with_tolerances
from cosim.scenario_system import build_system, evaluation
from cosim.studies.experiments import Experiment, laws_of, run_experiments
from fmu_export.native_fmu import export_native_fmu
from ihc_fmu.block_form import block_form
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.pendulum.interface import LAWS
from ihc_fmu.quantity import Quantity
from ihc_fmu.regulator.interface import Shape
from ihc_fmu.regulator.native_unit import NATIVE as CONTROLLER
from ihc_fmu.regulator.start_values import Regulator
from ihc_fmu.system import System
from plant_fmu.linear.native_unit import NATIVE as PLANT
from plant_fmu.linear.start_values import linear_plant_values
from plant_fmu.linear.start_values import shown_interface as shown_linear_plant
from tests.cosim.command import ended, files, sentence
from tests.cosim.linear_fmu import linear_fmu

CART = np.array([[0.0, 1.0], [0.0, -0.5]])
PUSH = np.array([[0.0], [2.0]])
GAIN = np.array([[-3.0, -2.0]])


@pytest.fixture(scope="session")
def units(tmp_path_factory):
    """A folder with the FMUs of a cart and its controller, a tank, two masses and theirs."""
    folder = tmp_path_factory.mktemp("units of others")
    state, pushed = [("position", "m"), ("speed", "m/s")], [("force", "N"), ("force_disturbance", "N")]
    both = np.hstack([PUSH, PUSH])
    linear_fmu(folder / "cart.fmu", pushed, state, CART, both, np.eye(2), x0=(0.1, 0.0))
    gains = np.hstack([GAIN, -GAIN[:, :1]])
    seen = [*state, ("position_setpoint", "m")]
    linear_fmu(folder / "cart_controller.fmu", seen, [("force", "N")], D=gains, law=True)
    linear_fmu(
        folder / "cart_in_mm.fmu",
        pushed,
        [("position", "mm"), ("speed", "m/s")],
        CART,
        both,
        np.diag([1e3, 1.0]),
        x0=(0.1, 0.0),
    )
    linear_fmu(folder / "unlike.fmu", [("x.in[1]", "m"), ("enable", None)], [("u out", "N")], D=[[-3.0, 0.0]])
    linear_fmu(folder / "valve.fmu", [("u", "N")], [("f", "N")], [[-50.0]], [[50.0]], [[1.0]], x0=(0.0,))
    linear_fmu(folder / "reference.fmu", [("r", "mm")], [("y", "mm")], D=[[1.0]], start={"r": 200.0})
    masses = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-8, 8, -1, 0], [4, -4, 0, -1]], float)
    names = [("body.frame_a.r[1]", "m"), ("arm, tilt", "rad"), ('v "1"', "m/s"), ("v 2", None)]
    act = [("drive[1].f", "N"), ("drive[2].tau", "N.m")]
    input_ = np.array([[0, 0], [0, 0], [2, 0], [0, 1]], float)
    linear_fmu(folder / "masses.fmu", act, names, masses, input_, np.eye(4), x0=(0.1, 0.2, 0.0, 0.0), begins="output")
    feedback = np.array([[-6.0, -1.0, -3.0, 0.0], [1.0, -5.0, 0.0, -3.0]])
    linear_fmu(folder / "masses_controller.fmu", names, act, D=feedback, law=True)
    linear_fmu(folder / "tank.fmu", [("heat", "W")], [("T", "degC")], [[-0.2]], [[0.05]], [[1.0]], x0=(40.0,))
    linear_fmu(folder / "thermostat.fmu", [("T", "K")], [("heat", "W")], D=[[-0.01]])
    return folder


@pytest.fixture
def scenario(tmp_path):
    """Write a scenario and load it; return it with its folder."""

    def write(text, name="mine.toml"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return load_scenario(str(tmp_path / name))

    return write


CART_SCENARIO = """
run = { step = 1e-2, duration = 4 }
plant.fmu = "cart.fmu"
controller.fmu = "cart_controller.fmu"
"""


def closed_loop(A, B, K, x0, step, count):
    """The states of x' = A x + B K x_k, the input held over each step, at the ends of the steps."""
    n, m = B.shape
    block = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * step)
    Ad, Bd = block[:n, :n], block[:n, n:]
    xs = [np.asarray(x0, float)]
    for _ in range(count):
        xs.append((Ad + Bd @ K) @ xs[-1])
    return np.array(xs)


# Wires


@pytest.mark.parametrize("engine", ["native", "fmpy"])
def test_a_cart_is_wired_by_names_and_follows_its_closed_form(units, scenario, engine):
    chosen, folder = scenario(CART_SCENARIO)
    result = run_scenario(chosen.changed({"run.engine": engine}), units, folder)
    assert result.metadata["wires"] == [
        ["plant.position", "controller.position"],
        ["plant.speed", "controller.speed"],
        ["controller.force", "plant.force"],
    ]
    expected = closed_loop(CART, PUSH, GAIN, (0.1, 0.0), 1e-2, 400)
    found = np.column_stack([result["plant.position"], result["plant.speed"]])
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_names_as_others_have_them_work_everywhere(units, scenario, tmp_path):
    name = "body.frame_a.r[1]"
    chosen, folder = scenario(
        f"""
        run = {{ step = 1e-2, duration = 5 }}
        plant.fmu = "masses.fmu"
        plant.start = {{ "{name}" = 0.3 }}
        controller.fmu = "masses_controller.fmu"
        record.outputs = ["plant.{name}", "plant.arm, tilt", "controller.drive[1].f", "controller.drive[2].tau",
                          "controller.mode"]
        evaluate.errors = ["plant.{name}", "plant.arm, tilt"]
        """
    )
    assert chosen.plant.start == {name: 0.3}
    changed = chosen.changed({"plant.start.arm, tilt": 0.0, "controller.start.a_min": 0.9})
    assert changed.plant.start == {name: 0.3, "arm, tilt": 0.0}
    result = run_scenario(changed, units, folder)
    assert [result[f"plant.{place}"][0] for place in (name, "arm, tilt")] == [0.3, 0.0]
    result.save(tmp_path / "run.csv")
    loaded = Result.load(tmp_path / "run.csv")
    assert list(loaded.signals) == list(changed.record.outputs or ())
    metrics = evaluate(loaded)
    assert metrics.as_dict() == evaluate(result).as_dict()
    assert f"steady_rms[plant.{name}]" in metrics.values
    assert metrics.values[f"integral_e2[plant.{name}]"] == np.trapezoid(result[f"plant.{name}"] ** 2, result.time)
    again = load_scenario(_written(tmp_path, changed.to_toml()))[0]
    assert again.model_copy(update={"name": changed.name}) == changed


def _written(folder, text):
    (folder / "again.toml").write_text(text, encoding="utf-8")
    return str(folder / "again.toml")


def test_units_that_differ_are_refused_until_the_user_says_how_they_convert(units, scenario):
    chosen, folder = scenario(CART_SCENARIO.replace('"cart.fmu"', '"cart_in_mm.fmu"'))
    with pytest.raises(UserError) as refusal:
        run_scenario(chosen, units, folder)
    assert str(refusal.value) == (
        "the wire plant.position -> controller.position must join equal units, found mm and m; it converts with "
        "factor = 0.001"
    )
    wires = (
        'wires = ["plant.position -> controller.position * 0.001", "plant.speed -> controller.speed", '
        '"controller.force -> plant.force"]'
    )
    loops = []
    for engine in ("native", "fmpy"):
        there, folder = scenario(wires + CART_SCENARIO.replace('"cart.fmu"', '"cart_in_mm.fmu"'))
        loops.append(run_scenario(there.changed({"run.engine": engine}), units, folder))
    plain = run_scenario(scenario(CART_SCENARIO)[0], units, folder)
    np.testing.assert_array_equal(loops[0]["plant.position"], loops[1]["plant.position"])
    np.testing.assert_allclose(loops[0]["plant.position"], 1e3 * plain["plant.position"], rtol=1e-9, atol=1e-12)
    assert loops[0].metadata["conversions"] == {"controller.position": [0.001, 0.0]}
    assert loops[0].metadata["wires"][0] == ["plant.position", "controller.position"]
    found, expected = evaluate(loops[0]), evaluate(plain)  # judged as the controller sees it, in m
    for name, value in expected.values.items():
        assert found.values[name] == pytest.approx(value, rel=1e-6, nan_ok=True), name
    about = evaluation_in(loops[0]).errors[0]
    assert (about.unit, about.factor) == ("m", 0.001)


def test_a_set_point_may_come_from_a_component_in_another_unit(units, scenario):
    wires = """wires = ["plant.position -> controller.position", "plant.speed -> controller.speed",
        "controller.force -> plant.force", "reference.y -> controller.position_setpoint * 0.001"]
    """
    more = '[components.reference]\nfmu = "reference.fmu"\n[evaluate]\nerrors = ["plant.position"]'
    chosen, folder = scenario(wires + CART_SCENARIO + more)
    result = run_scenario(chosen, units, folder)
    assert result["reference.y"][-1] == 200.0
    e = result["plant.position"] - 0.001 * result["reference.y"]
    assert evaluate(result).integral_e2 == np.trapezoid(e**2, result.time)
    assert evaluate(result).steady_rms < 0.02


def test_only_real_numbers_convert(tiny_fmu, scenario):
    wires = 'wires = ["plant.whole_out->plant.whole*2.0"]'
    chosen, folder = scenario(f'{wires}\nplant.fmu = "Tiny.fmu"\ncontroller.fmu = "none"\nrun.duration = 0.01')
    with pytest.raises(
        UserError, match=r"may convert real numbers by finite ones, found Integer, factor 2 and offset 0"
    ):
        run_scenario(chosen, tiny_fmu.parent, folder)


def test_a_wire_may_have_an_offset(units, scenario):
    chosen, folder = scenario('plant.fmu = "tank.fmu"\ncontroller.fmu = "thermostat.fmu"\nrun.duration = 1')
    with pytest.raises(UserError, match=r"found degC and K; it converts with factor = 1\.0 and offset = 273\.15$"):
        run_scenario(chosen, units, folder)
    wires = '[{ source = "plant.T", target = "controller.T", offset = 273.15 }, "controller.heat -> plant.heat"]'
    chosen, folder = scenario(
        f'wires = {wires}\nplant.fmu = "tank.fmu"\ncontroller.fmu = "thermostat.fmu"\nrun.duration = 1'
    )
    result = run_scenario(chosen, units, folder)
    held = -0.01 * (result["plant.T"][:-1] + 273.15)
    np.testing.assert_allclose(result["controller.heat"][1:], held, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('wires = ["plant.position - controller.position"]', "wires.0 must be 'component.output -> component.input'"),
        ('wires = ["a.b -> c.d * nan"]', "wires.0 must have a finite number behind \\*, found 'nan'"),
        ('wires = ["a.b -> c.d * 1e999"]', "wires.0 must have a finite number behind \\*, found '1e999'"),
        ('wires = [{ source = "plant.position" }]', "wires.0.target is required"),
        (
            'wires = [{ source = "a.b", target = "c.d", factor = nan }]',
            "wires.0.factor must be a finite number, found nan",
        ),
        (
            'wires = [{ source = "a.b", target = "c.d", factor = "x" }]',
            "wires.0.factor must be a number, found 'x'",
        ),
        ('[components."a b"]\nfmu = "valve.fmu"', "components must have names of letters, digits and underscores"),
        ('[components.plant]\nfmu = "valve.fmu"', "components must have names .* other than controller and plant"),
        ("[components.valve]", "components.valve.fmu is required"),
        ('[components.valve]\nfmu = "../valve.fmu"', "components.valve.fmu must be a plain name"),
    ],
)
def test_a_wrong_entry_is_named(scenario, text, problem):
    with pytest.raises(UserError, match=problem):
        scenario(text)


@pytest.mark.parametrize(
    ("wires", "problem"),
    [
        ("controller.forse -> plant.force", r"controller\.forse, which is no output; did you mean force\?$"),
        ("controller.position -> plant.force", r"controller\.position, which is no output"),
        ("controller.force -> plant.forse", r"plant\.forse, which is no input; did you mean force\?$"),
        ("controler.force -> plant.force", r"controler\.force, which is no component's variable; did you mean cont.*"),
    ],
)
def test_a_wrong_end_of_a_wire_is_said_of_the_wire(units, scenario, wires, problem):
    chosen, folder = scenario(f'wires = ["{wires}"]\n{CART_SCENARIO}')
    with pytest.raises(UserError, match=rf"^the wire {wires} (begins|ends) at {problem}"):
        run_scenario(chosen, units, folder)


def test_what_feeds_nothing_or_is_fed_by_nothing_is_refused(units, scenario):
    base = 'plant.fmu = "cart.fmu"\ncontroller.fmu = "unlike.fmu"\nrun.duration = 0.1'
    with pytest.raises(
        UserError, match="no output of the controller has the name of an input of the plant; list the wires"
    ):
        run_scenario(scenario(base)[0], units)
    wires = 'wires = ["plant.position -> controller.x.in[1]", "controller.u out -> plant.force"]\n'
    with pytest.raises(
        UserError, match=r"^the input controller\.enable gets nothing: none of the wires ends there; wire it"
    ):
        run_scenario(scenario(wires + base)[0], units)
    assert run_scenario(scenario(wires + base + "\ncontroller.start.enable = 1.0")[0], units).metadata["complete"]
    signal = '\n[[signals]]\ninput = "controller.enable"\nkind = "step"\nvalue = 1'
    assert run_scenario(scenario(wires + base + signal)[0], units).metadata["complete"]
    twice = '\n[[signals]]\ninput = "plant.force"\nkind = "step"\nvalue = 1'
    with pytest.raises(UserError, match=r"the input plant\.force must have one source, found 2"):
        run_scenario(scenario(wires + base + signal + twice)[0], units)


def test_components_step_along_the_wires_or_as_they_are_told(units, scenario):
    text = """
    wires = ["plant.position -> controller.position", "plant.speed -> controller.speed", "controller.force -> valve.u",
             "valve.f -> plant.force"]
    [run]
    step = 1e-2
    duration = 1
    [plant]
    fmu = "cart.fmu"
    [controller]
    fmu = "cart_controller.fmu"
    [components.valve]
    fmu = "valve.fmu"
    start = { "x0[1]" = 0.25 }
    """
    chosen, folder = scenario(text)
    assert [c.name for c in build_system(chosen, units, folder).components] == ["controller", "valve", "plant"]
    result = run_scenario(chosen, units, folder)
    assert result["valve.f"][0] == 0.25
    told = run_scenario(chosen.changed({"run.sequence": ["controller", "plant", "valve"]}), units, folder)
    assert (told["plant.position"][2:] != result["plant.position"][2:]).all()  # the valve's output comes a step later
    with pytest.raises(
        UserError, match=r"run\.sequence must name each component once: controller, plant, valve, found valve"
    ):
        run_scenario(chosen.changed({"run.sequence": ["valve"]}), units, folder)


def test_what_is_the_pendulums_is_refused_elsewhere(units, scenario):
    for entry, value in (
        ("plant.parameters", "ident"),
        ("plant.measurement", "ideal"),
        ("controller.design", "x.json"),
    ):
        chosen, folder = scenario(CART_SCENARIO)
        with pytest.raises(UserError, match=rf"^{entry} is for the FMU \w+, and cart\w*\.fmu is another FMU"):
            run_scenario(chosen.changed({entry: value}), units, folder)
    with pytest.raises(UserError, match=r"run\.seed draws the plant's offsets .* which this plant has not, found 1"):
        run_scenario(chosen.changed({"run.seed": 1}), units, folder)


def test_the_pendulums_own_wires_are_what_equal_names_give_with_its_encoders(fmus):
    """A controller of another kind on the pendulum gets the counted angles under the angles' names."""
    from cosim import pendulum, wiring
    from cosim.fmu_files import describe

    plant, controller = (
        {v.name: v for v in describe(fmus / f"{name}.fmu").modelVariables} for name in ("QubeServo2", "IhcController")
    )
    for measurement in ("encoders", "ideal"):
        seen = pendulum.measured(wiring.outputs(plant), measurement)
        assert tuple(wiring.by_names(controller, plant, seen)) == pendulum.WIRES[measurement]


# Signals

SIGNALS = """
[[signals]]
input = "controller.position_setpoint"
kind = "square"
amplitude = 0.2
period = 1.0
start = 0.5
[[signals]]
input = "plant.force_disturbance"
kind = "csv"
file = "push.csv"
"""


@pytest.mark.parametrize("engine", ["native", "fmpy"])
def test_signals_reach_their_inputs_and_are_recorded(units, scenario, tmp_path, engine):
    (tmp_path / "push.csv").write_text("time,other,value\n0.5,9,1.0\n1.5,9,-1.0\n", encoding="utf-8")
    chosen, folder = scenario(CART_SCENARIO + SIGNALS)
    result = run_scenario(chosen.changed({"run.engine": engine, "run.duration": 2.0}), units, folder)
    times = np.concatenate([[0.0], result.time[:-1]])  # a row has what was held over the step that ended there
    push = np.interp(times, [0.5, 1.5], [1.0, -1.0])
    np.testing.assert_allclose(result["plant.force_disturbance"], push, atol=1e-12)
    k = np.arange(-1, 200).clip(0)
    square = np.where(k < 50, 0.0, np.where(((k - 50) // 50) % 2 == 0, 0.2, -0.2))
    np.testing.assert_array_equal(result["controller.position_setpoint"], square)
    assert result.units["plant.force_disturbance"] == "N"
    e = result["plant.position"] - result["controller.position_setpoint"]
    about = evaluation_in(result)
    assert about.errors[0].set_point == "controller.position_setpoint"
    quantity = quantities_of(about)["integral_e2"]  # the speed, which has no set-point, is not judged
    assert quantity.unit == "m² s"
    assert evaluate(result).values[quantity.name] == np.trapezoid(e**2, result.time)


def test_the_short_form_of_a_disturbance_takes_the_plants_own(units, scenario):
    sines = "sines = [{ amplitude = 1.0, frequency = 0.0, phase = 1.5707963267948966 }]"
    short, folder = scenario(CART_SCENARIO + f"[disturbance]\n{sines}")
    long = scenario(
        CART_SCENARIO + f'[[signals]]\ninput = "plant.force_disturbance"\nkind = "sines"\n{sines}', "b.toml"
    )[0]
    results = [run_scenario(one, units, folder) for one in (short, long)]
    np.testing.assert_array_equal(results[0]["plant.position"], results[1]["plant.position"])
    assert "plant.force_disturbance" not in results[0].signals
    with pytest.raises(UserError, match=r"disturbance\.input must say which input of the plant, one of drive\[1\]\.f"):
        run_scenario(
            short.changed({"plant.fmu": "masses.fmu", "controller.fmu": "masses_controller.fmu"}), units, folder
        )


def test_steps_and_pulses_and_held_tables(units, scenario, tmp_path):
    (tmp_path / "held.csv").write_text("time,value\n0,1\n0.3,2\n", encoding="utf-8")
    for kind, about, expected in (
        ("step", "value = 3\ntime = 0.07", lambda k: 3.0 * (k >= 7)),
        ("pulse", "value = 3\ntime = 0.07\nwidth = 0.07", lambda k: 3.0 * ((k >= 7) & (k < 14))),
        ("csv", 'file = "held.csv"\ninterpolation = "held"', lambda k: np.where(k >= 30, 2.0, 1.0)),
    ):
        text = f'[[signals]]\ninput = "plant.force_disturbance"\nkind = "{kind}"\n{about}'
        chosen, folder = scenario(CART_SCENARIO + text)
        result = run_scenario(chosen.changed({"run.duration": 0.5}), units, folder)
        np.testing.assert_array_equal(
            result["plant.force_disturbance"], expected(np.arange(-1, 50).clip(0)), err_msg=kind
        )


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, r"signal file push\.csv does not exist"),
        ("", "must have the columns time and value, found nothing"),
        ("t,value\n0,1\n", "must have the columns time and value, found t, value"),
        ("time,value\n", "must have at least one row"),
        ("time,value\n0,1\n0,2\n", "the time must grow from row to row, found 0 after 0 s"),
        ("time,value\n0,x\n", "line 2 must have a number in each column, found '0, x'"),
        ("time,value\n0\n", "line 2 must have a number in each column"),
        ("time,value\n0,nan\n", "line 2 must have finite numbers"),
    ],
)
def test_a_table_that_is_none_is_named_with_its_line(units, scenario, tmp_path, content, problem):
    if content is not None:
        (tmp_path / "push.csv").write_text(content, encoding="utf-8")
    chosen, folder = scenario(CART_SCENARIO + SIGNALS)
    with pytest.raises(UserError, match=problem):
        run_scenario(chosen, units, folder)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('kind = "ramp"', "signals.0.kind must be one of step, pulse, square, sines, csv, found 'ramp'.*"),
        ('kind = "step"', r"signals\.0 \(step\)\.value is required"),
        ('kind = "pulse"\nvalue = 1\nwidth = 0', r"signals\.0 \(pulse\)\.width must be greater than 0, found 0"),
        ('kind = "csv"\nfile = "../x.csv"', r"signals\.0 \(csv\)\.file must be a plain name"),
    ],
)
def test_a_wrong_signal_is_named(scenario, text, problem):
    with pytest.raises(UserError, match=problem):
        scenario(f'[[signals]]\ninput = "plant.u"\n{text}')


def test_a_signal_on_whole_numbers_has_whole_numbers(tiny_fmu, scenario, tmp_path):
    base = 'plant.fmu = "Tiny.fmu"\ncontroller.fmu = "none"\nrun.duration = 0.01\n[[signals]]\ninput = "plant.whole"\n'
    chosen, folder = scenario(
        base + 'kind = "step"\nvalue = 3\ntime = 0.005\n[[signals]]\ninput = "plant.flag"\nkind = "step"\nvalue = 1'
    )
    result = run_scenario(chosen, tiny_fmu.parent, folder)
    assert result["plant.whole_out"].tolist() == [0] * 6 + [3] * 5
    assert result["plant.flag_out"].tolist() == [0] + [1] * 10
    assert "evaluation" in result.metadata
    with pytest.raises(
        UserError, match=r"the signal on plant\.whole must have whole numbers, since that is of type Integer"
    ):
        run_scenario(scenario(base + 'kind = "step"\nvalue = 0.5')[0], tiny_fmu.parent, folder)


# What is judged


def test_errors_of_one_unit_add_up_and_others_stand_side_by_side(units, scenario):
    chosen, folder = scenario(CART_SCENARIO)
    result = run_scenario(chosen, units, folder)
    apart, fastest = evaluate(result), 0.02 * abs(result["plant.speed"]).max()
    meanings = [q.meaning for q in apart.quantities.values() if q.role == "settling"]
    assert meanings == [  # 2 % of the 0.1 m at the start and of the largest speed; the same for each law
        f"from then on |e {name}| ≤ {within} to the end of the run"
        for name, within in (("position", "0.002 m"), ("speed", f"{fastest:.2g} m/s"))
    ]
    fixed = with_tolerances(chosen, units, folder).changed({"controller.start.law": "LC", "plant.start.x0[1]": 0.3})
    held = evaluate(run_scenario(fixed, units, folder))
    assert [q.meaning for q in held.quantities.values() if q.role == "settling"] == meanings
    assert list(apart.values) == [
        *(f"{name}[plant.{e}]" for e in ("position", "speed") for name in ERRORS),
        "energy",
        "peak",
        "control_variation",
    ]
    alone = chosen.changed({"evaluate.errors": ["plant.position"], "evaluate.tolerance": 0.005})
    result = run_scenario(alone, units, folder)
    found = evaluate(result)
    assert list(found.values) == [*ERRORS, "energy", "peak", "control_variation"]
    e, u = result["plant.position"], result["controller.force"]
    assert found.energy == pytest.approx(np.sum(u[1:] ** 2) * 1e-2, rel=1e-12)
    late = np.flatnonzero(abs(e) > 0.005)[-1] + 1
    assert found.settling_time == result.time[late]
    texts = {q.name: (q.heading, q.meaning) for q in found.quantities.values()}
    assert texts["settling_time"] == ("settling [s]", "from then on |e| ≤ 0.005 m to the end of the run")
    assert texts["peak"] == ("peak |force| [N]", "over the run")
    scaled = chosen.changed({"evaluate.scales": [0.1, 0.5]})
    result = run_scenario(scaled, units, folder)
    norm = np.hypot(result["plant.position"] / 0.1, result["plant.speed"] / 0.5)
    assert evaluate(result).integral_e2 == np.trapezoid(norm**2, result.time)
    assert quantities_of(evaluation_in(result))["integral_e2"].unit == "s"


ERRORS = ("settling_time", "integral_e2", "steady_rms", "steady_trend")


def test_several_controls_add_up_where_they_have_one_unit(units, scenario):
    text = 'run.duration = 1\nplant.fmu = "masses.fmu"\ncontroller.fmu = "masses_controller.fmu"'
    chosen, folder = scenario(f'{text}\nevaluate.errors = ["plant.arm, tilt"]')
    mixed = evaluate(run_scenario(chosen, units, folder))
    names = ("controller.drive[1].f", "controller.drive[2].tau")
    assert [n for n in mixed.values if n.startswith("energy")] == [f"energy[{name}]" for name in names]
    speeds = chosen.changed(
        {"evaluate.controls": ["plant.body.frame_a.r[1]", "plant.v 2"], "evaluate.errors": ["plant.arm, tilt"]}
    )
    with pytest.raises(UserError, match=r"evaluate\.controls names 'plant\.v 3', which is no variable; did you mean"):
        run_scenario(speeds.changed({"evaluate.controls": ["plant.v 3"]}), units, folder)
    both = chosen.changed({"evaluate.controls": ["controller.drive[1].f", "controller.drive[1].f"]})
    result = run_scenario(both, units, folder)
    u = result["controller.drive[1].f"]
    assert evaluate(result).energy == pytest.approx(2 * np.sum(u[1:] ** 2) * 1e-3, rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"evaluate.errors": ["plant.positon"]}, r"evaluate\.errors names 'plant\.positon', .*did you mean position\?"),
        (
            {"evaluate.errors": ["plant.force"]},
            r"evaluate\.errors takes outputs, and inputs with a signal; plant\.force is an input",
        ),
        (
            {"evaluate.scales": [1.0]},
            r"must have a scale for each of the errors plant\.position, plant\.speed, found 1$",
        ),
        ({"evaluate.tolerances": [1.0]}, r"^evaluate: must have a tolerance for each of 2 \|e\|, found 1$"),
        ({"evaluate.errors": []}, r"evaluate\.errors must have at least one entry, found none"),
        ({"evaluate.scales": [0.0, 1.0]}, r"evaluate\.scales\.0 must be greater than 0"),
    ],
)
def test_a_wrong_evaluation_is_named(units, scenario, changes, problem):
    chosen, folder = scenario(CART_SCENARIO)
    with pytest.raises(UserError, match=problem):
        run_scenario(chosen.changed(changes), units, folder)


def test_a_constant_set_point_counts(units, scenario):
    chosen, folder = scenario(CART_SCENARIO)
    held = {"controller.start.position_setpoint": 0.5, "run.duration": 30.0}
    found = evaluate(run_scenario(chosen.changed(held), units, folder))
    assert found.steady_rms < 1e-6


# The commands


@pytest.fixture
def place(units, tmp_path):
    (tmp_path / "cart.toml").write_text(CART_SCENARIO + 'evaluate.errors = ["plant.position"]', encoding="utf-8")
    return tmp_path


def test_run_prints_and_draws_in_the_systems_own_words(units, place):
    done = ended("run", "cart.toml", "--fmus", units, cwd=place)
    assert done.returncode == 0, done.stderr
    assert "peak |force|  " in done.stdout
    for word in ("|q|", "voltage", "pendulum", " V", "arm"):
        assert word not in done.stdout.replace(str(place), "")
    assert files(place / "results") == ["cart.csv", "cart.json", "cart.png"]


def test_numbers_that_overflow_are_said_without_warnings(units, place):
    far = ("--set", "plant.start.x0[1]=1e300", "--fmus", units)
    for command in (("run", "cart.toml"), ("compare", "cart.toml", "--draws", "2")):
        done = ended(*command, *far, cwd=place)
        assert done.returncode == 0, done.stderr
        assert "Warning" not in done.stderr
        assert "the numbers overflow: plant.position is not finite, or beyond 1.3e+154" in f"{done.stdout}{done.stderr}"


def test_compare_takes_the_controllers_laws_and_runs_once_without_chance(units, place):
    done = ended("compare", "cart.toml", "--fmus", units, cwd=place)
    assert done.returncode == 0, done.stderr
    assert "cart: one run" in done.stdout
    assert "nothing is left to chance" in done.stdout
    assert "acting to the end" in done.stdout
    folder = place / "results" / "cart"
    assert files(folder) == sorted(
        [f"{name}.{end}" for name in ("LC", "IHC", "comparison") for end in ("csv", "json")]
        + [f"{name}.png" for name in ("signals", "norm", "controls")]
    )
    rows = list(csv.DictReader((folder / "comparison.csv").open(encoding="utf-8")))
    assert [row["law"] for row in rows] == ["LC", "IHC"]
    assert float(rows[1]["settling_time"]) != float(rows[0]["settling_time"])
    about = json.loads((folder / "comparison.json").read_text(encoding="utf-8"))
    assert about["draws"] == 1
    side = ended("compare", "results/cart/LC.csv", "results/cart/IHC.csv", "-o", "side", cwd=place)
    assert side.returncode == 0, side.stderr
    assert "∫|e|² dt [m² s]" in side.stdout


def test_compare_varies_any_entry(units, place):
    done = ended("compare", "cart.toml", "--vary", "controller.start.x0=1,2", "--fmus", units, cwd=place)
    assert "controller has no variable named 'x0'" in sentence(done)
    done = ended("compare", "cart.toml", "--vary", "plant.start.x0[1]=0.1,0.2", "--fmus", units, cwd=place)
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((place / "results/cart/comparison.csv").open(encoding="utf-8")))
    assert [row["law"] for row in rows] == ["0.1", "0.2"]
    assert float(rows[1]["energy"]) == pytest.approx(4 * float(rows[0]["energy"]), rel=1e-9)
    for option, problem in (
        ("--laws=LC,SMC", "--laws must be different ones of LC, IHC, found 'LC,SMC'"),
        ("--vary=run.duration", "--vary takes ENTRY=VALUE,VALUE, found 'run.duration'"),
        ("--vary=run.duration=1,1", "--vary takes different values, found 'run.duration=1,1'"),
    ):
        assert sentence(ended("compare", "cart.toml", option, "--fmus", units, cwd=place)) == problem


def test_tune_lowers_a_min_of_any_controller(units, place):
    done = ended("tune", "cart.toml", "--a-min", "1,0.8,0.5", "--b-max", "1", "--fmus", units, cwd=place)
    assert done.returncode == 0, done.stderr
    folder = place / "results" / "tune_cart"
    assert files(folder) == ["best.toml", "landscape.png", "runs.sqlite", "tuning.csv"]
    rows = list(csv.DictReader((folder / "tuning.csv").open(encoding="utf-8")))
    assert [row["a_min"] for row in rows] == ["1.0", "0.8", "0.5"]
    values = [float(row["integral_e2"]) for row in rows]
    assert values == sorted(values, reverse=True)
    best, where = load_scenario(str(folder / "best.toml"))
    assert best.controller.start == {"law": "IHC", "a_min": 0.5, "b_max": 1.0}
    assert evaluate(run_scenario(best, units, where)).integral_e2 == values[-1]
    problem = sentence(ended("tune", "cart.toml", "--u-max", "3", "--fmus", units, cwd=place))
    assert problem == "--u-max and --mu are for the pendulum's controller; another keeps those of its design"
    (place / "bare.toml").write_text(
        'wires = ["plant.position -> controller.x.in[1]", "controller.u out -> plant.force"]\n'
        'plant.fmu = "cart.fmu"\ncontroller = { fmu = "unlike.fmu", start.enable = 1.0 }',
        encoding="utf-8",
    )
    assert "no enumeration `law`" in sentence(ended("tune", "bare.toml", "--fmus", units, cwd=place))


def test_laws_are_those_of_the_controller(units, scenario, fmus):
    assert laws_of(scenario(CART_SCENARIO)[0], units, None) == ["LC", "IHC"]
    assert laws_of(load_scenario("tilt")[0], fmus, None) == list(LAWS)


def test_a_comparison_of_two_units_needs_no_combined_norm(units, scenario):
    chosen, folder = scenario(CART_SCENARIO)
    (found,) = run_experiments([Experiment(chosen, folder, 4)], units, ("LC", "IHC"))
    assert found.count == 1
    assert found.value("IHC", "integral_e2[plant.speed]").value > 0.0
    assert math.isnan(found.change("IHC", "LC", "steady_rms[plant.position]").value) or found.steady("LC")
    assert start_values_of(Path(units) / "cart.fmu")["x0[1]"] == 0.1


# The project's own units for any linear system


@pytest.fixture(scope="session")
def carts(tmp_path_factory):
    """LinearPlant and HomogeneousController of two carts joined by a spring, pushed by two forces; a design of degree -1."""
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-2, 2, 0, 0], [1, -1, 0, 0]], float)
    B = np.array([[0, 0], [0, 0], [1, 0], [0, 0.5]], float)
    K = -B.T @ solve_continuous_are(A, B, np.diag([4.0, 4.0, 1.0, 1.0]), np.eye(2))
    states = tuple(Quantity(name, unit) for name, unit in (("x1", "m"), ("x2", "m"), ("v1", "m/s"), ("v2", "m/s")))
    forces = (Quantity("f1", "N"), Quantity("f2", "N"))
    system = System(A=A, B=B, K=K, name="carts", states=states, inputs=forces, set_points=("x1", "x2"))
    design, form = inverse_design(system, Options(alpha=0.1, u_max=2.0)), block_form(A, B)
    shape = Shape(
        name="carts", states=states, inputs=forces, outputs=states, set_points=("x1", "x2"), biases=(), estimated=False
    )
    N_x = np.diag([1.0, 1.0, 0.0, 0.0])
    regulator = Regulator(
        shape=shape,
        exponents=form.exponents,
        T=form.T,
        N=form.N,
        B=form.Bz,
        K_0=form.K_0,
        K=K,
        P=design.P,
        mu=design.mu,
        sample_time=1e-3,
        N_x=N_x,
    )
    folder = tmp_path_factory.mktemp("carts")
    shown, hidden = shown_linear_plant(system), linear_plant_values(system)
    export_native_fmu(PLANT, folder / "carts.fmu", interface=shown, hidden=hidden, identifier="carts_linear_plant")
    shown, hidden = regulator.exported()
    export_native_fmu(
        CONTROLLER, folder / "carts_controller.fmu", interface=shown, hidden=hidden, identifier="carts_controller"
    )
    text = """
    run = { duration = 8 }
    plant = { fmu = "carts.fmu", start = { x1_0 = 0.5, x2_0 = -0.2 } }
    controller = { fmu = "carts_controller.fmu" }
    evaluate.errors = ["plant.x1", "plant.x2"]
    """
    (folder / "carts.toml").write_text(text, encoding="utf-8")
    return folder, system


def test_a_linear_plant_and_its_homogeneous_controller_run_compare_and_tune(carts, tmp_path):
    folder, system = carts
    chosen, where = load_scenario(str(folder / "carts.toml"))
    laws = {law: chosen.changed({"controller.start.law": law, "controller.start.a_min": 0.2}) for law in ("LC", "IHC")}
    results = {law: run_scenario(one, folder, where) for law, one in laws.items()}
    expected = closed_loop(system.A, system.B, system.K, (0.5, -0.2, 0.0, 0.0), 1e-3, 8000)
    found = np.column_stack([results["LC"][f"plant.{q.name}"] for q in system.states])
    np.testing.assert_allclose(found, expected, atol=1e-9)
    metrics = {law: evaluate(result) for law, result in results.items()}
    assert metrics["IHC"].settling_time < metrics["LC"].settling_time
    assert metrics["LC"].quantities["energy"].heading == "∫Σu² dt [N² s]"
    assert {"peak[controller.f1]", "peak[controller.f2]"} <= metrics["LC"].values.keys()
    done = ended("compare", folder / "carts.toml", "--fmus", folder, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "carts: one run" in done.stdout  # sensors that do not count have no offset to draw
    assert (tmp_path / "results" / "carts" / "homogeneous_norm.png").is_file()
    options = ("--a-min", "1,0.5,0.2", "--b-max", "1", "--set", "controller.start.discretization=explicit")
    done = ended("tune", folder / "carts.toml", *options, "--fmus", folder, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((tmp_path / "results" / "tune_carts" / "tuning.csv").open(encoding="utf-8")))
    assert float(rows[0]["integral_e2"]) == pytest.approx(metrics["LC"].integral_e2, rel=1e-9)  # a_min = 1 is the LC


def test_sensors_that_count_are_drawn(carts):
    folder, _ = carts
    chosen, where = load_scenario(str(folder / "carts.toml"))
    counted = chosen.changed({"plant.start.x1_resolution": 1e-3, "run.duration": 0.5})
    (found,) = run_experiments([Experiment(counted, where, 3)], folder, ("LC",))
    assert (found.count, found.chance.offsets) == (3, ("x1_resolution_offset",))
    assert len({draw.metrics.integral_e2 for draw in found.draws}) == 3
    seeded = [run_scenario(counted.changed({"run.seed": seed}), folder, where)["plant.x1"][0] for seed in (1, 1, 2)]
    assert seeded[0] == seeded[1]
    with pytest.raises(UserError, match=r"run\.seed draws the plant's offsets"):
        run_scenario(chosen.changed({"run.seed": 1}), folder, where)


def test_a_set_point_moves_the_carts_and_a_disturbance_pushes_one(carts, tmp_path):
    folder, _ = carts
    chosen, where = load_scenario(str(folder / "carts.toml"))
    moved = chosen.changed(
        {
            "signals": [
                {"kind": "step", "input": f"controller.{x}_setpoint", "value": 0.3, "time": 1.0} for x in ("x1", "x2")
            ],
            "disturbance": {"input": "f1_disturbance", "sines": [{"amplitude": 0.05, "frequency": 3.0}], "start": 4.0},
        }
    )
    result = run_scenario(moved, folder, where)
    assert [e.set_point for e in evaluation_in(result).errors] == ["controller.x1_setpoint", "controller.x2_setpoint"]
    assert abs(result["plant.x1"][3999] - 0.3) < 1e-2
    assert evaluate(result).steady_rms < 0.05
    for changes, judged in (  # with a set-point only what has one: the others' rest moves with it
        ({}, ["x1", "x2"]),
        ({"signals": []}, ["x1", "x2", "v1", "v2"]),
        ({"signals": [], "controller.start.x2_setpoint": 0.0}, ["x1", "x2", "v1", "v2"]),
        ({"signals": [], "controller.start.x2_setpoint": 0.3}, ["x1", "x2"]),
        ({"evaluate.errors": ["plant.v1"]}, ["v1"]),
    ):
        about = evaluation(moved.changed({"evaluate.errors": None} | changes), folder, where)
        assert about is not None
        assert [error.signal for error in about.errors] == [f"plant.{name}" for name in judged]
    with pytest.raises(UserError, match=r"disturbance\.input must say .* one of f1_disturbance, f2_disturbance"):
        run_scenario(moved.changed({"disturbance.input": None}), folder, where)
    done = ended("ssp", folder / "carts.toml", "--fmus", folder, "-o", "carts.ssp", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    packed, inside = load_scenario(str(tmp_path / "carts.ssp"))
    again = run_scenario(packed.changed({"run.duration": 0.5}), inside, inside)
    plain = run_scenario(chosen.changed({"run.duration": 0.5}), folder, where)
    np.testing.assert_array_equal(again["plant.x1"], plain["plant.x1"])


# Overlay


def table_of(result, path, names, shift=0.0, extra=None):
    """Write columns of a result as someone's table, with a clock of its own."""
    columns = [result.time + shift, *(result[name] for name in names)]
    names = ["time", *names, *([] if extra is None else [extra])]
    rows = [[*row, *([] if extra is None else ["warm"])] for row in zip(*columns, strict=True)]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([names, *rows])


def test_a_scenario_is_laid_over_a_table_of_whatever_system(units, scenario, tmp_path):
    """A cart from elsewhere, measured at other times than the simulation's, beginning at 5 s of its clock."""
    chosen, folder = scenario(CART_SCENARIO)
    true = run_scenario(
        chosen.changed({"run.step": 4e-3, "plant.start.x0[1]": 0.13, "run.duration": 2.0}), units, folder
    )
    names = ["controller.force", "plant.position"]
    table_of(true, tmp_path / "bench.csv", names, 5.0, "note")
    done = ended("overlay", "bench.csv", "--scenario", "mine.toml", "--begin", "5", "--fmus", units, cwd=tmp_path)
    assert (done.returncode, done.stderr.split(": ", 1)[-1].strip()) == (
        0,
        "columns of bench.csv that no signal of the scenario has the name of: note",
    )
    assert files(tmp_path / "bench_overlay") == [
        "controls.png",
        "norm.png",
        "signals.png",
        "simulation.csv",
        "simulation.json",
    ]
    simulation = Result.load(tmp_path / "bench_overlay" / "simulation.csv")
    assert simulation.time[-1] == 2.0
    expected = np.interp(true.time, simulation.time, simulation["plant.position"]) - true["plant.position"]
    assert f"RMS difference of plant.position: {np.sqrt(np.mean(expected**2)):.4g} m\n" in done.stdout
    assert re.search(r"^RMS difference of controller\.force: \S+ N$", done.stdout, re.MULTILINE)
    assert not re.search(r"\barm\b|pendulum|\bV\b", done.stdout)
    same = lay(
        tmp_path / "bench.csv", chosen.changed({"plant.start.x0[1]": 0.13, "run.step": 4e-3}), units, folder, 5.0
    )
    assert all(value < 1e-12 for value in compared(same).values())  # what the right plant leaves: the clock's rounding


def test_a_simulation_that_rests_is_said_to(units, scenario, tmp_path):
    chosen, folder = scenario(CART_SCENARIO)
    rests = chosen.changed({"plant.start.x0[1]": 0.0})
    table_of(run_scenario(rests, units, folder), tmp_path / "bench.csv", ["plant.position", "controller.force"])
    at_rest = ("--set", "plant.start.x0[1]=0")
    done = ended("overlay", "bench.csv", "--scenario", "mine.toml", *at_rest, "--fmus", units, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip().startswith("note: nothing moved: all was at rest where it began")


def test_a_result_is_made_again_with_its_own_scenario(units, scenario, tmp_path):
    chosen, folder = scenario(CART_SCENARIO)
    result = run_scenario(chosen.changed({"run.duration": 1.0}), units, folder)
    result.metadata["fmus"]["plant"]["guid"] = "{earlier}"
    result.save(tmp_path / "run.csv")
    missing = "FMU fmus/cart_controller.fmu does not exist; --fmus names the folder of the scenario's FMUs"
    assert sentence(ended("overlay", "run.csv", cwd=tmp_path)) == missing.replace("/", os.sep)
    done = ended("overlay", "run.csv", "--fmus", units, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip() == "note: cart.fmu is not the file that the run was made with (another GUID)"
    assert "RMS difference of plant.speed: 0 m/s\n" in done.stdout
    del result.metadata["scenario"]
    result.save(tmp_path / "run.csv")
    assert "does not say with which scenario it was made" in sentence(ended("overlay", "run.csv", cwd=tmp_path))


def test_columns_that_nothing_is_judged_by_are_drawn_and_compared(units, scenario, tmp_path):
    chosen, folder = scenario(CART_SCENARIO)
    table_of(run_scenario(chosen, units, folder), tmp_path / "bench.csv", ["controller.force"])
    laid = lay(tmp_path / "bench.csv", chosen, units, folder)
    assert compared(laid) == {"controller.force": 0.0}
    assert laid.seen.metadata["evaluation"]["errors"] == []
    done = ended("overlay", "bench.csv", "--scenario", "mine.toml", "--fmus", units, cwd=tmp_path)
    assert files(tmp_path / "bench_overlay") == ["signals.png", "simulation.csv", "simulation.json"]
    assert "RMS difference of controller.force: 0 N\n" in done.stdout


@pytest.mark.parametrize(
    ("content", "options", "problem"),
    [
        ("t,plant.speed\n0,1\n", (), "bench.csv must have a column time, found t, plant.speed"),
        (
            "time,speed\n0,1\n",
            (),
            "must have columns named as the scenario's signals, .*plant.position.*; found time, speed",
        ),
        ("time,plant.speed\n0,1\n", (), "bench.csv must have 2 rows from 0 s on, found 1"),
        ("time,plant.speed\n0,1\n1,2\n", ("--begin", "3"), "bench.csv must have 2 rows from 3 s on, found 0"),
        ("time,plant.speed,plant.speed\n0,1,2\n", (), "bench.csv must have the column plant.speed once"),
        ("time,plant.speed\n0,1\n1,x\n", (), "line 3 must have a number in each column"),
        ("time,plant.speed\n0,1\n1,2\n", ("--parameters", "ident"), "--parameters is for logs of the pendulum"),
        (None, (), "measured file bench.csv does not exist"),
    ],
)
def test_what_cannot_be_overlaid_is_one_sentence(units, scenario, tmp_path, content, options, problem):
    scenario(CART_SCENARIO)
    if content is not None:
        (tmp_path / "bench.csv").write_text(content, encoding="utf-8")
    done = ended("overlay", "bench.csv", "--scenario", "mine.toml", "--fmus", units, *options, cwd=tmp_path)
    assert re.search(problem, sentence(done))
    assert files(tmp_path) == ["bench.csv", "mine.toml"][content is None :]
