"""Results: exact on disk, readable elsewhere, never half written, refused with one sentence that names the file."""

import csv
import json
import math
import os

import fmpy.util
import numpy as np
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cosim.errors import UserError
from cosim.results import FORMAT, Result, versions

SMALLEST = 5e-324
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)
HEADER = {"format": FORMAT, "units": {"a.x": "V"}, "metadata": {}}


@st.composite
def results(draw):
    rows = draw(st.integers(1, 6))
    floats = arrays(np.float64, rows, elements=st.floats(allow_subnormal=True))
    whole = arrays(np.int64, rows, elements=st.integers(-(2**63), 2**63 - 1))
    columns = draw(st.lists(floats | whole, max_size=4))
    signals = {f"part{i}.x": column for i, column in enumerate(columns)}
    time = draw(arrays(np.float64, rows, elements=st.floats(allow_nan=False, allow_infinity=False)))
    units = {name: draw(st.text(max_size=3)) for name in signals}
    return Result(time, signals, units, draw(st.dictionaries(st.text(), JSON, max_size=3)))


def example():
    signals = {"a.x": np.array([0.1 + 0.2, -0.0, SMALLEST]), "a.n": np.array([1, -2, 3])}
    return Result(np.array([0.0, 0.1, 0.2]), signals, {"a.x": "V", "a.n": "1"}, {"seed": 7})


def bits(array):
    return array.dtype, np.where(np.isnan(array), math.nan, array).tobytes()  # any NaN is as good as another


@given(results())
def test_what_is_saved_is_loaded_to_the_last_bit(tmp_path_factory, result):
    path = tmp_path_factory.getbasetemp() / "round trip" / "result.csv"
    result.save(path)
    loaded = Result.load(path)
    assert bits(loaded.time) == bits(result.time)
    assert {n: bits(s) for n, s in loaded.signals.items()} == {n: bits(s) for n, s in result.signals.items()}
    assert list(loaded.signals) == list(result.signals)
    assert (loaded.units, loaded.metadata) == (result.units, result.metadata)


def test_saving_again_gives_the_same_bytes(tmp_path):
    example().save(tmp_path / "first.csv")
    Result.load(tmp_path / "first.csv").save(tmp_path / "second.csv")
    for suffix in (".csv", ".json"):
        assert (tmp_path / f"first{suffix}").read_bytes() == (tmp_path / f"second{suffix}").read_bytes()


@pytest.mark.parametrize("reader", ["fmpy", "pandas", "csv"])
def test_other_tools_read_the_table(tmp_path, reader):
    result = example()
    path = tmp_path / "result.csv"
    result.save(path)
    if reader == "fmpy":
        table = fmpy.util.read_csv(path)
    elif reader == "pandas":
        table = pandas.read_csv(path)
        assert table["a.n"].dtype == np.int64
    else:
        rows = list(csv.DictReader(path.open(encoding="utf-8")))
        table = {name: [float(row[name]) for row in rows] for name in rows[0]}
    for name, signal in [("time", result.time), *result.signals.items()]:
        assert list(table[name]) == pytest.approx(list(signal), rel=1e-15, abs=1e-300)


def test_a_result_of_a_run_that_never_began_is_saved_and_loaded(tmp_path):
    Result(np.zeros(0), {}, {}, {"complete": False}).save(tmp_path / "empty.csv")
    loaded = Result.load(tmp_path / "empty.csv")
    assert (len(loaded.time), loaded.signals, loaded.metadata) == (0, {}, {"complete": False})


def test_a_missing_signal_is_named_with_those_there_are():
    with pytest.raises(UserError, match=r"no signal 'a\.y'; it has a\.x, a\.n$"):
        example()["a.y"]


@pytest.mark.parametrize("missing", [".csv", ".json"])
def test_a_missing_file_is_named(tmp_path, missing):
    example().save(tmp_path / "result.csv")
    gone = tmp_path / f"result{missing}"
    gone.unlink()
    with pytest.raises(UserError, match=f"result file .*result{missing} does not exist"):
        Result.load(tmp_path / "result.csv")


@pytest.mark.parametrize(
    ("header", "table", "cause"),
    [
        ("{", "time,a.x\n0.0,1.0\n", "line 1 column 2"),
        (json.dumps({**HEADER, "format": "another 1"}), "time,a.x\n0.0,1.0\n", FORMAT),
        (json.dumps(HEADER), "time,a.x\n0.0,1.0\n0.1\n", "row 3 must have 2 entries, found 1; .* it was cut"),
        (json.dumps(HEADER), "time,a.x\n0.0\n0.1,1.0\n", "row 2 must have 2 entries, found 1"),
        (json.dumps(HEADER), "time,a.x\n0.0,1.0,2.0\n0.1,1.0,2.0\n", "row 2 must have 2 entries, found 3"),
        (json.dumps(HEADER), "seconds,a.x\n0.0,1.0\n", FORMAT),
        (json.dumps(HEADER), "time,a.x\n0.0,1.0\n0.1,one\n", "column 'a.x' must hold numbers, found 'one'"),
        (json.dumps(HEADER), "time,a.x\nzero,1.0\n", "column 'time' must hold numbers, found 'zero'"),
        (json.dumps(HEADER), "", "not a result"),
    ],
    ids=["JSON", "format", "short row", "long row", "long rows", "no time", "text", "text for time", "empty"],
)
def test_a_broken_file_is_refused_by_its_name(tmp_path, header, table, cause):
    path = tmp_path / "broken.csv"
    path.write_text(table, encoding="utf-8")
    path.with_suffix(".json").write_text(header, encoding="utf-8")
    with pytest.raises(UserError, match=rf"broken\.(csv|json)\b.*{cause}") as refusal:
        Result.load(path)
    assert "\n" not in str(refusal.value)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    example().save(tmp_path / "result.csv")
    (tmp_path / "result.csv").write_bytes(b"time,a.x\n\xff,1.0\n")
    with pytest.raises(UserError, match=r"result\.csv must be text in UTF-8, found another byte at 9"):
        Result.load(tmp_path / "result.csv")


@pytest.mark.parametrize("stage", ["disk", "metadata"])
def test_a_save_that_fails_leaves_the_earlier_result(tmp_path, monkeypatch, stage):
    path = tmp_path / "result.csv"
    example().save(path)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    later = Result(np.array([5.0]), {}, {}, {"not JSON": object()} if stage == "metadata" else {})
    with monkeypatch.context() as patched:
        if stage == "disk":
            patched.setattr(os, "fsync", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left")))
        with pytest.raises((UserError, TypeError)):
            later.save(path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_versions_name_all_that_computes():
    assert set(versions()) == {"python", "qube-ihc", "fmpy", "pythonfmu", "numpy"}
    assert versions()["numpy"] == np.__version__
