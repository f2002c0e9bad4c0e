"""The log of a run: rows that survive, what they become, and what is made of files that are no logs."""

import json
import os
import signal
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil.log import (
    MAGIC,
    MEASURED,
    TIMING,
    Layout,
    LiveLog,
    RowLog,
    free_path,
    lateness,
    percentiles,
    recover,
    rows_of,
    to_result,
)
from cosim.hil.scaling import RESOLUTION
from cosim.results import Result
from tests.cosim.hil.rig import one_sentence

LAYOUT = Layout(("voltage", "norm"), ("mode",), {"voltage": "V", "mode": "1", "norm": "1"})
METADATA = {"step": 1e-3, "order": "controller-first"}
MS = 1_000_000

WRITER = """
import os, signal, sys
from pathlib import Path
from cosim.hil.log import RowLog
from tests.cosim.hil.test_log import METADATA, LAYOUT, values
log = RowLog(Path(sys.argv[1]), LAYOUT, 1000, METADATA)
for k in range(int(sys.argv[2])):
    log.append(*values(k))
if sys.argv[3] == "kill":
    os.kill(os.getpid(), signal.SIGKILL)
print("written", flush=True)
sys.stdin.read()
"""


def values(k, tick=None, **changes):
    """Return row k: one value for each column, all different."""
    row = {name: 100 * k + i for i, name in enumerate(TIMING)}
    row |= {"tick": k if tick is None else tick, "due": (k + 1) * MS, "woke": (k + 1) * MS + 10 * k, "steps": 1}
    row |= {name: 0.5 * k + 0.1 * i for i, name in enumerate(MEASURED)}
    row |= {"voltage": 1.0 / (k + 1), "norm": -float(k), "mode": 2 + k % 2}
    return list({**row, **changes}.values())


@pytest.fixture
def made(tmp_path):
    """Make a log with some rows; all are removed at the end."""
    logs = []

    def make(rows=3, capacity=10, name="run.rows", metadata=METADATA, ticks=None):
        log = RowLog(tmp_path / name, LAYOUT, capacity, metadata)
        logs.append(log)
        for k in range(rows):
            log.append(*values(k, None if ticks is None else ticks[k]))
        return log

    yield make
    for log in logs:
        log.discard()


def read(log):
    log.buffer.flush()
    return rows_of(log.path.read_bytes(), log.path)


def newest(live):
    row = live.newest()
    assert row is not None
    return row


def writer(path, rows, how):
    root = Path(__file__).parents[3]
    return subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path), str(rows), how],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


# Rows


def test_rows_come_back_exactly(made):
    layout, metadata, rows = read(made(5))
    assert layout == LAYOUT
    assert metadata == METADATA
    assert rows.dtype.names == (*LAYOUT.names, "number", "crc")
    for k, row in enumerate(rows):
        assert list(row.tolist())[:-1] == [*values(k), k + 1]


def test_the_header_says_what_the_columns_are(made):
    content = made().path.read_bytes()
    magic, length = struct.unpack_from("<8sQ", content)
    header = json.loads(content[16 : 16 + length])
    assert magic == MAGIC
    assert (header["reals"], header["integers"], header["units"]) == (["voltage", "norm"], ["mode"], LAYOUT.units)


def test_a_row_has_eight_bytes_a_column_without_padding(made):
    assert LAYOUT.row.size == 8 * (len(LAYOUT.names) + 1)
    log = made(0, capacity=7)
    assert log.path.stat().st_size == log.begin + 7 * LAYOUT.row.size


def test_extreme_values_are_kept(made):
    log = made(0)
    log.append(*values(0, arm=-(2**62), pendulum=2**62, current=float("nan"), voltage=-0.0, norm=5e-324))
    _, _, rows = read(log)
    assert (rows["arm"][0], rows["pendulum"][0]) == (-(2**62), 2**62)
    assert np.isnan(rows["current"][0])
    assert np.signbit(rows["controller.voltage"][0])
    assert rows["controller.norm"][0] == 5e-324


def test_a_log_without_rows_is_one(made):
    layout, _, rows = read(made(0))
    assert len(rows) == 0
    assert len(to_result(layout, rows, METADATA).time) == 0


