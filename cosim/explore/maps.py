"""Maps beside the curves: a region of attraction, a front. A click in them sets values, marks in them show what is set.

A map is drawn by `map.js`, in shares of the axes: 0 at the left and the lower end, 1 at the right and the upper one.
"""

from __future__ import annotations

import itertools
import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmu_export.errors import UserError

from ..metric_meanings import MetricMeaning
from ..plots import COLOURS, OTHERS, colours
from ..scenario import Scenario
from ..studies.cases import OF, Objective
from ..studies.pareto_front import DOMINATED, FRONT, LC, LOST, RETUNED, RULE
from ..studies.region_map import CERTIFIED_LAWS
from ..unit_definitions import with_unit
from .adjustables import Adjustable, Group, Slider, decided, step_of
from .map_drawing import Scale, gradient, image, outline, polyline, scale_of
from .study_files import AxisFile, ReadFront, ReadPoint, ReadRegion, read_front, read_region

Array = np.ndarray

BEATEN = "#999999"

Metrics = Mapping[str, Mapping[str, float]]
"""Of the run that is shown, by law and name."""


class RegionMap:
    """Where a law brings the plant to rest; a click sets the initial state."""

    title = "region of attraction"

    def __init__(self, region: ReadRegion, members: Mapping[str, Adjustable], base: Scenario, path: Path) -> None:
        self.region = region
        self.axes = [_slider_of(axis, members, path) for axis in region.axes]
        self.laws = list(region.settling)
        times = np.concatenate([settling.ravel() for settling in self._times()])
        self.latest = float(np.nanmax(times)) if np.isfinite(times).any() else 1.0
        x = region.axes[0]
        self.x = Scale(with_unit(x.name, x.unit), x.low, x.high)
        y = region.axes[-1]
        self.y = Scale(with_unit(y.name, y.unit), y.low, y.high)
        if len(region.axes) == 1:
            self.y = Scale("settled [s]", 0.0, 1.05 * self.latest)
        self.notes = ["a click sets the initial state"]
        if region.opened:
            self.notes.append("found without the swing-up")
        differing = _differing(region.scenario, base)
        if differing:
            self.notes.append(f"found with other values than the scenario's of {', '.join(differing)}")

    def _times(self) -> list[Array]:
        two = len(self.region.axes) == 2
        return [settling if two else settling[1] for settling in self.region.settling.values()]

    def drawn(self) -> dict[str, Any]:
        """Return a panel for each law; of one axis one with all laws."""
        shades = colours(self.laws)
        axes = {"x": self.x.drawn(), "y": self.y.drawn(), "free": True}
        if len(self.region.axes) == 1:
            return {"panels": [{"title": ", ".join(self.laws), **axes, **self._curves(shades)}]}
        outlines = {law: {"d": outline(np.isfinite(times)), "colour": shades[law]} for law, times in self._maps()}
        legend = [{"shape": "line", "colour": shades[law], "text": f"boundary, {law}"} for law in self.laws]
        ball = self._ball()
        legend += [{"shape": "dashed", "colour": "", "text": "certified ball"}] if ball else []
        panels = [
            {
                "title": law,
                **axes,
                "image": image(times / self.latest),
                "lines": [*(outlines[other] for other in sorted(self.laws, key=lambda one: one == law)), *ball],
                "legend": legend,
                "shades": {"of": gradient(), "low": "0", "high": f"{self.latest:.3g}", "text": "settled [s]"},
            }
            for law, times in self._maps()
        ]
        return {"panels": panels}

    def _maps(self) -> list[tuple[str, Array]]:
        return list(self.region.settling.items())

    def _curves(self, shades: Mapping[str, str]) -> dict[str, Any]:
        lines = []
        for law, (starts, times) in self._maps():
            at = [(self.x.share(x), self.y.share(y)) for x, y in zip(starts, times, strict=True)]
            lines.append({"d": polyline(at), "colour": shades[law]})
        legend = [{"shape": "line", "colour": shades[law], "text": law} for law in self.laws]
        return {"lines": lines, "legend": legend}

    def _ball(self) -> list[dict[str, Any]]:
        ball = self.region.ball
        if ball is None or ball.shape[1] != 2 or not {*CERTIFIED_LAWS} & {*self.laws}:
            return []
        at = [(self.x.share(x), self.y.share(y)) for x, y in ball]
        return [{"d": polyline(at), "colour": "", "dashed": True}]

    def marks(self, values: Mapping[str, Any], _: Metrics) -> list[dict[str, Any]]:
        """Return where the initial state lies, the same for each law."""
        now = [float(values.get(slider.entry, slider.value)) for slider in self.axes]
        x = self.x.share(now[0])
        y = self.y.share(now[1]) if len(now) == 2 else None
        inside = -1e-9 <= x <= 1.0 + 1e-9 and (y is None or -1e-9 <= y <= 1.0 + 1e-9)
        return [{"cross": [x, y] if inside else None}] * (1 if y is None else len(self.laws))

    def chosen(self, values: Mapping[str, Any], click: Any) -> dict[str, Any]:
        """Return the values with the initial state of a click."""
        place = click.get("at") if isinstance(click, Mapping) else None
        if not (isinstance(place, list) and len(place) == 2 and all(_is_share(share) for share in place)):
            raise UserError("a click must be in the map")
        clicked = zip(self.axes, self.region.axes, place, strict=False)
        return {**values, **{slider.entry: slider.taken(_value_at(axis, share)) for slider, axis, share in clicked}}


