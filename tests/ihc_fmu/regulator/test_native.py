"""The general controller in C against that in Python, to the last bit: sizes, modes, estimators, faults, words."""

import itertools
import math
import random

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from fmu_export.errors import UserError
from ihc_fmu.regulator.interface import INTERFACE
from ihc_fmu.regulator.unit import HomogeneousControllerUnit, Mode
from ihc_fmu.sampled_unit import Fault
from tests.fmu_export.conftest import Host
from tests.ihc_fmu.regulator.conftest import H, by_name, random_regulator, row

LC, IHC, STA = 1, 2, 3
SIZES = [(n, 1 + (5 * n) % 8) for n in range(1, 17)] + [(4, 1), (6, 1), (6, 2), (16, 8), (8, 8), (2, 8)]
KINDS = [
    {},
    {"p": 3, "set_points": True},
    {"p": 2, "integral": True},
    {"integral": True, "set_points": True},
    {"observed": 2, "set_points": True},
]


def measured(regulator, count, seed=0):
    """Return rows of inputs near the equilibrium, of all sizes in turn."""
    rng, p = np.random.default_rng(seed), len(regulator.shape.outputs)
    for k in range(count):
        size = 10.0 ** rng.uniform(-4, 1) if k % 9 else 0.0
        wanted = regulator.y_eq + (0.3 * rng.normal(size=p) if (k // 10) % 2 else 0.0)
        yield row(regulator.y_eq + size * rng.normal(size=p), wanted)


@pytest.mark.parametrize(("n", "m"), SIZES)
def test_every_size_and_kind_is_the_same(n, m, both):
    for i, kind in enumerate(KINDS):
        mu = (1.0, 0.5, 0.3, 0.0)[(n + i) % 4]
        regulator = random_regulator(n, m, **kind, mu=mu, seed=i)
        rates = {f"sta_rate_{j + 1}": 10.0 ** (j - 3) for j in range(m)}
        pair = both({**regulator.values(), **rates, "a_min": 0.2, "b_max": 5.0, "kalman_count_weight": 0.6})
        rows = measured(regulator, 48)
        modes, commands = set(), set()
        for law, solver, discretization in itertools.product((LC, IHC, STA), (1, 2), (1, 2)):
            pair.tune(law=law, norm_solver=solver, discretization=discretization)
            for inputs in itertools.islice(rows, 6):
                outputs = pair.step(inputs)
                modes.add(outputs["mode"])
                commands.add(outputs["command_1"])
        assert modes == {Mode.STABILIZING}
        assert len(commands) > 10


def test_tuning_between_steps_is_the_same(both):
    rng = random.Random(5)
    regulator = random_regulator(6, 2, 3, mu=0.5, integral=True, set_points=True)
    pair = both(regulator.values())
    for k, inputs in enumerate(measured(regulator, 200)):
        if k % 5 == 2:
            a_min = 10 ** rng.uniform(-2, 0)
            everything = {
                "law": rng.randint(1, 3),
                "norm_solver": rng.randint(1, 2),
                "discretization": rng.randint(1, 2),
                "j_max": rng.randint(1, 60),
                "enabled": rng.random() < 0.8,
                "compensate_disturbance": rng.random() < 0.5,
                "sta_rate_2": 10 ** rng.uniform(-3, 3),
                "lower_2": -rng.uniform(0, 5),
                "upper_2": rng.uniform(0, 5),
            }
            pair.tune(b_max=1e3)
            pair.tune(a_min=a_min, b_max=a_min * rng.choice((1.0, 3.0, 30.0)))
            pair.tune(**dict(rng.sample(sorted(everything.items()), 3)))
        pair.step(inputs)


@pytest.mark.parametrize("kind", KINDS, ids=["state", "filter", "filter and integral", "integral", "observer"])
def test_numbers_of_all_sizes_are_answered_alike(kind, both):
    rng = np.random.default_rng(3)
    for seed, (n, m) in enumerate([(1, 1), (4, 1), (5, 3), (16, 8)]):
        regulator = random_regulator(n, m, **kind, seed=seed, mu=(1.0, 0.25)[seed % 2])
        values = {**regulator.values(), "a_min": 1e-6, "b_max": 1e12}
        values |= {name: bound * 1e300 for name, bound in values.items() if name.startswith(("lower", "upper"))}
        for semi in (1, 2):
            pair = both({**values, "discretization": semi})
            for k in range(40):
                p = len(regulator.shape.outputs)
                sizes = 10.0 ** (rng.uniform(-300, 300, p) if k % 2 else np.full(p, rng.uniform(-300, 290)))
                outputs = pair.step(row(rng.choice([-1.0, 0.0, 1.0], p) * sizes, np.zeros(p)))
                if outputs["mode"] == Mode.FAULT:
                    pair = both({**values, "discretization": semi})


@pytest.mark.parametrize(("sample_time", "step"), [(5e-3, 1e-3), (1e-3, 2.5e-4), (1e-3, 1e-2), (1 / 60, 1 / 600)])
def test_samples_within_and_between_steps_are_the_same(sample_time, step, both):
    regulator = random_regulator(4, 2, 2, h=sample_time)
    pair = both(regulator.values(), start_time=-3.5)
    for inputs in measured(regulator, 40):
        pair.step(inputs, step)


# Faults and refusals


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("bad", ["measurement_3", "setpoint_1"])
def test_non_finite_input_faults_both_until_reset(bad, value, both):
    regulator = random_regulator(5, 2, 3, set_points=True)
    pair = both(regulator.values() | {"lower_1": 0.5})
    rows = list(measured(regulator, 6))
    for inputs in rows[:3]:
        assert pair.step(inputs)["mode"] == Mode.STABILIZING
    faulty = tuple((by_name(rows[3]) | {bad: value}).values())
    outputs = pair.step(faulty)
    assert (outputs["mode"], outputs["fault"]) == (Mode.FAULT, Fault.NON_FINITE_INPUT)
    assert (outputs["command_1"], outputs["command_2"]) == (0.5, 0.0)
    ((_, _, message),) = pair.native.log
    assert message == (
        f"t = 0.003 s: fault non_finite_input: {bad} = {value}; the commands are 0 within their limits until reset"
    )
    for inputs in (faulty, *rows):
        assert pair.step(inputs)["mode"] == Mode.FAULT
    pair.tune(enabled=False)
    assert pair.step(rows[0])["mode"] == Mode.FAULT


def test_inputs_that_the_design_has_not_are_not_looked_at(both):
    pair = both(random_regulator(2, 1).values())
    assert pair.step(tuple((by_name(row([0.1, 0.2])) | {"measurement_3": math.nan}).values()))["fault"] == Fault.NONE


def test_all_inputs_that_are_not_finite_are_named(both):
    pair = both(random_regulator(3, 1, set_points=True).values())
    pair.step(row([math.nan, 0.0, -math.inf], [0.0, math.inf, 0.0]))
    assert "measurement_1 = nan, measurement_3 = -inf, setpoint_2 = inf; the commands" in pair.native.log[0][2]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"a_min": 1.25, "b_max": 1.125}, "a_min must not exceed b_max, found a_min = 1.25 and b_max = 1.125"),
        ({"lower_2": 3.0, "upper_2": 2.5}, "lower_2 must not exceed upper_2, found 3 and 2.5"),
        ({"T_1": 0.0, "T_2": 0.0, "T_3": 0.0}, "T must be regular, found a singular matrix"),
        ({"P_1": -1.0}, "P must be positive definite, found that its leading 1 x 1 block is not"),
        ({"P_5": 1e9}, "P must be positive definite, found that its leading 3 x 3 block is not"),
        ({"exponent_1": 5}, "the exponents must fall by 0 or 1 from coordinate to coordinate, to 0"),
        ({"exponent_3": 1}, "the exponents must fall by 0 or 1 from coordinate to coordinate, to 0"),
        ({"estimator": 3, "q_min": 2.0, "q_max": 1.5}, "q_min must not exceed q_max, found q_min = 2 and q_max = 1.5"),
        (
            {"estimator": 3, "observer_exponent_2": 2},
            "the exponents must fall by 0 or 1 from coordinate to coordinate, to 0",
        ),
        ({"estimator": 1}, "states that are measured need as many outputs, found 3 states and 2 outputs"),
        (
            {"sample_time": 2e-3},
            "the Kalman filter is for a sample_time of 0.001 s, found sample_time = 0.002 s",
        ),
        (
            {"K_2": 1.5e308, "K0_2": -1.5e308},
            "P and the gains must be of moderate size, found block coordinates that are not finite",
        ),
    ],
    ids=[
        "bounds",
        "limits",
        "T",
        "P",
        "P as a whole",
        "exponent",
        "last",
        "errors",
        "observer",
        "outputs",
        "time",
        "sizes",
    ],
)
def test_values_that_contradict_each_other_are_refused_by_both_with_the_same_words(changes, words, whole):
    values = random_regulator(3, 2, 2).values() | changes
    with pytest.raises(UserError) as caught:
        HomogeneousControllerUnit(INTERFACE.start_values(values))
    assert str(caught.value) == words
    native = Host(whole)
    with pytest.raises(FMICallException):
        native.initialize(**values)
    assert native.log[-1][2].startswith(str(caught.value))
    native.slave.freeInstance()


def test_step_that_does_not_fit_the_sample_time_is_refused_by_both_with_the_same_words(both):
    pair = both(random_regulator(2, 1).values())
    for step in (2.5e-3, 3e-4, 1e4):
        with pytest.raises(UserError) as caught:
            pair.python.step(0.0, step, row([0.1, 0.2]))
        with pytest.raises(FMICallException):
            pair.native.step(0.0, step)
        assert pair.native.log[-1][2].startswith(str(caught.value))
    pair.step(row([0.1, 0.2]), H)
