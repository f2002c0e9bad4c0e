"""How commands end: exit codes by one policy, signals as Ctrl-C, output that cannot be encoded, users' texts literally."""

import io
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from cosim import signals
from cosim.cli import main
from cosim.cli.display import console, degrade_output, problems
from cosim.errors import UserError
from cosim.fmu import FmuError
from cosim.hil.device import DeviceError
from cosim.plots import save_comparison, save_overview
from cosim.results import Result, SimulationError
from fmu_export.native_build import BuildError
from tests.cosim.command import started

LONG = ("--set", "run.duration=20000", "--set", "record.every=1000")
NOTHING = Result(np.zeros(0), {}, {})


@pytest.fixture
def ended(monkeypatch, capsys, tmp_path):
    """Run the command line here; return its exit code and its error output."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(signals, "as_ctrl_c", lambda: None)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["qube-ihc", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
        return end.value.code, capsys.readouterr().err

    return run


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (UserError("a [/red] mistake"), 2, "error: a [/red] mistake"),
        (SimulationError("failed", NOTHING, 0.0, "plant"), 1, "error: failed"),
        (FmuError("failed"), 1, "error: failed"),
        (BuildError("no compiler"), 1, "error: no compiler"),
        (DeviceError("no board"), 1, "error: no board"),
        (MemoryError(), 1, "error: there is not enough memory"),
        *(
            (kind("inside"), 70, "inside")
            for kind in (ValueError, KeyError, OSError, ZeroDivisionError, RecursionError)
        ),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else "",
)
@pytest.mark.parametrize("debug", [(), ("--debug",)], ids=["", "debug"])
def test_an_error_ends_with_its_code_and_only_a_fault_shows_its_traceback(ended, monkeypatch, error, code, says, debug):
    def fail(*_):
        raise error

    monkeypatch.setattr("cosim.scenario.load_scenario", fail)
    found, err = ended("run", "tilt", *debug)
    assert found == code
    assert says in err
    assert ("Traceback (most recent call last)" in err) == (code == 70 or bool(debug))
    assert (err.splitlines()[-1].startswith("fault: ") and "please report it" in err) == (code == 70)
    if code != 70 and not debug:
        assert err.splitlines() == [says]


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "x" * 300),
        ("run", "x" * 300 + ".toml"),
        ("run", "tilt", "--fmus", "x" * 300),
        ("run", "tilt", "--fmus", "/dev/null"),
        ("run", "tilt", "--set", "plant.parameters=" + "x" * 300 + ".toml"),
        ("run", "tilt", "--set", "run.seed=" + "[" * 5000),
        ("run", "tilt", "--set", "run=5"),
        ("export", "--platforms", "linux66"),
        ("design", "--delta-max", "1e-200"),
        ("design", "--d-max", "1e300"),
        ("design", "-o", "."),
        ("hil", "--device", "udp://127.0.0.1:²"),
        ("hil", "--device", f"udp://{'a' * 70}:1"),
        ("[/red]",),
    ],
    ids=lambda arguments: " ".join(arguments)[:40],
)
def test_a_mistake_is_no_fault(ended, fmus, arguments):
    extra = ("--fmus", fmus) if arguments[0] == "hil" else ()
    code, err = ended(*arguments, *extra)
    assert code == 2, err
    assert not any(inside in err for inside in ("Traceback", "Warning", "instance of", "Errno"))
    assert list(Path().iterdir()) == []


def test_a_result_that_cannot_be_written_is_rescued(ended, fmus, monkeypatch, tmp_path):
    rescue = tmp_path / "rescue"
    rescue.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(rescue))
    save = Result.save

    def full(result, path):
        """Save a result, unless to where the disk is full."""
        if Path(path) == Path("full/out.csv"):
            raise UserError(f"{path} cannot be written: No space left on device")
        return save(result, path)

    monkeypatch.setattr(Result, "save", full)
    code, err = ended("run", "tilt", "--fmus", fmus, "--set", "run.duration=0.01", "-o", "full/out.csv")
    (saved,) = rescue.rglob("*.csv")
    assert code == 2
    assert f"full/out.csv cannot be written: No space left on device; the rows are in {saved}" in err
    assert len(Result.load(saved).time) == 11


# Output and texts


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_output_that_cannot_be_encoded_degrades(monkeypatch, encoding):
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(io.BytesIO(), encoding))
    degrade_output()
    for target, stream in ((console, sys.stdout), (problems, sys.stderr)):
        target.print("∫|q|² dt [rad² s] \udcff")
        stream.flush()
        assert "|q|" in stream.buffer.getvalue().decode(encoding)  # type: ignore[union-attr]


@pytest.mark.parametrize("text", ["$_{$ [/red]", r"\$ $x$"])
def test_users_texts_are_drawn_and_printed_literally(made_result, tmp_path, ended, fmus, text):
    result = made_result([0.0, 0.5, 1.0])
    save_overview(result, tmp_path / "one.png", text)
    assert len(save_comparison({text: result}, tmp_path, text)) >= 4
    name = f"{text.replace('/', '').replace(chr(92), '')}.csv"
    changes = ("--set", "run.duration=0.01", "--set", f"description={json.dumps(text)}")
    code, err = ended("run", "tilt", "--fmus", fmus, *changes, "--no-plot", "-o", name)
    assert (code, err.strip()) == (0, "")


# Signals


def started_run(*arguments, cwd, folder):
    """Start a command whose unpacked FMUs go to `folder`, and wait until they are there."""
    folder.mkdir()
    process = started(*arguments, cwd=cwd)
    end = time.monotonic() + 60.0
    while len([*folder.glob("qube-ihc-*/modelDescription.xml")]) < 2:
        assert time.monotonic() < end
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    time.sleep(0.5)
    return process


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("arguments", "number"),
    [
        (("run", "tilt", *LONG, "-o", "cut.csv"), signal.SIGTERM),
        (("compare", "tilt", *LONG, "-o", "out"), signal.SIGHUP),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else value.name,
)
def test_a_signal_ends_a_command_as_ctrl_c_does(elsewhere, monkeypatch, arguments, number):
    folder = elsewhere / "unpacked"
    monkeypatch.setenv("TMPDIR", str(folder))
    here = signal.signal(number, signal.SIG_DFL)  # under nohup the tests, and what they start, ignore SIGHUP
    try:
        process = started_run(*arguments, cwd=elsewhere, folder=folder)
    finally:
        signal.signal(number, here)
    try:
        process.send_signal(number)
        _, err = process.communicate(timeout=20)
    finally:
        process.kill()
    assert process.returncode == 128 + number, err
    assert "Traceback" not in err
    assert list(folder.iterdir()) == []
    if arguments[0] == "run":
        result = Result.load(elsewhere / "cut.partial.csv")
        assert len(result.time) > 1
        assert result.metadata["complete"] is False
    else:
        assert not (elsewhere / "out").exists()
