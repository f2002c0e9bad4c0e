"""Shares of the variance against closed forms: the Ishigami function, a product, lists."""

import math

import numpy as np
import pytest

from cosim.studies.sampling import points
from cosim.studies.sensitivity import LEAST, sensitivity

A, B = 7.0, 0.1


def ishigami(count):
    """Inputs in (-pi, pi), the function of Ishigami and Homma (1990), and its indices in closed form."""
    x = math.pi * (2.0 * points("sobol", 3, count, 3) - 1.0).T
    y = np.sin(x[0]) + A * np.sin(x[1]) ** 2 + B * x[2] ** 4 * np.sin(x[0])
    parts = [0.5 * (1.0 + B * math.pi**4 / 5.0) ** 2, A**2 / 8.0, 0.0]
    both = B**2 * math.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    total = sum(parts) + both
    return {f"x{k}": (x[k], False) for k in range(3)}, y, [part / total for part in parts], both / total


def test_the_ishigami_function_has_its_indices():
    inputs, y, parts, both = ishigami(8192)
    found = sensitivity(inputs, y)
    assert found is not None
    assert [found.single[name].value for name in inputs] == pytest.approx(parts, abs=0.02)
    assert found.pairs["x0", "x2"].value == pytest.approx(both, abs=0.03)
    assert [name for name, _ in found.deciding()] == ["x1", "x0", "x0 with x2"]
    assert found.rest == pytest.approx(0.0, abs=0.05)


def test_intervals_hold_the_true_shares_and_shrink_with_the_root_of_the_draws():
    halves = []
    for count in (512, 8192):
        inputs, y, parts, _ = ishigami(count)
        found = sensitivity(inputs, y)
        assert found is not None
        first = found.single["x0"]
        assert abs(first.value - parts[0]) < 1.5 * first.half_width
        halves.append(first.half_width)
    assert halves[1] < 0.5 * halves[0]


def test_lists_constant_inputs_and_draws_that_do_not_count():
    rng = np.random.default_rng(5)
    choice, noise = rng.integers(0, 3, 600), rng.standard_normal(600)
    y = np.array([0.0, 2.0, -1.0])[choice] + 0.5 * noise
    y[::7] = np.nan
    inputs = {"choice": (choice, True), "constant": (np.full(600, 4), True), "noise": (noise, False)}
    found = sensitivity(inputs, y)
    assert found is not None
    assert found.draws == int(np.isfinite(y).sum())
    explained = np.var(np.array([0.0, 2.0, -1.0])) / (np.var(np.array([0.0, 2.0, -1.0])) + 0.25)
    assert found.single["choice"].value == pytest.approx(explained, abs=0.03)
    assert found.single["constant"].value == pytest.approx(0.0, abs=1e-12)
    assert found.deciding()[0][0] == "choice"


def test_nothing_is_said_of_few_draws_or_of_what_never_differs():
    x = {"x": (np.linspace(0.0, 1.0, 200), False)}
    assert sensitivity(x, np.full(200, 3.0)) is None
    few = np.where(np.arange(200) < LEAST - 1, x["x"][0], np.nan)
    assert sensitivity(x, few) is None
    assert sensitivity(x, np.where(np.arange(200) < LEAST, x["x"][0], np.nan)) is not None
