"""What a sweep varies: entries of a scenario, by distributions or lists of values, as the command line writes them.

    normal(0.024,5%)      mean and standard deviation, or its part of the mean; normal(5%): about the nominal value
    uniform(0.2,1)        also 0.2..1; ±10%, or +-10%: about the nominal value
    lognormal(2,1.2)      median and geometric standard deviation, 20% for 1.2; lognormal(20%): about the nominal value
    loguniform(0.1,10)    uniform in its logarithm
    0.2,0.5,1             values in a list, of numbers or of others

The nominal value of an entry is that of the scenario, or of the FMU where the scenario has none.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fmu_export.errors import UserError, shown
from fmu_export.files import FilePath
from fmu_export.variables import did_you_mean

from ..fmu_files import describe, start_values_of
from ..scenario import Scenario
from ..scenario_system import build_system
from ..start_values import as_value
from ..typed import value_of
from ..unit_definitions import NO_UNIT, unit_of
from .entries import entry_of
from .experiments import LAW
from .ranges import SEPARATOR, range_of

Array = np.ndarray

LEAST_SHARE = 2.0**-53
"""What a share of a distribution is kept away from 0 and 1 by, where normal ones are infinite."""

FIXED = ("name", "description", "evaluate", "record", "animation", "wires")
"""Sections that a sweep does not vary: what is judged and kept is the same in all runs."""

LISTED = ("run",)
"""Sections whose entries take lists only: steps must divide the duration, seeds are whole."""

Quantile = Callable[[Array], Array]


@dataclass(frozen=True)
class Variation:
    """One entry that is varied: its name and specification as they were given, its path in the scenario.

    Either `values`, a list of any kind, or `quantile`, which maps shares in (0, 1) to numbers.
    """

    name: str
    path: str
    spec: str
    values: tuple[Any, ...] = ()
    quantile: Quantile | None = None
    logarithmic: bool = False

    def drawn(self, shares: Array) -> Array:
        """Return the numbers of shares in [0, 1), or of a list the numbers of its values, counted from 0."""
        if self.quantile is None:
            return np.minimum((shares * len(self.values)).astype(np.intp), len(self.values) - 1)
        return self.quantile(np.clip(shares, LEAST_SHARE, 1.0 - LEAST_SHARE))

    def value(self, drawn: Any) -> Any:
        """Return what a scenario takes of something drawn."""
        return self.values[int(drawn)] if self.quantile is None else float(drawn)


class Entries:
    """The entries of a scenario by the names under which they can be varied, with their nominal values."""

    def __init__(self, scenario: Scenario, fmus: FilePath, folder: FilePath | None = None) -> None:
        self.scenario, self._place = scenario, (fmus, folder)
        self._variables, self._start = {}, {}
        for component in build_system(scenario, fmus, folder).components:
            path = Path(component.path)
            self._variables[component.name] = {v.name: v for v in describe(path).modelVariables}
            self._start[component.name] = {**start_values_of(path), **component.start}
        self._data: Mapping[str, Any] = scenario.model_dump(mode="json")

    def path(self, name: str) -> str:
        """Return the path of an entry, see `entries.entry_of`.

        Raises UserError where there is no such entry, or one that a sweep does not vary.
        """
        if name.partition(".")[0] in FIXED:
            raise UserError(f"--vary cannot vary {name}: what is judged and kept is the same in all runs")
        try:
            path = entry_of(name, self.scenario, *self._place)
        except UserError as error:
            raise UserError(f"--vary {name}: {error}") from None
        if path == LAW:
            raise UserError("--vary cannot vary the controller's law; --laws names the laws that run side by side")
        if self._variable(path) is None:
            self._look(path)
        return path

    def _look(self, path: str) -> Any:
        """Return the value of an entry of the scenario; raise UserError where there is none."""
        place: Any = self._data
        for part in path.split("."):
            if isinstance(place, Mapping) and part in place:
                place = place[part]
            elif isinstance(place, list) and part.isdigit() and int(part) < len(place):
                place = place[int(part)]
            else:
                known = [*self._data, *self._variables] if place is self._data else place
                near = did_you_mean(part, known) if isinstance(known, Mapping) or place is self._data else ""
                raise UserError(f"--vary {path}: the scenario has no such entry{near}")
        return place

    def nominal(self, path: str) -> Any:
        """Return the value of an entry as the scenario stands."""
        variable = self._variable(path)
        return self._look(path) if variable is None else self._start[variable[0]].get(variable[1].name)

    def _variable(self, path: str) -> tuple[str, Any] | None:
        """Return the component and the variable of a start value's path; None for another entry."""
        parts = path.removeprefix("components.").split(".", 2)
        if len(parts) < 3 or parts[0] not in self._variables or parts[1] != "start":
            return None
        return parts[0], self._variables[parts[0]][parts[2]]

    def unit(self, path: str) -> str:
        """Return the unit of a start value; that of another entry is not known."""
        variable = self._variable(path)
        return NO_UNIT if variable is None else unit_of(variable[1])

    def check(self, variation: Variation, ends: Sequence[Any]) -> None:
        """Raise UserError where one of `ends`, its values or the outermost of them, cannot be that of the entry."""
        found = self._variable(variation.path)
        if found is not None and variation.quantile is not None and found[1].type != "Real":
            raise UserError(
                f"--vary {variation.name} takes a list of values, since {found[1].name} is of type {found[1].type}"
            )
        for value in ends:
            try:
                if found is not None:
                    as_value(found[1], value)
                self.scenario.changed({variation.path: value})
            except UserError as error:
                hint = "; uniform and lognormal ones stay within limits" if variation.spec.startswith("normal") else ""
                rule = str(error).removeprefix(f"{self.scenario.name}: ")
                raise UserError(f"--vary {variation.name} draws a value that cannot be: {rule}{hint}") from None


