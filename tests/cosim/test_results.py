"""Results: exact on disk, readable elsewhere, never half written, refused with one sentence that names the file."""

import csv
import hashlib
import json
import math
import os
import signal
import sys
from pathlib import Path

import fmpy.util
import numpy as np
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cosim import results as results_module
from cosim import signals
from cosim.errors import UserError
from cosim.plots import Picture
from cosim.results import FORMAT, Result, versions

SMALLEST = 5e-324
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@st.composite
def results(draw):
    rows = draw(st.integers(1, 6))
    floats = arrays(np.float64, rows, elements=st.floats(allow_subnormal=True))
    whole = arrays(np.int64, rows, elements=st.integers(-(2**63), 2**63 - 1))
    columns = draw(st.lists(floats | whole, max_size=4))
    signals = {f"part{i}.x": column for i, column in enumerate(columns)}
    times = st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=rows, max_size=rows, unique=True)
    time = np.array(sorted(draw(times)))
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
    for name, column in [("time", result.time), *result.signals.items()]:
        assert list(table[name]) == pytest.approx(list(column), rel=1e-15, abs=1e-300)


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


def written(folder, name="result", result=None):
    path = folder / f"{name}.csv"
    (result or example()).save(path)
    return path


def resealed(path, table, **changes):
    """Write a table, and a description that fits it but for `changes`."""
    path.write_bytes(table)
    header = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    header |= {"rows": table.count(b"\n") - 1, "sha256": hashlib.sha256(table).hexdigest(), **changes}
    del header["description_sha256"]
    header["description_sha256"] = hashlib.sha256(json.dumps(header).encode()).hexdigest()
    path.with_suffix(".json").write_text(json.dumps(header), encoding="utf-8")


def refusal(path):
    """Return the one sentence with which `path` is refused."""
    with pytest.raises(UserError) as refused:
        Result.load(path)
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "cause"),
    [
        (b"0.1,", b"0.7,", "is not the table that its description means"),
        (b"0.1,", b"0.10,", "is not the table that its description means"),
        (b",3\n", b",3", "has 2 rows, its description says 3"),
        (b"0.2,5e-324,3\n", b"0.2,5e", "has 2 rows, its description says 3"),
        (b"\n0.1", b"\n0.0,1.0,2\n0.1", "has 4 rows, its description says 3"),
        (b"time", b"\xef\xbb\xbftime", "is not the table that its description means"),
        (b"\n", b"\r\n", "is not the table that its description means"),
    ],
)
def test_a_table_that_was_changed_is_refused(tmp_path, old, new, cause):
    path = written(tmp_path)
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new))
    assert refusal(path).startswith(f"{path} {cause}")


def test_tables_and_descriptions_of_different_runs_are_refused(tmp_path):
    first = written(tmp_path)
    other = example()
    other.time[2] = 0.3
    second = written(tmp_path, "second", other)
    second.with_suffix(".json").replace(first.with_suffix(".json"))
    assert "of another run" in refusal(first)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda text: text.replace('"seed": 7', '"seed": 8'), "was changed: it does not fit its own digest"),
        (lambda text: text.replace('"rows": 3', '"rows": 4'), "was changed: it does not fit its own digest"),
        (lambda text: text.replace("description_sha256", "sha"), "was changed: it does not fit its own digest"),
        (lambda text: text.replace(FORMAT, "qube-ihc result 1"), "is of an earlier version, which kept no digest"),
        (
            lambda text: text.replace(FORMAT, "another 1"),
            f"is not the description of a result, whose format is '{FORMAT}'",
        ),
        (lambda text: "[" * 100_000, "must not be nested deeper"),
        (lambda text: "1" * 10_000, "must have numbers of a moderate size"),
        (lambda text: "[1]", "is not the description of a result"),
        (lambda text: text[:30], "is not JSON"),
        (lambda text: "", "is not JSON"),
    ],
)
def test_a_description_that_was_changed_is_refused(tmp_path, change, cause):
    path = written(tmp_path).with_suffix(".json")
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    assert refusal(path.with_suffix(".csv")).startswith(f"{path} {cause}")


