"""What the runs of a system are judged by: errors with their set-points, controls, the controller's modes.

A scenario may say it under `evaluate`; what it does not say follows from its wires. The result keeps what was found, under
`evaluation` in its metadata, so that a table of numbers can be judged anywhere. A result that keeps nothing is taken for the
pendulum's.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StrictBool, StrictInt, StrictStr, field_validator, model_validator

from fmu_export.units import same_unit
from fmu_export.variables import did_you_mean
from ihc_fmu.pendulum.interface import MODES

from .errors import UserError
from .structure import Signal, Wire
from .typed import Finite, Positive, checked
from .unit_definitions import NO_UNIT, unit_in, unit_of
from .wiring import CONTROLLER, SET_POINT, Variables

TOLERANCE = 0.02
"""|e| within which a run of the pendulum counts as settled [rad]."""
SHARE = 0.02
"""The same of any other plant, relative to the largest |e|, where nothing else is said."""

ACTING = "stabilizing"
"""The item of the controller's `mode` in which the law acts."""
SWING_UP = "swing_up"
"""The item of a controller that first brings the plant to where the law can act."""

TRUE = "_true"
"""How the names of a LinearPlant's states end that are also measured: they have the set-point of what is measured."""


class EvaluateSection(BaseModel):
    """What is judged."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    errors: tuple[str, ...] | None = Field(
        None,
        description="signals that should be 0, or at their set-points; none: those that are wired to the controller, where "
        "a set-point is given those that have one",
    )
    controls: tuple[str, ...] | None = Field(
        None, description="signals whose size and variation cost; none: the controller's outputs that are wired"
    )
    scales: tuple[Positive, ...] | None = Field(
        None,
        description="for each error what counts as equally large, in its unit: |e|^2 is then the sum of (e_i/scale_i)^2; "
        "none: errors of one unit are added, those of different units stand side by side",
    )
    tolerance: Positive | None = Field(
        None,
        description="|e| within which a run counts as settled, in its unit, 1 with scales; none: "
        f"{100 * SHARE:g} % of the largest |e| in the run as the scenario has it, of the pendulum {TOLERANCE:g} rad",
    )
    tolerances: tuple[Positive, ...] | None = Field(
        None, description="a tolerance for each |e| in its place, where errors stand side by side"
    )

    @field_validator("errors", "scales", "tolerances")
    @classmethod
    def _some(cls, value: tuple[Any, ...] | None) -> tuple[Any, ...] | None:
        if value == ():
            raise ValueError("must have at least one entry, found none")
        return value


class _Part(BaseModel, frozen=True, extra="ignore"):
    """Of metadata only what is used is looked at."""


class ErrorSignal(_Part, frozen=True):
    """e = factor signal + offset - set-point, in `unit`.

    The set-point is point_factor times a signal of the result plus point_offset, or a constant.

    `wraps`: an angle [rad] of which whole turns do not count, e in (-pi, pi]. `label` names it in pictures.
    """

    signal: StrictStr
    unit: StrictStr = NO_UNIT
    label: StrictStr = ""
    factor: Finite = 1.0
    offset: Finite = 0.0
    set_point: StrictStr | None = None
    point_factor: Finite = 1.0
    point_offset: Finite = 0.0
    constant: Finite = 0.0
    wraps: StrictBool = False

    @property
    def name(self) -> str:
        """How the error is called in pictures."""
        return self.label or self.signal


class ControlSignal(_Part, frozen=True):
    """A control in `unit`; `label` names it in pictures."""

    signal: StrictStr
    unit: StrictStr = NO_UNIT
    label: StrictStr = ""

    @property
    def name(self) -> str:
        """How the control is called in pictures."""
        return self.label or self.signal


class ModeSignal(_Part, frozen=True):
    """The signal that says in which mode the controller is, and the names of its values."""

    signal: StrictStr
    items: tuple[tuple[StrictInt, StrictStr], ...]

    def value(self, name: str) -> int | None:
        """Return the value of a mode; None where the controller has none of that name."""
        return next((value for value, item in self.items if item == name), None)

    @property
    def names(self) -> dict[int, str]:
        """The modes' names by their values."""
        return dict(self.items)


