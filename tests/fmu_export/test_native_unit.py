"""The C texts and the bytes that follow from an interface: table of variables, start values, initializer."""

import math
import struct
from dataclasses import replace

import pytest

from fmu_export.model_description import ModelExchange
from fmu_export.native_unit import (
    GUID_SIZE,
    NativeUnit,
    constants_header,
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
        *[parameter(f"T_{i}_{j}", 10.0 * i + j) for i in range(1, 3) for j in range(9, 12)],
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
    rows = entries(variable_table(unit))
    assert list(rows) == [v.name for v in INTERFACE.variables]
    assert "enum { VARIABLE_COUNT = 22 };" in variable_table(unit)
    header = unit.generated["fmu_model.h"]
    assert '#define UNIT_NAME "Tank"' in variable_table(unit)
    assert "#define FMI2_FUNCTION_PREFIX Tank_\n" in header
    assert unit.headers("north_tank")["fmu_model.h"] == header.replace("Tank_", "north_tank_")


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
        ("cells_1", "FMU_INTEGER, FMU_FIXED, 0, offsetof(tank_params, cells), 1.0, 60.0"),
        ("cells_2", "FMU_INTEGER, FMU_FIXED, 0, offsetof(tank_params, cells) + 1 * sizeof(int), -3.0, DBL_MAX"),
        ("T_1_9", "FMU_REAL, FMU_FIXED, 0, offsetof(tank_params, T), -DBL_MAX, DBL_MAX"),
        ("T_2_10", "FMU_REAL, FMU_FIXED, 0, offsetof(tank_params, T) + 4 * sizeof(double), -DBL_MAX, DBL_MAX"),
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
        ("tank_params", "cells", "2 * sizeof(int)"),
        ("tank_params", "T", "6 * sizeof(double)"),
    ],
)
def test_table_asserts_the_size_of_each_field(struct, field, size, unit):
    assert f"[sizeof((({struct} *)0)->{field}) == {size} ? 1 : -1];" in variable_table(unit)
    assert variable_table(unit).count(f"->{field})") == 1


def test_each_field_has_the_reference_of_its_first_variable(unit):
    text = variable_table(unit).split("enum {\n")[1].split("};")[0]
    constants = dict(line.strip().rstrip(",").split(" = ") for line in text.splitlines())
    assert {name: int(number) for name, number in constants.items()} == {
        **{f"VR_{name}": i for i, name in enumerate(("inflow", "level", "level_dot", "state", "area", "gain"))},
        **{"VR_M": 7, "VR_alone_1": 11, "VR_valve": 12, "VR_open_now": 13, "VR_cells": 14, "VR_T": 16},
    }


@pytest.mark.parametrize(
    "names",
    [("k_1", "other", "k_2"), ("k_2", "k_1"), ("k_1_1", "k_2"), ("k_1", "k_1_1"), ("k_1", "k_01")],
    ids=" ".join,
)
def test_entries_of_an_array_follow_each_other(names, tmp_path):
    table = replace(INTERFACE, variables=tuple(map(parameter, names)))
    with pytest.raises(ValueError, match="must be neighbouring entries of one array k, by rows"):
        variable_table(NativeUnit(table, dict, tmp_path, "tank", "tank"))


@pytest.mark.parametrize("last", [parameter("k_2", 1, type="Integer"), Variable("k_2", "input", "", start=0.0)])
def test_entries_of_an_array_are_of_one_type_in_one_struct(last, tmp_path):
    table = replace(INTERFACE, variables=(parameter("k_1"), last))
    with pytest.raises(ValueError, match="k_1 and k_2 must be neighbouring entries of one array k"):
        variable_table(NativeUnit(table, dict, tmp_path, "tank", "tank"))


@pytest.mark.parametrize("name", ["a.b", "2x", "größe", "a b"])
def test_compiled_variables_have_names_of_c(name, tmp_path):
    with pytest.raises(ValueError, match=f"variable name '{name}' is not a C identifier"):
        NativeUnit(replace(INTERFACE, variables=(parameter(name),)), dict, tmp_path, "tank", "tank")


def test_states_and_derivatives_are_value_references(unit):
    text = variable_table(unit)
    assert "static const unsigned STATES[] = {1};" in text
    assert "static const unsigned DERIVATIVES[] = {2};" in text
    plain = variable_table(replace(unit, model_exchange=None, largest_model_exchange=None))
    assert "STATES" not in plain
    assert "DERIVATIVES" not in plain
    assert entries(plain) == entries(text)


def test_constants_and_enumerations_are_those_of_python(unit):
    text = constants_header(replace(unit, constants={"TANK_MOST": 7, "TANK_LEAST": 1e-300}))
    assert text.splitlines()[1:-1] == [
        "#ifndef TANK_CONSTANTS_H",
        "#define TANK_CONSTANTS_H",
        "",
        "enum { TANK_MOST = 7 };",
        "#define TANK_LEAST 1e-300",
        "enum { TANK_STATE_EMPTY = 1, TANK_STATE_FULL = 2 }; /* state */",
        "enum { TANK_VALVE_SHUT = 1, TANK_VALVE_HALF = 2, TANK_VALVE_OPEN = 3 }; /* valve */",
        "",
    ]