STYLES: Mapping[str, tuple[str, str, str]] = {
    DOMINATED: ("circle", BEATEN, "beaten when judged"),
    RETUNED: ("triangle", COLOURS["LC"], "LC, retuned"),
    RULE: ("square", OTHERS[0], "the paper's rule"),
    FRONT: ("circle", COLOURS["IHC"], "front"),
    LC: ("diamond", COLOURS["LC"], "LC"),
}
"""Shape, colour and name of the points of a front by what they are, in the order in which they are drawn."""


class FrontMap:
    """What can be had for what; a click on a point sets its parameters."""

    title = "front"

    def __init__(
        self, front: ReadFront, members: Mapping[str, Adjustable], quantities: Mapping[str, MetricMeaning], path: Path
    ) -> None:
        self.front = front
        self.members = {name: _member_of(name, members, path) for name in front.names}
        kept = [p for p in front.points if p.kind != LOST]
        self.points = sorted(kept, key=lambda p: list(STYLES).index(p.kind))
        if not self.points:
            raise UserError(f"{path} has no feasible point")
        self.pairs = list(itertools.combinations(range(len(front.objectives)), 2))
        self.quantities = quantities
        self.scales = [
            scale_of([p.objectives[k] for p in self.points], _heading(name, quantities))
            for k, name in enumerate(front.objectives)
        ]
        self.notes = ["a click on a point sets its parameters; ✕: the run that is shown, which is one draw"]

    def drawn(self) -> dict[str, Any]:
        """Return a panel for each pair of objectives."""
        kinds = {p.kind for p in self.points}
        legend = [{"shape": s, "colour": c, "text": text} for kind, (s, c, text) in STYLES.items() if kind in kinds]
        if any(p.chosen for p in self.points):
            legend.append({"shape": "ring", "colour": OTHERS[1], "text": "chosen"})
        names = [scale.label.rpartition(" [")[0] or scale.label for scale in self.scales]
        return {
            "panels": [
                {
                    "title": f"{names[j]} over {names[i]}",
                    "x": self.scales[i].drawn(),
                    "y": self.scales[j].drawn(),
                    "points": [self._point(number, p, i, j) for number, p in enumerate(self.points)],
                    "legend": legend,
                }
                for i, j in self.pairs
            ]
        }

    def _point(self, number: int, p: ReadPoint, i: int, j: int) -> dict[str, Any]:
        shape, colour, kind = STYLES[p.kind]
        named = zip(self.front.objectives, self.scales, p.objectives, strict=True)
        told = ", ".join(f"{scale.label} {value:.4g}" for _, scale, value in named)
        values = ", ".join(f"{name} {value:.4g}" for name, value in p.values.items())
        return {
            "at": [self.scales[k].share(p.objectives[k]) for k in (i, j)],
            "shape": shape,
            "colour": colour,
            "ring": OTHERS[1] if p.chosen else "",
            "text": f"{'chosen' if p.chosen else kind}: {told}{'; ' if values else ''}{values}",
            "key": number if p.values else None,
        }

    def marks(self, values: Mapping[str, Any], metrics: Metrics) -> list[dict[str, Any]]:
        """Return for each pair the point whose parameters are set, and where the run of the IHC, or of another law, lies."""
        numbers = [k for k, p in enumerate(self.points) if p.values and self._is_set(p, values)]
        metrics_of = metrics.get("IHC") or next(iter(metrics.values()), {})
        run = [metrics_of.get(name, math.nan) for name in self.front.objectives]
        marks = []
        for i, j in self.pairs:
            x, y = (self.scales[k].share(run[k]) if math.isfinite(run[k]) else math.nan for k in (i, j))
            inside = 0.0 <= x <= 1.0 and 0.0 <= y <= 1.0
            marks.append({"cross": [x, y] if inside else None, "keys": numbers})
        return marks

    def _is_set(self, point: ReadPoint, values: Mapping[str, Any]) -> bool:
        now = {name: values.get(member.entry, member.value) for name, member in self.members.items()}
        wanted = {
            name: m.taken(point.values[name]) if name in point.values else m.value for name, m in self.members.items()
        }
        return now == wanted

    def chosen(self, values: Mapping[str, Any], click: Any) -> dict[str, Any]:
        """Return the values with the parameters of a point; what else the search varied is as the scenario has it."""
        number = click.get("key") if isinstance(click, Mapping) else None
        if not isinstance(number, int) or not 0 <= number < len(self.points) or not self.points[number].values:
            raise UserError("a click must be on a point that has parameters")
        tuned = {member.entry for member in self.members.values()}
        kept = {entry: value for entry, value in values.items() if entry not in tuned}
        point = {
            self.members[name].entry: self.members[name].taken(v) for name, v in self.points[number].values.items()
        }
        return {**kept, **point}


