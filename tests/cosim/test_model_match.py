"""Where controllers and plants of any kind meet: what is found, what is said, and where nothing is."""

from __future__ import annotations

import json
import re
import shutil
import zipfile

import numpy as np
import pytest

from cosim import plant_as_wired
from cosim.model_match import remarks
from cosim.pendulum_export import Kind
from cosim.remarks import remarks_before as notes
from cosim.scenario import Scenario
from cosim.scenario_system import build_system
from cosim.system_export import export_system
from fmu_export.archive import further_resources
from fmu_export.errors import UserError
from ihc_fmu.synthesis import synthesize
from ihc_fmu.system import System
from tests.cosim.command import ended
from tests.cosim.linear_fmu import linear_fmu

A = np.array([[0.0, 1.0, 0.0], [-2.0, -0.3, 1.0], [0.0, 0.0, -5.0]])
B = np.array([[0.0], [0.0], [5.0]])
ENTRIES = {
    "name": "spring",
    "A": A.tolist(),
    "B": B.tolist(),
    "C": [[1.0, 0.0, 0.0]],
    "lqr": {"Q": [1.0, 0.1, 0.0], "R": [1.0]},
    "states": ["angle [rad]", "rate [rad/s]", "torque [N.m]"],
    "inputs": ["command [V]"],
    "outputs": ["encoder [rad]"],
    "limits": [10.0],
    "resolutions": [1e-3],
}
OTHER = "the controller was designed for another"


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The FMUs of a design for ENTRIES, and of the same plant in Python."""
    folder = tmp_path_factory.mktemp("spring")
    made = synthesize(System.from_dict(ENTRIES))
    export_system(made, folder / "python", kind=Kind.python)
    export_system(made, folder)
    (folder / "python" / "spring_linear_plant.fmu").rename(folder / "python_plant.fmu")
    return folder


def built(folder, plant="spring_linear_plant.fmu", **changes):
    """Return the system of the controller and a plant."""
    parts = {"plant.fmu": plant, "controller.fmu": "spring_controller.fmu"}
    return build_system(Scenario().changed({**parts, **{n.replace("__", "."): v for n, v in changes.items()}}), folder)


def wired(output="encoder", more="", back=""):
    return [f"plant.{output} -> controller.encoder{more}", f"controller.command -> plant.command{back}"]


@pytest.mark.parametrize("plant", ["spring_linear_plant.fmu", "python_plant.fmu"])
def test_counted_linear_plants_of_both_kinds_are_judged(exported, plant):
    system = built(exported, plant, plant__start={"angle_0": 0.5, "encoder_resolution_offset": 0.2})
    assert remarks(system) == []
    loose = built(exported, plant, wires=wired()[:1])
    said = "the control controller.command acts on nothing: no wire leads from it"
    assert [notes(one, Scenario()) for one in (system, loose)] == [[], [said]]
    back, there = "controller.command -> plant.command", "plant.encoder -> controller.encoder"
    for wires, problem in (
        (wired(back=" * -1"), f"the sign of command is the opposite ({back} * -1 would fit without a factor)"),
        (
            wired(more=" * 57.29578"),
            f"encoder arrives in degrees instead of rad ({there} * 57.2958 would fit without a factor)",
        ),
        (wired(back=" * 1000"), f"command acts in thousands of V ({back} * 1000 would fit without a factor)"),
        (wired("rate", " * 1.1"), "its states are in the order rate, angle, torque, not angle, rate, torque"),
    ):
        said = re.escape(f"{OTHER} model than the plant's, as it is wired: {problem}; controller.other")
        with pytest.raises(UserError, match=said):
            built(exported, plant, wires=wires)
    with pytest.raises(UserError, match="must join equal units, found rad/s and rad"):
        built(exported, plant, wires=wired("rate"))
    assert built(exported, plant, wires=wired(back=" * -1"), controller__other_model=True).components


def test_a_plant_of_others_is_judged_by_its_answers_whatever_its_states_are(exported):
    T = np.array([[1.0, 0.0, 0.0], [0.3, 2.0, 0.1], [0.0, -1.0, 3.0]])  # states of its own
    mixed, names = T @ A @ np.linalg.inv(T), [("encoder", "rad"), ("p", None), ("q", None)]

    def plant(A, B, C):
        starts = [f"{name}_0" for name, _ in names]
        return linear_fmu(
            exported / "foreign.fmu", [("command", "V")], names, A, B, C, x0=(0.4, 0.0, 0.0), starts=starts
        )

    plant(mixed, T @ B, np.eye(3))
    assert remarks(built(exported, "foreign.fmu")) == []
    plant(mixed - 0.7 * np.eye(3), T @ B, np.eye(3))
    (said,) = remarks(built(exported, "foreign.fmu"))
    assert said.startswith("the controller's model is not quite the plant's: encoder answers otherwise by ")
    plant(-mixed, T @ B, np.eye(3))
    with pytest.raises(
        UserError, match=f"{OTHER} system than this plant: in its model encoder answers .*; poles .* instead"
    ):
        built(exported, "foreign.fmu")


def test_what_cannot_be_answered_is_not_judged(exported, tmp_path, monkeypatch, repacked):
    wrong = wired(back=" * -1")
    hidden = linear_fmu(
        tmp_path / "hidden.fmu", [("command", "V")], [("encoder", "rad")], A, B, [[1, 0, 0]], x0=(0, 0, 0)
    )
    shutil.copy(exported / "spring_controller.fmu", tmp_path)
    said = "the controller's model could not be compared with the plant's, because "
    for wires in (wrong, wired()):
        system = built(tmp_path, hidden.name, wires=wires)
        hides = f"{said}hidden.fmu is for co-simulation only and does not show its states"
        assert notes(system, Scenario()) == [hides]
    monkeypatch.setattr(plant_as_wired, "LONGEST", -1.0)
    plant_as_wired.plant_at.cache_clear()
    (said,) = remarks(built(exported, wires=wired(back=" * -2")))
    assert said == "the controller's model could not be compared with the plant's, because it takes too long"
    monkeypatch.undo()
    plant_as_wired.plant_at.cache_clear()
    for change, problem in ((None, None), (lambda text: text.replace('"mu": ', '"mu": 9'), "mu must lie in")):
        changed = repacked(exported / "spring_controller.fmu", {"resources/design.json": change})
        shutil.copy(changed, tmp_path / "spring_controller.fmu")
        shutil.copy(exported / "spring_linear_plant.fmu", tmp_path)
        said = remarks(built(tmp_path, wires=wrong))
        assert (problem is None and said == []) or ("cannot be read, so that its model is not judged" in said[0])
        assert problem is None or problem in said[0]


@pytest.mark.parametrize("command", [("run", "--no-plot"), ("compare",), ("tune", "--a-min=1,0.5", "--b-max=1")])
def test_a_command_says_once_that_a_plant_hides_its_states(exported, tmp_path, command):
    shutil.copy(exported / "spring_controller.fmu", tmp_path)
    linear_fmu(tmp_path / "hidden.fmu", [("command", "V")], [("encoder", "rad")], A, B, [[1, 0, 0]], x0=(0.3, 0.0, 0.0))
    (tmp_path / "hidden.toml").write_text(
        'plant.fmu = "hidden.fmu"\ncontroller.fmu = "spring_controller.fmu"\nrun.duration = 2.0', encoding="utf-8"
    )
    name, *options = command
    done = ended(name, "hidden.toml", *options, "--fmus", ".", cwd=tmp_path)
    said = " ".join((done.stdout + done.stderr).split())
    assert done.returncode == 0, said
    assert said.count("hidden.fmu is for co-simulation only and does not show its states") == 1


def test_a_controller_fmu_carries_its_design_and_a_resource_has_a_plain_name(exported):
    for name in ("../design.json", "taken", ""):
        with pytest.raises(ValueError, match="a resource must have a plain name"):
            further_resources({name: b""}, ["taken"])
    with zipfile.ZipFile(exported / "spring_controller.fmu") as archive:
        found = json.loads(archive.read("resources/design.json"))
    assert found["system"]["states"] == ["angle [rad]", "rate [rad/s]", "torque [N.m]"]
