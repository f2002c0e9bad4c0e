"""Reading what users, their editors and other programs wrote: of bounded size, decoded, parsed, or a UserError.

Text is UTF-8 with or without the byte-order mark that editors on Windows put in front. Standard library only.
"""

from __future__ import annotations

import codecs
import json
import math
import os
import stat
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn

from .errors import UserError, shown

MOST_BYTES = 16 * 2**20
"""Size of the largest file that is taken for somebody's settings [byte]."""
MOST_LEVELS = 64
"""Nesting of lists and tables, at most."""
_MOST_DIGITS = 400

_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_bytes(path: Path, what: str, most: int = MOST_BYTES) -> bytes:
    """Return the bytes of a file; raise UserError, which calls the file `what`, for a missing or too large one."""
    content = first_bytes(path, what, most + 1)
    if len(content) > most:
        raise UserError(f"{what} file {path} must not be larger than {most >> 20} MiB")
    return content


def first_bytes(path: Path, what: str, count: int) -> bytes:
    """Return the first `count` bytes of a file, or all there are; raises as `read_bytes`."""
    try:
        with path.open("rb") as file:
            regular = os.fstat(file.fileno())
            size = regular.st_size + 1 if stat.S_ISREG(regular.st_mode) else MOST_BYTES + 1  # a pipe never ends
            return file.read(min(count, size))
    except FileNotFoundError:
        raise UserError(f"{what} file {path} does not exist") from None
    except OSError as error:
        raise UserError(f"{what} file {path} cannot be read: {error.strerror}") from None
    except ValueError:  # a NUL character
        raise UserError(f"{what} file {str(path)!r} cannot be: no file has such a name") from None


def read_text(path: Path, what: str, most: int = MOST_BYTES) -> str:
    """Return the text of a UTF-8 file, without its byte-order mark; raises as `read_bytes`, and for other encodings."""
    return decoded(read_bytes(path, what, most), path)


def read_json(path: Path, what: str, most: int = MOST_BYTES) -> Any:
    """Return the contents of a JSON file; raises as `read_text` and `parse_json`."""
    return parse_json(read_text(path, what, most), path)


def read_toml(path: Path, what: str, most: int = MOST_BYTES) -> dict[str, Any]:
    """Return the contents of a TOML file; raises as `read_text` and `parse_toml`."""
    return parse_toml(read_text(path, what, most), path)


def decoded(content: bytes, path: Path) -> str:
    """Return bytes read from `path` as text; raise UserError where they are not UTF-8."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        hint = ", it looks like UTF-16" if content.startswith(_UTF_16) else ""
        raise UserError(f"{path} must be text in UTF-8, found another byte at {error.start}{hint}") from None


def parse_toml(text: str, source: object) -> dict[str, Any]:
    """Return the contents of TOML text; raise UserError that names `source`."""
    try:
        data = tomllib.loads(text)
    except RecursionError:
        _too_deep(source)
    except ValueError as error:  # TOMLDecodeError, and what int() refuses
        raise UserError(f"{source} is not TOML: {error}") from None
    _check_levels(data, source)
    return data


def parse_json(text: str, source: object, *, finite: bool = True) -> Any:
    """Return the contents of JSON text as the standard has it, every key once; raise UserError.

    Numbers must be finite, as the standard has it, unless `finite` is false.
    """

    def number(digits: str) -> int:
        if len(digits) > _MOST_DIGITS:
            raise UserError(f"{source} must have numbers of a moderate size, found one of {len(digits)} digits")
        return int(digits)

    def real(digits: str) -> float:
        value = float(digits)
        if finite and not math.isfinite(value):
            raise UserError(f"{source} must have finite numbers, found {digits[:40]}")
        return value

    def constant(name: str) -> float:
        if not finite:
            return float(name)
        raise UserError(f"{source} must have finite numbers, found {name}")

    def table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        entries = dict(pairs)
        if len(entries) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise UserError(f"{source} must have every key once, found {shown(twice)} twice")
        return entries

    try:
        data = json.loads(text, parse_int=number, parse_float=real, parse_constant=constant, object_pairs_hook=table)
    except RecursionError:
        _too_deep(source)
    except json.JSONDecodeError as error:
        raise UserError(f"{source} is not JSON: {error}") from None
    _check_levels(data, source)
    return data


def _check_levels(data: Any, source: object) -> None:
    level: list[Any] = [data]
    for _ in range(MOST_LEVELS):
        level = [child for value in level for child in _children(value)]
        if not level:
            return
    _too_deep(source)


def _children(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


def _too_deep(source: object) -> NoReturn:
    raise UserError(f"{source} must not be nested deeper than {MOST_LEVELS} levels") from None