@pytest.mark.parametrize(
    ("table", "changes", "cause"),
    [
        (b"time,a.x\n0.0,1.0\n0.1\n", {}, "row 2 has 1 values for 2 columns"),
        (b"time,a.x\n0.0,1.0,2.0\n", {}, "row 1 has 3 values for 2 columns"),
        (b"seconds,a.x\n0.0,1.0\n", {}, "the columns must be time and"),
        (b"time,a.y\n0.0,1.0\n", {}, "the columns must be time and"),
        (b"\n0.0\n", {}, "row 1 has 1 values for 0 columns"),
        (b"time,a.x\n0.0,1.0\n0.1,one\n", {}, "column a.x must hold numbers, found 'one'"),
        (b"time,a.x\nzero,1.0\n", {}, "column time must hold numbers, found 'zero'"),
        (b"time,a.x\n0.0,99999999999999999999\n", {}, "column a.x must hold numbers, found 'a whole number beyond"),
        (b"time,a.x\n0.0,\xff\n", {}, "is not a table of numbers"),
        (b"time,a.x\n0.0," + b"9" * 200_000 + b"\n", {}, "is not a table of numbers"),
        (b"time,a.x\n0.1,1.0\n0.0,1.0\n", {}, "the time must grow"),
        (b"time,a.x\n0.0,1.0\nNaN,1.0\n", {}, "the time must grow"),
        (b"time,hil.steps\n0.0,NaN\n", {"units": {"hil.steps": "1"}}, "whole numbers, found NaN in row 1"),
        (b"time,a.x\n0.0,1.0\n", {"units": ["V"]}, "units must be texts"),
        (b"time,a.x\n0.0,1.0\n", {"units": {"a.x": 1}}, "units must be texts"),
        (b"time,a.x\n0.0,1.0\n", {"metadata": None}, "is not the description of a result"),
    ],
)
def test_a_foreign_file_with_a_digest_is_refused_too(tmp_path, table, changes, cause):
    path = written(tmp_path)
    resealed(path, table, **changes)
    assert cause in refusal(path)


@pytest.mark.parametrize(("owner", "stage"), [(results_module, "_csv"), (Path, "replace")], ids=["text", "name"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_a_result_is_made_or_written_waits_for_it(tmp_path, monkeypatch, owner, stage, number):
    path, original = tmp_path / "result.csv", getattr(owner, stage)
    earlier = {n: signal.getsignal(n) for n in (signal.SIGINT, *signals.FORWARDED)}

    def interrupted(*arguments):
        signal.raise_signal(number)
        return original(*arguments)

    monkeypatch.setattr(owner, stage, interrupted)
    signals.as_ctrl_c()
    try:
        with pytest.raises(KeyboardInterrupt):
            example().save(path)
        assert signals.exit_code() == 128 + number
    finally:
        for n, handler in earlier.items():
            signal.signal(n, handler)
    assert bits(Result.load(path).time) == bits(example().time)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["result.csv", "result.json"]


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


# Elsewhere


def test_a_result_becomes_a_table_of_pandas_exactly(made_result):
    result = made_result(np.arange(4) * 0.1, [0.1, 0.2, np.nan, SMALLEST])
    table = result.to_dataframe()
    assert list(table.columns) == list(result.signals)
    assert (table.index.name, table.index.tolist()) == ("time", result.time.tolist())
    for name, column in result.signals.items():
        assert table[name].dtype == column.dtype
        np.testing.assert_array_equal(table[name].to_numpy(), column)
    assert table.attrs["units"] == result.units


def test_without_pandas_it_is_said_in_a_sentence(made_result, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UserError, match=r"^to_dataframe needs pandas, which is not installed: pip install pandas$"):
        made_result([0.0, 1.0]).to_dataframe()


def test_a_plot_shows_what_is_asked_for(made_result):
    result = made_result(np.arange(5.0), [0.0, 1.0, 2.0, 3.0, 4.0])
    axes = result.plot("plant.theta", "controller.voltage").axes
    assert [axis.get_ylabel() for axis in axes] == ["plant.\ntheta", "controller.\nvoltage"]
    assert np.asarray(axes[0].lines[0].get_ydata()).tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert [axis.get_ylabel() for axis in result.plot().axes][:2] == ["arm θ [rad]", "pendulum δ [rad]"]
    other = Result(result.time, {"tank.T": result.time}, {"tank.T": "degC"}, {})
    assert [axis.get_ylabel() for axis in other.plot().axes] == ["tank.\nT [degC]"]
    assert isinstance(picture := other.plot(), Picture)
    assert picture._repr_png_()[1:4] == b"PNG"  # what a notebook asks for that has not imported pyplot
    with pytest.raises(UserError, match=r"no signal 'tank\.t'"):
        other.plot("tank.t")
    with pytest.raises(UserError, match=r"^each of signals must be a text, found \['tank\.T'\]$"):
        other.plot(["tank.T"])  # type: ignore[arg-type]
    with pytest.raises(UserError, match="at least one row and one signal"):
        Result(np.zeros(0), {}, {}, {}).plot()