def test_beyond_the_capacity_what_is_there_stays(made):
    log = made(5, capacity=3)
    assert log.rows == 3
    _, _, rows = read(log)
    assert rows["tick"].tolist() == [0, 1, 2]
    assert log.path.stat().st_size == log.begin + 3 * LAYOUT.row.size


def test_an_unfinished_row_is_not_counted(made):
    log = made(4)
    end = log.begin + 4 * LAYOUT.row.size
    for missing in (4, 8, 20):  # the checksum, the number, some of the values
        log.buffer[end - missing : end] = bytes(missing)
        _, _, rows = read(log)
        assert rows["tick"].tolist() == [0, 1, 2]


@pytest.mark.parametrize("at", [0, 8, LAYOUT.row.size - 8, LAYOUT.row.size - 1])
def test_a_changed_byte_in_a_row_before_others_is_refused(made, at):
    log = made(4)
    log.buffer[log.begin + LAYOUT.row.size + at] ^= 1
    with pytest.raises(UserError, match=r"damaged: row 2 does not fit its checksum, later ones do$"):
        read(log)


def test_a_changed_digit_in_the_header_is_refused(made):
    content = made().path.read_bytes()
    assert content.count(b'"step": 0.001') == 1
    with pytest.raises(UserError, match="damaged: its header does not fit its checksum"):
        rows_of(content.replace(b'"step": 0.001', b'"step": 0.002'), Path("run.rows"))


@pytest.mark.parametrize("cut", [1, 8, 9, 100])
def test_a_file_that_was_cut_keeps_its_whole_rows(made, cut):
    log = made(4, capacity=4)
    content = log.path.read_bytes()
    _, _, rows = rows_of(content[:-cut], log.path)
    assert rows["tick"].tolist() == [0, 1, 2]


def test_a_log_that_exists_is_never_overwritten(made):
    log = made()
    with pytest.raises((UserError, FileExistsError)):
        RowLog(log.path, LAYOUT, 3, METADATA)
    assert len(read(log)[2]) == 3


def test_a_log_that_exists_is_a_user_error(made):
    log = made()
    with pytest.raises(UserError):
        RowLog(log.path, LAYOUT, 3, METADATA)


def test_a_log_without_room_leaves_no_file(tmp_path):
    with pytest.raises((UserError, OSError)):
        RowLog(tmp_path / "run.rows", LAYOUT, 2**52, METADATA)
    assert not list(tmp_path.iterdir())


def test_folders_are_made_and_the_file_goes_away(tmp_path):
    log = RowLog(tmp_path / "a" / "b" / "run.rows", LAYOUT, 3, METADATA)
    assert log.path.exists()
    for _ in range(2):
        log.discard()
    assert not log.path.exists()


# Killed writers


def test_rows_survive_the_kill_of_their_writer(tmp_path):
    path = tmp_path / "run.rows"
    process = writer(path, 137, "kill")
    process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL
    ((target, count),) = recover(tmp_path)
    assert (target, count) == (tmp_path / "run.csv", 137)
    assert not path.exists()
    result = Result.load(target)
    assert result.metadata == {**METADATA, "complete": False, "recovered": True}
    assert result["controller.voltage"].tolist() == [1.0 / (k + 1) for k in range(137)]
    assert recover(tmp_path) == []


def test_a_log_that_is_being_written_is_left_alone(tmp_path):
    path = tmp_path / "run.rows"
    process = writer(path, 5, "wait")
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "written\n"
        before = path.read_bytes()
        assert recover(tmp_path) == []
        live = LiveLog(path)
        assert live.written()
        assert newest(live)["tick"] == 4
        assert path.read_bytes() == before
        process.kill()
        process.wait(timeout=60)
        assert not live.written()
        live.close()
        assert recover(tmp_path) == [(tmp_path / "run.csv", 5)]
    finally:
        process.kill()
        process.communicate()


def test_a_log_of_this_process_is_left_alone(made, tmp_path):
    log = made()
    assert recover(tmp_path) == []
    log.close()
    assert recover(tmp_path) == [(tmp_path / "run.csv", 3)]


