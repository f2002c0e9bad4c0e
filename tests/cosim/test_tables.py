"""Numbers as text: with the digits that their interval leaves; "better" only where it is decided; as HTML for notebooks."""

import math
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from cosim.metric_meanings import QUANTITIES
from cosim.metrics import Metrics
from cosim.results import Result
from cosim.scenario import Scenario
from cosim.studies.comparison import Comparison, Draw
from cosim.studies.estimates import MeanEstimate, change_text, estimate_text
from ihc_fmu.synthesis import synthesize
from ihc_fmu.system import System


def cells(html):
    """The cells of tables in HTML, a list for each row, read by a strict parser."""
    return [[cell.text or "" for cell in row] for row in ET.fromstring(f"<div>{html}</div>").iter("tr")]


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (5.944, 0.97, "5.9 ± 1.0"),
        (0.012512, 0.00038, "0.0125 ± 0.0004"),
        (0.012512, 0.00014, "0.01251 ± 0.00014"),
        (1858.2, 15.2, "1858 ± 15"),
        (1858.2, 0.0, "1858"),
        (0.5, math.nan, "0.5"),
        (math.nan, math.nan, "never"),
    ],
)
def test_a_mean_has_the_digits_that_its_interval_leaves(value, half, text):
    assert estimate_text(MeanEstimate(value, half), QUANTITIES["settling_time"].text) == text


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (-0.209, 0.041, "-21 ± 4 % better"),
        (0.09, 0.11, "+9 ± 11 % open"),
        (0.645, 0.002, "+64.5 ± 0.2 % worse"),
        (25.94, 0.48, "× 26.9 ± 0.5 worse"),
        (0.0, 0.0, "equal"),
        (-0.71562, 1e-17, "-71.6 % better"),
        (-0.58, math.nan, "-58 %"),
        (math.nan, math.nan, "–"),
    ],
)
def test_a_change_is_called_better_only_where_its_interval_decides(value, half, text):
    assert change_text(MeanEstimate(value, half)) == text


def test_a_design_is_a_table_in_a_notebook():
    system = System(A=np.eye(2, k=1), B=np.eye(2)[-1], K=np.array([-2.0, -3.0]), states=("a<b [m]", "v [m/s]"))
    design = synthesize(system)
    assert cells(design._repr_html_()) == [list(row) for row in design.summary()]
    assert ["states", "a<b [m], v [m/s]"] in cells(design._repr_html_())
    assert len(design.summary()) == 15


def test_a_result_is_its_metrics_in_a_notebook(made_result):
    judged = cells(made_result(np.linspace(0.0, 4.0, 401), 0.01)._repr_html_())
    assert ["steady RMS |q|", "0.01 rad"] in judged
    other = Result(np.arange(3.0), {"a.y": np.zeros(3)}, {"a.y": "m"}, {})
    assert cells(other._repr_html_()) == [["signal", "unit"], ["a.y", "m"]]
    assert repr(other) == "<Result: 3 rows until 2 s of a.y>"


def test_a_comparison_is_its_tables_in_a_notebook():
    numbers = (2.0, 0.01, 0.0123, 1.0, 0.7, 3.258, 36.1, 0.001, 1)
    metrics = Metrics(dict(zip(QUANTITIES, numbers, strict=True)), QUANTITIES)
    comparison = Comparison(Scenario(), tuple(Draw(law, None, True, metrics) for law in ("LC", "IHC")), {})
    found = cells(comparison._repr_html_())
    assert all(row in found for _, _, rows in comparison.tables() for row in rows)
    assert ["∫V² dt", "equal"] in found
    drawn = Comparison(Scenario(), comparison.draws, {law: Result(np.arange(1.0), {}, {}, {}) for law in ("LC", "IHC")})
    assert repr(drawn) == "<Comparison: scenario, LC, IHC, runs of each: 1>"
