"""`qube-ihc paper` in a process of its own: refusals, and Ctrl-C, after which the same command goes on."""

import json
import signal
import time

import pytest

from tests.cosim.command import ended, files, journal_rows, sentence, started


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--draws", "0"), "--draws"),
        (("--draws", "few"), "--draws"),
        (("--workers", "0"), "--workers"),
        (("--fast",), "--fast"),
        (("quick",), "quick"),
    ],
)
def test_a_wrong_option_ends_with_code_2_and_is_named(tmp_path, arguments, named):
    done = ended("paper", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert named in done.stderr
    assert "Traceback" not in done.stderr
    assert files(tmp_path) == []


def test_missing_fmus_are_one_sentence_and_leave_nothing_behind(tmp_path):
    said = sentence(ended("paper", "--quick", "--fmus", "nowhere", cwd=tmp_path))
    assert said == "FMU nowhere/QubeServo2.fmu does not exist; `qube-ihc export` makes the project's FMUs"
    assert files(tmp_path) == []


def interrupted(journal, more, *args, cwd):
    """Start the command, interrupt it when the journal has `more` runs more than before; return what it said."""
    before = len(journal_rows(journal))
    process = started("paper", *args, cwd=cwd)
    try:
        end = time.monotonic() + 60.0
        while len(journal_rows(journal)) < before + more:
            assert process.poll() is None, process.stderr.read() if process.stderr else ""
            assert time.monotonic() < end
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    finally:
        process.kill()
    return process.returncode, out, err


def test_ctrl_c_ends_with_code_130_keeps_what_is_finished_and_the_next_start_goes_on(tmp_path):
    """Finished runs stay as they were and none is run again, though FMUs are exported anew; nothing is half written."""
    journal = tmp_path / "out" / "runs.sqlite"
    expected = ["fmus/IhcController.fmu", "fmus/QubeServo2.fmu", "fmus/QubeWithController.ssp"]
    expected += ["runs.sqlite", "scenarios/default.json", "scenarios/paper.json"]
    before = []
    for more in (4, 6):
        code, out, err = interrupted(journal, more, "--quick", "--draws", "3", "-o", "out", cwd=tmp_path)
        assert code == 130, err
        assert "Traceback" not in out + err
        assert "finished runs are kept, and the same command goes on from there" in out + err
        assert files(tmp_path / "out") == expected
        rows = journal_rows(journal)
        assert rows[: len(before)] == before
        assert len(rows) >= len(before) + more
        assert all(json.loads(numbers)["integral_q2"] > 0.0 for _, numbers in rows)
        before = rows