class Evaluation(_Part, frozen=True):
    """What a run is judged by. `kind`: the pendulum has names of its own for its metrics.

    `tolerance` is that of each group of errors, `tolerances` one for each; None both: see `metrics.with_tolerances`.
    """

    kind: Literal["pendulum", "general"] = "general"
    errors: tuple[ErrorSignal, ...] = ()
    controls: tuple[ControlSignal, ...] = ()
    scales: tuple[Positive, ...] | None = None
    tolerance: Positive | None = TOLERANCE
    tolerances: tuple[Positive, ...] | None = None
    mode: ModeSignal | None = None
    norm: StrictStr | None = None

    @model_validator(mode="after")
    def _a_scale_each(self) -> Self:
        if self.scales is not None and len(self.scales) != len(self.errors):
            names = ", ".join(error.signal for error in self.errors)
            raise ValueError(f"must have a scale for each of the errors {names}, found {len(self.scales)}")
        groups = len(self.error_groups)
        if self.tolerances is not None and len(self.tolerances) != groups:
            raise ValueError(f"must have a tolerance for each of {groups} |e|, found {len(self.tolerances)}")
        return self

    @property
    def settled(self) -> tuple[float | None, ...]:
        """|e| within which a run counts as settled, for each group of errors; None: not known before a run."""
        return self.tolerances or (self.tolerance,) * len(self.error_groups)

    @property
    def signals(self) -> list[str]:
        """The names of all signals that it needs."""
        points = [error.set_point for error in self.errors if error.set_point is not None]
        mode = [] if self.mode is None else [self.mode.signal]
        return list(
            dict.fromkeys([*(c.signal for c in self.controls), *mode, *(e.signal for e in self.errors), *points])
        )

    @property
    def error_groups(self) -> dict[str, tuple[int, ...]]:
        """The numbers of the errors that are judged together, by the suffix of their metrics' names."""
        if self.scales is not None:
            return {"": tuple(range(len(self.errors)))}
        return _groups([(error.signal, error.unit) for error in self.errors])

    @property
    def control_groups(self) -> dict[str, tuple[int, ...]]:
        """The numbers of the controls that add up, by the suffix of their metrics' names."""
        return _groups([(control.signal, control.unit) for control in self.controls])

    def error_unit(self, group: Sequence[int]) -> str:
        """Return the unit of a group's |e|."""
        return NO_UNIT if self.scales is not None else self.errors[group[0]].unit


def _groups(signals: Sequence[tuple[str, str]]) -> dict[str, tuple[int, ...]]:
    """Return one group of what has one unit, otherwise a group for each signal, with its name in brackets."""
    if all(same_unit(unit, signals[0][1]) for _, unit in signals):
        return {"": tuple(range(len(signals)))} if signals else {}
    return {f"[{signal}]": (k,) for k, (signal, _) in enumerate(signals)}


_ANGLES = {"theta": "arm θ", "delta": "pendulum δ"}
_MODES = tuple(enumerate(MODES, start=1))


ARM_SET_POINT = f"theta{SET_POINT}"
"""The input of the pendulum's controller that says where its arm is to be held."""


def pendulum_evaluation(known: Container[str], arm: str | float = 0.0) -> Evaluation:
    """Return the pendulum's evaluation: of the true angles where both are `known`, of the measured ones otherwise.

    `arm` is the set-point of the arm's angle: the name of a signal, or a number [rad].
    """
    missing = {suffix: sum(f"plant.{angle}{suffix}" not in known for angle in _ANGLES) for suffix in ("_encoder", "")}
    suffix = "" if missing[""] == 0 else min(missing, key=lambda s: missing[s])
    points: dict[str, Any] = {"theta": {"set_point": arm} if isinstance(arm, str) else {"constant": arm}}
    return Evaluation(
        kind="pendulum",
        errors=tuple(
            ErrorSignal(
                signal=f"plant.{angle}{suffix}",
                unit="rad",
                label=label,
                wraps=angle == "delta",
                **points.get(angle, {}),
            )
            for angle, label in _ANGLES.items()
        ),
        controls=(ControlSignal(signal="controller.voltage", unit="V", label="voltage V"),),
        mode=ModeSignal(signal="controller.mode", items=_MODES),
        norm="controller.homogeneous_norm",
    )


def evaluation_of(
    section: EvaluateSection,
    variables: Mapping[str, Variables],
    start: Mapping[str, Mapping[str, Any]],
    wires: Sequence[Wire],
    signals: Sequence[Signal],
    angles: Sequence[str] = (),
) -> Evaluation:
    """Return what a system's runs are judged by; without errors where the controller gets no signal and none is named.

    `variables` and `start` (all start values) are by component; `angles` are signals of which whole turns do not count, and
    that stand for what is measured of them, as plant.theta for plant.theta_encoder. Raises UserError for signals that do
    not exist.
    """
    find = _Found(variables, start, wires, {s.target for s in signals if s.recorded}, angles)
    errors = find.judged if section.errors is None else section.errors
    controls = find.acting if section.controls is None else section.controls
    labels = _labels([*errors, *controls])
    return checked(
        Evaluation,
        {
            "errors": [{**find.error(name), "label": labels[name]} for name in errors],
            "controls": [{"signal": c, "unit": find.unit(c, "controls"), "label": labels[c]} for c in controls],
            "scales": section.scales,
            "tolerance": section.tolerance or (TOLERANCE if angles and section.tolerances is None else None),
            "tolerances": section.tolerances,
            "mode": find.mode(),
            "norm": find.norm(),
        },
        "evaluate",
    )


def _labels(names: Sequence[str]) -> dict[str, str]:
    """Return what signals are called in pictures: without their component where that leaves them different."""
    different = list(dict.fromkeys(names))
    short = [name.partition(".")[2] for name in different]
    return {name: own if own and short.count(own) == 1 else name for name, own in zip(different, short, strict=True)}


