"""FMUs that show some of a unit's compiled variables: two from one binary, under names of any kind."""

import ctypes
import math
import shutil
import subprocess
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssd
from fmpy.validation import validate_fmu

from fmu_export import native_fmu
from fmu_export.errors import UserError
from fmu_export.native_build import host_platform, install_library
from fmu_export.native_fmu import export_native_fmu
from fmu_export.native_unit import ADAPTER, unit_files
from fmu_export.shown import Showing
from fmu_export.ssp import write_ssp
from tests.fmu_export.conftest import Native
from tests.fmu_export.tanks import NATIVE, TABLE

EXCHANGE = Native.MODEL_EXCHANGE
FLOW, LEVEL = 'Zufluß "A" <l/s> & 100 %s', "tank.north \\ level"


def shown(slot, name, **changes):
    """Return the variable `slot` of the table, shown as `name`."""
    return replace(TABLE.by_name[slot].shown_as(name), **changes)


def water(n, levels, rates, more=()):
    """Return the interface of `n` tanks with levels and their rates of these names."""
    pairs = enumerate(zip(levels, rates, strict=True), 1)
    states = [v for i, (x, dx) in pairs for v in (shown(f"level_rate_{i}", dx), shown(f"level_{i}", x))]
    return TABLE.showing([*more, *states], name="Water")


ONE = water(
    1,
    [LEVEL],
    ["rise"],
    [
        shown("high", "most", start=4.0),
        shown("low", "least"),
        shown("flow_3", FLOW, unit="m3/s"),
        shown("begin_1", "start"),
    ],
)
TWO = water(
    2,
    ["x", "level_1"],  # the latter is the table's name of the former
    ["dx", "dlevel"],
    [
        shown("corner", "corner"),
        shown("flow_8", "pump"),
        shown("mode", "mode_type"),
        shown("total", "sum"),
        shown("strategy", "mode"),
        shown("begin_1", "x_0"),
        shown("begin_2", "level_1_0"),
    ],
)
HIDDEN = {
    "ONE": {"gain_1_3": 2.0, "rate_1": 0.5, "kinds_1": 3},
    "TWO": {"count": 2, "gain_1_8": 1.0, "gain_2_8": -3.0, "rate_2": 2.0, "kinds_2": -1, "chart_50_50": 0.1},
}
INTERFACES = {"ONE": ONE, "TWO": TWO}
IDENTIFIERS = {"ONE": "north_tank", "TWO": "two_tanks"}


@pytest.fixture(scope="module")
def export(tmp_path_factory):
    """Export the unit, of which the binary has been built once."""
    binaries = tmp_path_factory.mktemp("binaries")
    install_library(binaries, unit_files(NATIVE), TABLE.name, host_platform())

    def make(path, *arguments, **options):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(native_fmu, "BINARIES", binaries)
            return export_native_fmu(NATIVE, path, *arguments, **options)

    return make


