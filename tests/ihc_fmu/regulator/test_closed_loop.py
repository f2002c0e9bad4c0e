"""From a system file's entries to the closed loop: designs of the library under the general controller, in discrete time."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from fmu_export.errors import UserError
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.regulator.documentation import notes
from ihc_fmu.regulator.interface import ESTIMATORS, INTERFACE
from ihc_fmu.regulator.start_values import LinearFilter, design_regulator
from ihc_fmu.regulator.unit import HomogeneousControllerUnit, Mode
from ihc_fmu.system import System
from tests.ihc_fmu.regulator.conftest import OUTPUT_NAMES, row

H = 1e-3
CART = {
    "A": np.array([[0, 1, 0, 0], [0, -0.5, 2.4, 0], [0, 0, 0, 1], [0, -1.1, 27.0, -0.1]]),
    "B": np.array([[0.0], [1.0], [0.0], [2.2]]),
    "name": "cart",
    "states": ("position [m]", "speed [m/s]", "angle [rad]", "rate [rad/s]"),
    "inputs": ("force [N]",),
}
ARM = {
    "A": np.array([[0, 0, 1, 0], [0, 0, 0, 1], [25.2, -25.2, 0, 0], [-33.6, 92.5, 0, 0]]),
    "B": np.array([[0, 0], [0, 0], [6.86, -17.1], [-17.1, 54.9]]),
    "name": "arm",
    "states": ("shoulder [rad]", "elbow [rad]", "shoulder_rate [rad/s]", "elbow_rate [rad/s]"),
    "inputs": ("shoulder_torque [N.m]", "elbow_torque [N.m]"),
}
ALPHA = {"cart": 0.05, "arm": 0.3}


def regulator_of(entries, *, mu=1.0, observed=None, **changes) -> Any:
    """Return the regulator of a system with an LQ gain; `observed` are the measured states, through a Kalman filter."""
    if observed is not None:
        changes |= {"C": np.eye(4)[observed], "outputs": tuple(entries["states"][i] for i in observed)}
    system = System(**{**entries, "sample_time": H, **changes})
    system = system.with_lqr(np.ones(system.n), np.full(system.m, 0.1))
    design = inverse_design(system, Options(mu=mu, alpha=ALPHA[entries["name"]], u_max=3.0))
    return design_regulator(design, None if observed is None else kalman(system))


def kalman(system):
    """Return the stationary filter of state and input disturbances, with plain noises."""
    n, m, p = system.n, system.m, system.p
    block = expm(H * np.block([[system.A, system.B], [np.zeros((m, n + m))]]))
    C = np.hstack([system.C, np.zeros((p, m))])
    S = solve_discrete_are(block.T, C.T, np.diag([1e-8] * n + [1e-3] * m), 1e-6 * np.eye(p))
    gain = S @ C.T @ np.linalg.inv(C @ S @ C.T + 1e-6 * np.eye(p))
    return LinearFilter(F=block[:n, :n], G=block[:n, n:], C=system.C, M=np.vstack([gain, np.zeros((p, p))]))


class Loop:
    """The unit and its model in discrete time, exact for held inputs; deviations from the equilibrium."""

    def __init__(self, entries, regulator, **changes):
        A, B = entries["A"], entries["B"]
        (self.n, self.m), self.regulator = B.shape, regulator
        block = expm(H * np.block([[A, B], [np.zeros((self.m, self.n + self.m))]]))
        self.F, self.G = block[: self.n, : self.n], block[: self.n, self.n :]
        self.C = np.eye(self.n) if regulator.filter is None else regulator.filter.C
        self.unit = HomogeneousControllerUnit(INTERFACE.start_values({**regulator.values(), **changes}))
        self.k = 0

    def run(self, x, seconds, wanted=None, disturbance: Any = 0.0):
        """Return the last state, from `x` on; set-points are those of all outputs, deviations too."""
        r = self.regulator.y_eq + (np.zeros(len(self.C)) if wanted is None else wanted)
        for _ in range(round(seconds / H)):
            self.unit.step(self.k * H, H, row(self.C @ x + self.regulator.y_eq, r))
            self.k += 1
            u = np.array(self.unit.outputs()[: self.m]) - self.regulator.u_eq
            x = self.F @ x + self.G @ (u + disturbance)
        assert self.outputs()["mode"] == Mode.STABILIZING
        return x

    def outputs(self):
        return dict(zip(OUTPUT_NAMES, self.unit.outputs(), strict=True))


@pytest.mark.parametrize("entries", [CART, ARM], ids=["cart", "arm"])
def test_homogeneous_law_brings_the_state_to_rest_and_far_nearer_than_the_linear_one(entries):
    regulator = regulator_of(entries)
    x = np.array([0.05, -0.05, 0.02, 0.1])
    ends = {}
    for law in ("LC", "IHC"):
        loop = Loop(entries, regulator, law=law, a_min=0.05)
        ends[law] = np.abs(loop.run(x, 6.0)).max()
    assert ends["IHC"] < 0.1 * ends["LC"] < 0.1 * np.abs(x).max()


def test_norm_falls_as_certified():
    """d||x||_d/dt <= -alpha ||x||_d^(1-mu), where the ideal law acts: r(t) <= r_0 - alpha t at mu = 1."""
    regulator = regulator_of(ARM)
    loop = Loop(ARM, regulator, a_min=0.02, b_max=1e3)
    x = np.array([0.05, -0.05, 0.02, 0.1])
    x = loop.run(x, H)
    first = loop.outputs()["homogeneous_norm"]
    for k in range(1, 200):
        x = loop.run(x, H)
        norm = loop.outputs()["homogeneous_norm"]
        assert norm <= first - ALPHA["arm"] * k * H + 1e-3 or norm < 0.05


def test_set_point_is_reached_about_an_equilibrium_that_is_not_0():
    regulator = regulator_of(
        ARM,
        set_points=("shoulder", "elbow"),
        x_eq=np.array([1.0, 2.0, 0.0, 0.0]),
        y_eq=np.array([1.0, 2.0, 0.0, 0.0]),
        u_eq=np.array([3.0, -1.0]),
    )
    wanted = np.array([0.1, -0.05, 0.0, 0.0])
    x = Loop(ARM, regulator, a_min=0.2).run(np.zeros(4), 5.0, wanted)
    np.testing.assert_allclose(x, wanted, atol=1e-6)


@pytest.mark.parametrize(("entries", "observed"), [(CART, [0, 2]), (ARM, [0, 1])], ids=["cart", "arm"])
def test_from_outputs_alone_the_filter_finds_state_and_disturbance_and_the_law_takes_it_away(entries, observed):
    regulator = regulator_of(entries, observed=observed)
    m = entries["B"].shape[1]
    disturbance = np.array([0.3, -0.2])[:m]
    loop = Loop(entries, regulator, a_min=0.3)
    x = loop.run(np.array([0.02, 0.0, 0.01, 0.0]), 8.0, disturbance=disturbance)
    values = loop.outputs()
    assert np.abs(x).max() < 1e-6
    np.testing.assert_allclose([values[f"disturbance_estimate_{i}"] for i in range(1, m + 1)], disturbance, atol=1e-5)
    np.testing.assert_allclose([values[f"state_estimate_{i}"] for i in (1, 2, 3, 4)], x, atol=1e-6)


def test_names_units_and_limits_are_those_of_the_system():
    regulator = regulator_of(ARM, observed=[0, 1], biases=("elbow",), set_points=("elbow",), lower=[-3.0, -2.0])
    shown, hidden = regulator.exported()
    assert shown.name == "arm_controller"
    assert [v.name for v in shown.of("input")] == ["shoulder", "elbow", "elbow_setpoint"]
    assert shown.by_name["elbow_torque"].unit == "N.m"
    assert shown.by_name["elbow_torque_lower"].start == -2.0
    assert "elbow_bias_estimate" in shown.by_name
    assert hidden["state_count"] == 4


def test_notes_hold_the_systems_names_and_every_margin():
    system = System(**ARM).with_lqr(np.ones(4), np.ones(2)).changed(states=("a < b", *ARM["states"][1:]))
    design = inverse_design(system, Options(mu=1.0, alpha=ALPHA["arm"], u_max=3.0))
    for estimator in ESTIMATORS:
        page = notes(design, estimator)
        assert "x = (a &lt; b, elbow, shoulder_rate, elbow_rate), u = (shoulder_torque, elbow_torque)" in page
        for name, value in design.certificate.as_dict().items():
            assert name == "identities" or f"<tr><td>{name}</td><td>{value:.3g}</td></tr>" in page


def test_outputs_alone_need_an_estimator():
    system = System(**ARM, C=np.eye(2, 4)).with_lqr(np.ones(4), np.ones(2))
    with pytest.raises(UserError, match="arm does not measure its states, so that its controller needs an estimator"):
        design_regulator(inverse_design(system, Options(mu=1.0, alpha=ALPHA["arm"], u_max=3.0)))


@pytest.mark.parametrize("entries", [CART, ARM], ids=["cart", "arm"])
def test_super_twisting_takes_a_constant_disturbance_of_the_inputs_away(entries):
    """Without an estimate of it: the state comes to rest at 0, the command at the disturbance's opposite."""
    regulator = regulator_of(entries)
    disturbance = np.array([0.3, -0.2])[: entries["B"].shape[1]]
    loop = Loop(entries, regulator, law="STA")
    x = loop.run(np.array([0.02, -0.01, 0.0, 0.0]), 30.0, disturbance=disturbance)
    assert np.abs(x).max() < 1e-5
    np.testing.assert_allclose(loop.unit.state.v, -disturbance, atol=1e-4)
    for law in ("LC", "STA"):  # the integral is that law's alone
        loop.unit = HomogeneousControllerUnit(INTERFACE.start_values({**regulator.values(), "law": law}))
        loop.k = 0
        loop.run(np.full(4, 1e-3), 2 * H, disturbance=disturbance)
        assert bool(np.any(loop.unit.state.v)) is (law == "STA")
