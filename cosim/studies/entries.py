"""Names of what a study varies: entries of a scenario, of start values also without `start`, as `plant.delta_0`."""

from __future__ import annotations

from fmpy.model_description import ScalarVariable

from fmu_export.errors import shown
from fmu_export.files import FilePath
from fmu_export.variables import did_you_mean

from ..errors import UserError
from ..fmu_files import describe
from ..scenario import Scenario
from ..scenario_files import check_fmus_exist, files
from ..start_values import not_settable
from ..wiring import CONTROLLER, PLANT

START = "start"


def entry_of(name: str, scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> str:
    """Return the scenario's entry that `name` means: `plant.start.delta_0` also for `plant.delta_0`.

    An entry of the component's own section, such as `plant.fmu`, goes before a variable of that name. Raises UserError for
    a variable that the component's FMU does not have, or that cannot be set.
    """
    component, variable = _parted(name, scenario)
    if component is None:
        return name
    _variable(component, variable, scenario, fmus, folder)
    section = component if component in (CONTROLLER, PLANT) else f"components.{component}"
    return f"{section}.{START}.{variable}"


def variable_of(name: str, scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> ScalarVariable | None:
    """Return the FMU's variable whose start value an entry is; None for another entry. Raises as `entry_of`."""
    component, variable = _parted(name, scenario)
    return None if component is None else _variable(component, variable, scenario, fmus, folder)


def _parted(name: str, scenario: Scenario) -> tuple[str | None, str]:
    """Return the component and its variable that an entry names; (None, "") for an entry that is no start value."""
    head, _, rest = name.partition(".")
    if head == "components":
        head, _, rest = rest.partition(".")
    elif head in type(scenario).model_fields and head not in (CONTROLLER, PLANT):
        return None, ""
    part = scenario.parts.get(head)
    if part is None:
        known = (*scenario.parts, *(field for field in type(scenario).model_fields if field not in (CONTROLLER, PLANT)))
        raise UserError(
            f"the scenario has no {shown(head)}, of which {shown(name)} is to be{did_you_mean(head, known)}"
        )
    if not rest:
        raise UserError(f"{shown(name)} is no entry of the scenario, but what has entries")
    variable = rest.removeprefix(f"{START}.")
    return (None, "") if rest in type(part).model_fields and rest != START else (head, variable)


def _variable(component: str, name: str, scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> ScalarVariable:
    path = files(scenario, fmus, folder).fmus[component]
    check_fmus_exist({component: path})
    known = {v.name: v for v in describe(path).modelVariables}
    if name not in known:
        settable = [v for v in known if not_settable(known[v]) is None]
        raise UserError(f"{path.name} has no variable {shown(name)}{did_you_mean(name, settable)}")
    why = not_settable(known[name])
    if why is not None:
        raise UserError(f"{component}.{name} {why}")
    return known[name]
