"""Readings of LMSE: their closed forms for made runs, and their order."""

import math

import numpy as np
import pytest

from cosim.paper import printed
from cosim.paper.readings import Reading, readings

DEGREES = 180.0 / math.pi
TIME = np.arange(10_001) * 1e-3
TAKEOVER = 4.0


def run(made_result, before, after):
    """Make a run with constant |q| before and after the capture at 4 s, the last swing-up row excluded."""
    on = TIME >= TAKEOVER
    return made_result(TIME, np.where(on, after, before), controller_mode=np.where(on, 3, 2))


def closed_forms(before, after):
    """Return {(name, unit): value} for constant |q|; the capture's step of 1 ms is half of each in a trapezoid."""
    rows = (4000 * before**2 + 6001 * after**2) / 10_001
    whole = (TAKEOVER - 0.5e-3) * before**2 + 6.0005 * after**2
    return {
        ("∫|q|² dt over the run", "rad² s"): whole,
        ("mean of |q|² over the run", "rad²"): rows,
        ("root mean square of |q| over the run", "rad"): math.sqrt(rows),
        ("mean of |q|² over the run", "deg²"): DEGREES**2 * rows,
        ("root mean square of |q| over the run", "deg"): DEGREES * math.sqrt(rows),
        ("∫|q| dt over the run", "rad s"): (TAKEOVER - 0.5e-3) * before + 6.0005 * after,
        ("∫|q|² dt after the capture", "rad² s"): 6.0 * after**2,
        ("∫|q|² dt after the capture", "deg² s"): 6.0 * (DEGREES * after) ** 2,
        ("mean of |q|² after the capture", "deg²"): (DEGREES * after) ** 2,
        ("root mean square of |q| after the capture", "deg"): DEGREES * after,
    }


def test_constant_angles_give_closed_forms(made_result):
    heights = {"LC": (3.0, 0.5), "IHC": (2.5, 0.25), "SMC1": (3.0, 0.0), "SMC2": (1.0, 1.0)}
    listed = readings({law: run(made_result, *q) for law, q in heights.items()})
    expected = {law: closed_forms(*q) for law, q in heights.items()}
    assert {(reading.name, reading.unit) for reading in listed} == expected["LC"].keys()
    assert len(listed) == len(expected["LC"])
    for reading in listed:
        for law, value in reading.values.items():
            assert value == pytest.approx(expected[law][reading.name, reading.unit], rel=1e-9), (reading.name, law)


def test_both_angles_count_and_hanging_down_is_pi(made_result):
    result = made_result(TIME, 0.3, plant_delta=0.4 + 2 * math.pi)
    values = {(r.name, r.unit): r.values["LC"] for r in readings({"LC": result})}
    assert values["root mean square of |q| over the run", "rad"] == pytest.approx(0.5)
    hanging = {(r.name, r.unit): r.values["LC"] for r in readings({"LC": made_result(TIME, plant_delta=3 * math.pi)})}
    assert hanging["∫|q|² dt over the run", "rad² s"] == pytest.approx(10 * math.pi**2)


@pytest.mark.parametrize(("before", "after"), [(1.6, 0.2), (0.05, 0.01), (3.0, 2.0)])
def test_the_reading_nearest_to_the_printed_lc_comes_first(made_result, before, after):
    listed = readings({"LC": run(made_result, before, after)})
    for reading in listed:
        assert reading.ratio == reading.values["LC"] / 11.23
    distances = [abs(math.log(reading.ratio)) for reading in listed]
    assert distances == sorted(distances)


def test_twice_and_half_the_printed_value_are_equally_near():
    ratios = [Reading("", "", {"LC": factor * printed.LMSE[0]["LC"]}).ratio for factor in (2.0, 0.5)]
    assert math.log(ratios[0]) == pytest.approx(-math.log(ratios[1]))
