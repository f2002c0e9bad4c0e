"""Cases: what a tuned point is run in besides its scenario as it stands, and objectives that are of one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fmu_export.errors import shown
from fmu_export.files import FilePath

from .. import pendulum
from ..errors import UserError
from ..metric_meanings import MetricMeaning
from ..scenario import Scenario
from ..scenario_system import controller_values
from .numbers import Numbers

OF = "@"
"""Between a metric and the case that it is of."""
FIRST = 2.5
"""Communication steps within which a law acts from the start: one of them is the coupling's."""

Runs = Mapping[str, Sequence[Numbers]]
"""The numbers of each draw by the case's name."""


@dataclass(frozen=True)
class Case:
    """A case: its name and what it changes in the scenario.

    `rest`: it must be brought to rest in every draw, whatever the LC does, and nothing is measured; otherwise it must be
    kept in no fewer draws than the LC keeps it.
    """

    name: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    rest: bool = False


AS_IT_STANDS = Case("")
"""The scenario itself."""


@dataclass(frozen=True)
class Objective:
    """A metric that is to be small, in a case; "" for the scenario as it stands."""

    quantity: MetricMeaning
    case: str = AS_IT_STANDS.name

    @property
    def name(self) -> str:
        """The metric's name, with its case's."""
        return f"{self.quantity.name}{OF}{self.case}" if self.case else self.quantity.name

    @property
    def symbol(self) -> str:
        """The metric's symbol, with its case's name."""
        return f"{self.quantity.symbol}, {self.case}" if self.case else self.quantity.symbol

    @property
    def heading(self) -> str:
        """The symbol with its unit."""
        return f"{self.symbol} [{self.quantity.unit}]" if self.quantity.unit else self.symbol


def cases_of(texts: Sequence[tuple[str, Any]], held: Sequence[tuple[str, Any]]) -> tuple[Case, ...]:
    """Return the cases besides the scenario as it stands.

    Parameters
    ----------
    texts
        Entries NAME:ENTRY and their values; those of one name are one case.
    held
        Entries and values, each a case that must be brought to rest.

    Raises
    ------
    UserError
        For an entry without a name, and one that is given twice.
    """
    changes: dict[str, dict[str, Any]] = {}
    for text, value in texts:
        name, colon, entry = (part.strip() for part in text.partition(":"))
        if not colon or not name.replace("_", "").replace("-", "").isalnum() or not entry:
            raise UserError(
                f"--case takes NAME:ENTRY=VALUE with a name of letters, digits, - and _, found {shown(text)}"
            )
        if entry in changes.setdefault(name, {}):
            raise UserError(f"--case gives {entry} twice in {name}")
        changes[name][entry] = value
    rests = [Case(f"{entry}={value}", {entry: value}, rest=True) for entry, value in held]
    if len({case.name for case in rests}) < len(rests):
        raise UserError("--hold gives the same entry and value twice")
    return (*(Case(name, entries) for name, entries in changes.items()), *rests)


def without_supervisor(scenario: Scenario, fmus: FilePath, folder: FilePath | None) -> dict[str, Any]:
    """Return what lets the pendulum's law act from the first sample on, within `fall_back_angle`; of others nothing."""
    own = controller_values(scenario, fmus, folder)
    if not pendulum.is_controller(own):
        return {}
    own = {**own, **scenario.controller.start}
    values = {**pendulum.ALWAYS_CAPTURED, "capture_angle": own["fall_back_angle"]}
    return {f"controller.start.{name}": value for name, value in values.items()}
