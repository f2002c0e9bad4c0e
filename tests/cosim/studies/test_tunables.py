"""What of a controller is tuned freely: ranges and their shares, and what a choice of values changes."""

import math

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.scenario import load_scenario
from cosim.scenario_system import build_system, controller_design
from cosim.studies.ranges import Range
from cosim.studies.tunables import COUNT_WEIGHT, NOISES, Tunable, TunedController, controller_over, ranges_over
from cosim.system_export import export_system
from ihc_fmu import System, inverse_design
from ihc_fmu.design import Design
from ihc_fmu.options import Options
from ihc_fmu.pendulum.kalman import KalmanOptions


@pytest.fixture
def tuned(fmus, design):
    """Make the tuned controller of a built-in scenario."""

    def make(name="tilt_kalman", changes=None):
        scenario, folder = load_scenario(name)
        return TunedController(scenario.changed(changes or {}), fmus, folder, design)

    return make


@pytest.fixture(scope="module")
def cart_system(tmp_path_factory):
    """Another system: its scenario, the folders of its FMUs and of itself, the design from its controller FMU."""
    system = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], name="cart", states=("position [m]", "speed [m/s]"))
    folder = tmp_path_factory.mktemp("cart")
    export_system(inverse_design(system, Options(alpha=0.4, u_max=3.0)), folder)
    scenario, beside = load_scenario(folder / "cart.ssp")
    known = controller_design(build_system(scenario, beside, beside), scenario, beside)[0]
    return scenario, beside, beside, known


@pytest.fixture
def cart(cart_system):
    """The tuned controller of another system."""
    return TunedController(*cart_system)


@pytest.mark.parametrize("low_high", [(0.05, 1.0), (1.0, 5.0), (-2.0, 30.0), (-4.0, -0.1)])
def test_shares_and_values_are_each_others_inverse_and_evenly_spread(low_high):
    t = Tunable("a_min", Range(*low_high))
    assert t.logarithmic == (low_high[0] > 0.0 and low_high[1] / low_high[0] > 10.0)
    assert (t.at(0.0), t.at(1.0)) == low_high
    assert (t.share(low_high[0] - 1.0), t.share(low_high[1] + 1.0)) == (0.0, 1.0)
    values = np.array([t.at(share) for share in np.linspace(0.0, 1.0, 5)])
    steps = np.diff(np.log(values) if t.logarithmic else values)
    np.testing.assert_allclose(steps, steps[0], rtol=2e-3)  # values have four digits
    for share in (0.1, 0.77):
        assert t.share(t.at(share)) == pytest.approx(share, abs=1e-3)


def test_the_usual_numbers_are_those_that_act(tuned, cart):
    assert [t.name for t in tuned().tunables({})] == ["a_min", "b_max", "u_max", "mu", *NOISES, COUNT_WEIGHT]
    assert [t.name for t in tuned("tilt").tunables({})] == ["a_min", "b_max", "u_max", "mu"]
    assert [t.name for t in cart.tunables({}, gain=True)] == ["a_min", "b_max", "u_max", "K_1_1", "K_1_2", "alpha"]
    assert [t.name for t in cart.tunables({"b_max": Range(1.0, 2.0)})] == ["b_max"]
    for t in (*tuned().tunables({}, gain=True), *cart.tunables({}, gain=True)):
        controller = cart if t.name.startswith("K") else tuned()
        assert t.range.low <= controller.start[t.name] <= t.range.high


def test_the_present_values_are_the_scenario_as_it_stands(tuned, cart, fmus):
    """Of the scenario, its design and its filter: nothing that acts is another number."""
    controller = tuned()
    scenario, folder = load_scenario("tilt_kalman")
    setting = controller.setting({t.name: controller.start[t.name] for t in controller.tunables({}, gain=True)})
    assert setting.design is controller.design
    systems = [build_system(s, fmus, folder) for s in (scenario.changed(dict(setting.changes)), scenario)]
    now, before = ({**controller.own, **s.components[0].start} for s in systems)
    assert {name for name in now if now[name] != before[name]} == set()
    assert cart.setting({"a_min": 0.5, "u_max": cart.start["u_max"]}).changes == {"controller.start.a_min": 0.5}


def test_mu_the_scale_and_the_gain_get_a_design_that_is_proven(tuned, design):
    setting = tuned().setting({"mu": 0.8, "u_max": 4.0, "k_lin_2": -25.0})
    found = setting.design
    assert isinstance(found, Design)
    assert (found.mu, found.alpha, found.u_max[0]) == (0.8, design.alpha, pytest.approx(4.0))
    assert found.k_lin[1] == -25.0
    assert setting.changes["controller.start.mu"] == 0.8
    assert setting.changes["controller.start.P_11"] == found.P[0, 0]
    assert setting.plain == {}
    with pytest.raises(UserError):
        tuned().setting({"k_lin_2": -1.0})  # does not hold the pendulum


