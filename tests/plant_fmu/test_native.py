"""The plant in C, as an FMU, against the plant in Python: the same numbers, and the same words where a step is refused."""

import itertools
import math
import platform
import random
import sys
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract
from fmpy.fmi1 import FMICallException

from fmu_export.native_fmu import export_native_fmu
from plant_fmu.interface import INTERFACE, MAX_DELAY_STEPS, start_values
from plant_fmu.native_unit import NATIVE
from plant_fmu.parameters import PARAMETER_SETS, QubeParameters
from plant_fmu.unit import QubePlant
from tests.fmu_export.conftest import Host
from tests.fmu_export.parity import compare, extreme_values

EXACT = sys.platform == "linux" and platform.machine() == "x86_64"
"""Where Python and the binary call the same mathematical library, all results are equal to the last bit."""

STEP = 1e-3
INPUTS = [v.name for v in INTERFACE.of("input")]


def agree(actual, expected):
    tolerance = 0.0 if EXACT else 1e-12
    np.testing.assert_allclose(np.array(actual, float), np.array(expected, float), rtol=tolerance, atol=tolerance)


def random_inputs(rng):
    """Beyond the voltage limit of 10 V about one time in four."""
    return rng.uniform(-12, 12), rng.uniform(-2, 2), rng.uniform(-1e-3, 1e-3)


def advance(pair, time, step, inputs):
    """Step both, and return the outputs of the native one."""
    native, python = pair
    python.step(time, step, inputs)
    outputs = native.step(time, step, **dict(zip(INPUTS, inputs, strict=True)))
    agree(outputs, python.outputs())
    return outputs


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("native")
    return Path(extract(str(export_native_fmu(NATIVE, path / "plant.fmu")), str(path / "plant")))


@pytest.fixture
def pair(folder):
    """Make (native FMU, Python unit), initialized with the same start values; equal from there."""
    made = []

    def make(**changes):
        native, python = Host(folder), QubePlant(INTERFACE.start_values(changes))
        made.append(native)
        agree(native.initialize(**changes).outputs(), python.outputs())
        return native, python

    yield make
    for native in made:
        native.slave.freeInstance()


CASES = {
    "hanging": {},
    "tilted": {"delta_0": 0.3, "theta_0": -2.0, "theta_dot_0": 5.0, "delta_dot_0": -7.0},
    "without back-EMF": {"back_emf": False},
    "dry friction": {"T_r": 2e-3},
    "dry friction alone": {"T_r": 3e-4, "D_r": 0.0, "D_p": 0.0, "back_emf": False, "delta_0": 1.0},
    "ideal sensors": {"encoder_counts": 0},
    "coarse encoders": {"encoder_counts": 7, "theta_encoder_offset": 0.0, "delta_encoder_offset": 1.0},
    "noise": {"noise_std": 1e-2, "noise_seed": 7},
    "largest seed": {"noise_std": 1e-2, "noise_seed": 2**31 - 1, "encoder_counts": 0},
    "delay": {"measurement_delay": 7e-3},
    "delay and noise": {"measurement_delay": 3e-3, "noise_std": 1e-3, "noise_seed": 0},
    "weak amplifier": {"voltage_limit": 0.5},
    "no amplifier": {"voltage_limit": 0.0, "delta_0": 0.1},
    "one substep": {"solver_step": 1e-3},
    "seven substeps": {"solver_step": 1.5e-4},
}


@pytest.mark.parametrize("motor_model", [1, 2])
@pytest.mark.parametrize("case", CASES)
def test_native_plant_equals_the_python_plant_under_random_inputs(case, motor_model, pair):
    both, rng = pair(**CASES[case], motor_model=motor_model), random.Random(case)
    rows = [advance(both, k * STEP, STEP, random_inputs(rng)) for k in range(300)]
    assert len(set(rows)) == len(rows)


