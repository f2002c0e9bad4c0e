"""The FMUs of a design in C and in Python: one unit each for every design, and to a user the same."""

import ctypes
import math
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.validation import validate_fmu

from fmu_export.errors import UserError
from fmu_export.native_fmu import export_native_fmu
from fmu_export.python_fmu import export_python_fmu
from ihc_fmu.regulator.native_unit import NATIVE as CONTROLLER
from ihc_fmu.regulator.slave import HomogeneousController
from plant_fmu.linear.native_unit import NATIVE as PLANT
from plant_fmu.linear.slave import LinearPlant
from plant_fmu.linear.start_values import linear_plant_values, shown_interface
from tests.fmu_export.conftest import Native
from tests.ihc_fmu.regulator.conftest import EXACT, H, random_regulator
from tests.plant_fmu.linear.models import CRANE, random_system

KINDS = ("native", "python")
ANY_NAME = 'Füllstand "1" <m> & 100 %s'


def controller(*sizes, **options):
    return CONTROLLER, HomogeneousController, *random_regulator(*sizes, **options).exported()


def plant(system):
    return PLANT, LinearPlant, shown_interface(system), linear_plant_values(system)


def renamed(design, slot, name):
    """Return the design with the variable of a slot shown under another name."""
    native, slave, interface, hidden = design
    variables = [v.shown_as(name) if v.compiled == slot else v for v in interface.variables]
    by_slots = [
        replace(v, initial_dependencies=native.interface.by_name[v.compiled].initial_dependencies) for v in variables
    ]
    shown = native.interface.showing(by_slots, name=interface.name, step_parameter=interface.step_parameter)
    return native, slave, shown, hidden


DESIGNS = {
    "small_controller": renamed(controller(2, 1, mu=0.5), "measurement_1", ANY_NAME),
    "filtered_controller": controller(6, 2, 3, set_points=True, integral=True, mu=0.5),
    "observed_controller": controller(4, 2, observed=2),
    "largest_controller": controller(16, 8, 16, set_points=True),
    "crane_linear_plant": plant(CRANE),
    "wide_linear_plant": plant(random_system(29)),
}


def export(which, kind, folder, changes=None, **options):
    """Export a design's FMU of a kind; return its path."""
    native, slave, interface, hidden = DESIGNS[which]
    options = {"interface": interface, "hidden": hidden, "identifier": which, **options}
    path = folder / f"{which}.fmu"
    if kind == "native":
        return export_native_fmu(native, path, changes, **options)
    return export_python_fmu(slave, path, changes, **options)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = {kind: tmp_path_factory.mktemp(kind) for kind in KINDS}
    return {(which, kind): export(which, kind, folder[kind]) for which in DESIGNS for kind in KINDS}


@pytest.fixture(scope="module")
def unpacked(files, tmp_path_factory):
    return {key: Path(extract(str(path), str(tmp_path_factory.mktemp(key[0])))) for key, path in files.items()}


@pytest.fixture
def instance(unpacked):
    """Make an instance of a design's FMU of a kind; all are freed after the test."""
    made = []

    def make(which, kind):
        made.append(Native(unpacked[which, kind]))
        return made[-1]

    yield make
    for one in made:
        one.free()


@pytest.fixture(params=DESIGNS)
def both(request, instance):
    """An FMU of either kind of one design."""
    return [instance(request.param, kind) for kind in KINDS]


def agree(actual, expected):
    """To the last bit where both call the same mathematical library."""
    tolerance = 0.0 if EXACT else 1e-12
    np.testing.assert_allclose(np.array(actual, float), np.array(expected, float), rtol=tolerance, atol=tolerance)


def inputs_of(fmu):
    return [name for name, v in fmu.variables.items() if v.causality == "input"]


def rows_of(fmu, count, seed=0):
    """Return random inputs about 0 by name, a row for each step."""
    names = inputs_of(fmu)
    return [dict(zip(names, row, strict=True)) for row in np.random.default_rng(seed).normal(size=(count, len(names)))]


def warned(fmu):
    return [entry for entry in fmu.log if entry[0] == 1]


