"""Files that were damaged or made up: each reader gives a valid object or a UserError of one line, and nothing else."""

import copy
import json
import tomllib
import zipfile

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim import archives, parameter_files
from cosim.errors import UserError
from cosim.fmu_files import describe
from cosim.hil.log import Layout, RowLog, recover
from cosim.hil.replay import controller_of
from cosim.names import is_plain
from cosim.provenance import provenance
from cosim.results import Result, _seal
from cosim.scenario import load_scenario
from fmu_export.reading import parse_json, parse_toml
from ihc_fmu.design import Design
from ihc_fmu.system import System
from plant_fmu.parameters import parameter_set

DEEP = "[" * 100_000
WRONG = [None, True, "", "x", "../../x", [], [1], [[1], [2, 3]], {}, {"a": 1}, [None], [{"a": 1}], -1, 0, 10**30, 1e308]
"""What may stand where something else should."""

NASTY = [b"NaN", b"1e999", b"9" * 5000, b"-", b'"', b"\n", b"[[", b"\0"]

EXAMPLES = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def places(value, here=()):
    yield here
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield from places(child, (*here, key))


@st.composite
def changed(draw, document):
    """Draw a document with one or two of its entries replaced, removed or added to."""
    data = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 2))):
        *parents, last = draw(st.sampled_from([place for place in places(data) if place]))
        where = data
        for key in parents:
            where = where[key]
        kind = draw(st.sampled_from(["replace", "replace", "remove", "add"]))
        if kind == "replace":
            where[last] = copy.deepcopy(draw(st.sampled_from(WRONG)))
        elif kind == "remove":
            del where[last]
        elif isinstance(where, dict):
            where[draw(st.sampled_from(["new", "", "step", "a.b"]))] = copy.deepcopy(draw(st.sampled_from(WRONG)))
        if not data:
            break
    return data


@st.composite
def damaged(draw, content):
    """Draw bytes that were cut, overwritten, doubled, or begin with a byte-order mark."""
    at = draw(st.integers(0, len(content)))
    kind = draw(st.sampled_from(["cut", "overwrite", "double", "mark", "insert"]))
    if kind == "cut":
        return content[:at]
    if kind == "mark":
        return draw(st.sampled_from([b"\xef\xbb\xbf", b"\xff\xfe", b"\xef\xbb\xbf\xef\xbb\xbf"])) + content
    if kind == "double":
        return content[:at] + content
    new = draw(st.binary(min_size=1, max_size=4) | st.sampled_from(NASTY))
    return content[:at] + new + content[at + (len(new) if kind == "overwrite" else 0) :]


def read(reader, *arguments):
    try:
        return reader(*arguments)
    except UserError as error:
        text = str(error)
    assert "\n" not in text
    assert 0 < len(text) < 1000
    return None


@pytest.fixture(scope="module")
def result():
    about = {"step": 0.1, "order": "controller-first", "every": 1, "wires": [["a.x", "b.x"]], "messages": {"a": ["x"]}}
    about |= {
        "fmus": {"controller": {"file": "C.fmu", "model": "C", "guid": "{1}"}},
        "start_values": {"controller": {"mu": 1.0}},
    }
    about |= {"scenario": {"name": "tilt", "plant": {"fmu": "P.fmu", "parameters": "ident"}}}
    signals = {"controller.voltage": np.array([0.1, -2.5, 1e-9]), "controller.mode": np.array([1, 2, 3])}
    return Result(np.array([0.0, 0.1, 0.2]), signals, {"controller.voltage": "V", "controller.mode": "1"}, about)


@EXAMPLES
@given(data=st.data())
def test_results(tmp_path_factory, result, data):
    tmp_path = tmp_path_factory.mktemp("result")
    path = tmp_path / "run.csv"
    result.save(path)
    described, table = path.with_suffix(".json"), path.read_bytes()
    text = described.read_bytes()
    kind = data.draw(st.sampled_from(["header", "text", "table"]))
    if kind == "header":
        header = data.draw(changed(json.loads(text)))
        if isinstance(header, dict):  # sealed again, so that the models behind the seal are reached
            header.pop("description_sha256", None)
            header["description_sha256"] = _seal(header)
        described.write_text(json.dumps(header), encoding="utf-8")
    elif kind == "text":
        described.write_bytes(data.draw(damaged(text)))
    else:
        path.write_bytes(data.draw(damaged(table)))
    loaded = read(Result.load, path)
    if loaded is not None:
        assert provenance(loaded).fmus.keys() <= {"controller"}
        read(controller_of, loaded, None, tmp_path)
        loaded.save(tmp_path / "again.csv")


