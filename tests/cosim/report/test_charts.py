"""Plots as data: thinned without losing a peak or a gap, packed without losing a digit that shows, told in words."""

import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.report.charts import Plots, packed, thinned

TIME = np.arange(1000) * 0.01


@given(
    st.integers(1, 400).flatmap(
        lambda rows: st.lists(st.floats(-1e6, 1e6) | st.just(np.nan), min_size=rows, max_size=rows)
    ),
    st.integers(2, 60),
)
def test_thinned_rows_keep_the_extremes_of_every_part(values, most):
    time, column = np.arange(len(values)) * 0.5, np.array(values)
    times, (found, other), per = thinned(time, [column, np.zeros(len(values))], most)
    assert np.all(np.diff(times) >= 0.0)
    assert len(times) == len(found) == len(other)
    assert not other.any()
    for begin in range(0, len(values), per):
        part = column[begin : begin + per]
        inside = found[(times >= time[begin]) & (times <= time[min(begin + per, len(values)) - 1])]
        for extreme in (np.nanmin, np.nanmax):
            if not np.isnan(part).all():
                assert extreme(inside) == extreme(part)
        assert np.isnan(part).any() == np.isnan(inside).any()
    if per == 1:
        np.testing.assert_array_equal(found, column)


def test_a_line_that_only_rises_stays_itself_and_a_jump_stays_a_gap():
    times, (line,), per = thinned(TIME, [TIME], 100)
    assert per == 20
    np.testing.assert_allclose(line, times)
    jump = np.where(TIME < 5.05, 3.1, -3.1)
    jump[505] = np.nan
    _, (seen,), _ = thinned(TIME, [jump], 100)
    turns = np.flatnonzero(np.diff(np.sign(np.nan_to_num(seen))) != 0)
    assert np.isnan(seen[turns[0] + 1])


@pytest.mark.parametrize(
    ("values", "kind"), [([1.0, 0.0, np.nan, -2.5], "f4"), ([1e-200, 1.0], "f8"), ([1e60, 1.0], "f8"), ([], "f4")]
)
def test_packed_numbers_come_back(values, kind):
    found = packed(np.array(values))
    assert found["type"] == kind
    raw = np.frombuffer(base64.b64decode(found["base64"]), dtype=f"<{kind}")
    np.testing.assert_allclose(raw, values, rtol=1e-7)


def test_the_plots_of_a_run_are_what_it_is_judged_by_and_all_its_signals(made_result):
    run = made_result(TIME, np.sin(TIME), plant_delta=3.0 * TIME, controller_voltage=2.0)
    run.units["plant.theta"] = "rad"
    plots = Plots({"run": run})
    plots.add_judged()
    plots.add_signals()
    assert [chart.label for chart in plots.charts] == [
        *("arm θ [rad]", "pendulum δ [rad]", "|q| [rad]", "voltage V [V]", "‖x‖_d")
    ]
    assert [chart.floor for chart in plots.charts] == [0.0, 0.0, 1e-16, 0.0, 1e-16]
    assert {curve.column for chart in plots.others for curve in chart.curves} == set(run.signals)
    assert plots.text(plots.charts[0]) == "arm θ [rad] over time; arm θ: from 0 to -0.536 rad, between -1 and 1 rad"
    drawn, said = plots.data({"run": "run.csv"})
    assert said == []
    assert len(drawn["charts"]) == len(plots.charts) + len(plots.others)


def test_a_plot_with_a_logarithmic_axis_needs_something_positive(made_result):
    plots = Plots({"run": made_result(TIME, controller_homogeneous_norm=0.0)})
    plots.add_judged()
    assert [chart.title for chart in plots.charts] == ["arm θ", "pendulum δ", "voltage V"]


def test_a_plot_says_what_lies_below_its_logarithmic_axis(made_result):
    runs = {name: made_result(TIME, controller_homogeneous_norm=1e3 * low) for name, low in (("LC", 0.5), ("IHC", 1.0))}
    runs["IHC"].signals["controller.homogeneous_norm"][9:] = np.logspace(-3, -60, 991)
    plots = Plots(runs)
    plots.add_judged()
    assert (plots.charts[-1].floor, plots.charts[-1].remark) == (
        1e-13,
        "On the lower edge, where it is 0 or below 1e-13: IHC.",
    )


def test_a_long_run_says_how_it_was_thinned(made_result):
    run = made_result(np.arange(200_000) * 1e-3)
    plots = Plots({"run": run})
    plots.add_signals()
    drawn, (said,) = plots.data({"run": "run.csv"})
    assert said.startswith(
        "The plots show two points for every 17 of the 200000 rows: the smallest and the largest value"
    )
    assert len(base64.b64decode(drawn["tables"][0]["time"]["base64"])) / 8 <= 24_000
