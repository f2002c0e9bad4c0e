"""The native FMU of one design: its own names, the library's numbers, its words."""

import math
from typing import Any

import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

from fmu_export.errors import UserError
from fmu_export.native_fmu import export_native_fmu
from fmu_export.shown import Showing
from ihc_fmu.regulator.interface import INTERFACE
from ihc_fmu.regulator.native_unit import NATIVE
from ihc_fmu.regulator.unit import HomogeneousControllerUnit, Mode
from tests.fmu_export.conftest import Native
from tests.ihc_fmu.regulator.conftest import OUTPUT_NAMES, H, agree, random_regulator, row

DESIGNS = {
    "small": random_regulator(2, 1, mu=0.5),
    "filtered": random_regulator(6, 2, 3, set_points=True, integral=True, mu=0.5),
    "largest": random_regulator(16, 8, 16, set_points=True, integral=True),
}


def described_by(path) -> Any:
    return read_model_description(str(path))


@pytest.fixture(scope="module")
def export(tmp_path_factory):
    """Export the FMU of a design."""

    def make(name, *changes, **options):
        interface, hidden = DESIGNS[name].exported()
        path = tmp_path_factory.mktemp(name) / f"{name}_controller.fmu"
        return export_native_fmu(
            NATIVE, path, *changes, interface=interface, hidden=hidden, identifier=f"{name}_controller", **options
        )

    return make


@pytest.fixture(scope="module")
def files(export):
    return {name: export(name) for name in DESIGNS}


@pytest.fixture
def instance(files, tmp_path):
    made = []

    def make(name):
        made.append(Native(extract(str(files[name]), str(tmp_path / f"{name}{len(made)}"))))
        return made[-1]

    yield make
    for native in made:
        native.free()


def test_file_is_valid_and_named_after_the_design(files):
    for name, path in files.items():
        assert validate_fmu(str(path)) == []
        described = described_by(path)
        assert described.modelName == "plant_controller"
        assert described.coSimulation.modelIdentifier == f"{name}_controller"
        assert described.defaultExperiment.stepSize == str(H)


def test_value_references_are_those_of_the_table(files):
    references = {v.name: v.valueReference for v in described_by(files["filtered"]).modelVariables}
    place = {v.name: i for i, v in enumerate(INTERFACE.variables)}
    assert references["u2"] == place["command_2"]
    assert references["y3_setpoint"] == place["setpoint_3"]
    assert references["K_2_1"] == place["K_7"]


@pytest.mark.parametrize("name", DESIGNS)
def test_fmu_has_the_librarys_numbers(name, instance):
    regulator = DESIGNS[name]
    native, unit = instance(name), HomogeneousControllerUnit(INTERFACE.start_values(regulator.values()))
    names = Showing(INTERFACE, regulator.exported()[0]).names
    inputs = [v.name for v in INTERFACE.of("input")]
    rng, p = np.random.default_rng(0), len(regulator.shape.outputs)
    native.initialize()
    unit.initialize(0.0, row(np.zeros(p), regulator.y_eq))
    for k in range(30):
        y = row(regulator.y_eq + rng.normal(size=p), regulator.y_eq + 0.1 * rng.normal(size=p))
        shown = {names[n]: value for n, value in zip(inputs, y, strict=True) if n in names}
        wanted = y if regulator.shape.set_points else row(y[:p], regulator.y_eq)
        native.step(k * H, H, **shown)
        unit.step(k * H, H, wanted)
        expected = {names[n]: value for n, value in zip(OUTPUT_NAMES, unit.outputs(), strict=True) if n in names}
        agree(native.get(*expected), list(expected.values()))
    assert native.get("mode") == (Mode.STABILIZING,)


def test_start_values_are_the_designs_and_can_be_changed_at_export_or_before_the_run(export, instance):
    path = export("small", {"law": "LC", "u1_upper": 0.25})
    starts = {v.name: v.start for v in described_by(path).modelVariables}
    assert float(starts["K_1_2"]) == DESIGNS["small"].K[0, 1]
    assert (starts["law"], float(starts["u1_upper"]), float(starts["mu"])) == ("1", 0.25, 0.5)
    native = instance("small").initialize(u1_equilibrium=0.125, u1_upper=0.2)
    y_eq = DESIGNS["small"].y_eq
    native.step(0.0, H, y1=y_eq[0], y2=y_eq[1])
    assert native.get("u1") == (0.125,)


def test_fault_is_told_in_the_designs_names(instance):
    native = instance("filtered").initialize()
    native.step(0.0, H, y2=math.inf, y3_setpoint=math.nan)
    assert native.log[-1][2] == (
        "t = 0 s: fault non_finite_input: y2 = inf, y3_setpoint = nan; the commands are 0 within their limits until reset"
    )


def test_contradictions_are_told_in_the_designs_names(export, instance):
    with pytest.raises(UserError, match=r"^u2_lower must not exceed u2_upper, found 9 and 8$"):
        export("filtered", {"u2_lower": 9.0, "u2_upper": 8.0})
    native = instance("filtered")
    native.set(u2_lower=9.0, u2_upper=8.0)
    native.setup()
    native.done("EnterInitializationMode")
    assert native.refused("ExitInitializationMode").startswith("u2_lower must not exceed u2_upper, found 9 and 8\n")


def test_filter_refuses_another_sample_time(export):
    with pytest.raises(
        UserError, match=r"^the Kalman filter is for a sample_time of 0.001 s, found sample_time = 0.002 s$"
    ):
        export("filtered", {"sample_time": 2e-3})


def test_state_is_saved_and_restored(instance):
    native, rng = instance("filtered").initialize(), np.random.default_rng(1)
    rows = [dict(zip(("y1", "y2", "y3"), y, strict=True)) for y in rng.normal(size=(30, 3))]
    for k in range(10):
        native.step(k * H, H, **rows[k])
    state = native.deserialize(native.serialize(native.save()))
    first = [native.step(k * H, H, **rows[k]) for k in range(10, 30)]
    native.done("SetFMUstate", state)
    assert [native.step(k * H, H, **rows[k]) for k in range(10, 30)] == first


def test_fmpy_simulates_it(files):
    signal = np.array([(0.0, 0.3, -0.2), (1.0, 0.3, -0.2)], dtype=[("time", float), ("y1", float), ("y2", float)])
    rows = simulate_fmu(str(files["small"]), stop_time=0.01, step_size=H, output_interval=H, input=signal)
    assert np.isfinite(rows["u1"]).all()
    assert rows["mode"][-1] == Mode.STABILIZING
