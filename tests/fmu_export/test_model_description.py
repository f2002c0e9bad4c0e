"""modelDescription.xml: valid, complete, and equal to the interface table it is made from."""

import math
import random
import zipfile
from xml.etree import ElementTree as ET

import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_export.errors import UserError
from fmu_export.model_description import Capabilities, model_description
from fmu_export.origin import Origin
from fmu_export.units import DISPLAY, base_unit
from fmu_export.variables import Interface, Variable

reproducible = settings(deadline=None, derandomize=True, database=None)
CAPABILITIES = Capabilities(
    "Everything", needs_execution_tool=True, generation_tool="a tool", origin=Origin(version="1.2.3")
)


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
    description = read_model_description(str(fmus[name]))
    assert (description.modelName, description.description) == (interface.name, interface.description)
    assert description.coSimulation is not None
    assert description.coSimulation.modelIdentifier == interface.name
    assert description.coSimulation.canHandleVariableCommunicationStepSize == interface.variable_step
    assert description.coSimulation.canGetAndSetFMUstate
    assert description.coSimulation.canSerializeFMUstate
    experiment = description.defaultExperiment
    assert experiment is not None
    times = (experiment.startTime, experiment.stopTime, experiment.stepSize)
    assert [float(time or "nan") for time in times] == [0.0, interface.stop_time, interface.step_size]
    assert [v.valueReference for v in description.modelVariables] == list(range(len(interface.variables)))
    for read, table in zip(description.modelVariables, interface.variables, strict=True):
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
    described = {v.name: v for v in read_model_description(str(fmus[name])).modelVariables}
    named = [v for v in slaves[name].interface.variables if v.type == "Enumeration"]
    assert named
    for variable in named:
        declared = described[variable.name].declaredType
        assert declared is not None
        assert [(item.name, item.value) for item in declared.items] == [
            (item, str(i)) for i, item in enumerate(variable.items, start=1)
        ]


def unknowns(path, section):
    """Return what each unknown of a section of ModelStructure depends on, by names."""
    root = xml_of(path)
    names = ["", *(v.get("name") for v in root.iterfind("ModelVariables/ScalarVariable"))]
    dependencies = {}
    for unknown in root.iterfind(f"ModelStructure/{section}/Unknown"):
        known = unknown.attrib["dependencies"].split()  # an absent attribute would mean: depends on everything
        assert unknown.attrib["dependenciesKind"].split() == ["dependent"] * len(known)
        dependencies[names[int(unknown.attrib["index"])]] = {names[int(index)] for index in known}
    return dependencies


def test_outputs_of_co_simulation_depend_on_no_input(name, fmus, slaves):
    assert unknowns(fmus[name], "Outputs") == {v.name: set() for v in slaves[name].interface.of("output")}


OF_THE_MODEL = {"voltage", "disturbance_voltage", "pendulum_torque", "voltage_limit"}
"""In model exchange voltages act at once; in co-simulation in the coming step."""


def another(variable, value, rng):
    """Return an admissible value near `value`, or another choice."""
    if variable.type == "Enumeration":
        return value % len(variable.items) + 1
    if variable.type == "Boolean":
        return not value
    if variable.type == "Integer":
        return int(value) + 3
    if variable.name.startswith("P_"):  # stays positive definite
        return value * rng.uniform(1.0 - 1e-4, 1.0 + 1e-4)
    low, high = variable.limits()
    return min(high, max(low, value * rng.uniform(0.5, 1.5) + rng.uniform(0.0, 0.02)))


def guess(interface, start, rng):
    """Return start values at random about those given, with encoders fine and coarse, so that all shows."""
    values = {}
    for v in interface.variables:
        if v.start is not None:
            again = v.type == "Real" or (v.type != "Integer" and rng.random() < 0.5)
            values[v.name] = another(v, start[v.name], rng) if again else start[v.name]
    fine = {"encoder_counts": rng.choice((2**30, 64)), "measurement_delay": 0.0}
    return values | {name: value for name, value in fine.items() if name in values}


def test_initial_unknowns_depend_on_what_changes_them_and_on_nothing_else(name, fmus, native_fmus, slaves, start):
    interface, rng = slaves[name].interface, random.Random(3)
    declared = {v.name: set(v.initial_dependencies) for v in interface.calculated}

    def outputs(values):
        inputs = tuple(values[v.name] for v in interface.of("input"))
        try:
            unit = slaves[name].unit_class(values)
            unit.initialize(0.0, inputs)
        except UserError:
            return None
        computed = dict(zip(declared, unit.outputs(), strict=True))
        return computed if all(map(math.isfinite, computed.values())) else None

    dependencies = {output: set() for output in declared}
    for _ in range(60):
        values = guess(interface, start[name], rng)
        before = outputs(values)
        if before is None:
            continue
        for v in interface.variables:
            if v.start is None:
                continue
            after = outputs({**values, v.name: another(v, values[v.name], rng)})
            if after is not None:
                for output in declared:
                    if after[output] != before[output]:
                        dependencies[output].add(v.name)
    assert {name: dependencies[name] ^ declared[name] for name in declared} == {name: set() for name in declared}
    initial = unknowns(fmus[name], "InitialUnknowns")
    assert initial == {v.name: declared[v.name] for v in interface.of("output")}
    native = unknowns(native_fmus[name], "InitialUnknowns")
    assert {output: known - OF_THE_MODEL for output, known in native.items()} == {o: declared[o] for o in native}
    assert {output for output in initial if initial[output] & {v.name for v in interface.of("input")}} == (
        {"homogeneous_norm"} if name == "IhcController" else set()
    )
    if name == "QubeServo2":
        assert set(native) == {*initial, "theta_ddot", "delta_ddot"}
        assert native["current"] & OF_THE_MODEL == {"voltage", "disturbance_voltage", "voltage_limit"}
        assert native["theta_ddot"] & OF_THE_MODEL == OF_THE_MODEL


