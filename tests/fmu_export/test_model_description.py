"""modelDescription.xml: valid, complete, and equal to the interface table it is made from."""

import math
import re
import zipfile
from xml.etree import ElementTree as ET

import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_export.model_description import DEGREES, UNITS, Capabilities, model_description
from fmu_export.variables import Interface, Variable

reproducible = settings(deadline=None, derandomize=True, database=None)
CAPABILITIES = Capabilities(needs_execution_tool=True, generation_tool="a tool", version="1.2.3")


def described(interface, start=None, **changes):
    start = interface.start_values() if start is None else start
    return ET.fromstring(model_description(interface, start, "{guid}", CAPABILITIES, **changes))


def thing(*variables):
    return Interface("Thing", "a thing", variables, step_size=0.1, stop_time=1.0, variable_step=True)


def xml_of(path):
    with zipfile.ZipFile(path) as archive:
        return ET.fromstring(archive.read("modelDescription.xml"))


def test_fmpy_finds_no_problem(name, fmus):
    assert validate_fmu(str(fmus[name])) == []


def test_fmpy_reads_the_interface_table_back(name, fmus, slaves, start):
    interface = slaves[name].interface
    found = read_model_description(str(fmus[name]))
    assert (found.modelName, found.description) == (interface.name, interface.description)
    assert found.coSimulation is not None
    assert found.coSimulation.modelIdentifier == interface.name
    assert found.coSimulation.canHandleVariableCommunicationStepSize == interface.variable_step
    assert found.coSimulation.canGetAndSetFMUstate
    assert found.coSimulation.canSerializeFMUstate
    experiment = found.defaultExperiment
    assert experiment is not None
    times = (experiment.startTime, experiment.stopTime, experiment.stepSize)
    assert [float(time or "nan") for time in times] == [0.0, interface.stop_time, interface.step_size]
    assert [v.valueReference for v in found.modelVariables] == list(range(len(interface.variables)))
    for read, table in zip(found.modelVariables, interface.variables, strict=True):
        assert (read.name, read.type, read.causality) == (table.name, table.type, table.causality)
        assert read.description == table.description
        assert read.unit == (table.unit if table.type == "Real" else None)
        assert [number(read.min), number(read.max)] == [table.min, table.max]
        assert as_start(read.start) == start[name].get(table.name)
        assert read.initial == ("calculated" if table.calculated else "exact")
        if table.type == "Real" or table.variability != "continuous":
            assert read.variability == table.variability


def number(text):
    return None if text is None else float(text)


def as_start(text):
    return {None: None, "true": True, "false": False}[text] if text in (None, "true", "false") else float(text)


def test_enumerations_carry_their_names(name, fmus, slaves):
    found = {v.name: v for v in read_model_description(str(fmus[name])).modelVariables}
    named = [v for v in slaves[name].interface.variables if v.type == "Enumeration"]
    assert named
    for variable in named:
        declared = found[variable.name].declaredType
        assert declared is not None
        assert [(item.name, item.value) for item in declared.items] == [
            (item, str(i)) for i, item in enumerate(variable.items, start=1)
        ]


def test_outputs_depend_on_no_input_and_are_exactly_the_initial_unknowns(name, fmus, slaves):
    outputs = [v.name for v in slaves[name].interface.of("output")]
    found = read_model_description(str(fmus[name]))
    assert [getattr(unknown.variable, "name", None) for unknown in found.outputs] == outputs
    assert [getattr(unknown.variable, "name", None) for unknown in found.initialUnknowns] == outputs
    # an absent attribute would mean: depends on everything
    declared = [unknown.attrib for unknown in xml_of(fmus[name]).iterfind("ModelStructure/Outputs/Unknown")]
    assert [(d["dependencies"], d["dependenciesKind"]) for d in declared] == [("", "")] * len(outputs)


def test_dependencies_are_counted_from_one_in_the_order_of_the_variables():
    parameter = Variable("p", "parameter", "", variability="fixed", start=0.0)
    inputs = [Variable(name, "input", "", start=0.0) for name in ("u", "v")]
    root = described(thing(parameter, *inputs, Variable("y", "output", "", dependencies=("v", "u"))))
    (unknown,) = root.iterfind("ModelStructure/Outputs/Unknown")
    assert unknown.attrib == {"index": "4", "dependencies": "2 3", "dependenciesKind": "dependent dependent"}


SYMBOLS = {"1": {}, "s": {"s": 1}, "m": {"m": 1}, "kg": {"kg": 1}, "rad": {"rad": 1}, "A": {"A": 1}}


def dimension(unit):
    """Multiply out a unit such as N.m.s/rad into exponents of the base units."""
    total: dict[str, int] = {}
    for sign, symbol, exponent in re.findall(r"(^|[./])([A-Za-z]+|1)(\d*)", unit):
        for base, power in SYMBOLS[symbol].items():
            total[base] = total.get(base, 0) + (-1 if sign == "/" else 1) * power * int(exponent or 1)
    return {base: power for base, power in total.items() if power}


