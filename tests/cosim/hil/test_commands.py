"""The commands for hardware: runs, refusals, stops, a killed loop, and what a log is for."""

from __future__ import annotations

import csv
import importlib.util
import json
import os
import re
import shutil
import signal
import socket
import time
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil import udp
from cosim.hil.log import LiveLog
from cosim.hil.replay import replay
from cosim.hil.simulated import HOLD
from cosim.results import Result
from tests.cosim.browser import check_alone
from tests.cosim.command import ended, files, finished, sentence, started

STAND_IN = Path(__file__).parent / "stand_in"
PERIOD = 1e-3
PATIENCE = 120
"""How long a process may take [s], many times what it needs."""

without_sdk = pytest.mark.skipif(importlib.util.find_spec("quanser") is not None, reason="Quanser's package is here")


@pytest.fixture
def process(tmp_path, fmus):
    """Run `hil` in a process of its own; otherwise as `hil`."""
    return lambda *args, **options: finished(
        started("hil", "--fmus", fmus, "-o", "out", *args, cwd=tmp_path, **options)
    )


@pytest.fixture
def on_board(stand_in, hil):
    """Run `hil` on a board of the stand-in with a configuration."""

    def run(*args, **changes):
        stand_in.configure(clock="steps", **changes)
        return hil("--device", "qube", *args)

    return run


def metadata_of(path):
    return json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))["metadata"]


def row_count(folder):
    """Return how many rows the log in a folder has so far."""
    for path in folder.glob("*.rows"):
        try:
            live = LiveLog(path)
        except (UserError, OSError, ValueError):  # not yet made, or gone
            return 0
        live.newest()
        live.close()
        return live.rows
    return 0


def wait_for_rows(process, folder, rows):
    """Wait until the log has `rows`, or the process ends."""
    until = time.monotonic() + PATIENCE
    while process.poll() is None and row_count(folder) < rows:
        assert time.monotonic() < until
        time.sleep(0.02)


# --- runs


def test_run_leaves_log_and_picture(logged):
    assert files(logged.parent) == ["run.csv", "run.html", "run.json", "run.png"]
    result = Result.load(logged)
    assert np.round(result.time / PERIOD).tolist() == list(range(3001))
    assert result.metadata["hil"]["stop"] == "complete"
    assert {"plant.theta_encoder", "controller.voltage", "hil.latency"} <= set(result.signals)


def test_the_page_of_a_run_says_how_it_ended_and_its_timing(logged):
    page = check_alone(logged.with_suffix(".html").read_text(encoding="utf-8"))
    texts = [text.strip() for _, text in page.texts]
    assert {"stopped at 0 V", "the duration is over", "timing of the run [us]", "missed periods: 0 of 3000"} <= {
        text.partition(" (a bare")[0] for text in texts
    }
    assert page.all("href") == ["run.csv"]
    assert not any(tag == "ul" and tags.get("class") == "notes" for tag, tags in page.tags)  # nothing to warn of


def test_earlier_run_stays(tmp_path, hil, logged):
    out = tmp_path / "out"
    shutil.copytree(logged.parent, out)
    done = hil("--lockstep", "--duration", "0.2")
    assert done.returncode == 0, done.stderr
    assert "stopped at 0 V: the duration is over" in done.stdout
    assert files(out) == sorted(
        ["run.html", *(f"run{n}.{kind}" for n in ("", "_2") for kind in ("csv", "json", "png"))]
    )
    assert (out / "run.csv").read_bytes() == logged.read_bytes()
    first, second = (Result.load(out / name)["controller.voltage"] for name in ("run.csv", "run_2.csv"))
    assert second.tolist() == first[:201].tolist()


