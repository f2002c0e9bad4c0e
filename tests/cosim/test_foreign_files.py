"""Commands look at once whether what they will write would replace a file that is not theirs."""

from __future__ import annotations

import zipfile

import pytest

from cosim import master
from cosim.cli import app
from cosim.errors import UserError
from cosim.hil.log import free_path
from cosim.results import Result

CASES = [
    ("run tilt --fmus {fmus} -o cartpole.csv", "cartpole.json"),
    ("run tilt --fmus {fmus} -o cartpole.csv", "cartpole.png"),
    ("run tilt --fmus {fmus} -o cartpole.csv", "cartpole.partial.json"),
    ("compare tilt --fmus {fmus} -o .", "tilt/LC.csv"),
    ("compare tilt --fmus {fmus} -o .", "tilt/comparison.json"),
    ("compare tilt --fmus {fmus} -o .", "tilt/angles.png"),
    ("tune tilt --fmus {fmus} -o t", "t/best.json"),
    ("tune tilt --fmus {fmus} -o t", "t/best.toml"),
    ("design -o mine.json", "mine.json"),
    ("export -o mine", "mine/QubeServo2.fmu"),
    ("export -o mine", "mine/QubeWithController.ssp"),
    ("paper -o p", "p/report.html"),
    ("demo -o d --fmus f", "f/IhcController.fmu"),
    ("demo -o d --fmus f", "d/tilt/comparison.json"),
    ("device --fmus {fmus} --record r.csv --once", "r.csv"),
    ("identify {run} -o mine.toml", "mine.toml"),
    ("overlay {run} -o o --fmus {fmus}", "o/simulation.json"),
]


@pytest.fixture
def log(pair, tmp_path):
    """Write the result of a short run and return its path."""
    path = tmp_path / "log" / "run.csv"
    master.simulate(pair("tilt"), 1e-3, 0.01).save(path)
    assert Result.load(path).time.size
    return path


@pytest.mark.parametrize(("command", "file"), CASES)
def test_a_file_of_another_is_named_before_the_work(fmus, log, tmp_path, monkeypatch, command, file):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix in (".fmu", ".ssp"):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", "<fmiModelDescription/>")
    else:
        path.write_text('{"mine": 1}', encoding="utf-8")
    before, files = path.read_bytes(), sorted(tmp_path.rglob("*"))
    with pytest.raises(UserError, match=rf"^{file} was not written by qube-ihc and stays"):
        app([part.format(fmus=fmus, run=log) for part in command.split()], standalone_mode=False)
    assert path.read_bytes() == before
    assert sorted(tmp_path.rglob("*")) == files


@pytest.mark.parametrize("taken", ["run.csv", "run.json", "run.png", "run.rows"])
def test_a_log_takes_no_name_of_which_a_file_is_there(tmp_path, taken):
    (tmp_path / taken).touch()
    assert free_path(tmp_path, "run") == tmp_path / "run_2.csv"