def test_several_are_recovered_in_their_order_and_none_in_an_empty_folder(made, tmp_path):
    assert recover(tmp_path) == []
    assert recover(tmp_path / "nowhere") == []
    for name, rows in (("b.rows", 2), ("a.rows", 0)):
        made(rows, name=name).close()
    assert recover(tmp_path) == [(tmp_path / "a.csv", 0), (tmp_path / "b.csv", 2)]
    assert len(Result.load(tmp_path / "a.csv").time) == 0


@pytest.mark.parametrize("content", [b"", b"nonsense" * 10], ids=["empty", "other"])
def test_a_file_that_is_no_log_keeps_no_other_back(made, tmp_path, content):
    (tmp_path / "a.rows").write_bytes(content)
    made(2, name="b.rows").close()
    assert (tmp_path / "b.csv", 2) in recover(tmp_path)


# Files that are no logs


def header(**changes):
    right = {"reals": ["voltage"], "integers": [], "units": {"voltage": "V"}, "metadata": METADATA}
    text = json.dumps({k: v for k, v in {**right, **changes}.items() if v is not ...}).encode()
    return struct.pack("<8sQ", MAGIC, len(text)) + text


BAD = {
    "short": b"QUBE",
    "magic": b"QUBEROWZ" + header()[8:],
    "other": b"time,voltage\n0,1\n" * 10,
    "no JSON": struct.pack("<8sQ", MAGIC, 5) + b"{{{{{",
    "no text": struct.pack("<8sQ", MAGIC, 4) + b"\xff\xfe\xfd\xfc",
    "cut header": header()[:-5],
    "list": struct.pack("<8sQ", MAGIC, 2) + b"[]",
    "null": struct.pack("<8sQ", MAGIC, 4) + b"null",
    "no columns": header(reals=...),
    "number for columns": header(integers=7),
    "no units": header(units=...),
}


@pytest.mark.parametrize("content", BAD.values(), ids=BAD.keys())
def test_a_file_that_is_no_log_is_a_user_error(tmp_path, content):
    path = tmp_path / "bad.rows"
    path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        rows_of(content, path)
    assert "bad.rows" in one_sentence(caught.value)
    with pytest.raises(UserError):
        LiveLog(path)


@pytest.mark.parametrize(
    "content",
    [header(metadata=...), struct.pack("<8sQ", MAGIC, 2**63) + header()[16:]],
    ids=["no metadata", "long header"],
)
def test_a_header_without_metadata_or_longer_than_the_file_is_a_user_error(tmp_path, content):
    with pytest.raises(UserError):
        rows_of(content, tmp_path / "bad.rows")


def test_an_empty_file_is_no_log(tmp_path):
    with pytest.raises(UserError):
        rows_of(b"", tmp_path / "bad.rows")


def test_an_empty_file_is_no_live_log(tmp_path):
    (tmp_path / "bad.rows").touch()
    with pytest.raises(UserError):
        LiveLog(tmp_path / "bad.rows")


# A live look


def test_a_live_log_shows_the_newest_row(made):
    log = made(0)
    live = LiveLog(log.path)
    assert live.newest() is None
    for k in range(3):
        log.append(*values(k))
        assert list(newest(live).values()) == values(k)
        assert live.rows == k + 1
    assert list(live.row(0).values()) == values(0)
    assert live.written()
    log.close()
    assert not live.written()
    assert newest(live)["tick"] == 2
    live.close()


def test_a_live_log_of_a_full_file_stays_at_its_last_row(made):
    live = LiveLog(made(4, capacity=2).path)
    assert newest(live)["tick"] == 1
    assert newest(live)["tick"] == 1
    live.close()


def test_looking_does_not_take_the_lock_for_good(made):
    log = made()
    log.close()
    live = LiveLog(log.path)
    assert not live.written()
    other = LiveLog(log.path)
    assert not other.written()
    live.close()
    other.close()


# Results


