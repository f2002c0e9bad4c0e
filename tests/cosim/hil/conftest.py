"""The stand-in for the vendor's package `quanser`, fresh for each test."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

STAND_IN = Path(__file__).parent / "stand_in"


def _forget():
    for name in [n for n in sys.modules if n.partition(".")[0] == "quanser"]:
        del sys.modules[name]


@pytest.fixture
def stand_in(monkeypatch):
    """The module `quanser.stand_in` with the default configuration; `quanser` can be imported until the test ends."""
    _forget()
    monkeypatch.delenv("QUBE_STAND_IN", raising=False)
    monkeypatch.syspath_prepend(STAND_IN)
    module = importlib.import_module("quanser.stand_in")
    yield module
    module.configure()
    _forget()
