"""The error that is the user's to mend. Light to import: the command line knows it before it knows what it will do."""

from __future__ import annotations

from fmu_export.errors import UserError

__all__ = ["UserError"]