def test_another_systems_ball_is_scaled_by_its_start_values(cart):
    setting = cart.setting({"u_max": 6.0})
    assert setting.design.u_max == pytest.approx([6.0])
    np.testing.assert_allclose(setting.design.P, cart.design.P / 4.0)
    entries = {f"P_{i}_{j}": setting.design.P[i - 1, j - 1] for i, j in ((1, 1), (1, 2), (2, 2))}
    assert entries.items() <= {name.rpartition(".")[2]: v for name, v in setting.changes.items()}.items()
    assert cart.linear() == {"controller.start.law": "LC"}


def test_a_filters_noises_become_its_gain(tuned):
    values = {"voltage_noise": 2e-6, "bias_noise": 1e-8}
    changes = tuned().setting(values).plain
    usual = tuned().setting({name: getattr(KalmanOptions(), name) for name in NOISES}).plain
    assert changes.keys() == usual.keys()
    assert len(changes) == 13  # M (6, 2) and its sample time
    assert changes["controller.start.kalman_M_11"] != usual["controller.start.kalman_M_11"]


def test_the_noises_of_a_filter_are_read_from_its_gain(tuned):
    """So that a search, and a page, go on from a scenario that a search has written."""
    found = tuned("tilt_sparing").start  # its file says the noises that its gain was made for
    values = [found[name] for name in NOISES]
    np.testing.assert_allclose(values, [1.117e-6, 0.09442, 3.84e-9], rtol=1e-6)
    own = tuned("tilt_kalman", {"controller.start.kalman_M_31": 9.0})
    assert own.filtered
    assert own.noises is None
    assert [t.name for t in own.tunables({})] == ["a_min", "b_max", "u_max", "mu", COUNT_WEIGHT]
    with pytest.raises(UserError, match=r"controller\.bias_noise cannot be tuned"):
        own.tunables({"bias_noise": Range(1e-9, 1e-8)})


def test_a_gain_that_is_none_belongs_to_no_noises(tuned):
    assert tuned("tilt_kalman", {"controller.start.kalman_M_11": math.inf}).noises is None


def test_the_controller_of_another_scenario_is_told_in_changes(fmus, cart_system):
    (tilt, folder), (sharp, beside) = load_scenario("tilt_kalman"), load_scenario("tilt_sharp")
    changes = controller_over((tilt, fmus, folder), (sharp, fmus, beside))
    assert (changes["controller.start.k_lin_1"], changes["controller.start.a_min"]) == (2.0, 0.5)
    assert (
        not {"controller.start.law", "controller.start.sample_time", "controller.start.kalman_angle"} & changes.keys()
    )
    assert controller_over((tilt, fmus, folder), (sharp.changed(changes), fmus, beside)) == {}
    with pytest.raises(UserError, match="a scenario with the same kind of controller, found tilt_kalman"):
        controller_over((tilt, fmus, folder), cart_system[:3])


@pytest.mark.parametrize(
    ("over", "sentence"),
    [
        (["a_min=0.1..1"], "--over takes controller.NAME=LOW..HIGH, found 'a_min=0.1..1'"),
        (["plant.m_p=0.1..1"], "--over takes controller.NAME=LOW..HIGH, found 'plant.m_p=0.1..1'"),
        (["controller.a_min"], "--over takes controller.NAME=LOW..HIGH, found 'controller.a_min'"),
        (
            ["controller.a_min=1"],
            "--over controller.a_min takes a range LOW..HIGH of finite numbers, LOW below HIGH, found '1'",
        ),
        (["controller.a_min=0.1..1", "controller.a_min=0.2..1"], "--over names controller.a_min twice"),
        (["controller.a_mni=0.1..1"], "controller.a_mni cannot be tuned; did you mean a_min"),
        (["controller.P_11=1..2"], "controller.P_11 cannot be tuned"),
        (["controller.law=1..2"], "controller.law cannot be tuned"),
        (["controller.mu=0.5..1.5"], "controller.mu must lie in (0, 1], found 0.5..1.5"),
        (["controller.u_max=0..1"], "controller.u_max must lie in (0, inf], found 0..1"),
        (["controller.a_min=0..1"], "controller.a_min must lie in [1e-06, 1e+12], found 0..1"),
    ],
)
def test_what_cannot_be_tuned_is_refused_in_a_sentence(tuned, over, sentence):
    with pytest.raises(UserError) as said:
        tuned().tunables(ranges_over(over))
    assert str(said.value).startswith(sentence)


def test_without_a_known_design_neither_scale_nor_gain_is_tuned(cart_system):
    scenario, fmus, folder, design = cart_system
    foreign = TunedController(scenario, fmus, folder, None)
    assert [t.name for t in foreign.tunables({})] == ["a_min", "b_max"]
    assert foreign.setting({"a_min": 0.5}).design is None
    with pytest.raises(UserError, match="tuning K needs a controller whose design is known"):
        foreign.tunables({}, gain=True)
    moved = scenario.changed({"controller.start.K_1_1": -5.0})
    assert TunedController(moved, fmus, folder, design).design is None
