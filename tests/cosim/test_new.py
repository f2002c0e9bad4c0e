"""What `new` writes runs as it is written, and nothing that is there is replaced."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.judged_signals import evaluation_in
from cosim.new import new
from cosim.results import Result
from cosim.scenario import load_scenario
from ihc_fmu.design import Design
from ihc_fmu.system import System
from tests.cosim.command import ended, files, sentence


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """A folder in which the commands that `new` names have been run."""
    folder = tmp_path_factory.mktemp("my plants")
    done = ended("new", "see_saw", cwd=folder)
    assert done.returncode == 0, done.stderr
    commands = [line.split() for line in done.stdout.splitlines() if line.startswith("    ")]
    assert [command[0] for command in commands] == ["pythonfmu", *4 * ["qube-ihc"]]
    place = folder / "see_saw"
    python = [sys.executable, "-m", *commands[0]]
    subprocess.run(python, cwd=place, check=True, capture_output=True, timeout=60)
    before = (place / "see_saw.toml").read_bytes()
    done = ended(*commands[1][1:], cwd=place)
    assert done.returncode == 0, done.stderr
    for command in commands[2:]:
        later = ended(*command[1:], cwd=place)
        assert later.returncode == 0, later.stderr
    return place, before, done


def test_the_system_file_is_what_linearize_writes_byte_for_byte(begun):
    place, before, done = begun
    assert (place / "see_saw.toml").read_bytes() == before
    assert "note" not in done.stderr
    made = ["results/see_saw_run.csv", "see_saw.fmu", "see_saw.json", "see_saw_controller.fmu"]
    assert {*made, "see_saw.py", "see_saw.toml", "see_saw_run.toml"} <= {*files(place)}


def test_the_system_is_the_plants_and_its_controller_holds_it(begun):
    place, _, _ = begun
    system: Any = System.load(place / "see_saw.toml")
    inertia = 0.5 * 0.3**2
    np.testing.assert_allclose(system.A, [[0, 1], [9.81 / 0.3, -0.01 / inertia]], rtol=1e-8)
    np.testing.assert_allclose(system.B, [[0], [1 / inertia]], rtol=1e-8)
    assert (system.name, [str(q) for q in system.inputs], system.upper.tolist()) == ("see_saw", ["torque [N.m]"], [2.0])
    spec: Any = importlib.util.spec_from_file_location("see_saw_by_hand", place / "see_saw.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    plant = module.SeeSaw(instance_name="plant")
    scenario, _ = load_scenario(str(place / "see_saw_run.toml"))
    for name, value in scenario.plant.start.items():
        setattr(plant, name, value)
    plant.exit_initialization_mode()
    assert plant.angle == 0.2
    for k in range(round(scenario.run.duration / scenario.run.step)):
        u = system.K @ [plant.angle, plant.velocity]
        plant.torque = float(np.clip(u, system.lower, system.upper)[0])
        assert plant.do_step(k * scenario.run.step, scenario.run.step)
    assert abs(plant.angle) < 1e-6


def test_the_design_is_certified_and_of_this_system(begun):
    place, _, _ = begun
    design = Design.load(place / "see_saw.json")
    assert (design.system.name, design.mu) == ("see_saw", 1.0)
    assert design.certificate.decrease > 0.0


def test_the_scenario_names_the_files_that_there_are_and_will_be(begun):
    place, _, _ = begun
    scenario, folder = load_scenario(str(place / "see_saw_run.toml"))
    assert (scenario.plant.fmu, scenario.controller.fmu) == ("see_saw.fmu", "see_saw_controller.fmu")
    assert (folder / scenario.plant.fmu).is_file()


def test_a_result_has_the_units_of_the_descriptions_which_are_those_of_the_wires(begun):
    place, _, _ = begun
    result = Result.load(place / "results" / "see_saw_run.csv")
    names = ("plant.angle", "plant.velocity", "controller.torque")
    assert [result.units[name] for name in names] == ["rad", "rad/s", "N.m"]
    about = evaluation_in(result)
    assert [e.unit for e in (*about.errors, *about.controls)] == ["rad", "rad/s", "N.m"]
    assert result.metadata["messages"].get("plant", []) == []


@pytest.mark.parametrize("there", ["crane.py", "crane.toml", "crane_run.toml"])
def test_a_file_that_is_there_stays_whoever_wrote_it(tmp_path, there):
    (tmp_path / there).write_text("# written by qube-ihc\n")
    assert sentence(ended("new", "crane", "-o", ".", cwd=tmp_path)) == (
        f"{there} exists and stays; choose another name or --output"
    )
    assert files(tmp_path) == [there]
    assert (tmp_path / there).read_text() == "# written by qube-ihc\n"


@pytest.mark.parametrize("name", ["", "2cranes", "a b", "../crane", "a.b", "ä", "x" * 41, "_x", "a\n"])
def test_a_name_that_is_no_identifier_is_refused(tmp_path, name):
    with pytest.raises(UserError, match="the name must be at most 40 letters, digits and underscores, a letter first"):
        new(name, tmp_path)
    assert files(tmp_path) == []


@pytest.mark.parametrize("name", ["math", "class", "Random", "pythonfmu", "con", "real", "numpy", "matplotlib"])
def test_a_name_that_python_has_is_refused(tmp_path, name):
    with pytest.raises(UserError, match="must not be one that Python has already"):
        new(name, tmp_path)
    assert files(tmp_path) == []
