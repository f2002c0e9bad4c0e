"""The device's swing-up: every draw captures in time and within the cable's range."""

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks import device_swing_up
from benchmarks.device_swing_up import CABLE, LATEST, SETS, STEPS, Key, Outcome, jobs, judged, main, outcomes, table
from plant_fmu.parameters import PARAMETER_SETS

DRAWS = 100
PAGE = Path(__file__).parents[2] / "docs" / "hil.md"


def test_every_draw_is_captured_in_time_within_the_cable_and_kept_as_the_page_says(fmus, tmp_path):
    found = outcomes(jobs(DRAWS, seed=1), fmus, tmp_path / "runs")
    assert table(found) in PAGE.read_text(encoding="utf-8")
    assert len(found) == DRAWS * len(SETS) * len(STEPS)
    assert [key for key, outcome in found.items() if not outcome.good] == []
    assert max(o.arm for o in found.values()) < CABLE == pytest.approx(1.8326, abs=1e-4)
    assert max(o.capture for o in found.values()) < LATEST == 5.0


def test_the_usual_swing_up_would_not_do(fmus, tmp_path):
    assert not all(o.good for o in outcomes(jobs(4, seed=7, name="swing_up"), fmus, tmp_path / "runs").values())


def test_draws_are_within_their_ranges_and_equal_at_all_steps():
    starts = {job.key: job.whole.plant.start | {"seed": job.whole.run.seed or 0} for job in jobs(20, seed=3)}
    for name in SETS:
        usual = PARAMETER_SETS[name].parameters
        for draw in range(20):
            one, two = (starts[Key(name, step, draw)] for step in STEPS)
            assert one == two
            for damping in ("D_r", "D_p"):
                value = getattr(usual, damping)
                assert 0.8 * value <= float(one[damping]) <= 1.2 * value
            if draw % 2 == 0:
                assert one["delta_0"] == -math.pi
                assert one["theta_0"] == one["delta_dot_0"] == 0.0
    assert len({start["seed"] for start in starts.values()}) == 20 * len(SETS)


@pytest.mark.parametrize(
    ("changes", "good"),
    [
        ({}, True),
        ({"theta": 1.9}, False),
        ({"delta": 0.2}, False),
        ({"mode": 2}, False),
        ({"late": 5.5}, False),
        ({"lost": True}, False),
    ],
)
def test_what_counts_as_good(made_result, changes, good):
    time = np.linspace(0.0, 10.0, 101)
    mode = np.where(time < changes.get("late", 2.0), 2, changes.get("mode", 3))
    if changes.get("lost"):
        mode[60:65] = 2
    result = made_result(time, changes.get("theta", 0.5), plant_delta=changes.get("delta", 0.0), controller_mode=mode)
    assert judged(result)["good"] == good


def test_the_table_names_each_cell(monkeypatch, capsys):
    found = {Key(name, step, 0): Outcome(1.5, 0.9, good=name != "hcs") for name in SETS for step in STEPS}
    lines = table(found).splitlines()
    assert len(lines) == 1 + len(SETS) * len(STEPS)
    assert "1/1" in lines[1]
    assert "0/1" in lines[-1]
    monkeypatch.setattr(device_swing_up, "outcomes", lambda *_: found)
    assert main(["--draws", "1"]) == 1
    assert capsys.readouterr().out.splitlines() == lines