class _Found:
    """A system's signals: those that the controller is given and gives, those that are named."""

    def __init__(
        self,
        variables: Mapping[str, Variables],
        start: Mapping[str, Mapping[str, Any]],
        wires: Sequence[Wire],
        driven: set[str],
        angles: Sequence[str],
    ) -> None:
        self.variables, self.start, self.wires, self.driven, self.angles = variables, start, wires, driven, angles
        self.sources = {w.target: w for w in wires}
        true = {f"{angle}_encoder": angle for angle in angles}
        to_controller = [w for w in wires if _component(w.target) == CONTROLLER and not w.target.endswith(SET_POINT)]
        self.given = {true.get(w.source, w.source): w for w in to_controller if self._is_real(w.source)}

    @property
    def judged(self) -> list[str]:
        """The real numbers that the controller is given; those that have a set-point where one of them is told its own.

        The state at rest under a set-point moves the other outputs off the equilibrium, except the pendulum's.
        """
        points = {name: f"{wire.target.partition('.')[2]}{SET_POINT}" for name, wire in self.given.items()}
        held = [name for name, point in points.items() if point in self.variables[CONTROLLER]]
        return held if not self.angles and any(self._is_told(points[name]) for name in held) else list(self.given)

    def _is_told(self, point: str) -> bool:
        """Return whether a set-point has a wire or a signal, or starts beside the equilibrium."""
        target, own = f"{CONTROLLER}.{point}", self.start.get(CONTROLLER, {})
        rest = own.get(f"{point.removesuffix(SET_POINT)}_equilibrium", 0.0)
        return target in self.sources or target in self.driven or own.get(point, rest) != rest

    @property
    def acting(self) -> list[str]:
        """The real numbers that the controller gives to others."""
        given = [w.source for w in self.wires if _component(w.source) == CONTROLLER != _component(w.target)]
        return [name for name in dict.fromkeys(given) if self._is_real(name)]

    def unit(self, name: str, entry: str) -> str:
        """Return the unit of a signal that can be recorded; raise UserError for another name, found in `entry`."""
        component, _, variable = name.partition(".")
        known = self.variables.get(component, {})
        if variable not in known:
            raise UserError(f"evaluate.{entry} names {name!r}, which is no variable{did_you_mean(variable, known)}")
        declared = known[variable]
        if declared.causality != "output" and name not in self.driven:
            raise UserError(
                f"evaluate.{entry} takes outputs, and inputs with a signal; {name} is an {declared.causality}"
            )
        if declared.type == "String":
            raise UserError(f"evaluate.{entry} takes numbers; {name} is a String")
        return unit_in(name, self.variables, self.wires)

    def error(self, name: str) -> dict[str, Any]:
        """Return an error's description: as the controller is given it, less its set-point."""
        description: dict[str, Any] = {"signal": name, "unit": self.unit(name, "errors"), "wraps": name in self.angles}
        wire = self.given.get(name, self.given.get(name.removesuffix(TRUE)))
        if wire is None:
            return description
        variable = wire.target.partition(".")[2]
        if wire.converts:
            seen = unit_of(self.variables[CONTROLLER][variable])
            description |= {"factor": wire.factor, "offset": wire.offset, "unit": seen}
        return description | self._set_point(variable)

    def _set_point(self, variable: str) -> dict[str, Any]:
        """Return where the set-point of what the controller is given as `variable` comes from."""
        point = f"{variable}{SET_POINT}"
        feed = self.sources.get(f"{CONTROLLER}.{point}")
        if feed is not None:
            return {"set_point": feed.source, "point_factor": feed.factor, "point_offset": feed.offset}
        if f"{CONTROLLER}.{point}" in self.driven:
            return {"set_point": f"{CONTROLLER}.{point}"}
        own = self.start.get(CONTROLLER, {})
        return {"constant": float(own.get(point, own.get(f"{variable}_equilibrium", 0.0)))}

    def mode(self) -> dict[str, Any] | None:
        """Return the controller's output `mode` with the names of its values; None where it has none."""
        mode = self.variables.get(CONTROLLER, {}).get("mode")
        items = getattr(getattr(mode, "declaredType", None), "items", None) or ()
        if mode is None or mode.causality != "output" or not items:
            return None
        return {"signal": f"{CONTROLLER}.mode", "items": [(int(item.value), item.name) for item in items]}

    def norm(self) -> str | None:
        """Return the controller's homogeneous norm; None where it has none."""
        norm = self.variables.get(CONTROLLER, {}).get("homogeneous_norm")
        return f"{CONTROLLER}.homogeneous_norm" if norm is not None and norm.causality == "output" else None

    def _is_real(self, name: str) -> bool:
        component, _, variable = name.partition(".")
        declared = self.variables.get(component, {}).get(variable)
        return declared is None or declared.type == "Real"


def _component(name: str) -> str:
    return name.partition(".")[0]
