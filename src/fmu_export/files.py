"""The one way in which files are written: whole or not at all, and only over files that a check lets go.

The check is told the path and, where it is text or bytes at hand, the new content; it raises UserError where a file that
is there must stay.
"""

from __future__ import annotations

import filecmp
import os
import secrets
import shutil
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from .errors import UserError

Content = str | bytes | Iterable[bytes]
"""Text (UTF-8), bytes, or pieces of bytes."""

FilePath = str | os.PathLike[str]
"""A path as callers may give it."""

Check = Callable[[Path, str | bytes | None], None]


def any_file(_path: Path, _content: str | bytes | None) -> None:
    """Let every file be replaced."""


@contextmanager
def replacing(path: Path, check: Check) -> Iterator[IO[bytes]]:
    """Give a temporary file beside `path` that becomes `path` where the block ends well, and vanishes where it does not.

    It is on the disk before it gets its name, so that neither a crash nor a full disk leaves half a file, and an earlier
    file of that name stays until then. Folders on the way are made. Raises UserError that names `path` where it cannot be
    written, and what `check` raises.
    """
    with _beside(path, None, check) as (file, beside), _named(path):
        yield file
        _finish(file)
        beside.replace(path)


def write_file(path: Path, content: Content, check: Check) -> None:
    """Write `content` to `path`, whole or not at all; raises as `replacing` does."""
    write_files({path: content}, check)


def write_files(contents: Mapping[Path, Content], check: Check) -> None:
    """Write files of one folder that belong together: all are on the disk before the first gets its name.

    They get their names in the order given, undisturbed by Ctrl-C and by another process that writes there in the same
    way; of a file that describes the others the place is last. Raises as `replacing` does, and then all earlier files are
    as they were.
    """
    with uninterrupted(), ExitStack() as stack:
        staged = {path: stack.enter_context(_beside(path, content, check)) for path, content in contents.items()}
        for path, content in contents.items():
            with _named(path):
                file = staged[path][0]
                file.writelines(_pieces(content))
                _finish(file)
        for folder in {path.parent for path in contents}:
            stack.enter_context(_alone_in(folder))
        for path, (_, beside) in staged.items():
            with _named(path):
                beside.replace(path)


@contextmanager
def staging(folder: Path, check: Check, last: str | None = None) -> Iterator[Path]:
    """Give a hidden folder for files that belong together; where the block ends well they all go to `folder`.

    Files of the same names are replaced, others stay. The file `last`, which describes the others, comes last; otherwise
    the order is that of the names. Where the block does not end well `folder` is as it was. Raises as `replacing` does.
    """
    with _named(folder):
        made = [place for place in (folder, *folder.parents) if not place.exists()]
    place = folder / f".{secrets.token_hex(6)}.tmp"
    try:
        with _named(folder):
            place.mkdir(parents=True)
        try:
            yield place
        except UserError as error:
            raise UserError(str(error).replace(str(place), str(folder))) from error.__cause__
        names = sorted(path.relative_to(place) for path in place.rglob("*") if path.is_file())
        with _named(folder):
            for name in names:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
        names = [name for name in names if not _same(folder / name, place / name)]
        for name in names:
            check(folder / name, (place / name).read_bytes() if name.suffix == ".json" else None)
        with uninterrupted(), _alone_in(folder):
            for name in sorted(names, key=lambda name: str(name) == last):
                with _named(folder / name):
                    (place / name).replace(folder / name)
    finally:
        shutil.rmtree(place, ignore_errors=True)
        for empty in made:
            with suppress(OSError):  # not empty: the block ended well, or others wrote there meanwhile
                empty.rmdir()


def is_file(path: Path) -> bool:
    """Return whether `path` is a file; a name that cannot be one, such as one too long, is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Return whether `path` is a folder, as `is_file` does."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Put Ctrl-C off until the block has ended; in threads, which it does not reach, do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    earlier = signal.signal(signal.SIGINT, lambda number, _: received.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, earlier)
    if received:
        signal.raise_signal(signal.SIGINT)


def _same(path: Path, other: Path) -> bool:
    """Return whether a file has the content of another, so that nothing would be replaced."""
    return path.is_file() and filecmp.cmp(path, other, shallow=False)


@contextmanager
def _beside(path: Path, content: Content | None, check: Check) -> Iterator[tuple[IO[bytes], Path]]:
    """Give a new file beside `path` and its path; it is closed and, where it still has that name, removed at the end."""
    with _named(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        check(path, content if isinstance(content, str | bytes) else None)
        beside = path.with_name(f".{path.name[:50]}.{secrets.token_hex(4)}.tmp")
        file = beside.open("xb")
    try:
        yield file, beside
    finally:
        with suppress(OSError):  # closed already where all went well; a full disk fails here once more
            file.close()
        with _named(path):
            beside.unlink(missing_ok=True)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Turn an operating system's error into one that names the user's file."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror or error}") from error


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Wait until no other process renames files into `folder` in this block, where the system has locks on folders."""
    try:
        import fcntl  # noqa: PLC0415

        descriptor = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield
        return
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _pieces(content: Content) -> Iterable[bytes]:
    if isinstance(content, str):
        return [content.encode("utf-8")]
    return [content] if isinstance(content, bytes) else content


def _finish(file: IO[bytes]) -> None:
    """See the file to the disk and close it, as Windows wants it before it is renamed."""
    file.flush()
    os.fsync(file.fileno())
    file.close()