@pytest.mark.parametrize(("name", "motor_model"), list(itertools.product(PARAMETER_SETS, (1, 2))))
def test_every_parameter_set_is_the_same_in_both(name, motor_model, pair):
    both, rng = pair(**start_values(name), motor_model=motor_model, delta_0=0.1), random.Random(name)
    for k in range(300):
        advance(both, k * STEP, STEP, random_inputs(rng))


@pytest.mark.parametrize("seed", range(20))
def test_random_pendulums_are_the_same_in_both(seed, pair):
    rng = random.Random(seed)
    ident = start_values("ident")
    changes = {name: ident[name] * 10 ** rng.uniform(-0.5, 0.5) for name in QubeParameters.__dataclass_fields__}
    changes["T_r"] = 10 ** rng.uniform(-5.0, -2.5)
    for name in ("theta_0", "delta_0", "theta_dot_0", "delta_dot_0"):
        changes[name] = rng.uniform(-20, 20)
    both = pair(**changes, motor_model=rng.choice([1, 2]), encoder_counts=rng.choice([0, 1, 500, 4096]))
    for k in range(50):
        advance(both, k * STEP, STEP, random_inputs(rng))


@pytest.mark.parametrize("motor_model", [1, 2])
def test_steps_of_any_length_are_the_same_in_both(motor_model, pair):
    both, rng, time = pair(motor_model=motor_model, delta_0=0.3, noise_std=1e-4), random.Random(5), 0.0
    for _ in range(100):
        step = 10 ** rng.uniform(-7, -1)
        advance(both, time, step, random_inputs(rng))
        time += step


def test_steps_on_the_edge_of_one_substep_more_are_the_same_in_both(pair):
    both, time = pair(delta_0=0.3, solver_step=1e-3), 0.0
    for n, nudge in itertools.product((1, 2, 3, 10), (-1e-8, -1e-10, 0.0, 1e-10, 1e-8)):
        step = n * 1e-3 * (1 + nudge)
        advance(both, time, step, (2.0, 0.0, 0.0))
        time += step


def test_longest_delay_is_the_same_in_both(pair):
    """A ring of 1001 measurements in C: it wraps around twice."""
    both = pair(measurement_delay=MAX_DELAY_STEPS * 1e-4, noise_std=1e-3, delta_0=0.2, encoder_counts=0)
    seen = [advance(both, k * 1e-4, 1e-4, (1.0, 0.0, 0.0))[5] for k in range(2 * MAX_DELAY_STEPS + 10)]
    assert len(set(seen[:MAX_DELAY_STEPS])) == 1
    assert len(set(seen[MAX_DELAY_STEPS - 1 :])) == len(seen) - MAX_DELAY_STEPS + 1


# Refusals: (start values, steps before, the step that is refused, its inputs, the beginning of the sentence)

