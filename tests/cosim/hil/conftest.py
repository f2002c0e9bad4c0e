"""Devices on the stand-in for the vendor's package `quanser`, on simulated boards and over UDP, and runs on them."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from cosim.hil import loop as loop_module
from cosim.hil.device import LED_IDLE
from cosim.hil.loop import Loop
from cosim.hil.quanser import QuanserDevice
from tests.cosim.command import ended
from tests.cosim.hil import rig
from tests.cosim.hil.benches import Simulated, StandIn

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
    done = ended("hil", "--fmus", fmus, "--lockstep", "--duration", "3", "-o", folder, "--report", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "run.csv"


@pytest.fixture
def patient(monkeypatch):
    """A loop that waits longer for a sample: this machine may be busy, and relays lose packets."""
    monkeypatch.setattr(loop_module, "READ_TIMEOUT", 3.0)


@pytest.fixture
def quanser(stand_in):
    """Make a device on a board of the stand-in with the stepped clock and a configuration of its own; closed at the end."""
    devices = []

    def make(kind="qube", *, watchdog=True, identifier=None, **changes):
        stand_in.configure(clock="steps", **changes)
        device = QuanserDevice(kind, watchdog=watchdog, identifier=identifier)
        devices.append(device)
        return device

    yield make
    for device in devices:
        device.close()


@pytest.fixture
def sampling(quanser):
    """Make a device that samples with the amplifier on and -2 V."""

    def make(**changes):
        device = quanser(**changes)
        device.open()
        device.start(1e-3)
        device.enable(True)
        device.read(0.1)
        device.write(-2.0, LED_IDLE)
        return device

    return make


@pytest.fixture
def library_calls(stand_in, monkeypatch):
    """The names of the library's calls from now on, in order."""
    called = []
    count = stand_in.failure

    def failure(name):
        called.append(name)
        return count(name)

    monkeypatch.setattr(stand_in, "failure", failure)
    return called


@pytest.fixture
def breaks(stand_in):
    """Let a call fail from now on with -843: once, or for ever."""

    def plan(name, *, for_ever=False):
        stand_in.current.failures[name] = (stand_in.calls[name] + 1, -843, for_ever)

    return plan


@pytest.fixture(scope="session")
def components(fmus):
    """The scenario `device` as (controller, plant)."""
    return rig.parts(fmus)


@pytest.fixture(params=["stand-in", "simulated"])
def bench(request, components):
    """Make a device whose board has faults: a configuration of the stand-in, or a script; tick by tick the same."""

    def make(changes=None, script=""):
        if request.param == "stand-in":
            return StandIn(request.getfixturevalue("stand_in"), changes or {})
        return Simulated(components[1], script)

    return make


@pytest.fixture
def loop_of(components, tmp_path):
    """Make the loop of a device; its log goes at the end."""
    loops = []

    def make(device, duration=0.2, **settings):
        options = rig.settings_of(duration, **settings)
        loop = Loop(device, components[0], options, tmp_path / f"run{len(loops)}.csv")
        loops.append(loop)
        return loop

    yield make
    for loop in loops:
        loop.log.discard()


@pytest.fixture
def run(loop_of):
    """Run the loop on a bench and return its report."""
    return lambda bench, **settings: loop_of(bench.device, **settings).run()
