"""A file that this project did not write is never replaced."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from cosim import parameter_files
from cosim.plots import save_figure
from cosim.results import Result
from cosim.scenario import Scenario
from filing.files import staging, write_file
from filing.origin import origin
from filing.ownership import check_replaceable, is_ours
from fmu_export.errors import UserError
from fmu_export.native_fmu import export_native_fmu
from fmu_export.ssp import write_ssp
from plant_fmu.native_unit import NATIVE
from plant_fmu.parameters import PARAMETER_SETS


def _zip(path: Path, **files: str) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name.replace("__", "."), text)


def _result(path: Path) -> None:
    Result(np.zeros(1), {"tiny.y": np.zeros(1)}, {"tiny.y": "1"}).save(path)


OURS = {
    "result.csv": _result,
    "result.json": lambda path: _result(path.with_suffix(".csv")),
    "picture.png": lambda path: save_figure(Figure(), path, ""),
    "set.toml": lambda path: parameter_files.save(path, PARAMETER_SETS["ident"]),
    "scenario.toml": lambda path: write_file(path, Scenario().to_toml()),
    "comparison.csv": lambda path: write_file(path, "law,seed,settling_time\n"),
    "torn.csv": lambda path: write_file(path, "time,controller.voltage,plant.theta\n"),
    "empty.json": lambda path: path.touch(),
    "library.so": lambda path: path.write_bytes(b"of no kind that is written for users"),
}
FOREIGN = {
    "cartpole.json": lambda path: path.write_text('{"A": [[0, 1], [0, 0]]}', encoding="utf-8"),
    "list.json": lambda path: path.write_text("[1, 2]", encoding="utf-8"),
    "broken.json": lambda path: path.write_text('{"format": "qube-ihc', encoding="utf-8"),
    "measured.csv": lambda path: path.write_text("time,speed\n0,1\n", encoding="utf-8"),
    "other_tool.csv": lambda path: path.write_text("time,root.plant.theta\n", encoding="utf-8"),
    "photo.png": lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n, of the qube-ihc set-up"),
    "QubeServo2.fmu": lambda path: _zip(path, modelDescription__xml='<fmiModelDescription generationTool="Dymola"/>'),
    "no_zip.fmu": lambda path: path.write_bytes(b"qube-ihc"),
    "mine.toml": lambda path: path.write_text("# for qube-ihc run\n", encoding="utf-8"),
    "notes.md": lambda path: path.write_text("qube-ihc is fine", encoding="utf-8"),
}


@pytest.mark.parametrize("name", OURS)
def test_what_was_written_before_is_replaced(tmp_path, name):
    OURS[name](tmp_path / name)
    check_replaceable(tmp_path / name, tmp_path / "missing.json")
    write_file(tmp_path / name, "new")
    assert (tmp_path / name).read_bytes() == b"new"


@pytest.mark.parametrize(
    ("path", "why"), [("taken", "it is a folder"), ("file/new.csv", "{}/file is a file, not a folder")]
)
def test_what_cannot_be_a_file_is_told_before_anything_is_written(tmp_path, path, why):
    (tmp_path / "taken").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(UserError) as refusal:
        check_replaceable(tmp_path / path)
    assert str(refusal.value) == f"{tmp_path / path} cannot be written: {why.format(tmp_path)}"


@pytest.mark.parametrize("name", FOREIGN)
def test_the_file_of_somebody_else_stays(tmp_path, name):
    path = tmp_path / name
    FOREIGN[name](path)
    before = path.read_bytes()
    with pytest.raises(UserError) as refusal:
        write_file(path, "new")
    assert str(refusal.value) == f"{path} was not written by qube-ihc and stays; choose another name or move that file"
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["plant.fmu", "old.fmu", "pair.ssp"])
def test_exported_files_are_known(tmp_path, name):
    """Those of earlier versions too, which said so in the same words."""
    old = '<fmiModelDescription author="The qube-ihc developers" generationTool="qube-ihc 0.0.1"/>'
    files = {
        "plant.fmu": lambda path: export_native_fmu(NATIVE, path, platforms=[], origin=origin()),
        "old.fmu": lambda path: _zip(path, modelDescription__xml=old),
        "pair.ssp": lambda path: write_ssp(
            path, "Pair", {"plant": files["plant.fmu"](tmp_path / "a.fmu")}, [], origin()
        ),
    }
    files[name](tmp_path / name)
    assert is_ours(tmp_path / name)


def test_a_file_of_another_kind_stays_too(tmp_path):
    path = tmp_path / "mine.json"
    design, result = '{"format": "qube-ihc design 1"}', '{"format": "qube-ihc result 2"}'
    for kind, before, after in (("result", design, result), ("design", result, design)):
        path.unlink(missing_ok=True)
        write_file(path, before)
        with pytest.raises(
            UserError, match=f"mine.json is a {'design' if kind == 'result' else 'result'}, not a {kind}"
        ):
            check_replaceable(path, kind=kind)
        with pytest.raises(UserError, match="and stays"), staging(tmp_path) as place:
            write_file(place / path.name, after)
        with pytest.raises(UserError, match="and stays"):
            write_file(path, after)
        assert path.read_text(encoding="utf-8") == before
        write_file(path, before.replace("1", "3"))  # another version of its kind


def test_a_table_is_not_ours_for_a_design_beside_it(tmp_path):
    (tmp_path / "mine.json").write_text('{"format": "qube-ihc design 1"}', encoding="utf-8")
    (tmp_path / "mine.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(UserError, match=r"mine\.csv was not written"):
        check_replaceable(tmp_path / "mine.csv", kind="result")


def test_a_name_that_no_file_can_have_is_refused(tmp_path):
    with pytest.raises(UserError, match="cannot be written: File name too long"):
        check_replaceable(tmp_path / ("a" * 300 + ".csv"))