AT_REST = (0.0, 0.0, 0.0)
REFUSALS = {
    "delay between two steps": (
        {"measurement_delay": 1.5e-3},
        [],
        (1e-3, AT_REST),
        "measurement_delay must be a multiple of the communication step, found 0.0015 s with a step of 0.001 s",
    ),
    "delay of less than a step": (
        {"measurement_delay": 1e-4},
        [],
        (1e-3, AT_REST),
        "measurement_delay must be a multiple of the communication step, found 0.0001 s with a step of 0.001 s",
    ),
    "delay too long by one": (
        {"measurement_delay": 1.001},
        [],
        (1e-3, AT_REST),
        "measurement_delay must not exceed 1000 communication steps, found 1.001 s with a step of 0.001 s",
    ),
    "delay far too long": (
        {"measurement_delay": 1e9},
        [],
        (1e-9, AT_REST),
        "measurement_delay must not exceed 1000 communication steps, found 1e+09 s with a step of 1e-09 s",
    ),
    "another step under a delay": (
        {"measurement_delay": 2e-3},
        [1e-3, 1e-3],
        (5e-4, AT_REST),
        "the communication step must stay the same with a measurement_delay, found 0.0005 s after 0.001 s",
    ),
    "too many substeps": (
        {"solver_step": 1e-7},
        [1e-3],
        (0.1001, AT_REST),
        "a communication step must not exceed 1000000 internal steps of 1e-07 s, found 0.1001 s",
    ),
    "too many substeps of the motor": (
        {"L_m": 1e-9, "motor_model": 2},
        [],
        (1e-3, AT_REST),
        "a communication step must not exceed 1000000 internal steps of 0.0005 s, found 0.001 s",
    ),
    "inputs that add up to infinity": (
        {},
        [1e-3],
        (1e-3, (1e308, 1e308, 0.0)),
        "inputs must be finite, found voltage, disturbance_voltage, pendulum_torque = (1e+308, 1e+308, 0",
    ),
    "state without bounds": (
        {},
        [1e-3],
        (1e-3, (0.0, 0.0, 1e300)),
        "the state left the range of numbers, x = (",
    ),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_both_refuse_with_the_same_words_and_stay_as_they_were(case, pair):
    changes, before, (step, inputs), words = REFUSALS[case]
    native, python = both = pair(**changes, delta_0=0.5)
    time = 0.0
    for length in before:
        advance(both, time, length, (1.0, 0.0, 0.0))
        time += length
    outputs, state = native.outputs(), python.get_state()
    with pytest.raises((ValueError, ArithmeticError)) as caught:
        python.step(time, step, inputs)
    with pytest.raises(FMICallException):
        native.step(time, step, **dict(zip(INPUTS, inputs, strict=True)))
    ((_, _, message),) = native.log
    assert str(caught.value).startswith(words)
    assert message.startswith(words)
    assert native.outputs() == outputs
    assert python.get_state() == state
    if before:
        advance(both, time, before[-1], (1.0, 0.0, 0.0))


def test_step_that_diverged_does_not_bind_the_length_of_the_next(pair):
    native, python = both = pair(measurement_delay=2e-3)
    with pytest.raises(ArithmeticError):
        python.step(0.0, 1e-3, (0.0, 0.0, 1e300))
    with pytest.raises(FMICallException):
        native.step(0.0, 1e-3, pendulum_torque=1e300)
    advance(both, 0.0, 5e-4, (1.0, 0.0, 0.0))


@pytest.mark.parametrize("name", ["m_p", "L_p", "J_p", "L_r", "J_r", "g_p", "R_m", "k_m", "L_m"])
def test_constant_that_must_be_positive_is_named_by_both(name, folder):
    with pytest.raises(ValueError, match=rf"^{name} must lie in \[1e-12, 1e\+12\]"):
        INTERFACE.start_values({name: 0.0})
    native = Host(folder)
    with pytest.raises(FMICallException):
        native.set(**{name: 0.0})
    assert native.log[-1][2].startswith(f"{name} must lie in [1e-12, 1e+12], found 0")
    native.slave.freeInstance()


def test_any_admissible_numbers_are_answered_alike(folder):
    rng, ends = random.Random(2), []
    for _ in range(200):
        changes = extreme_values(INTERFACE, rng, {})
        rows = [
            tuple(rng.choice((0.0, rng.uniform(-5, 5), 1e-320, -1e-100, 1e3, 1e300)) for _ in INPUTS) for _ in range(6)
        ]
        ends.append(compare(folder, INTERFACE, QubePlant, {}, changes, rows, EXACT))
    assert {end: ends.count(end) > 3 for end in ("refused", "failed", "ran")} == dict.fromkeys(ends, True)


def test_undamped_pendulum_keeps_its_energy(pair):
    """A check of the native plant by itself: nothing drives or brakes it."""
    native, _ = pair(D_p=0.0, D_r=0.0, back_emf=False, delta_0=2.0, delta_dot_0=3.0, solver_step=1e-4)
    place = native.output_names.index("energy")
    start = native.outputs()[place]
    energies = [native.step(k * STEP, STEP)[place] for k in range(1000)]
    assert max(abs(energy - start) for energy in energies) < 1e-9 * abs(start)
    assert math.dist(native.outputs()[:2], (0.0, 2.0)) > 0.1