@EXAMPLES
@given(data=st.data())
def test_designs(design, data):
    document = json.loads(design.to_json())
    if data.draw(st.booleans()):
        read(Design.from_json, json.dumps(data.draw(changed(document))))
    else:
        read(Design.from_json, data.draw(damaged(design.to_json().encode())).decode("utf-8", "replace"))


SYSTEM = {"A": [[0.0, 1.0], [0.0, 0.0]], "b": [0.0, 1.0], "k_lin": [-1.0, -1.0]}
SCENARIO = {
    "name": "mine",
    "run": {"step": 1e-3, "duration": 1.0, "seed": 1},
    "plant": {"fmu": "P.fmu", "start": {"m_p": 0.024}},
    "controller": {"fmu": "C.fmu", "design": "d.json", "start": {"law": "IHC"}},
    "disturbance": {"sines": [{"amplitude": 1.0, "frequency": 2.0}]},
    "record": {"outputs": ["plant.theta"], "every": 2},
}


@pytest.fixture(scope="module")
def parameters(tmp_path_factory):
    path = tmp_path_factory.mktemp("set") / "set.toml"
    parameter_files.save(path, parameter_set("ident"))
    return tomllib.loads(path.read_text(encoding="utf-8"))


@EXAMPLES
@given(data=st.data())
def test_toml_files(tmp_path, parameters, data):
    readers = {
        "system": (SYSTEM, System.load),
        "scenario": (SCENARIO, lambda path: load_scenario(str(path))),
        "parameters": (parameters, parameter_files.load),
    }
    document, reader = readers[data.draw(st.sampled_from(sorted(readers)))]
    path = tmp_path / "file.toml"
    if data.draw(st.booleans()):
        path.write_text(tomli_w.dumps(without_null(data.draw(changed(document)))), encoding="utf-8")
    else:
        path.write_bytes(data.draw(damaged(tomli_w.dumps(document).encode())))
    read(reader, path)


def without_null(value):
    if isinstance(value, dict):
        return {key: without_null(child) for key, child in value.items()}
    return [without_null(child) for child in value] if isinstance(value, list) else "" if value is None else value


@EXAMPLES
@given(data=st.data())
def test_logs_of_runs(tmp_path, data):
    for file in tmp_path.iterdir():
        file.unlink()
    path = tmp_path / "run.rows"
    about = {"step": 1e-3, "order": "controller-first"}
    log = RowLog(path, Layout(("voltage",), ("mode",), {"voltage": "V", "mode": "1"}), 5, about)
    for k in range(3):
        log.append(k, k, k + 5, 1, 1, 1, 3, 4, 0, 0.1, 0.2, 0.3, 0.4, 2)
    log.close()
    content = path.read_bytes()
    if data.draw(st.booleans()):
        begin = 16 + int.from_bytes(content[8:16], "little")
        header = json.dumps(data.draw(changed(json.loads(content[16:begin])))).encode()
        content = content[:8] + len(header).to_bytes(8, "little") + header + content[begin:]
    else:
        content = data.draw(damaged(content))
    path.write_bytes(content)
    for file, rows in recover(tmp_path):
        assert (file == path) == isinstance(rows, str)
        if isinstance(rows, int) and rows:
            Result.load(file)


@EXAMPLES
@given(data=st.data())
def test_archives(tmp_path, fmus, data):
    path, small = tmp_path / "x.fmu", tmp_path / "small.fmu"
    with zipfile.ZipFile(fmus / "QubeServo2.fmu") as full, zipfile.ZipFile(small, "w") as made:
        made.writestr("modelDescription.xml", full.read("modelDescription.xml"))
    path.write_bytes(data.draw(damaged(small.read_bytes())))
    read(describe, path)


# Each by itself, where a mutation would find it too seldom


@pytest.mark.parametrize(
    "text",
    [DEEP, "{" * 9, '{"a": 1, "a": 2}', "[NaN]", "[-Infinity]", "[1e999]", "[" + "9" * 5000 + "]", "[" * 65 + "]" * 65],
)
def test_json_is_refused(text):
    with pytest.raises(UserError, match=r"^x\.json (is not|must)"):
        parse_json(text, "x.json")


