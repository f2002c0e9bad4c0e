"""Errors that are the user's to mend: one sentence that names the thing, the rule and the value found."""

from __future__ import annotations


class UserError(ValueError):
    """A file, name, number or combination that cannot work."""
