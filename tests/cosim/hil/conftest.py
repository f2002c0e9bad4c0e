"""The stand-in for the vendor's package `quanser`, fresh for each test; simulated devices that are served over UDP."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from cosim.hil import loop as loop_module
from tests.cosim.command import ended
from tests.cosim.hil import rig

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


@pytest.fixture
def serve(fmus):
    """Serve boards; when the test is over each must be at 0 V and no server may have failed."""
    served = []

    def make(faults="", **changes):
        served.append(rig.Served(rig.board_of(fmus, faults, **changes)))
        return served[-1]

    yield make
    for one in served:
        one.stop()
    for one in served:
        if one.error is not None:
            raise one.error
        if one.board.record:
            rig.at_rest(one.board)


@pytest.fixture
def hil(tmp_path, fmus):
    """Run `hil` in a temporary folder, with the log in `out`."""
    return lambda *args: ended("hil", "--fmus", fmus, "-o", "out", *args, cwd=tmp_path)


@pytest.fixture(scope="session")
def logged(tmp_path_factory, fmus):
    """The log of a run of 3 s in lockstep, not to be changed."""
    folder = tmp_path_factory.mktemp("logged")
    done = ended("hil", "--fmus", fmus, "--lockstep", "--duration", "3", "-o", folder, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "run.csv"


@pytest.fixture
def patient(monkeypatch):
    """A loop that waits longer for a sample: this machine may be busy, and relays lose packets."""
    monkeypatch.setattr(loop_module, "READ_TIMEOUT", 3.0)
