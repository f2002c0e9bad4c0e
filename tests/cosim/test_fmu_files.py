"""FMUs as files: what is refused, unpacked once and again, and how what is unpacked and loaded ends."""

import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import pytest

import cosim
import ihc_fmu
from cosim.errors import UserError
from cosim.fmu import Instance
from cosim.fmu_files import KEPT, describe, unpacked
from cosim.scenario import load_scenario
from fmu_export.python_fmu import export_python_fmu

FMI_3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="M" instantiationToken="t">
  <CoSimulation modelIdentifier="M"/>
  <ModelVariables><Float64 name="time" valueReference="0" causality="independent" variability="continuous"/></ModelVariables>
  <ModelStructure/>
</fmiModelDescription>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The SSP file of a small system."""
    system = ihc_fmu.System(A=[[0, 1], [4, 0]], B=[[0], [1]], K=[[-8, -4]], name="arm", sample_time=1e-3)
    return cosim.export(ihc_fmu.synthesize(system), tmp_path_factory.mktemp("arm"))[2]


def a_zip(path, **files):
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return path


def test_a_missing_fmu_is_named_and_one_of_the_projects_with_the_command_that_makes_it(tmp_path):
    with pytest.raises(UserError, match=r"nowhere\.fmu does not exist$"):
        describe(tmp_path / "nowhere.fmu")
    with pytest.raises(UserError, match=r"QubeServo2\.fmu does not exist; `qube-ihc export` makes the project's FMUs$"):
        describe(tmp_path / "QubeServo2.fmu")


def test_what_is_no_fmu_is_refused_by_its_name(tmp_path):
    (tmp_path / "text.fmu").write_text("no zip", encoding="utf-8")
    with pytest.raises(UserError, match=r"text\.fmu is not an FMU: it is not a zip file"):
        describe(tmp_path / "text.fmu")
    with pytest.raises(UserError, match=r"bare\.fmu is not a valid FMU: .*modelDescription"):
        describe(a_zip(tmp_path / "bare.fmu", readme="nothing else"))
    with pytest.raises(UserError, match=r"broken\.fmu is not a valid FMU: "):
        describe(a_zip(tmp_path / "broken.fmu", **{"modelDescription.xml": "<fmiModelDescription"}))
    with pytest.raises(UserError, match="is not an FMU"):
        describe(tmp_path)


def test_another_version_of_fmi_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"third\.fmu must be an FMI 2\.0 FMU, found FMI 3\.0"):
        describe(a_zip(tmp_path / "third.fmu", **{"modelDescription.xml": FMI_3}))


def test_an_fmu_is_unpacked_once_until_its_file_changes(tmp_path, tiny_slave):
    path = export_python_fmu(tiny_slave, tmp_path / "Tiny.fmu", {"gain": 2.0})
    first = unpacked(path)
    assert unpacked(path.parent / "." / "Tiny.fmu") is first
    export_python_fmu(tiny_slave, path, {"gain": 3.0})
    assert unpacked(path).folder != first.folder
    assert unpacked(path).start_values["gain"] == 3.0


def test_an_fmu_whose_folder_was_tidied_away_is_unpacked_again(tmp_path, tiny_slave):
    path = export_python_fmu(tiny_slave, tmp_path / "Tiny.fmu")
    shutil.rmtree(unpacked(path).folder)
    assert (unpacked(path).folder / "resources").is_dir()


def test_folders_with_spaces_hold_fmus_and_unpacked_ones(tmp_path, monkeypatch, tiny_slave):
    roomy = tmp_path / "a folder" / "with two  spaces"
    roomy.mkdir(parents=True)
    monkeypatch.setattr(tempfile, "tempdir", str(roomy))
    path = export_python_fmu(tiny_slave, roomy / "T i n y.fmu")
    instance = Instance("a", path)
    instance.start({}, 0.0, 1.0)
    instance.run()
    instance.stepper()(0.0, 0.1)
    instance.close()
    assert unpacked(path).folder.parent == roomy


def loaded():
    """The libraries of unpacked FMUs that this process has loaded, and the folders of unpacked archives."""
    maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    libraries = set(re.findall(rf"{tempfile.gettempdir()}/qube-ihc-\S+\.so", maps))
    return libraries, set(Path(tempfile.gettempdir()).glob("qube-ihc-*"))


def test_what_is_unpacked_and_loaded_ends_when_enough_others_have_been(tmp_path, arm, monkeypatch):
    own = tmp_path / "temporary"  # other processes use the usual one
    own.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(own))
    for k in range(KEPT + 5):
        (tmp_path / str(k)).mkdir()
        again = shutil.copy(arm, tmp_path / str(k) / "arm.ssp")
        cosim.run(again, {"run.duration": 0.01, "plant.start.x1_0": 0.1})
    libraries, folders = loaded()
    assert 0 < len(libraries) <= KEPT
    assert 0 < len(folders) <= KEPT + 16  # and those of the SSP files


def test_an_fmu_in_use_stays(tmp_path, arm):
    _, folder = load_scenario(arm)
    instance = Instance("plant", folder / "arm_linear_plant.fmu")
    instance.start({}, 0.0, 1.0)
    for k in range(KEPT):
        unpacked(shutil.copy(folder / "arm_linear_plant.fmu", tmp_path / f"{k}.fmu"))
    place = unpacked(tmp_path / "0.fmu").folder
    assert instance._unpacked.folder.is_dir()
    instance.run()
    instance.stepper()(0.0, 0.1)
    instance.close()
    gone = instance._unpacked.folder
    del instance
    assert place.is_dir()
    assert not gone.exists()


def test_a_python_fmu_stays_where_python_has_its_modules_from(tmp_path, tiny_fmu):
    instance = Instance("a", tiny_fmu)
    instance.start({}, 0.0, 1.0)
    instance.close()
    place = instance._unpacked.folder
    del instance
    for k in range(KEPT):
        unpacked(shutil.copy(tiny_fmu, tmp_path / f"{k}.fmu"))
    assert place.is_dir()


def test_all_folders_can_be_removed_at_once(tiny_fmu):
    code = f"""
import os
from cosim.archives import remove_unpacked
from cosim.fmu_files import unpacked
place = unpacked({str(tiny_fmu)!r}).folder
assert place.is_dir()
remove_unpacked()
assert not place.exists()
os._exit(0)
"""
    subprocess.run([sys.executable, "-c", code], check=True)
