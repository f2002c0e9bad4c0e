"""The C texts and the bytes that follow from an interface: table of variables, start values, initializer."""

import math
import struct
from dataclasses import replace

import pytest

from fmu_export.model_description import ModelExchange
from fmu_export.native_unit import (
    GUID_SIZE,
    NativeUnit,
    start_value_file,
    start_value_source,
    struct_initializer,
    unit_files,
    variable_table,
)
from fmu_export.variables import Interface, Value, Variability, Variable


def parameter(name, start: Value = 0.0, variability: Variability = "fixed", **rest):
    return Variable(name, "parameter", "a parameter", variability=variability, start=start, **rest)


INTERFACE = Interface(
    name="Tank",
    description="A tank with an outlet",
    variables=(
        Variable("inflow", "input", "what comes in", start=0.0, fault_on_non_finite=True),
        Variable("level", "output", "height of the water"),
        Variable("level_dot", "local", "its rate"),
        Variable(
            "state", "output", "what it does", type="Enumeration", items=("empty", "full"), variability="discrete"
        ),
        parameter("area", 2.0, min=1e-6),
        parameter("gain_1", 0.1),
        parameter("gain_2", -3.0),
        parameter("M_11", 1.0),
        parameter("M_12", 2.0),
        parameter("M_21", 3.0),
        parameter("M_22", 4.0),
        parameter("alone_1", 5.0),
        parameter("valve", 2, "tunable", type="Enumeration", items=("shut", "half", "open")),
        parameter("open_now", True, "tunable", type="Boolean"),
        parameter("cells_1", 7, type="Integer", min=1, max=60),
        parameter("cells_2", 8, type="Integer", min=-3),
    ),
    step_size=0.1,
    stop_time=1.0,
    variable_step=True,
)
START = INTERFACE.start_values()
EXCHANGE = ModelExchange(("level",), ("level_dot",), {"level": ("level",), "level_dot": ("inflow", "level")}, {})


@pytest.fixture
def unit(tmp_path):
    for end in (".c", "_fmu.c", ".h"):
        (tmp_path / f"tank{end}").write_text(f"/* tank{end} */\n")
    return NativeUnit(INTERFACE, dict, tmp_path, "tank", "tank", lambda _: EXCHANGE, EXCHANGE)


def entries(text):
    """Return the table's entries by variable name, in order."""
    lines = text.split("VARIABLES[] = {\n")[1].split("\n};")[0].splitlines()
    fields = [line.strip().rstrip(",").strip("{}").split(", ", 1) for line in lines]
    return {name.strip('"'): rest for name, rest in fields}


def test_table_has_an_entry_for_each_variable_in_the_order_of_references(unit):
    found = entries(variable_table(unit))
    assert list(found) == [v.name for v in INTERFACE.variables]
    assert "enum { VARIABLE_COUNT = 16 };" in variable_table(unit)
    header = unit.generated["fmu_model.h"]
    assert '#define MODEL_IDENTIFIER "Tank"' in header
    assert "#define FMI2_FUNCTION_PREFIX Tank_\n" in header


@pytest.mark.parametrize(
    ("name", "entry"),
    [
        ("inflow", "FMU_REAL, FMU_INPUT, 1, offsetof(tank_inputs, inflow), -DBL_MAX, DBL_MAX"),
        ("level", "FMU_REAL, FMU_OUTPUT, 0, offsetof(tank_outputs, level), -DBL_MAX, DBL_MAX"),
        ("level_dot", "FMU_REAL, FMU_OUTPUT, 0, offsetof(tank_outputs, level_dot), -DBL_MAX, DBL_MAX"),
        ("state", "FMU_INTEGER, FMU_OUTPUT, 0, offsetof(tank_outputs, state), 1.0, 2.0"),
        ("area", "FMU_REAL, FMU_FIXED, 0, offsetof(tank_params, area), 1e-06, DBL_MAX"),
        ("gain_1", "FMU_REAL, FMU_FIXED, 0, offsetof(tank_params, gain), -DBL_MAX, DBL_MAX"),
        ("gain_2", "FMU_REAL, FMU_FIXED, 0, offsetof(tank_params, gain) + 1 * sizeof(double), -DBL_MAX, DBL_MAX"),
        ("M_22", "FMU_REAL, FMU_FIXED, 0, offsetof(tank_params, M) + 3 * sizeof(double), -DBL_MAX, DBL_MAX"),
        ("alone_1", "FMU_REAL, FMU_FIXED, 0, offsetof(tank_params, alone_1), -DBL_MAX, DBL_MAX"),
        ("valve", "FMU_INTEGER, FMU_TUNABLE, 0, offsetof(tank_params, valve), 1.0, 3.0"),
        ("open_now", "FMU_BOOLEAN, FMU_TUNABLE, 0, offsetof(tank_params, open_now), 0.0, 1.0"),
        ("cells_1", "FMU_INTEGER, FMU_FIXED, 0, offsetof(tank_params, cells_1), 1.0, 60.0"),
        ("cells_2", "FMU_INTEGER, FMU_FIXED, 0, offsetof(tank_params, cells_2), -3.0, DBL_MAX"),
    ],
)
def test_entry_tells_type_role_place_and_limits(name, entry, unit):
    assert entries(variable_table(unit))[name] == entry


