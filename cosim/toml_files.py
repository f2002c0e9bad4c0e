"""Reading TOML files that users write."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from .errors import UserError


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Return the contents of a TOML file; raise UserError in one sentence, which calls the file `what`."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"{what} file {path} does not exist") from None
    except OSError as error:
        raise UserError(f"{what} file {path} cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is not TOML: {error}") from None