def described_by(path) -> Any:
    return read_model_description(str(path))


def complaint(fmu):
    """Return the first error in the log; PythonFMU's wrapper adds one of its own."""
    return next(message for status, _, message in fmu.log if status == 3)


# The file


@pytest.mark.parametrize("which", DESIGNS)
def test_both_kinds_are_valid_and_describe_the_same(which, files):
    native, python = (described_by(files[which, kind]) for kind in KINDS)
    assert validate_fmu(str(files[which, "python"])) == []
    assert (python.modelName, python.coSimulation.modelIdentifier) == (native.modelName, which)
    variables = [
        [(v.name, v.valueReference, v.causality, v.variability, v.type, v.start, v.min, v.max, v.unit) for v in d]
        for d in (native.modelVariables, python.modelVariables)
    ]
    assert variables[0] == variables[1]
    with zipfile.ZipFile(files[which, "python"]) as archive:
        assert f"binaries/linux64/{which}.so" in archive.namelist()


def test_same_arguments_give_the_same_bytes(files, tmp_path):
    which = "small_controller"
    assert export(which, "python", tmp_path).read_bytes() == files[which, "python"].read_bytes()


def test_hidden_values_are_part_of_the_identity(files, tmp_path):
    _, _, _, hidden = DESIGNS["crane_linear_plant"]
    changed = export("crane_linear_plant", "python", tmp_path, hidden={**hidden, "A_4_4": -0.2})
    guids = {read_model_description(str(path)).guid for path in (changed, files["crane_linear_plant", "python"])}
    assert len(guids) == 2


# A run


def test_both_kinds_have_the_same_values(both):
    native, python = both
    for fmu in both:
        fmu.initialize()
    agree(native.outputs(), python.outputs())
    for k, row in enumerate(rows_of(native, 40)):
        agree(native.step(k * H, H, **row), python.step(k * H, H, **row))
    assert len(set(native.outputs())) > 1


@pytest.mark.parametrize("which", [which for which in DESIGNS if which.endswith("controller")])
def test_both_kinds_can_be_tuned_and_go_on_with_the_same_values(which, instance):
    native, python = both = [instance(which, kind) for kind in KINDS]
    bounds = {"_lower": -0.01, "_upper": 0.02}
    tuned = {name: bounds[name[-6:]] for name in native.variables if name.endswith(tuple(bounds))} | {"law": 1}
    for fmu in both:
        fmu.initialize(a_min=0.5, b_max=0.5)
    for k, row in enumerate(rows_of(native, 30, seed=1)):
        if k == 10:
            assert native.get("homogeneous_norm_used") == (0.5,)
            for fmu in both:
                fmu.set(**tuned)
            agree(native.outputs(), python.outputs())
        agree(native.step(k * H, H, **row), python.step(k * H, H, **row))
    assert native.get("homogeneous_norm_used") == (1.0,)  # of the linear law


def test_saved_state_continues_in_another_instance(instance):
    for which in ("filtered_controller", "wide_linear_plant"):
        one, other = (instance(which, "python") for _ in range(2))
        rows = rows_of(one.initialize(), 30, seed=2)
        for k in range(10):
            one.step(k * H, H, **rows[k])
        other.done("SetFMUstate", other.deserialize(one.serialize(one.save())))
        for k in range(10, 30):
            assert other.step(k * H, H, **rows[k]) == one.step(k * H, H, **rows[k])


def test_state_of_another_design_is_refused(instance, tmp_path):
    """Of the same names and sizes, with another gain."""
    redesigned = export("filtered_controller", "python", tmp_path, {"K_1_1": 0.5})
    other = Native(extract(str(redesigned), str(tmp_path / "unpacked"))).initialize()
    state = other.serialize(other.save())
    fmu = instance("filtered_controller", "python").initialize()
    before = fmu.everything()
    assert fmu.call("SetFMUstate", fmu.deserialize(state)) >= 3
    assert complaint(fmu).startswith("the state must be one of this FMU")
    assert fmu.everything() == before
    other.free()


