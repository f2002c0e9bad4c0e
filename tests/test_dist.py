"""The sdist and this machine's wheel: the same bytes again, what is in them, what they need, used without network.

What takes longer, the wheels of other machines among it, is tried by `make dist-check`.
"""

import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from fmu_export.native_build import BINARIES, host_platform
from hatch_build import TAGS
from make_dist import ROOT, build, unpacked
from tests.dist import UV, use

HOST = host_platform()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
COMPILED = {"src/fmu_export/binaries": BINARIES, "cosim/binaries": ROOT / "cosim" / "binaries"}
FEW = (
    "design --mu 0.5 --alpha 0.3 -o my.json",
    "export --design my.json",
    "run tilt --set run.duration=0.1",
    "new balance",
)


def test_the_version_is_one():
    version = PROJECT["project"]["version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    (date,) = re.findall(r'^date-released: "(.+)"$', citation, re.MULTILINE)
    assert re.findall(r"^version: (.+)$", citation, re.MULTILINE) == [version]
    assert f"\n## {version} ({date})\n" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def make_wheel(sdist, folder):
    """The wheel of this machine, with the binaries that the installation has compiled already."""
    with unpacked(sdist) as source:
        for place, binaries in COMPILED.items():
            shutil.copytree(binaries / HOST.name, source / place / HOST.name)
            shutil.copytree(binaries / HOST.name, source / place / "another")
        return build(source, "wheel", folder, HOST.name)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Sdist and wheel."""
    folder = tmp_path_factory.mktemp("dist")
    sdist = build(ROOT, "sdist", folder)
    return sdist, make_wheel(sdist, folder)


def contents(path):
    """The files' texts by their names; an sdist's without its first folder."""
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    with tarfile.open(path) as archive:
        files = {member.name.partition("/")[2]: archive.extractfile(member) for member in archive}
        return {name: file.read() for name, file in files.items() if file is not None}


def test_made_again_they_are_the_same(made, tmp_path, monkeypatch):
    sdist, wheel = made
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))  # a folder of another name
    again = build(ROOT, "sdist", tmp_path)
    assert again.read_bytes() == sdist.read_bytes()
    assert make_wheel(again, tmp_path).read_bytes() == wheel.read_bytes()


def test_times_are_those_of_source_date_epoch(made, tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    with tarfile.open(build(ROOT, "sdist", tmp_path)) as archive:
        assert {member.mtime for member in archive} == {1700000000}
    with tarfile.open(made[0]) as archive:
        assert 1700000000 not in {member.mtime for member in archive}


def test_wheel_holds_the_binaries_of_its_platform_only(made):
    _, wheel = made
    assert wheel.name == f"qube_ihc-{PROJECT['project']['version']}-py3-none-{TAGS[HOST.name]}.whl"
    in_wheel = {name: text for name, text in contents(wheel).items() if "/binaries/" in name}
    assert {Path(name).parent.name for name in in_wheel} == {HOST.name}
    expected = {
        f"{place.removeprefix('src/')}/{HOST.name}/{file.name}": file.read_bytes()
        for place, binaries in COMPILED.items()
        for file in (binaries / HOST.name).iterdir()
    }
    assert in_wheel == expected
    assert sum(name.endswith(HOST.suffix) for name in in_wheel) == 5


def test_sdist_holds_what_tests_and_documentation_need_and_nothing_compiled(made):
    names = contents(made[0]).keys()
    assert names >= {"README.md", "Makefile", "make_dist.py", "tests/test_dist.py", "docs/fmus.md", ".ci/run"}
    assert not [name for name in names if Path(name).suffix in (".so", ".dll", ".dylib", ".pyc", ".fmu", ".sha256")]


@pytest.mark.parametrize("index", [0, 1], ids=["sdist", "wheel"])
def test_licences_are_there(made, index):
    files = contents(made[index])
    (metadata,) = [text.decode() for name, text in files.items() if name.endswith(("PKG-INFO", "METADATA"))]
    assert "License-Expression: MIT AND BSD-2-Clause AND ZPL-2.1\n" in metadata
    inside = "" if index == 0 else f"qube_ihc-{PROJECT['project']['version']}.dist-info/licenses/"
    for name in PROJECT["project"]["license-files"]:
        assert f"License-File: {name}\n" in metadata
        assert files[inside + name] == (ROOT / name).read_bytes()


def test_licences_of_what_the_compiler_adds_are_those_of_this_compiler():
    import ziglang

    compiler, texts = Path(ziglang.__file__).parent, ROOT / "src" / "fmu_export" / "licenses"
    assert (texts / "Zig.txt").read_bytes() == (compiler / "LICENSE").read_bytes()
    assert (texts / "mingw-w64.txt").read_bytes() == (compiler / "lib" / "libc" / "mingw" / "COPYING").read_bytes()


def test_every_package_says_that_it_has_types(made):
    files = contents(made[1])
    packages = {name.partition("/")[0] for name in files if name.endswith("/__init__.py")}
    assert packages == {Path(path).name for path in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]}
    assert all(f"{package}/py.typed" in files for package in packages)


def test_zig_has_one_version():
    extras = PROJECT["project"]["optional-dependencies"]
    named = [line for lines in (PROJECT["build-system"]["requires"], *extras.values()) for line in lines]
    assert len({line for line in named if "zig" in line}) == 1


def test_a_platform_that_is_none_is_refused(made, tmp_path):
    with unpacked(made[0]) as source, pytest.raises(SystemExit, match=r"must be one of linux64, .* found amiga"):
        build(source, "wheel", tmp_path, "amiga")


@pytest.mark.skipif(sys.platform != "linux", reason="auditwheel looks at wheels for Linux")
def test_wheel_needs_the_glibc_that_its_name_says(made):
    command = [sys.executable, "-m", "auditwheel", "show", made[1]]
    said = " ".join(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
    assert f'consistent with the following platform tag: "{TAGS[HOST.name]}"' in said
    assert "libc.so.6 with versions" in said


def test_wheel_works_without_network_and_compiler(made, tmp_path):
    environment, work = tmp_path / "venv", tmp_path / "work"
    work.mkdir()
    quiet = ("--quiet", "--no-config", "--offline")
    subprocess.run([UV, "venv", *quiet, "--python", sys.executable, environment], check=True)
    install = [UV, "pip", "install", *quiet, "--python", environment, made[1]]
    done = subprocess.run(install, capture_output=True, text=True, check=False)
    if done.returncode != 0 and "network was disabled" in done.stderr:
        pytest.skip("the wheel was not installed: uv's cache lacks what it needs; make dist-check downloads that")
    assert done.returncode == 0, done.stderr
    use(environment, work, FEW)
    assert (work / "balance" / "balance.py").is_file()
