"""Unpacking zip archives made by others: estimated first, and only into the folder that they are given."""

from __future__ import annotations

import lzma
import os
import shutil
import stat
import struct
import tempfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from weakref import WeakSet, finalize

from fmu_export.errors import UserError, shown

MOST_ENTRIES = 10_000
MOST_BYTES = 2**30
"""What an archive may unpack to [byte]."""
MOST_RATIO = 200
"""How many times larger than the archive that may be, beyond SMALL; code shrinks to a tenth, zeros to a thousandth."""
SMALL = 64 * 2**20

_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    NotImplementedError,  # a way to compress that is not there
    RuntimeError,  # a password
)


_unpacked: WeakSet[UnpackedArchive] = WeakSet()


class UnpackedArchive:
    """A temporary `folder` with what a zip file holds, removed with this object and at the latest when the process ends.

    Raises UserError as `unpack`.
    """

    def __init__(self, path: Path) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="qube-ihc-"))
        self.remove = finalize(self, _remove, self.folder, os.getpid())
        try:
            unpack(path, self.folder)
        except BaseException:
            self.remove()
            raise
        _unpacked.add(self)


def _remove(folder: Path, owner: int) -> None:
    if os.getpid() == owner:  # not a process that was forked
        shutil.rmtree(folder, ignore_errors=True)


def remove_unpacked() -> None:
    """Remove the folders of all unpacked archives: for a process that ends without leaving in the usual way."""
    for archive in list(_unpacked):
        archive.remove()


def unpack(path: Path, folder: Path) -> None:
    """Unpack the zip file `path` into `folder`.

    Raises UserError for what is no zip file, unpacks to too much, has entries that lead out of the folder, links or the
    same entry twice, or is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            _check_size(path, entries, folder)
            _check_entries(path, entries)
            archive.extractall(folder)
    except OSError as error:
        raise UserError(f"{path} cannot be unpacked into {folder}: {error.strerror or error}") from None
    except _DAMAGED as error:
        raise UserError(f"{path} is damaged, or no zip file of a usual kind: {error}") from None


def _check_size(path: Path, entries: list[zipfile.ZipInfo], folder: Path) -> None:
    if len(entries) > MOST_ENTRIES:
        raise UserError(f"{path} must have at most {MOST_ENTRIES} entries, found {len(entries)}")
    packed, size = path.stat().st_size, sum(entry.file_size for entry in entries)
    free = shutil.disk_usage(folder).free
    if size > MOST_BYTES or size > max(SMALL, MOST_RATIO * packed):
        raise UserError(
            f"{path} must not unpack to more than {MOST_BYTES >> 20} MiB or {MOST_RATIO} times its size, found "
            f"{size >> 20} MiB in {packed / 2**20:.1f} MiB"
        )
    if size > free:
        raise UserError(f"{path} unpacks to {size >> 20} MiB, and {folder} has {free >> 20} MiB left")


def _check_entries(path: Path, entries: list[zipfile.ZipInfo]) -> None:
    seen: set[str] = set()
    for entry in entries:
        name = entry.filename
        parts = PurePosixPath(name).parts
        if not parts or name.startswith("/") or ".." in parts or not name.isprintable() or set(name) & set("\\:"):
            raise UserError(f"{path} must have entries inside its folder, found {shown(entry.filename)}")
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise UserError(f"{path} must not have links, found {shown(name)}")
        place = "/".join(parts).casefold()
        if place in seen:
            raise UserError(f"{path} must have every entry once, found {shown(name)} twice")
        seen.add(place)
