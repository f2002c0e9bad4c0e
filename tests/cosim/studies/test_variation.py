"""What --vary says: distributions with their quantiles in closed form, names, and what is refused in a sentence."""

import math

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.scenario import load_scenario
from cosim.studies.variation import Entries, variation_of
from plant_fmu.parameters import parameter_set

NORMAL_AT = {0.5: 0.0, 0.8413447460685429: 1.0}
"""Quantiles of the standard normal distribution."""


@pytest.fixture(scope="module")
def entries(fmus):
    scenario, folder = load_scenario("disturbed")
    return Entries(scenario, fmus, folder)


@pytest.mark.parametrize(
    ("spec", "quantiles"),
    [
        ("normal(3,2)", {u: 3.0 + 2.0 * z for u, z in NORMAL_AT.items()}),
        ("normal(-3,50%)", {u: -3.0 + 1.5 * z for u, z in NORMAL_AT.items()}),
        ("normal(5%)", {u: 0.024 * (1.0 + 0.05 * z) for u, z in NORMAL_AT.items()}),
        ("uniform(-1, 3)", {0.25: 0.0, 0.5: 1.0}),
        ("-1..3", {0.25: 0.0, 0.5: 1.0}),
        ("±10%", {0.0: 0.0216, 0.5: 0.024, 0.75: 0.0252}),
        ("+-10%", {0.75: 0.0252}),
        ("lognormal(2,1.2)", {u: 2.0 * 1.2**z for u, z in NORMAL_AT.items()}),
        ("lognormal(2,20%)", {u: 2.0 * 1.2**z for u, z in NORMAL_AT.items()}),
        ("lognormal(20%)", {u: 0.024 * 1.2**z for u, z in NORMAL_AT.items()}),
        ("loguniform(0.01,100)", {0.25: 0.1, 0.5: 1.0}),
    ],
    ids=str,
)
def test_a_distribution_has_the_quantiles_of_its_name(entries, spec, quantiles):
    found = variation_of("plant.m_p", spec, entries).drawn(np.array(list(quantiles)))
    np.testing.assert_allclose(found, list(quantiles.values()), rtol=1e-9, atol=1e-12)


def test_shares_at_the_ends_give_finite_numbers_and_every_value_of_a_list(entries):
    ends = np.array([0.0, np.nextafter(1.0, 0.0)])
    assert np.isfinite(variation_of("plant.m_p", "normal(1,1)", entries).drawn(ends)).all()
    listed = variation_of("plant.measurement", "encoders,ideal", entries)
    assert [listed.value(k) for k in listed.drawn(np.array([0.0, 0.49, 0.5, ends[1]]))] == [
        *["encoders"] * 2,
        *["ideal"] * 2,
    ]


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("plant.m_p", "plant.start.m_p"),
        ("plant.start.m_p", "plant.start.m_p"),
        ("controller.a_min", "controller.start.a_min"),
        ("plant.parameters", "plant.parameters"),
        ("run.step", "run.step"),
        ("disturbance.sines.0.amplitude", "disturbance.sines.0.amplitude"),
    ],
)
def test_start_values_have_short_names_and_entries_their_own(entries, name, path):
    assert entries.path(name) == path


def test_the_nominal_value_is_that_of_the_scenario_its_parameter_set_or_the_fmu(fmus):
    scenario, folder = load_scenario("tilt")
    entries = Entries(scenario.changed({"plant.parameters": "hcs", "plant.start.m_p": 0.03}), fmus, folder)
    hcs, own = parameter_set("hcs").parameters, parameter_set("ident").parameters
    assert hcs.J_r != own.J_r
    assert entries.nominal("plant.start.J_r") == hcs.J_r
    assert Entries(scenario, fmus, folder).nominal("plant.start.J_r") == own.J_r
    assert entries.nominal("plant.start.m_p") == 0.03
    assert (entries.nominal("plant.start.delta_0"), entries.nominal("run.step")) == (0.1, 1e-3)


@pytest.mark.parametrize(
    ("name", "spec", "sentence"),
    [
        ("plant.m_q", "1..2", "QubeServo2.fmu has no variable 'm_q'; did you mean m_p?"),
        ("plant", "1..2", "'plant' is no entry of the scenario, but what has entries"),
        ("plant.theta", "1..2", "no start value to set"),
        ("run.stp", "1,2", "the scenario has no such entry; did you mean step?"),
        ("signals.0.value", "1..2", "the scenario has no such entry"),
        ("evaluate.tolerance", "1..2", "what is judged and kept is the same in all runs"),
        ("controller.law", "LC,IHC", "--laws names the laws"),
        ("plant.m_p", "normal(1,0)", "takes a positive standard deviation, found 0"),
        ("plant.m_p", "normal(0,5%)", "takes a positive standard deviation, found 5% of 0"),
        ("plant.m_p", "normal(1)", r"takes normal\(mean,std\), found normal\(1\)"),
        ("plant.m_p", "norml(1,2)", "found 'norml'; did you mean normal"),
        ("plant.m_p", "normal(a,1)", "takes finite numbers, found 'a'"),
        ("plant.m_p", "2..1", "LOW below HIGH, found '2..1'"),
        ("plant.m_p", "loguniform(0,1)", "of positive numbers, found 0"),
        ("plant.m_p", "lognormal(1,0.5)", "takes a factor above 1"),
        ("plant.m_p", "±10", "takes a part in percent, such as 10%, found '10'"),
        ("plant.theta_0", "±10%", "the nominal value, which must be a number other than 0, found 0.0"),
        ("plant.m_p", "1", "takes at least two different values, found 1; --set fixes one"),
        ("plant.m_p", "1,1", "takes at least two different values"),
        ("plant.m_p", "1,,2", "values separated by commas, found '1,,2'"),
        ("plant.m_p", "[1],[2]", r"takes numbers, names, true or false, found \[1\]"),
        ("run.step", "0.001..0.002", "takes a list of values"),
        ("description", "a,b", "what is judged and kept"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(entries, name, spec, sentence):
    with pytest.raises(UserError, match=sentence):
        variation_of(name, spec, entries)


@pytest.mark.parametrize(
    ("name", "spec", "sentence"),
    [
        ("plant.m_p", "normal(0.024,200%)", r"m_p must lie in .* kg, found -"),
        ("plant.m_p", "1,a", "m_p must be a number, found 'a'"),
        ("plant.measurement", "ideal,none", "plant.measurement must be 'encoders' or 'ideal', found 'none'"),
        ("plant.parameters", "ident,foo", "plant.parameters must be one of "),
        ("controller.velocity_source", "0.1..0.2", "velocity_source is of type Enumeration"),
        ("run.step", "0.001,0.0033", "must be a multiple of the step"),
    ],
)
def test_values_that_an_entry_cannot_have_are_refused_before_anything_runs(entries, name, spec, sentence):
    found = variation_of(name, spec, entries)
    with pytest.raises(UserError, match=sentence):
        entries.check(found, found.values or found.drawn(np.array([0.01, 0.99])).tolist())


def test_numbers_reach_the_scenario_as_plain_ones(entries):
    found = variation_of("plant.m_p", "normal(1,1)", entries)
    (number,) = found.drawn(np.array([0.7]))
    assert type(found.value(number)) is float
    assert not math.isnan(found.value(number))