def test_run_on_the_stand_in(tmp_path, fmus, process, monkeypatch):
    log, configuration = tmp_path / "board.log", tmp_path / "board.json"
    configuration.write_text(json.dumps({"clock": "steps", "log": str(log)}), encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [str(STAND_IN), os.environ.get("PYTHONPATH")])))
    monkeypatch.setenv("QUBE_STAND_IN", str(configuration))
    square = ("--scenario", "device_square_wave", "--set", "signals.0.start=0.2")
    done = process("--device", "qube", "--duration", "0.5", *square)
    assert done.returncode == 0, done.stderr
    assert "while stopping" not in done.stdout
    result = Result.load(tmp_path / "out" / "run.csv")
    assert result["controller.theta_setpoint"].tolist() == [0.0] * 201 + [0.3] * 300
    replayed = replay(result, fmus / "IhcController.fmu")
    assert (replayed.first, replayed.samples) == (None, 500)
    events = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    assert max(abs(event["values"][0]) for event in events if event["what"] == "AO0") > 0.1
    last = {event["what"]: event["values"] for event in events}
    assert (last["AO0"], last["DO0"], last["LED"]) == ([0.0], [0], [1.0, 0.0, 0.0])
    assert (last["close"], last["exit"]) == ([0.0, 0], [0.0, 0, False])


def test_fault_of_the_script_ends_the_run(tmp_path, hil):
    done = hil("--lockstep", "--no-sign-test", "--duration", "2", "--faults", "amplifier-fault@0.8")
    assert done.returncode == 1, done.stderr
    assert "stopped at 0 V: the amplifier reports a fault" in done.stdout
    path = tmp_path / "out" / "run.csv"
    assert Result.load(path).time[-1] == pytest.approx(0.3)  # after 0.5 s of rest
    assert (metadata_of(path)["hil"]["stop"], metadata_of(path)["complete"]) == ("fault", False)
    assert not path.with_suffix(".rows").exists()


def test_unplugged_board_ends_the_run(tmp_path, on_board):
    done = on_board("--no-sign-test", "--duration", "2", unplugged_at=0.8)
    assert done.returncode == 1, done.stderr
    assert "stopped at 0 V" not in done.stdout
    assert "while stopping: setting 0 V: " in done.stdout
    assert "check its USB cable" in done.stdout
    assert len(metadata_of(tmp_path / "out" / "run.csv")["hil"]["failures"]) == 6


def test_stop_that_failed_is_no_success(on_board):
    third = 3  # off at the opening, on, off at the stop
    failures = {"write": (1, -843, True), "write_digital": (third, -843, True)}
    done = on_board("--no-sign-test", "--duration", "0.1", failures=failures)
    assert "while stopping: switching the amplifier off" in done.stdout
    assert done.returncode == 1


# --- refusals


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--device", "cube"), "'cube'; did you mean qube?"),
        (("--faults", "arm-jmp@1"), "did you mean arm-jump?"),
        (("--device", "qube", "--lockstep"), "--lockstep is for simulated devices"),
        (("--rate", "0"), "--rate must lie in [100, 10000] Hz, found 0 Hz"),
        (("--on-fall", "cry"), "--on-fall must be swing-up or stop, found 'cry'"),
        (("--scenario", "tilt_ideal"), "a device measures with encoders, the scenario tilt_ideal says ideal"),
        (("--device", "udp://127.0.0.1"), "no device listens at 127.0.0.1:18950; start one with `qube-ihc device"),
    ],
)
def test_refusals(tmp_path, hil, args, said):
    done = hil(*args)
    assert said in sentence(done)
    assert done.stdout == ""
    assert not (tmp_path / "out").exists() or files(tmp_path / "out") == []


@pytest.mark.parametrize(
    "command", [("hil", "--lockstep"), ("hil", "--device", "qube"), ("device", "--once")], ids=" ".join
)
@pytest.mark.parametrize(
    ("entry", "what"),
    [
        (
            '[[signals]]\nkind = "step"\ninput = "plant.pendulum_torque"\nvalue = 0.001',
            "a signal on plant.pendulum_torque",
        ),
        ("[disturbance]\nsines = [{amplitude = 0.1, frequency = 3.0}]", "a disturbance of the plant"),
    ],
    ids=["signal", "disturbance"],
)
def test_what_acts_on_a_devices_plant_is_refused(tmp_path, fmus, command, entry, what):
    (tmp_path / "pushed.toml").write_text(entry, encoding="utf-8")
    said = sentence(ended(*command, "--scenario", "pushed.toml", "--fmus", fmus, cwd=tmp_path))
    assert said == f"on a device signals can act on the controller's inputs only, and the scenario pushed has {what}"