@pytest.fixture(scope="module")
def files(export, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tanks")
    return {
        which: export(
            folder / f"{IDENTIFIERS[which]}.fmu",
            interface=interface,
            hidden=HIDDEN[which],
            identifier=IDENTIFIERS[which],
        )
        for which, interface in INTERFACES.items()
    }


@pytest.fixture(scope="module")
def folders(files, tmp_path_factory):
    return {which: Path(extract(str(file), str(tmp_path_factory.mktemp(which)))) for which, file in files.items()}


def contents(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


# The file


def test_both_have_the_one_binary_under_their_own_names(files):
    host = host_platform()
    held = {which: contents(path) for which, path in files.items()}
    binaries = {which: held[which][f"binaries/{host.name}/{IDENTIFIERS[which]}{host.suffix}"] for which in files}
    assert binaries["ONE"] == binaries["TWO"]
    for which, identifier in IDENTIFIERS.items():
        description = read_model_description(str(files[which]))
        assert description.coSimulation.modelIdentifier == identifier  # type: ignore[union-attr]
        assert description.modelExchange.modelIdentifier == identifier  # type: ignore[union-attr]
        assert f"#define FMI2_FUNCTION_PREFIX {identifier}_\n".encode() in held[which]["sources/fmu_model.h"]


@pytest.mark.parametrize("which", INTERFACES)
def test_fmpy_finds_no_problem(which, files):
    assert validate_fmu(str(files[which])) == []


@pytest.mark.parametrize("which", INTERFACES)
def test_description_has_the_shown_variables_with_the_references_of_the_table(which, files):
    described = read_model_description(str(files[which])).modelVariables
    interface, references = INTERFACES[which], [v.name for v in TABLE.variables]
    assert [v.name for v in described] == [v.name for v in interface.variables]
    assert [v.valueReference for v in described] == [references.index(v.slot) for v in interface.variables]
    assert sorted(v.valueReference for v in described) != [v.valueReference for v in described]
    assert [v.unit for v in described if v.type == "Real"] == [v.unit for v in interface.variables if v.type == "Real"]


def test_structure_speaks_of_positions_and_of_shown_variables_only(files):
    root = ET.fromstring(contents(files["TWO"])["modelDescription.xml"])
    names = [v.get("name", "") for v in root.iterfind("ModelVariables/ScalarVariable")]

    def unknowns(section):
        dependencies = {}
        for unknown in root.iterfind(f"ModelStructure/{section}/Unknown"):
            known = unknown.get("dependencies", "").split()
            dependencies[names[int(unknown.get("index", "")) - 1]] = {names[int(i) - 1] for i in known}
        return dependencies

    assert unknowns("Derivatives") == {"dx": {"x", "pump"}, "dlevel": {"level_1", "pump"}}
    states = {"x": {"x"}, "level_1": {"level_1"}}
    assert unknowns("Outputs") == {"corner": set(), "mode_type": {"pump"}, "sum": {"x", "level_1"}, **states}
    initial = unknowns("InitialUnknowns")
    assert (initial["x"], initial["level_1"], initial["mode_type"]) == ({"x_0"}, {"level_1_0"}, {"mode"})
    types = {t.get("name") for t in root.iterfind("TypeDefinitions/SimpleType")}
    assert types == {"mode_type_", "mode_type_type"}
    derivatives = {v.get("name"): v[0].get("derivative") for v in root.iterfind("ModelVariables/ScalarVariable")}
    assert {k: names[int(v) - 1] for k, v in derivatives.items() if v} == {"dx": "x", "dlevel": "level_1"}


def test_pages_and_sources_hold_any_name(files):
    held = contents(files["ONE"])
    page = held["documentation/index.html"].decode()
    assert "<code>Zufluß &quot;A&quot; &lt;l/s&gt; &amp; 100 %s</code>" in page
    assert held["sources/start_values.c"].isascii()
    assert "Zufluß".encode() in held["resources/start_values.bin"]


def test_guid_follows_hidden_values_and_names(export, tmp_path):
    makes = [
        {"hidden": {"count": 2}},
        {"hidden": {"count": 2, "chart_7_7": 5e-324}},
        {"hidden": {"count": 2}, "interface": replace(TWO, variables=TWO.variables[::-1])},
    ]
    paths = [export(tmp_path / f"{i}.fmu", **{"interface": TWO, **make}) for i, make in enumerate(makes)]
    assert len({read_model_description(str(path)).guid for path in paths}) == 3


# Refusals


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hidden": {"begin_1": 1.0}}, "begin_1 must be hidden or shown, found it as start and hidden"),
        ({"hidden": {"begun": 1.0}}, "Tanks has no parameter or input named 'begun'; did you mean begin"),
        ({"hidden": {"level_2": 1.0}}, "Tanks has no parameter or input named 'level_2'"),
        ({"hidden": {"count": 17}}, r"count must lie in \[1, 16\], found 17"),
        ({"hidden": {"rate_2": math.nan}}, "rate_2 must be finite, found nan"),
        ({"changes": {"least": 5.0}}, "^least must not exceed most, found 5 and 4$"),
        ({"changes": {"low": 1.0}}, "Water has no parameter or input named 'low'"),
        ({"outputs": ["level_1"]}, "Water has no output named 'level_1'"),
        ({"identifier": "a-b"}, "identifier must be letters, digits and underscores.* found 'a-b'"),
        ({"identifier": "2b"}, "found '2b'"),
        ({"identifier": ""}, "found ''"),
        ({"identifier": "../b"}, "found '../b'"),
        ({"identifier": "x" * 201}, "at most 200 of them"),
    ],
)
def test_users_mistake_is_refused_before_anything_is_written(options, message, export, tmp_path):
    with pytest.raises(UserError, match=message):
        export(tmp_path / "new" / "x.fmu", **{"interface": ONE, **options})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("variable", "message"),
    [
        (
            replace(TABLE.by_name["level_2"], name="x", slot="level_20"),
            "Tanks has no variable level_20 for x to stand for",
        ),
        (replace(TABLE.by_name["mode"], name="x"), "Tanks has no variable x for x to stand for"),
        (shown("level_1", "x"), "and x have the same slot level_1"),
        (shown("rate_2", "x", min=None), "x must have the type, causality, variability and limits of its slot rate_2"),
        (shown("rate_2", "x", variability="tunable"), "x must have the type"),
        (shown("strategy", "x", items=("a", "b", "c")), "x must have the type"),
        (shown("mode", "x", type="Real", items=()), "x must have the type"),
        (shown("flow_2", "x", fault_on_non_finite=False), "x must have the type"),
        (shown("flow_2", "x", causality="parameter"), "x must have the type"),
    ],
)
def test_interface_that_does_not_fit_the_table_is_refused(variable, message):
    with pytest.raises(ValueError, match=message):
        Showing(TABLE, replace(ONE, variables=(*ONE.variables, variable)))


