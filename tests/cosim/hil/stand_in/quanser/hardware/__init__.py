"""What a driver imports."""

from .enumerations import Clock, DigitalState, IntegerProperty, StringProperty
from .exceptions import HILError
from .types import MAX_STRING_LENGTH, Version

from .hil import HIL  # isort: skip  # as in the real package it loads the library, after the names above exist

__all__ = [
    "HIL",
    "MAX_STRING_LENGTH",
    "Clock",
    "DigitalState",
    "HILError",
    "IntegerProperty",
    "StringProperty",
    "Version",
]