def test_two_designs_of_one_class_do_not_touch_each_other(instance):
    names = ("small_controller", "filtered_controller", "largest_controller")
    alone = {}
    for which in names:
        fmu = instance(which, "python").initialize()
        alone[which] = [fmu.step(k * H, H, **row) for k, row in enumerate(rows_of(fmu, 10))]
    together = {which: instance(which, "python").initialize() for which in names}
    for k in range(10):
        for which, fmu in together.items():
            assert fmu.step(k * H, H, **rows_of(fmu, 10)[k]) == alone[which][k]


# Words


@pytest.mark.parametrize(
    ("which", "bad", "words"),
    [
        (
            "small_controller",
            {ANY_NAME: math.nan},
            f"fault non_finite_input: {ANY_NAME} = nan; the commands are 0 within",
        ),
        (
            "filtered_controller",
            {"y2": math.inf, "y3_setpoint": math.nan},
            "fault non_finite_input: y2 = inf, y3_setpoint = nan; the commands are 0 within",
        ),
    ],
)
def test_faults_are_told_in_the_same_words(which, bad, words, instance):
    both = [instance(which, kind).initialize() for kind in KINDS]
    for fmu in both:
        fmu.step(0.0, H, **bad)
    native, python = map(warned, both)
    assert native == python
    assert words in python[0][2]


@pytest.mark.parametrize(
    ("which", "wrong", "words"),
    [
        ("filtered_controller", {"u2_lower": 9.0, "u2_upper": 8.0}, "u2_lower must not exceed u2_upper, found 9 and 8"),
        ("crane_linear_plant", {"force_lower": 6.0}, "force_lower must not exceed force_upper, found 6 and 4"),
    ],
)
def test_contradictions_are_told_in_the_same_words(which, wrong, words, instance, tmp_path):
    for kind in KINDS:
        with pytest.raises(UserError) as caught:
            export(which, kind, tmp_path, wrong)
        assert str(caught.value) == words
        assert list(tmp_path.iterdir()) == []
        fmu = instance(which, kind)
        fmu.set(**wrong)
        fmu.setup()
        fmu.done("EnterInitializationMode")
        assert fmu.call("ExitInitializationMode") >= 3
        assert complaint(fmu).startswith(words)


def test_inputs_that_a_plant_refuses_are_told_in_its_names(instance):
    fmu = instance("crane_linear_plant", "python").initialize(force_upper=1.7e308)
    fmu.set(force=1.7e308, force_disturbance=1.7e308)
    assert fmu.call("DoStep", 0.0, H, 0) >= 3
    message = complaint(fmu)
    assert message.startswith("inputs must be finite, found force, force_disturbance = (")
    assert "with force = 1.7e+308, force_disturbance = 1.7e+308\n" in message


@pytest.mark.parametrize("kind", KINDS)
def test_variables_that_are_not_shown_do_not_exist(kind, instance):
    fmu = instance("small_controller", kind).initialize()
    hidden = [v.name for v in CONTROLLER.interface.variables].index("measurement_3")
    references = (ctypes.c_uint * 1)(hidden)
    value = (ctypes.c_double * 1)(1.0)
    for function in ("SetReal", "GetReal"):
        fmu.log.clear()
        assert fmu.call(function, references, 1, value) >= 3
        assert f"no Real variable has the value reference {hidden}" in complaint(fmu)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"identifier": "2 small"}, "an FMU's identifier must be letters, digits and underscores"),
        ({"hidden": {"measurement_1": 1.0}}, "measurement_1 must be hidden or shown"),
        ({"changes": {"b_max": math.nan}}, "b_max must be finite, found nan"),
        ({"changes": {"measurement_1": 0.0}}, "plant_controller has no parameter or input named 'measurement_1'"),
    ],
)
def test_what_cannot_be_exported_is_refused_by_both_in_the_same_words(options, words, tmp_path):
    for kind in KINDS:
        with pytest.raises(UserError, match=words):
            export("small_controller", kind, tmp_path, **options)
        assert list(tmp_path.iterdir()) == []
