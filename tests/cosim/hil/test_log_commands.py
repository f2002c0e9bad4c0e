"""What a log is for: replay, overlay and identification by their commands."""

from __future__ import annotations

import re

import numpy as np

from cosim.results import Result
from tests.cosim.command import ended, files, sentence


def test_replay_is_exact(tmp_path, fmus, logged):
    done = ended("replay", logged, "--fmus", fmus, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("exact: 3000 samples replayed")


def test_arm_held_elsewhere_is_judged_there_and_replayed(tmp_path, fmus, hil):
    done = hil("--lockstep", "--duration", "7", "--set", "controller.start.theta_setpoint=0.25")
    assert done.returncode == 0, done.stderr
    path = tmp_path / "out" / "run.csv"
    arm = Result.load(path).metadata["evaluation"]["errors"][0]
    assert (arm["signal"], arm["constant"]) == ("plant.theta_encoder", 0.25)
    assert abs(np.mean(Result.load(path)["plant.theta_encoder"][-1000:]) - 0.25) < 0.05
    done = ended("replay", path, "--fmus", fmus, cwd=tmp_path)
    assert done.stdout.startswith("exact: 7000 samples replayed")


def test_the_arm_follows_a_square_wave_on_a_device(tmp_path, fmus, hil):
    faster = ("signals.0.start=2", "signals.0.period=3")
    settings = (part for change in faster for part in ("--set", change))
    done = hil("--lockstep", "--duration", "5", "--scenario", "device_square_wave", *settings)
    assert done.returncode == 0, done.stderr
    path = tmp_path / "out" / "run.csv"
    arm, log = Result.load(path).metadata["evaluation"]["errors"][0], Result.load(path)
    assert (arm["signal"], arm["set_point"]) == ("plant.theta_encoder", "controller.theta_setpoint")
    rows = np.flatnonzero(np.diff(log["controller.theta_setpoint"]))
    assert (rows.tolist(), log["controller.theta_setpoint"][[2000, 2001, 3501]].tolist()) == (
        [2000, 3500],
        [0.0, 0.3, -0.3],
    )
    assert abs(log["plant.theta_encoder"][3500] - 0.3) < 0.1
    done = ended("replay", path, "--fmus", fmus, cwd=tmp_path)
    assert done.stdout.startswith("exact: 5000 samples replayed")
    done = ended("overlay", path, "--fmus", fmus, "--begin", "1.9", "-o", "over", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    again = Result.load(tmp_path / "over" / "simulation.csv")
    assert again["controller.theta_setpoint"].tolist() == log["controller.theta_setpoint"][1900:].tolist()
    assert again.metadata["evaluation"] == log.metadata["evaluation"]
    assert abs(again["plant.theta_encoder"][1600] - log["plant.theta_encoder"][3500]) < 0.03


def test_replay_finds_one_digit(tmp_path, fmus, logged):
    result, changed, row = Result.load(logged), tmp_path / "changed.csv", 700
    voltage = result["controller.voltage"]
    voltage[row] = np.nextafter(voltage[row], 20.0)
    result.save(changed)
    done = ended("replay", changed, "--fmus", fmus, cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert re.match(rf"not exact: 1 of 300\d rows differ, the first at {row / 1000:g} s: voltage is ", done.stdout)


def test_overlay_writes_its_pictures(tmp_path, fmus, logged):
    done = ended("overlay", logged, "--fmus", fmus, "--begin", "2", "-o", "over", cwd=tmp_path)
    assert (done.returncode, done.stderr.strip()) == (0, "")
    written = files(tmp_path / "over")
    assert {"simulation.csv", "simulation.json", "angles.png", "voltage.png"} <= set(written)
    assert "RMS difference of plant.theta_encoder: " in done.stdout


def test_identify_writes_parameters(tmp_path, logged):
    done = ended("identify", logged, "--fit", "D_p", "-o", "mine.toml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert files(tmp_path) == ["mine.toml"]
    assert "D_p" in (tmp_path / "mine.toml").read_text(encoding="utf-8")


def test_log_that_is_missing(tmp_path):
    assert sentence(ended("replay", "nothing.csv", cwd=tmp_path)) == "result file nothing.csv does not exist"
    assert files(tmp_path) == []
