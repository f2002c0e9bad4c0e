"""What the files of this project say of where they come from."""

from __future__ import annotations

import importlib.metadata
from functools import cache

from fmu_export.archive import license_of
from fmu_export.origin import Origin

SOFTWARE = "qube-ihc"
"""What files of a kind with a place for the software's name have there."""

WRITTEN = f"written by {SOFTWARE}"
"""What text files have in a comment at their beginning."""


@cache
def origin() -> Origin:
    """Return what FMUs and SSPs say of this project, as it is installed."""
    version = importlib.metadata.version(SOFTWARE)
    return Origin(SOFTWARE, version, f"The {SOFTWARE} developers", "MIT", license_of(SOFTWARE))