SYMBOLS["N"] = dimension("kg.m/s2")
SYMBOLS["J"] = dimension("N.m")
SYMBOLS["V"] = dimension("J/A/s")
SYMBOLS["Ohm"] = dimension("V/A")
SYMBOLS["H"] = dimension("V.s/A")


@pytest.mark.parametrize("unit", sorted(UNITS))
def test_exponents_of_a_unit_are_those_of_its_symbol(unit):
    assert UNITS[unit] == dimension(unit)


def test_volt_is_kg_m2_per_s3_and_ampere(name, fmus):
    units = {u.name: u.baseUnit for u in read_model_description(str(fmus[name])).unitDefinitions}
    volt = units["V"]
    assert volt is not None
    assert (volt.kg, volt.m, volt.s, volt.A, volt.K, volt.mol, volt.cd, volt.rad) == (1, 2, -3, -1, 0, 0, 0, 0)
    assert (volt.factor, volt.offset) == (1.0, 0.0)


def test_every_real_has_a_unit_defined_with_its_exponents(name, fmus):
    found = read_model_description(str(fmus[name]))
    units = {u.name: u.baseUnit for u in found.unitDefinitions}
    used = {v.unit for v in found.modelVariables if v.type == "Real"}
    assert set(units) == used
    for symbol, base in units.items():
        exponents = {key: getattr(base, key) for key in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
        assert {key: power for key, power in exponents.items() if power} == dimension(symbol)


def test_angles_are_displayed_in_degrees(name, fmus):
    shown = {
        u.name: [(d.name, d.factor, d.offset) for d in u.displayUnits]
        for u in read_model_description(str(fmus[name])).unitDefinitions
        if u.displayUnits
    }
    assert set(shown) == set(DEGREES)
    for radians, degrees in (("rad", "deg"), ("rad/s", "deg/s")):
        ((symbol, factor, offset),) = shown[radians]
        assert (symbol, float(offset)) == (degrees, 0.0)
        assert float(factor) * math.pi == pytest.approx(180.0, rel=1e-15)


@reproducible
@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**31), 2**31 - 1), st.booleans())
def test_start_values_are_written_exactly(real, integer, boolean):
    interface = thing(
        Variable("x", "input", "", start=0.0),
        Variable("n", "parameter", "", type="Integer", variability="fixed", start=0),
        Variable("flag", "parameter", "", type="Boolean", variability="fixed", start=False),
    )
    x, n, flag = described(interface, {"x": real, "n": integer, "flag": boolean}).iterfind(".//*[@start]")
    assert (x.tag, n.tag, flag.tag) == ("Real", "Integer", "Boolean")
    assert float(x.attrib["start"]).hex() == real.hex()
    assert n.attrib["start"] == str(integer)
    assert flag.attrib["start"] == ("true" if boolean else "false")


def test_exported_file_has_the_start_values_asked_for(tmp_path, slaves):
    from fmu_export.python_fmu import export_python_fmu

    changes = {"theta_0": 0.1 + 0.2, "delta_0": 1e-300, "noise_seed": 2**31 - 1, "back_emf": False, "motor_model": 2}
    path = export_python_fmu(slaves["QubeServo2"], tmp_path / "plant.fmu", changes)
    assert validate_fmu(str(path)) == []
    found = {v.name: v.start for v in read_model_description(str(path)).modelVariables}
    asked = {"theta_0": "0.30000000000000004", "delta_0": "1e-300", "noise_seed": "2147483647", "back_emf": "false"}
    assert {key: found[key] for key in changes} == {**asked, "motor_model": "2"}
    assert found["m_p"] == "0.024"


def test_limits_and_discrete_variability_are_written_in_the_variables_type():
    root = described(
        thing(
            Variable("x", "parameter", "", variability="tunable", start=0.5, min=0.0, max=1.0),
            Variable("n", "parameter", "", type="Integer", variability="fixed", start=2, min=1, max=60),
            Variable("y", "output", "", type="Integer"),
        )
    )
    x, n, y = root.iterfind("ModelVariables/ScalarVariable")
    assert (x[0].get("min"), x[0].get("max"), n[0].get("min"), n[0].get("max")) == ("0.0", "1.0", "1", "60")
    assert (x.get("variability"), n.get("variability"), y.get("variability")) == ("tunable", "fixed", "discrete")


def test_same_arguments_give_the_same_bytes_without_a_date(name, slaves, start, fmus):
    arguments = (slaves[name].interface, start[name], "{guid}", CAPABILITIES)
    assert model_description(*arguments) == model_description(*arguments)
    assert "generationDateAndTime" not in xml_of(fmus[name]).attrib


def test_capabilities_appear_where_fmi_wants_them():
    root = described(thing(Variable("u", "input", "", start=0.0)))
    assert (root.get("generationTool"), root.get("version"), root.get("guid")) == ("a tool", "1.2.3", "{guid}")
    (slave,) = root.iterfind("CoSimulation")
    assert slave.get("needsExecutionTool") == "true"


def test_variable_with_an_undefined_unit_is_refused():
    with pytest.raises(KeyError, match="furlong"):
        described(thing(Variable("x", "input", "", "furlong", start=0.0)))