def test_outputs_and_local_variables_are_one(export, tmp_path):
    local = shown("total", "sum", causality="local")
    path = export(tmp_path / "x.fmu", interface=replace(ONE, variables=(*ONE.variables, local)), outputs=[])
    described = read_model_description(str(path)).modelVariables
    assert {v.name: v.causality for v in described if v.causality in ("output", "local")} == {
        "sum": "local",
        LEVEL: "local",
        "rise": "local",
    }


def test_states_that_are_not_shown_are_refused(export, tmp_path):
    with pytest.raises(ValueError, match="model exchange needs level_2 of Tanks to be shown"):
        export(tmp_path / "x.fmu", interface=ONE, hidden={"count": 2})
    assert list(tmp_path.iterdir()) == []


# The instance


def exact(values, flow, time):
    """Return the level of a tank that begins empty under a constant flow."""
    return values["gain"] * flow / values["rate"] * (1.0 - math.exp(-values["rate"] * time))


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_fmpy_simulates_both(kind, files):
    for which, flow, levels in (
        ("ONE", FLOW, {LEVEL: {"gain": 2.0, "rate": 0.5}}),
        ("TWO", "pump", {"x": {"gain": 1.0, "rate": 1.0}, "level_1": {"gain": -3.0, "rate": 2.0}}),
    ):
        signal = np.array([(0.0, 3.0), (1.0, 3.0)], dtype=[("time", float), (flow, float)])
        rows = simulate_fmu(
            str(files[which]), fmi_type=kind, input=signal, relative_tolerance=1e-10, output_interval=0.1
        )
        for name, values in levels.items():
            expected = [exact(values, 3.0, t) for t in rows["time"]]
            np.testing.assert_allclose(rows[name], expected, rtol=1e-6, atol=1e-9)


def test_hidden_values_act(native, folders):
    two = native(folders["TWO"]).initialize()
    assert two.get("corner") == (0.1,)
    level, other, total = two.step(0.0, 1.0, pump=1.0) and two.get("x", "level_1", "sum")
    assert total == pytest.approx(level - other, rel=1e-15)
    assert two.get("mode_type") == (2,)


def test_messages_have_the_shown_names(native, folders):
    instance = native(folders["ONE"])
    assert instance.refused(*instance.setting(most=math.nan)) == "most must be finite, found nan at t = 0 s"
    assert instance.refused(*instance.setting(rise=1.0)) == "rise is an output and cannot be set"
    instance.initialize()
    instance.set(**{FLOW: math.inf})
    assert instance.refused("DoStep", 0.0, 0.1, 0) == f"the flow {FLOW} must be finite\nat t = 0 s, {FLOW} = inf"
    instance.set(**{FLOW: 0.0})
    assert instance.refused(*instance.setting(least=9.0)).startswith("least must not exceed most, found 9 and 4\n")
    with_states = native(folders["ONE"], EXCHANGE).initialize()
    with_states.done("EnterContinuousTimeMode")
    assert with_states.call("SetContinuousStates", (ctypes.c_double * 1)(math.nan), 1) == 2
    assert with_states.log[-1][2] == f"{LEVEL} must be finite, found nan at t = 0 s"


