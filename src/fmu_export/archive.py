"""FMU and SSP files: reproducible zip archives whose GUID is a hash of what is in them."""

from __future__ import annotations

import hashlib
import importlib.metadata
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path

from .errors import UserError
from .files import replacing

ZIP_TIME = (1980, 1, 1, 0, 0, 0)
_HEAD = 4096


def content_guid(files: Mapping[str, bytes], description: bytes) -> str:
    """Return the GUID of an FMU with the `files` and, without a GUID, the model `description`."""
    digest = hashlib.sha256(description)
    for name in sorted(files):
        digest.update(name.encode() + b"\0" + hashlib.sha256(files[name]).digest())
    h = digest.hexdigest()
    return f"{{{h[:8]}-{h[8:12]}-{h[12:16]}-{h[16:20]}-{h[20:32]}}}"


def further_resources(resources: Mapping[str, bytes] | None, taken: Collection[str]) -> dict[str, bytes]:
    """Return the archive's entries for files of the folder `resources`; raise ValueError for a name that cannot be theirs.

    `taken` are the names that the FMU's own files have there.
    """
    for name in resources or {}:
        if not name.isprintable() or set(name) & set("/\\:") or name in ("", ".", "..", *taken):
            raise ValueError(f"a resource must have a plain name that the FMU has no other use for, found {name!r}")
    return {f"resources/{name}": content for name, content in (resources or {}).items()}


def write_zip(path: Path, files: Mapping[str, bytes], software: str) -> None:
    """Write a zip file with sorted entries and a fixed time, modelDescription.xml first, whole or not at all.

    Raises UserError where it cannot be written, or would replace a file that `software` did not make.
    """

    def check(path: Path, _: object) -> None:
        if path.is_file() and path.stat().st_size > 0 and not made_by(path, software):
            raise UserError(f"{path} was not written by {software} and stays; choose another name or move that file")

    with replacing(path, check) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files, key=lambda n: (n != "modelDescription.xml", n)):
            entry = zipfile.ZipInfo(name, ZIP_TIME)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, files[name])


def made_by(path: Path, software: str) -> bool:
    """Return whether the file `path` is an FMU or an SSP that names `software` near its description's beginning."""
    try:
        with zipfile.ZipFile(path) as archive:
            inside = [name for name in ("modelDescription.xml", "SystemStructure.ssd") if name in archive.namelist()]
            return any(software.encode() in archive.open(name).read(_HEAD) for name in inside)
    except (zipfile.BadZipFile, NotImplementedError, EOFError):
        return False


def license_of(distribution: str) -> bytes:
    """Return the licence text of an installed distribution."""
    for file in importlib.metadata.files(distribution) or []:
        if file.name == "LICENSE":
            return file.read_binary()
    raise FileNotFoundError(f"the licence of {distribution} is not installed")
