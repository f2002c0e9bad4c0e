"""A user's mistake, told apart from a bug.

Standard library only: this module travels inside the Python FMUs.
"""

from __future__ import annotations


class UserError(ValueError):
    """A file, name, number or combination that cannot work: one sentence with the thing, the rule and the value found."""