@pytest.mark.parametrize(
    ("constants", "message"),
    [
        ({"MOST-PUMPS": 1}, "the name 'MOST-PUMPS' of a constant is not a C identifier"),
        ({"MOST": 2**31}, "the constant MOST must be finite, or an integer of 32 bits, found 2147483648"),
        ({"MOST": math.inf}, "the constant MOST must be finite, .*, found inf"),
    ],
)
def test_constant_that_c_cannot_have_is_refused(constants, message, unit):
    with pytest.raises(ValueError, match=message):
        constants_header(replace(unit, constants=constants))


def test_item_that_c_cannot_have_is_refused(unit):
    valve = replace(INTERFACE.by_name["valve"], items=("half open", "shut", "open"))
    with pytest.raises(ValueError, match="the name 'TANK_VALVE_HALF OPEN' of a constant is not a C identifier"):
        constants_header(replace(unit, interface=replace(INTERFACE, variables=(valve,))))


def test_files_of_a_unit_are_its_own_the_adapter_the_headers_and_the_table(unit):
    files = unit_files(unit)
    assert set(files) == {
        "tank.c",
        "tank.h",
        "tank_fmu.c",
        "tank_constants.h",
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
        ".open_now = 0, .cells = {7, 8}, .T = {19.0, 20.0, 21.0, 29.0, 30.0, 31.0}}"
    )


NUMBERS = [0.0, 0.0, 0.0, 0.0, 2.0, 0.1, -3.0, 1.0, 2.0, 3.0, 4.0, 5.0, 2.0, 1.0, 7.0, 8.0]
NUMBERS += [19.0, 20.0, 21.0, 29.0, 30.0, 31.0]
"""START as numbers in the order of the references; outputs are 0."""
NAMES = {"inflow": 'Zufluß "50 %" \\n', "level": "level", "gain_2": "*/ ??/"}


def test_start_value_file_is_a_head_the_guid_a_number_and_a_name_for_each_variable():
    data, count = start_value_file(INTERFACE, "{abc}", START, NAMES), len(NUMBERS)
    assert data[:8] == b"FMUstart"
    assert struct.unpack_from("<II", data, 8) == (2, count)
    assert data[16 : 16 + GUID_SIZE] == b"{abc}" + bytes(GUID_SIZE - 5)
    numbers, texts = data[16 + GUID_SIZE :][: 8 * count], data[16 + GUID_SIZE + 8 * count :]
    assert list(struct.unpack(f"<{count}d", numbers)) == NUMBERS
    assert struct.unpack_from("<I", texts) == (len(texts) - 4,)
    assert texts[4:].decode().split("\0") == [NAMES.get(v.name, "") for v in INTERFACE.variables] + [""]


def test_guid_must_leave_room_for_its_end():
    longest = "g" * (GUID_SIZE - 1)
    assert start_value_file(INTERFACE, longest, START, NAMES)[16:80] == longest.encode() + b"\0"
    with pytest.raises(ValueError, match="shorter than 64 characters"):
        start_value_file(INTERFACE, longest + "g", START, NAMES)


@pytest.mark.parametrize("value", [0.1, -1e-300, 1.7976931348623157e308, 5e-324, 1 / 3])
def test_source_and_file_hold_the_same_numbers_to_the_last_bit(value):
    start = START | {"area": value}
    text = start_value_source(INTERFACE, "{abc}", start, NAMES)
    lines = text.split("START[] = {\n")[1].split("\n};")[0].splitlines()
    numbers = [line.split(", /* ")[0].strip() for line in lines]
    names = [line.split(", /* ")[1].removesuffix(" */") for line in lines]
    assert names == [v.name for v in INTERFACE.variables]
    data = start_value_file(INTERFACE, "{abc}", start, NAMES)[16 + GUID_SIZE :]
    assert struct.pack(f"<{len(numbers)}d", *map(float, numbers)) == data[: 8 * len(numbers)]
    assert 'snprintf(start->guid, FMU_GUID_SIZE, "{abc}");' in text


def test_names_in_the_source_are_plain_literals():
    text = start_value_source(INTERFACE, "g", START, NAMES)
    texts = text.split("NAMES[] = {\n")[1].split("\n};")[0].splitlines()
    expected = ["NULL"] * len(texts)
    expected[:2] = r'"Zuflu\303\237 \04250 %\042 \134n"', '"level"'
    expected[6] = r'"*/ \077\077/"'
    assert [line.strip().rstrip(",") for line in texts] == expected
    assert text.isascii()


def test_texts_are_the_same_every_time(unit):
    assert unit_files(unit) == unit_files(unit)
    backwards = dict(reversed(START.items())), dict(reversed(NAMES.items()))
    assert start_value_source(INTERFACE, "g", START, NAMES) == start_value_source(INTERFACE, "g", *backwards)
