"""Names of start values without `start`, for each kind of component; refusals of what is no start value."""

import pytest

from cosim.errors import UserError
from cosim.scenario import load_scenario
from cosim.studies.entries import entry_of, variable_of


@pytest.fixture
def tilted(fmus):
    """The scenario `tilt` with a second pendulum, and the folders of its files."""
    scenario, folder = load_scenario("tilt")
    return scenario.changed({"components": {"other": {"fmu": "QubeServo2.fmu"}}}), fmus, folder


@pytest.mark.parametrize(
    ("name", "entry", "variable"),
    [
        ("plant.delta_0", "plant.start.delta_0", "delta_0"),
        ("plant.start.delta_0", "plant.start.delta_0", "delta_0"),
        ("controller.a_min", "controller.start.a_min", "a_min"),
        ("other.m_p", "components.other.start.m_p", "m_p"),
        ("components.other.start.m_p", "components.other.start.m_p", "m_p"),
        ("plant.parameters", "plant.parameters", None),
        ("run.step", "run.step", None),
        ("disturbance.gain", "disturbance.gain", None),
    ],
)
def test_start_values_are_named_without_start(tilted, name, entry, variable):
    assert entry_of(name, *tilted) == entry
    found = variable_of(entry, *tilted)
    assert (found and found.name) == variable


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("plant.delta0", "QubeServo2.fmu has no variable 'delta0'; did you mean delta_0 or"),
        ("plant.start", "'plant.start' is no entry of the scenario, but what has entries"),
        ("plnt.delta_0", "the scenario has no 'plnt', of which 'plnt.delta_0' is to be; did you mean plant?"),
        ("delta_0", "the scenario has no 'delta_0', of which 'delta_0' is to be"),
        ("plant.delta", "plant.delta is an output variable that the FMU calculates"),
    ],
)
def test_what_is_no_start_value_is_refused(tilted, name, sentence):
    with pytest.raises(UserError) as refusal:
        entry_of(name, *tilted)
    assert str(refusal.value).startswith(sentence)