@without_sdk
def test_board_without_the_sdk(tmp_path, hil):
    text = sentence(hil("--device", "qube"))
    assert "Quanser's Python package is not installed" in text
    assert "install the Quanser SDK" in text
    assert files(tmp_path) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"libhil_missing": True}, "its library is not"),
        ({"identifiers": ()}, "no board was found; plug in its USB cable"),
    ],
)
def test_board_that_cannot_be_had(tmp_path, on_board, changes, said):
    assert said in sentence(on_board(**changes))
    assert files(tmp_path) == []


def test_fault_at_the_opening_is_one_sentence(on_board):
    done = on_board(digital_inputs=((0.0, 0, 1),))
    assert "the amplifier reports a fault" in done.stderr
    assert "Traceback" not in done.stderr


def test_silent_address_is_one_sentence(hil, monkeypatch):
    monkeypatch.setattr(udp, "REPLY_TIME", 0.01)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        done = hil("--device", f"udp://127.0.0.1:{taken.getsockname()[1]}")
    assert "does not answer" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(os.name != "posix", reason="limits the size of files by the operating system")
def test_log_without_room_does_not_spoil_the_folder(tmp_path, process):
    import resource  # of POSIX

    def small():
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    sentence(process("--lockstep", "--duration", "10", preexec_fn=small))
    assert files(tmp_path / "out") == []


def test_device_refuses_a_taken_port(tmp_path, fmus):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        done = ended("device", "--fmus", fmus, "--listen", f"127.0.0.1:{port}", cwd=tmp_path)
    assert sentence(done).startswith(f"cannot listen at 127.0.0.1:{port}: ")


# --- signals and kills, with a clock: a busy machine may end such a run by the device's own hold


def test_interrupt(tmp_path, fmus):
    out = tmp_path / "out"
    loop = started("hil", "--fmus", str(fmus), "--no-sign-test", "--duration", "60", "-o", "out", cwd=tmp_path)
    wait_for_rows(loop, out, 100)
    loop.send_signal(signal.SIGINT)
    done = finished(loop)
    logged = (out / "run.csv").exists()  # not where a stall ended the run in its checks
    stop = metadata_of(out / "run.csv")["hil"]["stop"] if logged else "fault"
    assert (done.returncode, stop) in {(130, "signal"), (1, "fault")}, done.stderr
    said = {"signal": "stopped by SIGINT", "fault": "the device cut its voltage by itself"}[stop]
    assert f"stopped at 0 V: {said}" in done.stdout
    assert "while stopping" not in done.stdout
    assert "Traceback" not in done.stderr
    assert not list(out.glob("*.rows"))
    if not logged:
        return
    result = Result.load(out / "run.csv")
    assert stop == "fault" or len(result.time) + np.sum(result["hil.missed"]) >= 100


@pytest.fixture
def device(tmp_path, fmus):
    """A device in a process of its own; (process, port, file of its record)."""
    record = tmp_path / "rec.csv"
    listen = ("--listen", "127.0.0.1:0", "--record", str(record))
    process = started("device", "--fmus", str(fmus), *listen, cwd=tmp_path)
    assert process.stdout is not None
    listening = re.fullmatch(r"listening at 127\.0\.0\.1:(\d+)\n", process.stdout.readline())
    assert listening
    yield process, listening[1], record
    process.kill()
    process.wait()


def sessions(record):
    """Return the device's record as (time, voltage, what), session by session."""
    with record.open(encoding="utf-8", newline="") as file:
        rows = [(float(row["time"]), float(row["voltage"]), row["what"]) for row in csv.DictReader(file)]
    begins = [i for i, row in enumerate(rows) if row[2] == "open"]
    return [rows[i:j] for i, j in zip(begins, [*begins[1:], len(rows)], strict=True)]


