"""The live line of a run, and the process that prints it."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from cosim.hil import status
from cosim.hil.log import Layout, RowLog

ROOT = Path(__file__).parents[3]
LAYOUT = Layout(("voltage",), ("mode",), {"voltage": "V", "mode": "1"})
ROW = {
    "tick": 1500,
    "due": 1_000_000,
    "woke": 1_023_000,
    "latency": 61_000,
    "step_time": 40_000,
    "steps": 1,
    "arm": -512,
    "pendulum": 1024 + 2048,
    "digital": 0,
    "current": 0.1,
    "tachometer": 0.0,
    "applied_voltage": -2.5,
    "voltage": -2.5,
    "controller.mode": 3,
}


@pytest.fixture
def calm(monkeypatch):
    """`main` in this process: without its changes of handlers and priority."""
    monkeypatch.setattr(status.signal, "signal", lambda *_: None)
    monkeypatch.setattr(status.os, "nice", lambda _: 0)
    monkeypatch.setattr(status, "PAUSE", 0.01)


@pytest.fixture
def log(tmp_path):
    log = RowLog(tmp_path / "run.rows", LAYOUT, 10, {"step": 1e-3})
    yield log
    log.discard()


def line(first=0, rows=1501, width=500, **changes):
    return status.fitted(status.parts({**ROW, **changes}, first, rows, 1e-3), width)


def test_the_line_says_it_all():
    said = "1.50 s|stabilizing|arm +90.0°|pendulum +0.0°|-2.50 V|61 us to command|late 23 us|missed 0"
    assert line().split() == said.replace("|", " ").split()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"controller.mode": 1}, "idle"),
        ({"controller.mode": 2}, "swing-up"),
        ({"controller.mode": 4}, "fault"),
        ({"controller.mode": 0}, "running"),
        ({"controller.mode": 9}, "running"),
        ({"pendulum": 0}, "pendulum  -180.0°"),
        ({"pendulum": 1024 - 256}, "pendulum   -45.0°"),
        ({"first": 500, "rows": 1001}, "   1.00 s"),
        ({"rows": 1489}, "missed 12"),
        ({"digital": 1}, "the amplifier reports a fault"),
        ({"digital": 8}, "cut its voltage"),
    ],
    ids=str,
)
def test_what_the_line_says(changes, said):
    assert said in line(**changes)


@pytest.mark.parametrize(
    ("width", "said"),
    [
        (79, "1.50 s  stabilizing  θ  +90.0°  δ   +0.0°   -2.50 V  late   23 us  missed 12"),
        (39, "1.50 s  stabilizing  missed 12"),
        (12, "1.50 s"),
        (4, "1.5…"),
    ],
)
def test_the_line_fits_the_terminal_and_keeps_what_matters_most(width, said):
    assert line(rows=1489, width=width) == said
    fault = line(rows=1489, width=width, digital=8)
    assert len(fault) <= width
    assert (fault[:-1] if fault.endswith("…") else fault) in line(rows=1489, digital=8)
    assert width < 30 or fault.startswith(status.digital_reason(8)[:20])


def test_a_stall_alone_is_no_fault_and_another_clock_no_lateness():
    assert line(digital=2) == line()
    assert "late" not in line(due=0)


def test_a_controller_without_a_mode_has_a_line():
    row = {k: v for k, v in ROW.items() if k != "controller.mode"}
    assert "running" in status.fitted(status.parts(row, 0, 1501, 1e-3), 500)


def test_it_prints_the_newest_row_until_the_writer_closes(log, calm, capsys):
    log.append(*{**ROW, "tick": 7}.values())
    log.append(*{**ROW, "tick": 9}.values())
    closing = threading.Timer(0.3, log.close)
    closing.start()
    assert status.main([str(log.path)]) == 0
    closing.join()
    error = capsys.readouterr().err
    assert "0.00 s" in error
    assert "missed 1" in error
    assert error.startswith(status.CLEAR)
    assert error.endswith(status.CLEAR)
    assert "\n" not in error


def test_a_run_without_rows_prints_nothing(log, calm, capsys):
    closing = threading.Timer(0.1, log.close)
    closing.start()
    assert status.main([str(log.path)]) == 0
    closing.join()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("content", [None, b"nonsense" * 9])
def test_without_a_log_it_says_so(tmp_path, calm, capsys, content):
    path = tmp_path / "run.rows"
    if content is not None:
        path.write_bytes(content)
    assert status.main([str(path)]) == 1
    assert capsys.readouterr().err.startswith("no live status: ")


def test_an_empty_file_is_no_log(tmp_path, calm):
    (tmp_path / "run.rows").touch()
    assert status.main([str(tmp_path / "run.rows")]) == 1


def test_as_a_process_it_outlives_ctrl_c_and_ends_with_the_writer(log):
    log.append(*ROW.values())
    process = subprocess.Popen(
        [sys.executable, "-m", "cosim.hil.status", str(log.path)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        assert process.stderr is not None
        assert process.stderr.read(1) == b"\r"
        process.send_signal(signal.SIGINT)
        log.append(*{**ROW, "tick": 1501}.values())
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(timeout=0.3)
        log.close()
        assert process.wait(timeout=30.0) == 0
        assert b"Traceback" not in process.stderr.read()
    finally:
        process.kill()
        process.communicate()
