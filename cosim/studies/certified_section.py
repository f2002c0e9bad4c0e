"""The unit ball of a design's certificate in the plane, or on the line, of start values of the plant.

The ball is {x : ||x||_d <= 1} = {x : x' P x <= 1}, x the deviation from the equilibrium in the design's units. With some
entries of x fixed at what the scenario starts with, x = (v, w), it is the ellipse

    (v - c)' Q (v - c) <= 1 - w' (P_ww - P_wv Q^-1 P_vw) w,   Q = P_vv,   c = -Q^-1 P_vw w,

in the plant's units after scaling, and empty where the right side is negative.

What it says, for the design's linear model, its state known, without sampling, limits and disturbances: from a start in it
the IHC with a_min <= 1 <= b_max brings ||x||_d down to a_min and x to 0, by (11); and x' P x falls under the LC, since (11)
with G_d' P + P G_d > 0 gives (A + B K)' P + P (A + B K) < 0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fmu_export.files import FilePath
from ihc_fmu.design import Design

from ..compared_pair import ComparedPair
from ..plant_variables import START
from ..scenario import Scenario
from ..scenario_system import build_system, controller_design
from ..structure import SystemStructure
from ..wiring import CONTROLLER, PLANT, SET_POINT

Array = np.ndarray

PREFIX = f"{PLANT}.start."


@dataclass(frozen=True, eq=False)
class Section:
    """The section {v : (v - centre)' Q (v - centre) <= level} of the unit ball in the units of the d axes; level >= 0.

    Q (d, d), centre (d,). `reaches`: the commands whose limits a law may reach within the whole ball, by their names.
    """

    Q: Array
    centre: Array
    level: float
    reaches: tuple[str, ...]

    def has(self, v: ArrayLike) -> Array:
        """Return whether points (..., d) are in the section."""
        d = np.asarray(v) - self.centre
        return np.einsum("...i,ij,...j", d, self.Q, d) <= self.level

    @property
    def extent(self) -> Array:
        """How far it goes from its centre along each axis (d,)."""
        return np.sqrt(self.level * np.diag(np.linalg.inv(self.Q)))

    def outline(self, count: int = 361) -> Array:
        """Return points on the border (count, d): around an ellipse, or from end to end of an interval."""
        back = math.sqrt(self.level) * np.linalg.inv(np.linalg.cholesky(self.Q)).T
        if len(self.Q) == 1:
            return self.centre + np.linspace(-1.0, 1.0, count)[:, None] * back[0]
        turn = np.linspace(0.0, 2.0 * np.pi, count)
        return self.centre + np.column_stack((np.cos(turn), np.sin(turn))) @ back.T


@dataclass(frozen=True, eq=False)
class Certified:
    """What of a design can be placed among the start values of its plant.

    `rests`: the equilibrium by the entries that set the design's states, in the plant's units. `section`: of the unit ball,
    None where `why_not` says in words why there is none.
    """

    rests: Mapping[str, float]
    section: Section | None
    why_not: str = ""


def certified(
    scenario: Scenario, fmus: FilePath, folder: FilePath | None = None, entries: Sequence[str] = ()
) -> Certified:
    """Return the section of the unit ball over `entries` of the scenario, its other states where the scenario starts them.

    Raises UserError as `build_system`.
    """
    system = build_system(scenario, fmus, folder)
    pair = ComparedPair.of(system)
    design, uncovered = controller_design(system, scenario, folder)
    if pair is None or design is None:
        return Certified({}, None, "the controller has no design of this project")
    states = _states(design, pair)
    rests = {entry: rest for entry, rest, _ in states if entry}
    reason = _not_covered(scenario, system, pair, design, uncovered)
    missing = [q.name for q, (entry, *_) in zip(design.system.states, states, strict=True) if not entry]
    other = [entry for entry in entries if entry not in rests]
    if other:
        reason = f"{other[0]} sets no state of the design's model"
    elif missing and not reason:
        reason = f"no start value of the plant is known to set the state {missing[0]} of the design's model"
    if reason:
        return Certified(rests, None, reason)
    section = _section(design, pair, states, entries)
    if section is None:
        return Certified(rests, None, "the other states start outside of it")
    return Certified(rests, section)


def _states(design: Design, pair: ComparedPair) -> list[tuple[str, float, float]]:
    """Return for each state of the design what sets it in the scenario, "" where that is not known, its rest, its factor."""
    places = pair.states_in_plant()
    found = []
    for quantity in design.system.states:
        setter = next((name for name in (quantity.name + START, quantity.name) if name in pair.plant_values), None)
        known = setter is not None and quantity.name in places
        found.append((f"{PREFIX}{setter}", *places[quantity.name]) if known else ("", 0.0, 1.0))
    return found


def _not_covered(
    scenario: Scenario, system: SystemStructure, pair: ComparedPair, design: Design, uncovered: Sequence[str]
) -> str:
    """Return why the certificate is not about what runs; empty where it is."""
    own = pair.controller_values
    if scenario.controller.other_model:
        return "controller.other_model lets the design be of another model than the plant's"
    if uncovered:
        return uncovered[0]
    if design.integral is not None:
        return "the design has integral action, whose state is not among the ball's"
    if not own.get("a_min", 1.0) <= 1.0 <= own.get("b_max", 1.0):
        return f"a_min = {own['a_min']:g} and b_max = {own['b_max']:g} do not enclose 1"
    moved = _moved_set_point(system, own)
    return f"the set-point {moved} moves what the controller holds the plant at" if moved else ""


def _moved_set_point(system: SystemStructure, own: Mapping[str, Any]) -> str:
    """Return a set-point of the controller that is not, or not always, at the equilibrium; empty where there is none."""
    driven = {end.target for end in (*system.wires, *system.signals)}
    for name in (name for name in own if name.endswith(SET_POINT)):
        rest = own.get(f"{name.removesuffix(SET_POINT)}_equilibrium", 0.0)
        if own[name] != rest or f"{CONTROLLER}.{name}" in driven:
            return f"{CONTROLLER}.{name}"
    return ""


def _section(
    design: Design, pair: ComparedPair, states: Sequence[tuple[str, float, float]], entries: Sequence[str]
) -> Section | None:
    """Return the section over entries that set states, in the entries' order; None where it is empty."""
    names = [entry for entry, *_ in states]
    along = [names.index(entry) for entry in entries]
    across = [i for i in range(len(names)) if i not in along]
    starts = [float(pair.plant_values[name.removeprefix(PREFIX)]) for name in names]
    scale = np.array([factor for *_, factor in states])
    rest = np.array([place for _, place, _ in states])
    P = design.P * np.outer(scale, scale)
    w = np.array(starts)[across] - rest[across]
    Q, mixed = P[np.ix_(along, along)], P[np.ix_(along, across)] @ w
    level = 1.0 - float(w @ P[np.ix_(across, across)] @ w) + float(mixed @ np.linalg.solve(Q, mixed))
    if level < 0.0:
        return None
    return Section(Q, rest[along] - np.linalg.solve(Q, mixed), level, _reaching(design, pair))


def _reaching(design: Design, pair: ComparedPair) -> tuple[str, ...]:
    """Return the inputs that a law may need beyond their limits somewhere in the unit ball.

    |K x| is at most sqrt(K P^-1 K') there, and |u| of the IHC that of K_0 and u_max together.
    """

    def largest(gain: Array) -> Array:
        return np.sqrt(np.einsum("ij,ji->i", gain, np.linalg.solve(design.P, gain.T)))

    needed = np.maximum(largest(design.K), largest(design.form.K_0) + design.u_max)
    rooms = _rooms(design, pair)
    return tuple(q.name for q, u, room in zip(design.system.inputs, needed, rooms, strict=True) if u > room)


def _rooms(design: Design, pair: ComparedPair) -> list[float]:
    """Return what the limits of the controller as it is started leave around each input at the equilibrium."""
    own = pair.controller_values
    if pair.balances:
        return [float(own["voltage_limit"])]
    rooms = []
    for q, rest in zip(design.system.inputs, np.asarray(design.system.u_eq), strict=True):
        low, high = (
            float(own.get(f"{q.name}{end}", far)) for end, far in (("_lower", -math.inf), ("_upper", math.inf))
        )
        rooms.append(min(high - float(rest), float(rest) - low))
    return rooms