def killed(tmp_path, fmus, port):
    """Kill loops until one died of it and not of a stall of the machine; return (its folder, how many began)."""
    for n in range(1, 6):
        folder = tmp_path / f"out {n}"
        options = ("--no-sign-test", "--duration", "60", "-o", str(folder))
        with mock.patch.dict(os.environ, TMPDIR=str(tmp_path)):  # a killed process leaves its unpacked FMUs behind
            loop = started("hil", "--fmus", str(fmus), "--device", f"udp://127.0.0.1:{port}", *options, cwd=tmp_path)
        wait_for_rows(loop, folder, 150)
        loop.kill()
        if finished(loop).returncode == -signal.SIGKILL:
            return folder, n
    pytest.skip("the machine is too busy for a run with a clock")


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_killed_loop(tmp_path, fmus, device):
    process, port, record = device
    folder, begun = killed(tmp_path, fmus, port)
    assert row_count(folder) >= 150
    assert files(folder) == ["run.rows"]
    time.sleep(1.5)  # then the device has ended the session
    again = ("--device", f"udp://127.0.0.1:{port}", "--lockstep", "--duration", "0.2", "-o", folder)
    done = ended("hil", "--fmus", fmus, *again, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    process.send_signal(signal.SIGINT)
    assert finished(process).returncode == 130

    recovered = re.search(r"recovered (\d+) rows of a run that was killed", done.stdout)
    assert recovered
    result = Result.load(folder / "run.csv")
    assert len(result.time) == int(recovered[1]) >= 150
    assert (result.metadata["recovered"], result.metadata["complete"]) == (True, False)
    assert {"run_2.csv", "run_2.json"} <= set(files(folder))
    assert not list(folder.glob("*.rows"))

    *_, dead, clean = sessions(record)
    assert len(sessions(record)) == begun + 1
    before, cut, *after = dead[[row[2].startswith("cut: ") for row in dead].index(True) - 2 :]
    assert (before[2], cut) == ("command", (cut[0], 0.0, "cut"))
    assert before[1] != 0.0
    assert cut[0] - before[0] <= HOLD + PERIOD + 1e-9
    assert {row[1] for row in after} == {0.0}
    assert [row[2] for row in clean][-2:] == ["stop: the duration is over", "close"]
    assert clean[-1][1] == 0.0


# --- check


def findings(done):
    """Return the (word, text) of each line."""
    return [tuple(line.split(None, 1)) for line in done.stdout.strip().splitlines()]


def test_check_of_the_simulated_device(tmp_path, hil):
    done = hil("--check", "--lockstep")
    lines = findings(done)
    assert (done.returncode, done.stderr) == (0, "")
    assert {word for word, _ in lines} == {"ok"}
    for text in ("the controller IhcController.fmu needs", "amplifier off", "rest for", "periods missed", "signs: "):
        assert sum(text in line for _, line in lines) == 1
    assert files(tmp_path) == []


def test_check_of_the_stand_in(stand_in, on_board):
    done = on_board("--check", "--no-real-time")
    lines = findings(done)
    assert done.returncode == 0, done.stdout
    assert {word for word, _ in lines} == {"ok"}
    assert lines[0][1] == "Quanser's package and library are there"
    assert stand_in.history("close")[-1].values == [0.0, 0]
    assert any(event.values[0] < 0.0 for event in stand_in.history("AO0"))  # the pulse


def test_check_of_an_encoder_the_other_way_round(hil):
    # rest 0.5 s, timing 2 s, then the pulse: the arm's counts go up instead of down
    done = hil("--check", "--lockstep", "--faults", "arm-jump@2.52=60:0.08")
    assert done.returncode == 1, done.stdout
    wrong = [text for word, text in findings(done) if word == "wrong"]
    assert len(wrong) == 1
    assert "the arm turned against the voltage's sign" in wrong[0]


@without_sdk
def test_check_without_the_sdk(hil):
    done = hil("--check", "--device", "qube")
    assert done.returncode == 1
    ((word, text),) = findings(done)
    assert word == "wrong"
    assert "is not installed" in text


def test_a_check_has_no_page(hil):
    done = hil("--check", "--report")
    assert (done.returncode, done.stdout) == (2, "")
    assert "it takes neither --report nor --report-file" in done.stderr