def test_a_result_has_a_simulations_names_units_and_signs(made):
    layout, metadata, rows = read(made(4))
    result = to_result(layout, rows, metadata)
    assert list(result.signals)[:3] == ["controller.voltage", "controller.mode", "controller.norm"]
    assert result.units["controller.voltage"] == "V"
    assert set(result.units) == set(result.signals)
    np.testing.assert_array_equal(result.time, np.arange(4) * 1e-3)
    np.testing.assert_array_equal(result["plant.theta_encoder"], -RESOLUTION * rows["arm"])
    np.testing.assert_array_equal(result["plant.delta_encoder"], RESOLUTION * (rows["pendulum"] - 1024))
    np.testing.assert_array_equal(result["plant.current"], -rows["current"])
    np.testing.assert_array_equal(result["hil.tachometer"], -RESOLUTION * rows["tachometer"])
    np.testing.assert_array_equal(result["hil.applied_voltage"], rows["applied_voltage"])
    assert result["controller.mode"].dtype == np.int64
    assert result.metadata == METADATA


def test_missed_periods_are_gaps_in_time(made):
    layout, metadata, rows = read(made(4, ticks=[17, 18, 22, 23]))
    result = to_result(layout, rows, metadata)
    assert result["hil.missed"].tolist() == [0, 0, 3, 0]
    np.testing.assert_array_equal(result.time, np.array([0, 1, 5, 6]) * 1e-3)


def test_a_result_survives_its_file(made, tmp_path, same):
    layout, metadata, rows = read(made(6))
    result = to_result(layout, rows, metadata)
    result.save(tmp_path / "saved.csv")
    same(Result.load(tmp_path / "saved.csv"), result)


# Lateness


def readings(ticks, woke, due: Any = 0):
    rows = np.zeros(len(ticks), dtype=[("tick", "<i8"), ("due", "<i8"), ("woke", "<i8")])
    for name, column in (("tick", ticks), ("woke", woke), ("due", due)):
        rows[name] = column
    return rows


def test_lateness_with_due_times_is_what_passed_since():
    rows = readings([3, 4, 5], [1000, 2500, 3100], [900, 2000, 3000])
    np.testing.assert_allclose(lateness(rows, 1e-3), [1e-7, 5e-7, 1e-7], rtol=1e-12)


def test_lateness_without_due_times_leaves_the_clocks_drift_out():
    ticks = np.arange(2000)
    late = np.where(ticks % 100 == 50, 200e-6, 0.0)
    woke = 5 * 10**12 + np.round((ticks * 1.0001e-3 + late) * 1e9).astype(np.int64)  # a clock 100 ppm slow
    late_by = lateness(readings(ticks, woke), 1e-3)
    assert np.min(late_by) == 0.0
    np.testing.assert_allclose(late_by, late, atol=5e-6)


def test_lateness_counts_from_the_ticks_that_were_seen():
    ticks = np.array([7, 8, 12, 13])
    late_by = lateness(readings(ticks, 10**9 + ticks * MS), 1e-3)
    np.testing.assert_allclose(late_by, 0.0, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2])
def test_lateness_of_few_rows(count):
    late_by = lateness(readings(range(count), [10**9 + k * MS for k in range(count)]), 1e-3)
    np.testing.assert_allclose(late_by, 0.0, atol=1e-12)


def test_percentiles():
    assert percentiles([]) == {}
    assert percentiles(np.zeros(0)) == {}
    assert percentiles([2.0]) == {"p50": 2.0, "p99": 2.0, "p99.9": 2.0, "max": 2.0}
    values = percentiles(np.arange(1001.0))
    assert values == pytest.approx({"p50": 500.0, "p99": 990.0, "p99.9": 999.0, "max": 1000.0})


# Names


def test_free_names_leave_earlier_runs_and_logs_alone(tmp_path):
    assert free_path(tmp_path, "run") == tmp_path / "run.csv"
    (tmp_path / "run.csv").touch()
    assert free_path(tmp_path, "run") == tmp_path / "run_2.csv"
    (tmp_path / "run_2.rows").touch()
    assert free_path(tmp_path, "run") == tmp_path / "run_3.csv"
    (tmp_path / "run_4.csv").touch()
    assert free_path(tmp_path, "run") == tmp_path / "run_3.csv"
    assert free_path(tmp_path, "other") == tmp_path / "other.csv"