def variation_of(name: str, spec: str | Sequence[Any], entries: Entries) -> Variation:
    """Return the variation of the entry `name` by `spec`, a text as above or a list of values.

    Raises UserError for what it cannot be.
    """
    name = name.strip()
    path, what = entries.path(name), f"--vary {name}"
    if not isinstance(spec, str):
        return Variation(name, path, ",".join(map(str, spec)), _listed(tuple(spec), what))
    text = spec.strip()
    relative = re.fullmatch(r"(?:±|\+-|\+/-)\s*(.+)", text)
    call = re.fullmatch(r"([A-Za-z_]+)\s*\((.*)\)", text)
    if not (relative or call or SEPARATOR in text):
        texts = [part.strip() for part in text.split(",")]
        if not all(texts):
            raise UserError(f"{what} takes a distribution, a range or values separated by commas, found {spec!r}")
        return Variation(name, path, text, _listed(tuple(value_of(part, what) for part in texts), what))
    if path.startswith(tuple(f"{section}." for section in LISTED)):
        raise UserError(f"{what} takes a list of values, such as 0.001,0.002, found {spec!r}")
    nominal = entries.nominal(path)
    if isinstance(nominal, str | bool | Mapping | list):
        raise UserError(f"{what} takes a list of values, since {path} is {shown(nominal)}, found {spec!r}")
    if relative:
        part, about = _part(relative[1], what), _nominal(nominal, what)
        return Variation(name, path, text, quantile=_uniform(about - part * abs(about), about + part * abs(about)))
    if call is None:
        ends = range_of(text, what)
        return Variation(name, path, text, quantile=_uniform(ends.low, ends.high))
    arguments = [argument.strip() for argument in call[2].split(",")]
    logarithmic = call[1].startswith("log")
    return Variation(name, path, text, quantile=_called(call[1], arguments, nominal, what), logarithmic=logarithmic)


def _listed(values: tuple[Any, ...], what: str) -> tuple[Any, ...]:
    if len(values) < 2 or len({repr(value) for value in values}) < len(values):
        raise UserError(
            f"{what} takes at least two different values, found {', '.join(map(shown, values)) or 'none'}; --set fixes one"
        )
    for value in values:
        if not isinstance(value, bool | int | float | str):
            raise UserError(f"{what} takes numbers, names, true or false, found {shown(value)}")
    return values


def _called(kind: str, arguments: list[str], nominal: Any, what: str) -> Quantile:
    if kind not in FORMS:
        near = did_you_mean(kind, FORMS)
        raise UserError(f"{what} takes one of {', '.join(FORMS.values())}, found {kind!r}{near}")
    about = kind in ("normal", "lognormal") and len(arguments) == 1 and arguments[0].endswith("%")
    if len(arguments) != (1 if about else 2) or not all(arguments):
        raise UserError(f"{what} takes {FORMS[kind]}, found {kind}({','.join(arguments)})")
    if kind in ("uniform", "loguniform"):
        ends = range_of(SEPARATOR.join(arguments), what)
        if kind == "uniform":
            return _uniform(ends.low, ends.high)
        if ends.low <= 0.0:
            raise UserError(f"{what} takes loguniform(a,b) of positive numbers, found {ends.low:g}")
        logarithm = _uniform(math.log(ends.low), math.log(ends.high))
        return lambda u: np.exp(logarithm(u))
    centre = _nominal(nominal, what) if about else _number(arguments[0], what)
    width = arguments[-1]
    if kind == "normal":
        std = _part(width, what) * abs(centre) if width.endswith("%") else _number(width, what)
        if not std > 0.0:
            raise UserError(f"{what} takes a positive standard deviation, found {width}{_of(width, centre)}")
        return lambda u: centre + std * _normal(u)
    factor = 1.0 + _part(width, what) if width.endswith("%") else _number(width, what)
    if not factor > 1.0:
        raise UserError(f"{what} takes a factor above 1, or a part such as 20%, found {width}")
    if not centre > 0.0:
        raise UserError(f"{what} takes lognormal(median,factor) with a positive median, found {centre:g}")
    return lambda u: centre * factor ** _normal(u)


FORMS = {
    "normal": "normal(mean,std)",
    "uniform": "uniform(a,b)",
    "lognormal": "lognormal(median,factor)",
    "loguniform": "loguniform(a,b)",
}
"""The distributions, and how they are written."""


def _uniform(low: float, high: float) -> Quantile:
    return lambda u: low + (high - low) * u


def _normal(u: Array) -> Array:
    from scipy.special import ndtri  # noqa: PLC0415 - heavy

    return ndtri(u)


def _of(width: str, centre: float) -> str:
    return f" of {centre:g}" if width.endswith("%") else ""


def _nominal(nominal: Any, what: str) -> float:
    if not isinstance(nominal, int | float) or isinstance(nominal, bool) or nominal == 0.0:
        raise UserError(
            f"{what} is about the nominal value, which must be a number other than 0, found {shown(nominal)}"
        )
    return float(nominal)


def _number(text: str, what: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UserError(f"{what} takes finite numbers, found {text!r}")
    return number


def _part(text: str, what: str) -> float:
    """Return a part of 1, written in percent."""
    if not text.endswith("%"):
        raise UserError(f"{what} takes a part in percent, such as 10%, found {text!r}")
    part = _number(text[:-1].strip(), what) / 100.0
    if not part > 0.0:
        raise UserError(f"{what} takes a positive part, found {text!r}")
    return part
