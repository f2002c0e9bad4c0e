"""What FMUs and SSPs say of those who made them."""

import zipfile
from xml.etree import ElementTree as ET

import pytest

from filing.origin import SOFTWARE, origin
from fmu_export.errors import UserError
from fmu_export.native_fmu import export_native_fmu
from fmu_export.origin import Origin
from fmu_export.ssp import write_ssp
from plant_fmu.native_unit import NATIVE

OTHER = Origin("Works", "2.1", "A. <Writer>", "BSD-3-Clause", b"do as you like")


def inside(path, name):
    with zipfile.ZipFile(path) as archive:
        return archive.read(name) if name in archive.namelist() else b""


def said(path):
    root = ET.fromstring(inside(path, "modelDescription.xml"))
    return [root.get(name) for name in ("generationTool", "version", "author", "license")]


@pytest.mark.parametrize("who", [origin(), OTHER], ids=lambda who: who.software)
def test_files_say_whose_they_are(who, tmp_path):
    path = export_native_fmu(NATIVE, tmp_path / "plant.fmu", platforms=[], origin=who)
    assert said(path) == [f"{who.software} {who.version}", who.version, who.author, who.license]
    assert inside(path, "documentation/licenses/license.txt").endswith(who.license_text)
    pair = write_ssp(tmp_path / "plant.ssp", "Pair", {"plant": path}, [], who)
    assert ET.fromstring(inside(pair, "SystemStructure.ssd")).get("generationTool") == who.software


def test_without_an_origin_they_say_nothing_of_it(tmp_path):
    path = export_native_fmu(NATIVE, tmp_path / "plant.fmu", platforms=[])
    assert said(path) == ["fmu_export", None, None, None]
    assert inside(path, "documentation/licenses/license.txt") == b""
    assert SOFTWARE.encode() not in inside(path, "modelDescription.xml")


def test_another_makers_file_stays(tmp_path):
    path = export_native_fmu(NATIVE, tmp_path / "plant.fmu", platforms=[], origin=OTHER)
    before = path.read_bytes()
    with pytest.raises(UserError, match=r"plant\.fmu was not written by qube-ihc and stays"):
        export_native_fmu(NATIVE, path, platforms=[], origin=origin())
    assert path.read_bytes() == before
    export_native_fmu(NATIVE, path, {"theta_0": 0.1}, platforms=[], origin=OTHER)
    assert path.read_bytes() != before
