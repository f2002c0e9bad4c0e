"""The controller FMU as the loop calls it: what is refused, and how missed samples are made up for."""

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil.controller import MOST_CAUGHT_UP, ControllerFmu
from cosim.hil.loop import Loop
from tests.cosim.hil.rig import lockstep, one_sentence, parts, settings_of


@pytest.mark.parametrize("name", ["plant", "tiny"])
def test_a_controller_of_another_interface_is_refused(fmus, tmp_path, tiny, name):
    component = tiny("controller") if name == "tiny" else parts(fmus)[1]
    with pytest.raises(UserError) as caught:
        Loop(lockstep(fmus), component, settings_of(), tmp_path / "run")
    assert "theta" in one_sentence(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("rate", [500.0, 1001.0, 999.9999])
def test_the_controllers_sample_time_is_the_loops_period(fmus, tmp_path, rate):
    with pytest.raises(UserError, match="sample_time") as caught:
        Loop(lockstep(fmus), parts(fmus)[0], settings_of(1.0, rate), tmp_path / "run")
    assert "0.001" in one_sentence(caught.value)
    assert not list(tmp_path.iterdir())


def test_unknown_start_values_are_refused(fmus, tmp_path):
    with pytest.raises(UserError, match="swing_up_energy_gian"):
        Loop(
            lockstep(fmus),
            parts(fmus, controller__start__swing_up_energy_gian=1.0)[0],
            settings_of(),
            tmp_path / "run",
        )


def test_missed_samples_lie_on_the_line_between_two_measurements(fmus):
    controller = ControllerFmu(parts(fmus)[0], 1e-3)
    given = []
    controller.command = lambda theta, delta, number: given.append((theta, delta, number)) or 0.0
    assert controller.catch_up((0.0, -3.0, 7), 0.4, -2.6, 4) == 3
    np.testing.assert_allclose(given, [(0.1, -2.9, 7), (0.2, -2.8, 7), (0.3, -2.7, 7)], rtol=1e-15)
    assert controller.catch_up((0.0, 0.0, 0), 1.0, 1.0, 1) == 0
    assert controller.catch_up((0.0, 0.0, 0), 1.0, 1.0, 1000) == MOST_CAUGHT_UP
