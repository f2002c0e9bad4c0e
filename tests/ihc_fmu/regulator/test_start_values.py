"""From a design's arrays to the start values of the compiled table, and what is refused of them."""

from dataclasses import replace

import numpy as np
import pytest

from fmu_export.errors import UserError
from ihc_fmu.regulator.interface import INTERFACE, UNLIMITED, numbered
from ihc_fmu.regulator.start_values import LinearFilter
from ihc_fmu.regulator.unit import HomogeneousControllerUnit
from tests.ihc_fmu.regulator.conftest import random_regulator


def entries(values, name, shape):
    return np.array([values[entry] for entry in numbered(name, int(np.prod(shape)))]).reshape(shape)


def test_arrays_arrive_entry_by_entry():
    regulator = random_regulator(5, 2, 3, integral=True, set_points=True, mu=0.5)
    values = regulator.values()
    f = regulator.filter
    expected = {"T": regulator.T, "N": regulator.N, "B": regulator.B, "K": regulator.K, "K0": regulator.K_0}
    expected |= {"Ki": regulator.K_i, "Nx": regulator.N_x, "Nu": regulator.N_u, "F": f.F, "G": f.G, "C": f.C, "M": f.M}
    expected |= {"first": np.linalg.pinv(f.C), "lower": regulator.lower, "upper": regulator.upper}
    expected |= {"output_equilibrium": regulator.y_eq, "input_equilibrium": regulator.u_eq, "setpoint": regulator.y_eq}
    expected |= {"state_equilibrium": regulator.x_eq, "exponent": regulator.exponents}
    for name, array in expected.items():
        np.testing.assert_array_equal(entries(values, name, np.shape(array)), array)
    unit = HomogeneousControllerUnit(INTERFACE.start_values(values))
    np.testing.assert_allclose(
        regulator.T.T @ np.array(unit.design.Pz) @ regulator.T, regulator.P, rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(np.array(unit.Kiz) @ regulator.T, regulator.K_i, rtol=1e-9, atol=1e-12)
    assert (unit.mu, unit.sample_time, unit.estimator) == (0.5, 1e-3, "kalman")


def test_inputs_without_limits_have_enormous_ones():
    values = replace(random_regulator(3, 2), lower=None, upper=None).values()
    assert [values[name] for name in ("lower_1", "upper_1", "lower_2", "upper_2")] == [-UNLIMITED, UNLIMITED] * 2


def test_shown_and_hidden_values_are_together_those_of_the_design():
    regulator = random_regulator(4, 2, 3, set_points=True)
    shown, hidden = regulator.exported()
    starts = {v.compiled: v.start for v in shown.variables}
    assert not set(starts) & set(hidden)
    for name, value in regulator.values().items():
        assert {**starts, **hidden}[name] == value
    assert shown.by_name["K_2_3"].start == regulator.K[1, 2]
    assert shown.by_name["y2_setpoint"].start == regulator.y_eq[1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"T": np.eye(3)}, r"T must have the shape \(4, 4\), found \(3, 3\)"),
        ({"K": np.zeros((1, 4))}, r"K must have the shape \(2, 4\), found \(1, 4\)"),
        ({"P": np.full((4, 4), np.nan)}, "P must be finite, found nan"),
        ({"exponents": [1, 0]}, r"exponents must have the shape \(4,\), found \(2,\)"),
        ({"upper": [np.nan, 1.0]}, "upper must be finite, found nan"),
        ({"u_eq": [np.inf, 0.0]}, "u_eq must be finite, found inf"),
        ({"filter": None}, "disturbances are estimated by a Kalman filter, and by nothing else"),
        (
            {"filter": LinearFilter(F=np.eye(4), G=np.zeros((4, 2)), C=np.eye(3, 4), M=np.zeros((4, 3)))},
            r"the estimator's M must have the shape \(9, 3\), found \(4, 3\)",
        ),
    ],
)
def test_arrays_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(UserError, match=message):
        replace(random_regulator(4, 2, 3), **changes)


def test_measured_states_need_as_many_outputs():
    regulator = random_regulator(4, 2, 3)
    shape = replace(regulator.shape, estimated=False, biases=())
    with pytest.raises(UserError, match="states that are measured need as many outputs, found 4 states and 3 outputs"):
        replace(regulator, shape=shape, filter=None, y_eq=None)
