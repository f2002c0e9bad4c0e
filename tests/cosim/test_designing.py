"""Why there is no design: what is said instead is true of the mu that it names."""

import re
from contextlib import nullcontext

import numpy as np
import pytest

from cosim.designing import Wish, beyond_limits, find, prospect, unexportable
from cosim.errors import UserError
from cosim.pendulum_export import export_units
from cosim.system_export import export_system
from ihc_fmu.design import Design
from ihc_fmu.largest_rate import largest_alpha
from ihc_fmu.synthesis import degrees
from ihc_fmu.system import PENDULUM, System


def test_without_mu_the_largest_feasible_alpha_is_the_best_of_those_tried():
    system = System(A=np.array([[0.0, 1.0], [0.0, 0.0]]), B=np.array([[0.0], [1.0]]), K=np.array([[-1.0, -0.5]]))
    with pytest.raises(UserError, match=r"the dual proves that there is no solution with mu = 0\.25$") as refused:
        find(system, Wish(alpha=1.0), lambda _: None)
    pattern = r"the largest feasible one is ([\d.]+) 1/s with mu = ([\d.]+), the best of 1, 0.75, 0.5, 0.25;"
    said = re.search(pattern, str(refused.value))
    assert said
    found = {mu: largest_alpha(system, mu) for mu in degrees(system)}
    best = max(found, key=lambda mu: found[mu])
    assert float(said[2]) == best
    assert float(said[1]) == pytest.approx(found[best], rel=1e-3)
    assert found[best] > 1.1 * found[1.0]


def test_the_largest_feasible_alpha_is_that_of_the_options_given():
    system = System(A=np.array([[0.0, 1.0], [0.0, 0.0]]), B=np.array([[0.0], [1.0]]), K=np.array([[-1.0, -2.0]]))
    said = []
    for d_max in (0.0, 0.2):
        design, choice = find(system, Wish(u_max="0.3", d_max=d_max), lambda _: None)
        said.append(prospect(design, choice.options, False, lambda _: None))
        assert float(said[-1].split()[-2]) == pytest.approx(2 * design.alpha, rel=0.02)
    assert said[0] == "largest feasible alpha for this gain and mu: 0.2929 1/s"
    assert said[1].startswith("largest feasible alpha for this gain, mu, d_max and scale: 0.03")


INTEGRATORS = {"A": [[0, 1], [0, 0]], "B": [[0], [1]], "K": [[-1, -2]]}
SEEN = {"C": [[1, 0], [0, 1]], "outputs": ["y1", "y2"]}
"""Outputs of the double integrator."""


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, None),
        ({"inputs": ["law"]}, "variable named 'law'"),
        ({**SEEN, "outputs": ["homogeneous_norm", "y"]}, "variable named 'homogeneous_norm'"),
        ({"states": ["a", "a_0"]}, "variable names must be unique, found 'a_0' more than once"),
        ({**SEEN, "set_points": ["y2"]}, "found y2: at rest y2 stays where"),
        ({"C": [[0, 1]]}, "no measured output tells x1"),
        ({"sample_time": 1e-8}, r"sample_time must lie in \[1e-06, 1000\] s, found 1e-08"),
        ({"name": "rotary_pendulum"}, "takes designs of 4 states and 1 input, found 2 and 1"),
        (
            {"A": (-np.eye(17)).tolist(), "B": np.eye(17).tolist(), "K": np.zeros((17, 17)).tolist()},
            "a controller FMU is for 1 to 16 states, found 17",
        ),
    ],
)
def test_what_export_refuses_is_noted_in_its_words(given, said, tmp_path):
    system = System.from_dict({**INTEGRATORS, **given})
    design = Design(system, np.eye(system.n), 1.0, 0.1) if system.n > 2 else find(system, Wish(), lambda _: None)[0]
    notes = unexportable(design)
    assert len(notes) == (said is not None)
    assert not notes or re.match(f"export will refuse this: .*{said}", notes[0])
    refused = pytest.raises(UserError, match=f"^{re.escape(notes[0].partition(': ')[2])}$") if notes else nullcontext()
    with refused:
        (export_units if system.name == PENDULUM else export_system)(design, output=tmp_path)


@pytest.mark.parametrize(
    ("wish", "said"),
    [
        (Wish(), None),
        (Wish(u_max="2"), None),
        (Wish(u_max="3"), "reaches 3 N on the unit ball, more than half of the 4 N that the limits leave around"),
        (Wish(u_max="5"), "reaches 5 N on the unit ball, more than the 4 N that the limits leave around"),
        (
            Wish(delta_max=10.0, state="x"),
            r"reaches [\d.]+ N on the unit ball, more than the 4 N that the limits",
        ),
        (Wish(direct=True, alpha=1.0, u_max="5"), "reaches 5 N on the unit ball, more than the 4 N that the limits"),
    ],
)
def test_a_ball_on_which_the_control_meets_its_limits_is_noted(wish, said):
    system = System(
        A=np.array([[0.0, 1.0], [0.0, 0.0]]),
        B=np.array([[0.0], [1.0]]),
        K=np.array([[-1.0, -1.5]]),
        states=("x", "v"),  # type: ignore[arg-type]
        inputs=("force [N]",),  # type: ignore[arg-type]
        lower=np.array([-9.0]),
        upper=np.array([6.0]),
        u_eq=np.array([2.0]),
    )
    notes = beyond_limits(find(system, wish, lambda _: None)[0])
    assert len(notes) == (said is not None)
    assert not notes or re.match(f"the homogeneous part of force {said}", notes[0])
