"""Constants and small records."""

from typing import NamedTuple

MAX_STRING_LENGTH = 2147483647


class Version(NamedTuple):
    """The version of the SDK."""

    size: int
    major: int
    minor: int
    release: int
    build: int