@pytest.mark.parametrize(
    "text", ["a = " + DEEP, "a = " + "9" * 5000, "a = " + "[" * 70 + "]" * 70, "a = 1\na = 2", "a = 1979-99-01"]
)
def test_toml_is_refused(text):
    with pytest.raises(UserError, match=r"^x\.toml (is not|must)"):
        parse_toml(text, "x.toml")


def test_a_byte_order_mark_of_an_editor_changes_nothing(tmp_path, design, result, parameters):
    mark = b"\xef\xbb\xbf"
    (tmp_path / "scenario.toml").write_bytes(mark + b"[run]\r\nduration = 2.0\r\n")
    assert load_scenario(str(tmp_path / "scenario.toml"))[0].run.duration == 2.0
    (tmp_path / "set.toml").write_bytes(mark + tomli_w.dumps(parameters).encode())
    assert parameter_files.load(tmp_path / "set.toml").parameters == parameter_set("ident").parameters
    (tmp_path / "design.json").write_bytes(mark + design.to_json().encode())
    assert Design.load(tmp_path / "design.json").to_json() == design.to_json()
    result.save(tmp_path / "run.csv")
    (tmp_path / "run.json").write_bytes(
        mark + (tmp_path / "run.json").read_bytes()
    )  # the table's digest forbids it there
    assert Result.load(tmp_path / "run.csv").metadata == result.metadata


def test_a_file_of_settings_is_not_read_without_end(tmp_path):
    with (tmp_path / "big.toml").open("wb") as file:
        file.truncate(17 * 2**20)
    with pytest.raises(UserError, match=r"big\.toml must not be larger than 16 MiB"):
        load_scenario(str(tmp_path / "big.toml"))


# Names


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".",
        "..",
        "../x",
        "/x",
        "a/b",
        "a\\b",
        "C:x",
        ".hidden",
        "x.",
        " x",
        "a\nb",
        "a\0b",
        "nul",
        "COM1.fmu",
        "x" * 121,
        "a*b",
    ],
)
def test_a_name_that_leads_elsewhere_is_refused_in_every_place(tmp_path, name):
    assert not is_plain(name)
    for document in ({"name": name}, {"plant": {"fmu": name}}, {"controller": {"fmu": name}}):
        (tmp_path / "mine.toml").write_text(tomli_w.dumps(document), encoding="utf-8")
        with pytest.raises(UserError, match=r"mine\.toml: (name|plant\.fmu|controller\.fmu) must be a plain name"):
            load_scenario(str(tmp_path / "mine.toml"))


@pytest.mark.parametrize("name", ["tilt", "tilt.v2", "x.fmu", "ä b-c_d", "IhcController.fmu", "console", "{x}"])
def test_a_plain_name_is_one(name):
    assert is_plain(name)


# Archives


def packed(path, *entries):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries:
            archive.writestr(name, content)
    return path


def link():
    entry = zipfile.ZipInfo("link")
    entry.external_attr = 0o120777 << 16
    return entry


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize(
    ("entries", "problem"),
    [
        ([("../x", "")], r"inside its folder, found '\.\./x'"),
        ([("a/../../x", "")], "inside its folder"),
        ([("/x", "")], "inside its folder"),
        ([("C:x", "")], "inside its folder"),
        ([("a\\..\\x", "")], "inside its folder"),
        ([("a\nb", "")], "inside its folder"),
        ([(link(), "/etc/passwd")], "must not have links, found 'link'"),
        ([("x", ""), ("x", "")], "every entry once, found 'x' twice"),
        ([("x", ""), ("X", "")], "every entry once, found 'X' twice"),
        ([("x", ""), ("./x", "")], "every entry once"),
        ([(f"{k}", "") for k in range(10_001)], "at most 10000 entries, found 10001"),
        ([("zeros", bytes(65 * 2**20))], r"more than 1024 MiB or 200 times its size, found 65 MiB in 0\.1 MiB"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_an_archive_that_escapes_or_exhausts_is_refused_before_anything_is_unpacked(tmp_path, entries, problem):
    folder = tmp_path / "folder"
    folder.mkdir()
    with pytest.raises(UserError, match=problem):
        archives.unpack(packed(tmp_path / "x.zip", *entries), folder)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["folder", "x.zip"]
