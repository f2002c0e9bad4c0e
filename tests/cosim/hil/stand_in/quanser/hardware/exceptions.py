"""The exception of every HIL call."""

from ..common import GenericError


class HILError(GenericError):
    """A HIL call failed."""