def test_what_is_not_shown_cannot_be_reached(native, folders):
    instance = native(folders["ONE"]).initialize()
    seen = {v.valueReference for v in instance.variables.values()}
    number, flag = (ctypes.c_double * 1)(1.0), (ctypes.c_int * 1)(1)
    before = instance.everything()
    for reference in range(len(TABLE.variables)):
        if reference in seen:
            continue
        at = (ctypes.c_uint * 1)(reference)
        for kind, value in (("Real", number), ("Integer", flag)):
            for do in ("Get", "Set"):
                message = instance.refused(f"{do}{kind}", at, 1, value)
                assert message == f"no {kind} variable has the value reference {reference}"
    hidden = (ctypes.c_uint * 1)(TABLE.variables.index(TABLE.by_name["flow_1"]))
    own = (ctypes.c_uint * 1)(instance.reference("rise"))
    message = instance.refused("GetDirectionalDerivative", own, 1, hidden, 1, number, number)
    assert message == "there is no derivative with respect to a value reference that does not exist"
    message = instance.refused("GetDirectionalDerivative", hidden, 1, own, 0, number, number)
    assert message == "there is no derivative of a value reference that does not exist"
    assert instance.everything() == before


def test_number_of_states_follows_a_parameter(native, folders):
    for which, count in (("ONE", 1), ("TWO", 2)):
        instance = native(folders[which], EXCHANGE).initialize()
        assert instance.description.numberOfContinuousStates == count
        row = (ctypes.c_double * 2)(math.nan, math.nan)
        instance.done("GetContinuousStates", row, count)
        assert list(row)[:count] == [0.0] * count
        assert instance.refused("GetContinuousStates", row, 3) == (
            f"fmi2GetContinuousStates must be for {count} values, found 3"
        )


def test_directional_derivatives_are_the_matrices(native, folders):
    instance = native(folders["TWO"], EXCHANGE).initialize()
    unknowns, knowns = ["dx", "dlevel", "sum"], ["x", "level_1", "pump"]
    rows, columns = [(ctypes.c_uint * 3)(*map(instance.reference, n)) for n in (unknowns, knowns)], []
    for seeds in np.eye(3):
        column = (ctypes.c_double * 3)()
        instance.done("GetDirectionalDerivative", rows[0], 3, rows[1], 3, (ctypes.c_double * 3)(*seeds), column)
        columns.append(list(column))
    np.testing.assert_array_equal(np.transpose(columns), [[-1.0, 0.0, 1.0], [0.0, -2.0, -3.0], [1.0, -1.0, 0.0]])


def test_state_of_one_interface_is_none_of_the_other(native, folders):
    one, two = (native(folders[which]).initialize() for which in INTERFACES)
    data = one.everything()
    state = ctypes.c_void_p()
    message = two.refused("DeSerializeFMUstate", data, len(data), ctypes.byref(state))
    assert message.startswith("the bytes are no state of this FMU")


def test_a_large_table_does_not_slow_calls(native, folders):
    """As fast as with a table of fifty variables: a call looks nothing up."""
    instance = native(folders["ONE"]).initialize()
    reference, number = (ctypes.c_uint * 1)(instance.reference("rise")), (ctypes.c_double * 1)()
    flow = (ctypes.c_uint * 1)(instance.reference(FLOW))
    get, put = instance.library.fmi2GetReal, instance.library.fmi2SetReal
    best = math.inf
    for _ in range(5):
        begin = time.perf_counter()
        for _ in range(2000):
            get(instance.component, reference, 1, number)
            put(instance.component, flow, 1, number)
        best = min(best, (time.perf_counter() - begin) / 4000)
    assert best < 5e-6


# Sources


PROGRAM = """
#include <stdarg.h>
#include <stdio.h>
#include "fmi2FunctionTypes.h"
extern fmi2InstantiateTYPE north_tank_fmi2Instantiate, two_tanks_fmi2Instantiate;
extern fmi2SetRealTYPE north_tank_fmi2SetReal, two_tanks_fmi2SetReal;
static void say(fmi2ComponentEnvironment e, fmi2String n, fmi2Status s, fmi2String c, fmi2String message, ...)
{
    va_list rest;
    (void)e;
    (void)s;
    (void)c;
    va_start(rest, message);
    printf("%s: ", n);
    vprintf(message, rest);
    printf("\\n");
    va_end(rest);
}
int main(int count, char **arguments)
{
    fmi2CallbackFunctions f = {say, NULL, NULL, NULL, NULL};
    const fmi2ValueReference flow[2] = {2, 7};
    const fmi2Real bad[1] = {1.0};
    fmi2Component one = north_tank_fmi2Instantiate("one", fmi2CoSimulation, arguments[1], NULL, &f, 0, 1);
    fmi2Component two = two_tanks_fmi2Instantiate("two", fmi2CoSimulation, arguments[2], NULL, &f, 0, 1);
    north_tank_fmi2SetReal(one, flow + 1, 1, bad);
    two_tanks_fmi2SetReal(two, flow, 1, bad);
    return count == 3 && north_tank_fmi2SetReal(one, flow, 1, bad) == fmi2OK ? 0 : 1;
}
"""