Map = RegionMap | FrontMap


def maps_of(
    base: Scenario,
    members: Mapping[str, Adjustable],
    quantities: Mapping[str, MetricMeaning],
    results: Path = Path("results"),
) -> tuple[list[Map], list[str]]:
    """Return the maps of a scenario that lie in the results, and sentences on those that are not what they should be."""
    maps: list[Map] = []
    said = []
    region, tuned = results / f"region_{base.name}", results / f"tune_{base.name}"
    try:
        found = read_region(region)
        if found is not None:
            maps.append(RegionMap(found, members, base, region / "region.json"))
    except UserError as error:
        said.append(f"no region of attraction is drawn: {error}")
    try:
        front = read_front(tuned)
        if front is not None:
            maps.append(FrontMap(front, members, quantities, tuned / "front.csv"))
    except UserError as error:
        said.append(f"no front is drawn: {error}")
    return maps, said


def commands_of(
    groups: Sequence[Group], quantities: Mapping[str, MetricMeaning], laws: Sequence[str], arguments: Sequence[str]
) -> dict[str, str]:
    """Return by the titles of maps the command that each comes from; `arguments` name the scenario.

    The region is over the first position that does not start at 0, and its velocity.
    """
    found, named = {}, shlex.join(arguments)
    states = [m for g in groups if g.title == "initial state" for m in g.members if isinstance(m, Slider)]
    if states:
        half = len(states) // 2
        first = next((k for k in range(half) if states[k].value), 0)
        over = [states[first], states[first + half]] if half else states[:1]
        axes = (f"{m.entry.replace('.start.', '.')}={m.low:g}..{m.high:g}" for m in over)
        found[RegionMap.title] = f"qube-ihc region {named} {' '.join(f'--over {shlex.quote(axis)}' for axis in axes)}"
    if {"LC", "IHC"} <= {*laws}:
        able = [[q.name for q in quantities.values() if q.role == role] for role in ("settling", "energy", "variation")]
        roles = zip(("settling", "energy", "variation"), able, strict=True)
        names = [role if len(some) == 1 else some[0] for role, some in roles if some]
        found[FrontMap.title] = f"qube-ihc tune {named} --pareto {shlex.quote(','.join(names))}"
    return found


def _heading(name: str, quantities: Mapping[str, MetricMeaning]) -> str:
    """Return what an objective is called, also one of a case; its name in the file where that is no metric."""
    metric, _, case = name.partition(OF)
    return Objective(quantities[metric], case).heading if metric in quantities else name


def _value_at(axis: AxisFile, share: float) -> float:
    """Return the value at a share of an axis, in steps of about a pixel."""
    width = axis.high - axis.low
    step = step_of(width)
    value = round((axis.low + share * width) / step) * step
    return min(max(value, axis.low), axis.high)


def _is_share(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _slider_of(axis: AxisFile, members: Mapping[str, Adjustable], path: Path) -> Slider:
    member = members.get(axis.entry)
    if not isinstance(member, Slider):
        raise UserError(f"{path}: the axis {axis.entry} is no number that this page sets")
    return member


def _member_of(name: str, members: Mapping[str, Adjustable], path: Path) -> Slider:
    for entry in (decided(name), f"controller.start.{name}"):
        member = members.get(entry)
        if isinstance(member, Slider):
            return member
    raise UserError(f"{path}: {name} is no number that this page sets")


def _differing(found: Mapping[str, Any], base: Scenario) -> list[str]:
    """Return the sections in which the scenario of a file differs from the base; what is judged and recorded is left out."""
    own = base.model_dump(mode="json")
    names = ("run", "plant", "controller", "components", "wires", "signals")
    return [name for name in names if name in found and found[name] != own.get(name)]
