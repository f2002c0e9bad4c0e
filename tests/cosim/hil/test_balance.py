"""The whole program: from hanging, with its start checks, to a balanced pendulum; its log replays and goes everywhere."""

import math

import numpy as np
import pytest

from benchmarks.device_swing_up import CABLE
from cosim.hil.loop import Loop
from cosim.hil.replay import replay
from cosim.hil.settings import Settings
from cosim.hil.udp import UdpDevice
from cosim.judged_signals import kept_upright
from cosim.metrics import evaluate
from cosim.plots import save_overview
from cosim.results import Result
from tests.cosim.hil import rig

DURATION = 6.0


@pytest.fixture
def balanced(fmus, serve, tmp_path):
    """Run the program in lockstep with its usual settings; return the log as read from its file."""

    def make(kind, rate, **changes):
        changes |= {"duration": DURATION, "step": 1.0 / rate}
        controller = rig.parts(fmus, **changes)[0]
        devices = {
            "sim": lambda: rig.lockstep(fmus, **changes),
            "udp": lambda: UdpDevice(serve(**changes).address, real_time=False),
        }
        loop = Loop(devices[kind](), controller, Settings(rate=rate, duration=DURATION), tmp_path / kind)
        try:
            report = loop.run()
        finally:
            loop.log.discard()
        assert (report.stop, report.failures) == ("complete", ())
        report.result.save(tmp_path / f"{kind}.csv")
        return Result.load(tmp_path / f"{kind}.csv")

    return make


@pytest.mark.parametrize("rate", [500.0, 1000.0])
def test_it_swings_up_and_balances_the_same_on_both_devices(balanced, patient, fmus, tmp_path, rate):
    result, other = balanced("sim", rate), balanced("udp", rate)
    assert len(result.time) == DURATION * rate + 1
    assert abs(math.degrees(result["plant.delta_encoder"][0])) > 150.0
    assert kept_upright(result)
    assert np.max(np.abs(result["plant.theta_encoder"])) < CABLE
    numbers = evaluate(result)
    assert numbers.capture_time < 5.0
    assert numbers.steady_rms < 0.1
    again = replay(result, fmus / "IhcController.fmu")
    assert (again.samples, again.differing, again.same_fmu) == (DURATION * rate, 0, True)
    assert save_overview(result, tmp_path / "run.png", "a run").stat().st_size > 10_000
    for name, signal in result.signals.items():
        if name not in ("hil.lateness", "hil.latency", "hil.step_time"):  # the machine's time
            np.testing.assert_array_equal(signal, other[name], err_msg=name)


@pytest.mark.parametrize("law", ["LC", "SMC"])
def test_the_other_laws_balance_too(balanced, law):
    assert kept_upright(balanced("sim", 1000.0, controller__start__law=law))
