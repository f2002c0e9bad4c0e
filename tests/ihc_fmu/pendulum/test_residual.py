"""What the encoders leave of the pendulum: against published steady states, and what decides it."""

import numpy as np
import pytest

from ihc_fmu.pendulum.residual import angle_rms, residual_set

KALMAN = {"velocity_source": "kalman", "norm_solver": "exact", "discretization": "semi_implicit", "a_min": 0.5}


@pytest.mark.parametrize(
    ("changes", "steady"),
    [
        (KALMAN, 0.0025),
        ({**KALMAN, "law": "LC"}, 0.0042),
        ({"law": "LC"}, 0.0124),
        ({"a_min": 0.88}, 0.0100),
    ],
    ids=["IHC, Kalman filter", "LC, Kalman filter", "LC, velocity filter", "IHC, velocity filter"],
)
def test_steady_states_of_the_nonlinear_pendulum_are_foretold_to_a_fifth(design, changes, steady):
    """`steady_rms` of tilt_kalman and tilt in docs/results.md; white noise is off by a factor of two to ten."""
    found = residual_set(design, changes)
    assert angle_rms(found) == pytest.approx(steady, rel=0.2)
    assert np.hypot(*found.white[:2]) < 0.5 * steady


def test_it_is_proportional_to_the_count_and_hardly_depends_on_the_sample_time(design):
    """White noise would fall with the root of the sample time."""
    found = {
        (h, c): residual_set(design, {**KALMAN, "sample_time": h}, counts=c) for h in (5e-4, 2e-3) for c in (1024, 4096)
    }
    for h in (5e-4, 2e-3):
        assert angle_rms(found[h, 1024]) == pytest.approx(4.0 * angle_rms(found[h, 4096]), rel=0.02)
    assert angle_rms(found[2e-3, 1024]) == pytest.approx(angle_rms(found[5e-4, 1024]), rel=0.02)
    assert found[2e-3, 1024].white[0] == pytest.approx(2.0 * found[5e-4, 1024].white[0], rel=0.05)


def test_the_bound_is_proven_down_to_the_a_min_at_which_the_estimate_leaves_the_ball(design):
    assert residual_set(design, {**KALMAN, "a_min": 0.55}).proven
    assert not residual_set(design, {**KALMAN, "a_min": 0.45}).proven
    assert residual_set(design, KALMAN, counts=4096).proven


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"law": "SMC"}, "LC or IHC, found SMC"),
        ({"velocity_source": "inputs"}, "kalman or filter, found inputs"),
        ({**KALMAN, "kalman_count_weight": 0.7}, "kalman_count_weight = 1, found 0.7"),
    ],
)
def test_others_are_refused(design, changes, message):
    with pytest.raises(ValueError, match=message):
        residual_set(design, changes)