def compiler():
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("the sources were not compiled: gcc is not on the PATH")
    return [
        compiler,
        "-std=c99",
        "-O2",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-pedantic",
        "-ffp-contract=off",
        "-I",
        str(ADAPTER / "fmi2"),
    ]


@pytest.mark.parametrize("which", INTERFACES)
def test_rebuilt_library_does_the_same(which, folders, native, tmp_path):
    sources = sorted(map(str, (folders[which] / "sources").glob("*.c")))
    library = tmp_path / "rebuilt.so"
    options = ["-DFMI2_OVERRIDE_FUNCTION_PREFIX", "-fPIC", "-shared", *sources, "-o", str(library), "-lm"]
    subprocess.run([*compiler(), *options], check=True)
    own, other = native(folders[which]), native(folders[which], library=str(library), location=None)
    flow = {"ONE": FLOW, "TWO": "pump"}[which]
    rows = []
    for instance in (own, other):
        instance.initialize()
        rows.append([instance.step(0.1 * k, 0.1, **{flow: math.sin(k)}) for k in range(20)])
        instance.set(**{flow: math.nan})
        assert flow in instance.refused("DoStep", 2.0, 0.1, 0)
    assert rows[0] == rows[1]
    assert own.log == other.log
    assert own.deserialize(other.everything())  # one's state is the other's


def test_two_fmus_of_one_unit_are_static_libraries_of_one_program(folders, tmp_path):
    (tmp_path / "main.c").write_text(PROGRAM)
    libraries = []
    for which, folder in folders.items():
        target = tmp_path / which
        target.mkdir()
        sources = sorted(map(str, (folder / "sources").glob("*.c")))
        subprocess.run([*compiler(), "-c", *sources], cwd=target, check=True)
        libraries.append(str(tmp_path / f"lib{which}.a"))
        subprocess.run(["ar", "rcs", libraries[-1], *map(str, target.glob("*.o"))], check=True)
    subprocess.run([*compiler(), "main.c", *libraries, "-o", "main", "-lm"], cwd=tmp_path, check=True)
    guids = [str(read_model_description(str(folder)).guid) for folder in folders.values()]
    done = subprocess.run([str(tmp_path / "main"), *guids], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == [
        "one: no Real variable has the value reference 7",
        "two: no Real variable has the value reference 2",
    ]
    assert done.returncode == 0


# The SSP


def test_ssp_leaves_out_units_that_have_no_base_units(export, files, tmp_path):
    odd = [replace(v, unit="furlong") if v.name == LEVEL else v for v in ONE.variables]
    fmu = export(tmp_path / "odd.fmu", interface=replace(ONE, variables=tuple(odd)), outputs=[LEVEL])
    assert validate_fmu(str(fmu)) == []
    path = write_ssp(tmp_path / "odd.ssp", "Odd", {"odd": fmu}, [])
    read_ssd(str(path), validate=True)
    assert b"furlong" in contents(fmu)["modelDescription.xml"]
    assert b"furlong" not in contents(path)["SystemStructure.ssd"]


def test_components_have_plain_names_and_files_of_their_own(files, tmp_path):
    other = tmp_path / files["ONE"].name
    other.write_bytes(files["TWO"].read_bytes())
    for components, message in (
        ({"a.b": files["ONE"]}, "an instance's name must have no dot, found 'a.b'"),
        ({"a": files["ONE"], "b": other}, "FMU files must have different names, found .* and .*north_tank"),
    ):
        with pytest.raises(UserError, match=message):
            write_ssp(tmp_path / "bad.ssp", "Bad", components, [])


def test_wires_go_by_any_name(files, tmp_path):
    path = tmp_path / "pair.ssp"
    wires = [(f"one.{LEVEL}", "two.pump")]
    write_ssp(path, "Pair", {"one": files["ONE"], "two": files["TWO"]}, wires)
    read_ssd(str(path), validate=True)
    rows = simulate_ssp(str(path), stop_time=1.0, step_size=0.1)
    assert f"one.{LEVEL}" in (rows.dtype.names or ())
    for wire, message in (
        ((f"one.{LEVEL}", "two.pump.x"), "needs the input two.pump.x"),
        (("three.x", "two.pump"), "needs the output three.x"),
        (("one.rise", "two.pump"), "needs the output one.rise"),
    ):
        with pytest.raises(UserError, match=message):
            write_ssp(tmp_path / "bad.ssp", "Pair", {"one": files["ONE"], "two": files["TWO"]}, [wire])
