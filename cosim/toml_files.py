"""Reading TOML files that users write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fmu_export.reading import parse_toml, read_text


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Return the contents of a TOML file; raise UserError in one sentence, which calls the file `what`."""
    return parse_toml(read_text(path, what), path)
