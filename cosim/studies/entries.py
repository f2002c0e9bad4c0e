"""Names of what a study varies: entries of a scenario, of start values also without `start`, as `plant.delta_0`."""

from __future__ import annotations

from fmpy.model_description import ScalarVariable

from fmu_export.errors import shown
from fmu_export.files import FilePath
from fmu_export.variables import did_you_mean

from ..errors import UserError
from ..fmu_files import describe
from ..prepared import start_value
from ..scenario import Scenario
from ..scenario_files import check_fmus_exist, files
from ..start_values import not_settable
from ..wiring import CONTROLLER, PLANT


def entry_of(name: str, scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> str:
    """Return the scenario's entry that `name` means, see `Scenario.entry`.

    Raises UserError for a component that there is not, and for a variable that its FMU does not have, or that cannot be set.
    """
    entry = scenario.entry(name)
    variable_of(entry, scenario, fmus, folder)
    return entry


def variable_of(
    entry: str, scenario: Scenario, fmus: FilePath, folder: FilePath | None = None
) -> ScalarVariable | None:
    """Return the FMU's variable whose start value an entry is; None for another entry. Raises as `entry_of`."""
    component, variable = start_value(entry)
    if component in scenario.parts:
        return _variable(component, variable, scenario, fmus, folder)
    head, *rest = entry.removeprefix("components.").split(".")
    known = (*scenario.parts, *(field for field in type(scenario).model_fields if field not in (CONTROLLER, PLANT)))
    if component or head not in known:
        raise UserError(
            f"the scenario has no {shown(head)}, of which {shown(entry)} is to be{did_you_mean(head, known)}"
        )
    if not rest or (head in scenario.parts and rest == ["start"]):
        raise UserError(f"{shown(entry)} is no entry of the scenario, but what has entries")
    return None


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
