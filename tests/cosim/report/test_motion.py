"""Samples of bodies in motion: where they are by plane geometry."""

import json

import numpy as np
import pytest

from cosim.animation import BodySection
from cosim.plots import COLOURS
from cosim.report.motion import FRAME, MOST_FRAMES, bodies_in_motion, pendulum_in_motion
from cosim.results import Result

TIME = np.arange(2001) * 1e-3


def body(name, shape, size=1.0, **entries):
    return BodySection.model_validate({"name": name, "shape": shape, "size": size, **entries})


def moved(bodies, **signals):
    result = Result(TIME, {f"plant.{name}": values for name, values in signals.items()}, {})
    found = bodies_in_motion({"run": result}, {"run": "#123456"}, bodies)
    assert found["step"] == pytest.approx(FRAME)
    times = found["step"] * np.arange(found["frames"])
    return times, [[np.array(values) for values in place] for place in found["runs"][0]["bodies"]]


def test_a_load_hangs_from_its_cart_and_swings_to_the_right():
    bodies = [
        body("cart", "cart", x="plant.s"),
        body("load", "rod", 0.3, on="cart", angle="plant.phi", zero="down"),
        body("end", "wheel", 0.1, on="load"),
    ]
    t, (cart, load, end) = moved(bodies, s=np.sin(TIME), phi=0.5 * TIME)
    np.testing.assert_allclose(cart[0], np.sin(t), atol=1e-4)
    np.testing.assert_allclose(load[0], cart[0])
    np.testing.assert_allclose(end[0], np.sin(t) + 0.3 * np.sin(0.5 * t), atol=2e-4)
    np.testing.assert_allclose(end[1], -0.3 * np.cos(0.5 * t), atol=2e-4)
    assert cart[1] == 0.0  # one number, for it does not move


def test_the_second_link_of_an_arm_counts_from_the_first_and_angles_may_be_clockwise():
    bodies = [
        body("first", "rod", angle="plant.p", zero="up"),
        body("second", "rod", on="first", angle="plant.q", relative=True),
        body("other", "beam", x=2.0, angle="plant.p", zero="up", turns="clockwise"),
    ]
    t, (first, second, other) = moved(bodies, p=0.3 * TIME, q=-0.1 * TIME)
    np.testing.assert_allclose(first[2], 0.5 * np.pi + 0.3 * t, atol=1e-4)
    np.testing.assert_allclose(second[2], first[2] - 0.1 * t, atol=2e-4)
    np.testing.assert_allclose(second[0], -np.sin(0.3 * t), atol=1e-4)
    np.testing.assert_allclose(other[2], 0.5 * np.pi - 0.3 * t, atol=1e-4)
    assert other[0] == 2.0


def test_a_long_run_has_fewer_samples_and_runs_of_other_lengths_the_same(made_result):
    long, short = made_result(np.arange(0.0, 100.0, 0.01)), made_result(TIME, controller_mode=TIME > 1.0)
    found = pendulum_in_motion({"LC": long, "IHC": short}, COLOURS)
    assert {len(run["theta"]) for run in found["runs"]} == {MOST_FRAMES}
    assert found["step"] * (MOST_FRAMES - 1) == pytest.approx(long.time[-1])
    assert found["runs"][1]["mode"][-1] == 1
    json.dumps(found, allow_nan=False)
