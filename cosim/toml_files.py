"""Reading TOML files that users write."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from fmu_export.files import read_text

from .errors import UserError


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Return the contents of a TOML file; raise UserError in one sentence, which calls the file `what`."""
    text = read_text(path, what)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path} is not TOML: {error}") from None
    except (ValueError, RecursionError):  # numbers of thousands of digits, lists nested as deeply
        raise UserError(f"{path} is TOML beyond reason: a number is too long or the nesting too deep") from None