def test_left_out_outputs_become_local_variables(slaves, start, unit, tmp_path):
    from fmu_export.python_fmu import export_python_fmu

    slave = slaves["IhcController"]
    path = export_python_fmu(slave, tmp_path / "unit.fmu", start["IhcController"], outputs=["voltage", "mode"])
    assert validate_fmu(str(path)) == []
    causalities = {v.name: v.causality for v in read_model_description(str(path)).modelVariables}
    assert [name for name, causality in causalities.items() if causality == "output"] == ["voltage", "mode"]
    assert causalities["fault"] == "local"
    assert set(unknowns(path, "Outputs")) == {"voltage", "mode"}
    with pytest.raises(UserError, match="IhcController has no output named 'vltage'; did you mean voltage"):
        slave.interface.exposing(["vltage"])


def test_dependencies_are_counted_from_one_in_the_order_of_the_variables():
    parameter = Variable("p", "parameter", "", variability="fixed", start=0.0)
    inputs = [Variable(name, "input", "", start=0.0) for name in ("u", "v")]
    root = described(thing(parameter, *inputs, Variable("y", "output", "", dependencies=("v", "u"))))
    (unknown,) = root.iterfind("ModelStructure/Outputs/Unknown")
    assert unknown.attrib == {"index": "4", "dependencies": "2 3", "dependenciesKind": "dependent dependent"}


MODELICA = """algorithm and annotation block break class connect connector constant constrainedby der discrete each else
elseif elsewhen encapsulated end enumeration equation expandable extends external false final flow for function if import
impure in initial inner input loop model not operator or outer output package parameter partial protected public pure record
redeclare replaceable return stream then true type when while within"""


def test_no_name_is_a_word_of_modelica(slaves):
    """Nor do items have the names of an enumeration's attributes."""
    words, attributes = set(MODELICA.split()), {"quantity", "min", "max", "start", "fixed"}
    for slave in slaves.values():
        variables = slave.interface.variables
        assert words & {slave.interface.name, *(v.name for v in variables)} == set()
        assert (words | attributes) & {item for v in variables for item in v.items} == set()


def test_volt_is_kg_m2_per_s3_and_ampere(name, fmus):
    units = {u.name: u.baseUnit for u in read_model_description(str(fmus[name])).unitDefinitions}
    volt = units["V"]
    assert volt is not None
    assert (volt.kg, volt.m, volt.s, volt.A, volt.K, volt.mol, volt.cd, volt.rad) == (1, 2, -3, -1, 0, 0, 0, 0)
    assert (volt.factor, volt.offset) == (1.0, 0.0)


def test_every_real_has_a_unit_defined_with_its_exponents(name, fmus):
    description = read_model_description(str(fmus[name]))
    units = {u.name: u.baseUnit for u in description.unitDefinitions}
    used = {v.unit for v in description.modelVariables if v.type == "Real"}
    assert set(units) == used
    for symbol, base in units.items():
        exponents = {key: getattr(base, key) for key in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
        known = base_unit(symbol or "")
        assert known is not None
        assert base is not None
        assert {key: power for key, power in exponents.items() if power} == known.powers
        assert (base.factor, base.offset) == (known.factor, known.offset) == (1.0, 0.0)


def test_units_of_any_kind_are_declared():
    units = ["mV", "furlong", "degC", "%", 'a "<unit>"']
    root = described(thing(*[Variable(f"y_{i}", "output", "", unit) for i, unit in enumerate(units)]))
    bases = {unit.get("name"): unit.find("BaseUnit") for unit in root.iterfind("UnitDefinitions/Unit")}
    assert {name: None if base is None else base.attrib for name, base in bases.items()} == {
        "mV": {"kg": "1", "m": "2", "s": "-3", "A": "-1", "factor": "0.001"},
        "furlong": None,
        "degC": {"K": "1", "offset": "273.15"},
        "%": {"factor": "0.01"},
        'a "<unit>"': None,
    }


def test_angles_are_displayed_in_degrees(name, fmus):
    shown = {
        u.name: [(d.name, d.factor, d.offset) for d in u.displayUnits]
        for u in read_model_description(str(fmus[name])).unitDefinitions
        if u.displayUnits
    }
    assert set(shown) == set(DISPLAY)
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
    starts = {v.name: v.start for v in read_model_description(str(path)).modelVariables}
    asked = {"theta_0": "0.30000000000000004", "delta_0": "1e-300", "noise_seed": "2147483647", "back_emf": "false"}
    assert {key: starts[key] for key in changes} == {**asked, "motor_model": "2"}
    assert starts["m_p"] == "0.024"


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
