"""A scenario prepared for many runs that differ in a few entries: found, wired and checked once, judged by its metrics."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import Any

from fmu_export.files import FilePath

from .errors import UserError
from .evaluation import Evaluation, pendulum_evaluation
from .judged_signals import check_judged
from .master import coupled, step_count
from .results import Result
from .rig import Progress, Rig
from .room import check_rows
from .scenario import Scenario
from .scenario_system import Plan
from .start_values import StartValue, StartValues
from .structure import Signal
from .wiring import SET_POINT

KEPT = 4
"""Forms of a scenario that are kept: they differ in more than start values and signals."""

_SIGNALS = ("disturbance.", "signals.")
_NAMES = ("name", "description")
_POINTS = (SET_POINT, "_equilibrium")
"""Ends of the names of start values by which errors are judged."""


class Prepared:
    """A scenario ready to run with changes of its entries, as `Scenario.changed` takes them.

    A result has what the metrics need, in every row, in arrays that the next run takes. Whether a controller fits the plant
    is checked without the start values that are changed. Not for several threads at a time; `close` in the end.
    """

    def __init__(self, scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> None:
        self.scenario, self.fmus, self.folder = scenario, fmus, folder
        self._forms: OrderedDict[str, _Form] = OrderedDict()

    def run(self, changes: Mapping[str, Any] | None = None, progress: Progress | None = None) -> Result:
        """Run once; raises as `build_system` and `simulate`, and UserError where there is nothing to judge."""
        start: dict[str, dict[str, StartValue]] = {}
        signals, others = {}, {}
        seed = self.scenario.run.seed
        for entry, value in (changes or {}).items():
            component, variable = start_value(entry)
            if variable:
                start.setdefault(component, {})[variable] = value
            elif entry == "run.seed":
                seed = value
            elif entry.startswith(_SIGNALS):
                signals[entry] = value
            elif entry not in _NAMES:
                others[entry] = value
        form = self._form(others)
        driven = form.driven(signals) if signals else form.signals
        if driven is None:
            form = self._form(others | signals)
            driven = form.signals
        return form.run(start, seed, driven, progress)

    def close(self) -> None:
        """Give the FMUs' libraries back."""
        for form in self._forms.values():
            form.rig.close()
        self._forms.clear()

    def _form(self, changes: Mapping[str, Any]) -> _Form:
        """Return the form with these changes; the last ones are kept."""
        key = json.dumps(changes, sort_keys=True, default=str)
        form = self._forms.pop(key, None)
        if form is None:
            scenario = self.scenario.changed(changes) if changes else self.scenario
            form = _Form(scenario, self.fmus, self.folder)
            if len(self._forms) >= KEPT:
                self._forms.popitem(last=False)[1].rig.close()
        self._forms[key] = form
        return form


def start_value(entry: str) -> tuple[str, str]:
    """Return component and variable of an entry `component.start.variable`; empty texts for another entry."""
    component, start, variable = entry.removeprefix("components.").partition(".start.")
    return (component, variable) if start and "." not in component else ("", "")


class _Form:
    """A scenario's rig, for runs that differ in start values, signals and seed."""

    def __init__(self, scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> None:
        self.scenario, self.place = scenario, (fmus, folder)
        self.plan = Plan(scenario, fmus, folder)
        system = self.plan.system()
        coupling, engine = coupled(system, scenario.run.engine)
        known = coupling.checked_outputs(scenario.record.outputs)
        self.evaluation = self.plan.evaluation() or pendulum_evaluation(known)
        check_judged(known, self.evaluation, fmus)
        self.signals = list(system.signals)
        run = scenario.run
        steps = step_count(run.step, run.duration)
        check_rows(steps + 2, len(self.evaluation.signals), 1)
        self.rig = Rig(coupling, self.evaluation.signals, run.step, steps, run.order, engine, reuse=True)
        self._raw = {component.name: component.start for component in system.components}

    def driven(self, changes: Mapping[str, Any]) -> list[Signal] | None:
        """Return the signals with changed entries; None where they are on other inputs then."""
        signals = Plan(self.scenario.changed(changes), *self.place).signals()
        known, new = ([(s.target, s.recorded) for s in some] for some in (self.signals, signals))
        return signals if new == known else None

    def run(
        self,
        changes: Mapping[str, Mapping[str, StartValue]],
        seed: int | None,
        signals: Sequence[Signal],
        progress: Progress | None,
    ) -> Result:
        """Run once with changed start values."""
        unknown = changes.keys() - self._raw.keys()
        if unknown:
            raise UserError(f"the scenario has no component {min(unknown)!r}")
        start = {name: self._start(name, changes.get(name, {}), seed) for name in self._raw}
        evaluation = self._evaluation(changes)
        return self.rig.run(start, {"step": self.rig.step}, progress, signals, evaluation)

    def _start(self, name: str, changes: StartValues, seed: int | None) -> StartValues:
        """Return the checked start values of a component."""
        checked = self.rig.coupling.start[name]
        if not changes and seed == self.scenario.run.seed:
            return checked
        raw = self.plan.start(name, {**self.scenario.parts[name].start, **changes}, seed)
        before = self._raw[name]
        new = {v: value for v, value in raw.items() if v not in before or before[v] is not value}
        new = self.rig.instances[name].checked_start(new)
        return {v: new[v] if v in new else checked[v] for v in raw}

    def _evaluation(self, changes: Mapping[str, Mapping[str, StartValue]]) -> Evaluation:
        """Return what a run is judged by, whose set-points may be start values."""
        entries = {
            f"{'' if hasattr(self.scenario, name) else 'components.'}{name}.start.{variable}": value
            for name, values in changes.items()
            for variable, value in values.items()
            if variable.endswith(_POINTS)
        }
        if not entries:
            return self.evaluation
        changed = Plan(self.scenario.changed(entries), *self.place).evaluation()
        return changed or pendulum_evaluation(self.evaluation.signals)
