"""The one way in which files are written: whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from .errors import UserError
from .ownership import check_replaceable


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Give a temporary file beside `path` that becomes `path` where the block ends well, and vanishes where it does not.

    It is on the disk before it gets its name, so that neither a crash nor a full disk leaves half a file, and an earlier
    file of that name stays until then. Folders on the way are made. Raises UserError that names `path` where it cannot be
    written, or is a file that this project did not write.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise UserError(f"{path} cannot be written: it is a folder")
        check_replaceable(path)
        beside = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}.tmp")
        try:
            with beside.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror or error}") from error


def write_file(path: Path, content: str | bytes | Iterable[bytes]) -> None:
    """Write text (UTF-8), bytes, or pieces of bytes to `path`, whole or not at all; raises as `replacing` does."""
    with replacing(path) as file:
        if isinstance(content, str):
            file.write(content.encode("utf-8"))
        elif isinstance(content, bytes):
            file.write(content)
        else:
            file.writelines(content)
