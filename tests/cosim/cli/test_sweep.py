"""The command `sweep`: what it prints and writes, what Ctrl-C leaves, what it refuses."""

import signal
import sys
import time

import pytest

from tests.cosim.command import ended, finished, journal_rows, sentence, started

SHORT = ("--set", "run.duration=0.5", "--workers", "1", "--laws", "LC,IHC")


def test_tables_remarks_and_files_and_again_to_the_byte(elsewhere):
    command = ("sweep", "tilt", "--vary", "plant.m_p=±10%", "--draws", 4, "--worst", 1, "--metric", "energy", *SHORT)
    done = ended(*command, cwd=elsewhere)
    assert done.returncode == 0, done.stderr
    folder = elsewhere / "results" / "sweep_tilt"
    lines = done.stdout.splitlines()
    assert lines[0].startswith("tilt, 4 draws (Sobol) of plant.m_p, offsets and noise: mean ± 95 % interval")
    assert [line for line in lines if line.startswith("over LC on the same 4 draws")]
    assert not [line for line in lines if "settling" in line and "never" not in line]
    files = {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.startswith("runs.sqlite")}
    written = {line.rpartition("/")[2] for line in lines if line.startswith("wrote")}
    assert written == files.keys() >= {"worst_LC_1.toml", "worst_IHC_1.toml", "sweep.parquet", "scatter.png"}
    assert ended(*command, cwd=elsewhere).stdout == done.stdout
    assert {name: (folder / name).read_bytes() for name in files} == files


def test_ctrl_c_keeps_the_finished_runs_and_writes_nothing_else(elsewhere):
    command = ("sweep", "tilt", "--vary", "plant.m_p=±10%", "--draws", 4, "--set", "run.duration=1000", *SHORT[2:])
    journal = elsewhere / "results" / "sweep_tilt" / "runs.sqlite"
    process = started(*command, cwd=elsewhere)
    while len(journal_rows(journal)) < 2 and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    done = finished(process)
    assert done.returncode == 128 + signal.SIGINT, done.stderr
    assert 2 <= len(journal_rows(journal)) < 8
    assert "interrupted; finished runs are kept, and the same command goes on from there" in done.stderr
    assert [path.name for path in journal.parent.iterdir() if not path.name.startswith("runs.sqlite")] == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "a sweep needs something to vary, such as --vary plant.m_p=±10%"),
        (["--vary", "plant.m_p"], "--vary takes ENTRY=SPEC, such as plant.m_p=±10%, found 'plant.m_p'"),
        (["--vary", "=1..2"], "--vary takes ENTRY=SPEC, such as plant.m_p=±10%, found '=1..2'"),
        (["--vary", "plant.m_p=±5%", "--vary", "plant.m_p=±6%"], "--vary names plant.m_p twice"),
        (["--vary", "plant.m_p=±5%", "--metric", "speed"], "the metric must be one of settling_time, "),
    ],
    ids=str,
)
def test_a_mistake_is_one_sentence_and_writes_nothing(elsewhere, arguments, said):
    assert sentence(ended("sweep", "tilt", *arguments, cwd=elsewhere)).startswith(said)
    assert not (elsewhere / "results").exists()


def test_without_pyarrow_a_sentence_names_the_extra(elsewhere, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    done = ended("sweep", "tilt", "--vary", "plant.m_p=±5%", cwd=elsewhere)
    assert sentence(done).endswith('needs pyarrow: pip install "qube-ihc[sweep]"')