@pytest.mark.parametrize(
    ("struct", "field", "size"),
    [
        ("tank_inputs", "inflow", "1 * sizeof(double)"),
        ("tank_outputs", "state", "1 * sizeof(int)"),
        ("tank_params", "gain", "2 * sizeof(double)"),
        ("tank_params", "M", "4 * sizeof(double)"),
        ("tank_params", "alone_1", "1 * sizeof(double)"),
        ("tank_params", "open_now", "1 * sizeof(int)"),
        ("tank_params", "cells_2", "1 * sizeof(int)"),
    ],
)
def test_table_asserts_the_size_of_each_field(struct, field, size, unit):
    assert f"[sizeof((({struct} *)0)->{field}) == {size} ? 1 : -1];" in variable_table(unit)
    assert variable_table(unit).count(f"->{field})") == 1


def test_states_and_derivatives_are_value_references(unit):
    text = variable_table(unit)
    assert "static const unsigned STATES[] = {1};" in text
    assert "static const unsigned DERIVATIVES[] = {2};" in text
    plain = variable_table(replace(unit, model_exchange=None, largest_model_exchange=None))
    assert "STATES" not in plain
    assert "DERIVATIVES" not in plain
    assert entries(plain) == entries(text)


def test_files_of_a_unit_are_its_own_the_adapter_the_headers_and_the_table(unit):
    files = unit_files(unit)
    assert set(files) == {
        "tank.c",
        "tank.h",
        "tank_fmu.c",
        "tank_table.h",
        "fmi2_adapter.c",
        "fmu_instance.c",
        "fmu_instance.h",
        "fmu_model.h",
        "fmu_names.h",
        "fmu_unit.h",
        "start_values_file.c",
        "fmi2Functions.h",
        "fmi2FunctionTypes.h",
        "fmi2TypesPlatform.h",
    }
    assert files["tank_table.h"] == variable_table(unit).encode()
    assert files["tank.c"] == b"/* tank.c */\n"
    assert b"\r" not in b"".join(files.values())


def test_initializer_names_parameters_and_groups_arrays(unit):
    start = START | {"area": math.nextafter(2.0, 3.0), "gain_2": -1e-300, "open_now": False, "valve": 3}
    assert struct_initializer(unit, start) == (
        "{.area = 2.0000000000000004, .gain = {0.1, -1e-300}, .M = {1.0, 2.0, 3.0, 4.0}, .alone_1 = 5.0, .valve = 3, "
        ".open_now = 0, .cells_1 = 7, .cells_2 = 8}"
    )


NUMBERS = [0.0, 0.0, 0.0, 0.0, 2.0, 0.1, -3.0, 1.0, 2.0, 3.0, 4.0, 5.0, 2.0, 1.0, 7.0, 8.0]
"""START as numbers in the order of the references; outputs are 0."""


def test_start_value_file_is_a_head_the_guid_and_one_number_for_each_variable():
    data = start_value_file(INTERFACE, "{abc}", START)
    assert data[:8] == b"FMUstart"
    assert struct.unpack_from("<II", data, 8) == (1, len(INTERFACE.variables))
    assert data[16 : 16 + GUID_SIZE] == b"{abc}" + bytes(GUID_SIZE - 5)
    assert list(struct.unpack("<16d", data[16 + GUID_SIZE :])) == NUMBERS


def test_guid_must_leave_room_for_its_end():
    longest = "g" * (GUID_SIZE - 1)
    assert start_value_file(INTERFACE, longest, START)[16:80] == longest.encode() + b"\0"
    with pytest.raises(ValueError, match="shorter than 64 characters"):
        start_value_file(INTERFACE, longest + "g", START)


@pytest.mark.parametrize("value", [0.1, -1e-300, 1.7976931348623157e308, 5e-324, 1 / 3])
def test_source_and_file_hold_the_same_numbers_to_the_last_bit(value):
    start = START | {"area": value}
    text = start_value_source(INTERFACE, "{abc}", start)
    lines = text.split("START[] = {\n")[1].split("\n};")[0].splitlines()
    numbers = [line.split(", /* ")[0].strip() for line in lines]
    names = [line.split(", /* ")[1].removesuffix(" */") for line in lines]
    assert names == [v.name for v in INTERFACE.variables]
    assert struct.pack("<16d", *map(float, numbers)) == start_value_file(INTERFACE, "{abc}", start)[16 + GUID_SIZE :]
    assert 'snprintf(guid, FMU_GUID_SIZE, "{abc}");' in text


def test_texts_are_the_same_every_time(unit):
    assert unit_files(unit) == unit_files(unit)
    assert start_value_source(INTERFACE, "g", START) == start_value_source(
        INTERFACE, "g", dict(reversed(START.items()))
    )
