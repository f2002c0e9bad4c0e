"""Files are written whole or not at all."""

import io
import os
from pathlib import Path
from unittest import mock

import pytest

from fmu_export.errors import UserError
from fmu_export.files import any_file, replacing, write_file


@pytest.mark.parametrize(("owner", "stage"), [(os, "fsync"), (Path, "replace")])
@pytest.mark.parametrize("stop", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_write_that_stops_leaves_the_earlier_file_and_no_other(tmp_path, monkeypatch, owner, stage, stop):
    path = tmp_path / "kept.txt"
    write_file(path, "earlier", any_file)

    def halfway(*_):
        raise stop

    monkeypatch.setattr(owner, stage, halfway)
    with pytest.raises(UserError if isinstance(stop, OSError) else KeyboardInterrupt) as raised:
        write_file(path, "later", any_file)
    if isinstance(stop, OSError):
        assert str(raised.value) == f"{path} cannot be written: No space left on device"
    assert [file.name for file in tmp_path.iterdir()] == ["kept.txt"]
    assert path.read_text(encoding="utf-8") == "earlier"


def test_a_block_that_fails_leaves_the_earlier_file(tmp_path):
    path = tmp_path / "kept.txt"
    write_file(path, "earlier", any_file)
    with pytest.raises(TypeError), replacing(path, any_file) as file:
        file.writelines([b"la", "ter"])  # type: ignore[list-item]
    assert [file.name for file in tmp_path.iterdir()] == ["kept.txt"]
    assert path.read_bytes() == b"earlier"


def test_a_full_disk_is_named_also_where_closing_finds_it(tmp_path):
    """What is written is small enough to wait in the file's buffer: the disk refuses it when it is flushed, and again."""

    class Full(io.BufferedWriter):
        def flush(self):
            raise OSError(28, "No space left on device")

    path = tmp_path / "new.txt"
    full = mock.patch.object(Path, "open", lambda self, *_: Full(io.FileIO(self, "x")))
    with full, pytest.raises(UserError, match=r"new\.txt cannot be written: No space left on device"):
        write_file(path, "text", any_file)
    assert list(tmp_path.iterdir()) == []


def test_folders_are_made_and_text_bytes_and_pieces_taken(tmp_path):
    for content in ("µ", "µ".encode(), iter([b"\xc2", b"\xb5"])):
        write_file(tmp_path / "new" / "folder" / "file", content, any_file)
        assert (tmp_path / "new" / "folder" / "file").read_bytes() == "µ".encode()


@pytest.mark.parametrize("where", ["folder", "file/below"])
def test_a_place_that_cannot_be_written_is_named(tmp_path, where):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    path = tmp_path / where
    with pytest.raises(UserError) as refusal:
        write_file(path, "text", any_file)
    assert str(path) in str(refusal.value)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["file", "folder"]


def test_new_files_have_the_usual_permissions(tmp_path):
    write_file(tmp_path / "ours", "", any_file)
    (tmp_path / "usual").touch()
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "usual").stat().st_mode
