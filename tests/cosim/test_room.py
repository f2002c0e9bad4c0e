"""What does not fit is refused before anything runs, with the numbers and with what would do."""

import shutil
from collections import namedtuple

import pytest

from cosim import room
from cosim.errors import UserError
from cosim.hil.log import Layout, RowLog
from cosim.results import Result
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario

Disk = namedtuple("Disk", "total used free")


@pytest.fixture
def little(monkeypatch):
    """Set the free memory and disk [byte]."""

    def leave(memory=10**9, disk=10**12):
        monkeypatch.setattr(room, "free_memory", lambda: memory)
        monkeypatch.setattr(shutil, "disk_usage", lambda _path: Disk(disk, 0, disk))

    return leave


def scenario_of(**changes):
    scenario, folder = load_scenario("tilt")
    return scenario.changed({name.replace("__", "."): value for name, value in changes.items()}), folder


def test_a_run_that_does_not_fit_into_memory_names_what_would(fmus, little):
    little()
    scenario, folder = scenario_of(run__duration=1e5, run__step=1e-3)
    with pytest.raises(
        UserError, match=r"the run of 1\d{8} rows of \d+ numbers needs .* GB of memory, .* 1 GB; record"
    ) as caught:
        run_scenario(scenario, fmus, folder)
    every = int(str(caught.value).partition("record.every = ")[2].partition(",")[0])
    columns = int(str(caught.value).partition(" rows of ")[2].partition(" ")[0])
    assert 8 * columns * 1e8 / every < 0.5e9 < 8 * columns * 1e8 / (every / 1.2)
    room.check_rows(int(1e8 // every) + 2, columns - 1, every)  # that would do


def test_a_result_that_does_not_fit_onto_the_disk_is_not_begun(fmus, little, tmp_path):
    little(memory=10**12, disk=10**6)
    scenario, folder = scenario_of(run__duration=1e4)
    with pytest.raises(
        UserError, match=r"writing the run of .* needs about .* GB, and .* has 0\.001 GB left; record\.every"
    ):
        run_scenario(scenario, fmus, folder, target=tmp_path / "not yet" / "there")


def test_the_log_of_a_long_run_on_a_device_is_not_begun(tmp_path, little):
    layout = Layout(("voltage",), (), {"voltage": "V"})
    for memory, disk, problem in (
        (10**12, 10**6, "has 0.001 GB left"),
        (10**6, 10**12, "more than half of the free 0.001 GB"),
    ):
        little(memory, disk)
        with pytest.raises(UserError, match=f"the run's log.*{problem}; a shorter duration or a lower rate"):
            RowLog(tmp_path / "run.rows", layout, 10**6, {"step": 1e-3})
    assert list(tmp_path.iterdir()) == []


def test_a_table_that_does_not_fit_is_not_read(tmp_path, little, made_result):
    made_result([0.0, 1.0]).save(tmp_path / "run.csv")
    little(memory=1000)
    with pytest.raises(UserError, match=r"reading .*run\.csv needs"):
        Result.load(tmp_path / "run.csv")


def test_the_free_memory_is_that_of_this_machine():
    free = room.free_memory()
    assert free is None or 10**7 < free < 10**14
