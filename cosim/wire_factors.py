"""What would make a design fit a plant, and which wires' factors that would change: the likeliest in words.

A factor of all measurements is not told from one of all commands by what the plant answers. Then the factors that the
wires have and the units at their ends decide, and where these do not either, all that is as likely is said.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from .structure import Wire
from .unit_slips import SCALE_TOLERANCE
from .wiring import CONTROLLER

AGREES, UNKNOWN, DOUBTFUL, CONTRADICTS = 1, 3, 5, 20
"""What a change costs: the units at a wire's ends ask for it, or it undoes the wire's factor or its crossing; nothing is
known; the wire is as it should be if a plant that declares no unit counts in SI units; it is as declared units ask."""
AS_LIKELY = 5
"""By how much more an explanation may cost, at most as much again, and be said beside the cheapest."""
MOST = 3
"""Explanations, or wires of one, that are said."""
ALIKE = 0.01
"""By which part factors may differ and be called the same: 57.3 for 180/pi."""


@dataclass(frozen=True)
class ComparedWire:
    """A wire between plant and controller.

    `number`: of the controller's variable among its own outputs or inputs. `asked`: the factor that the units at both ends
    ask for, None where these do not say; `declared`: whether both ends declare theirs, else the other's is taken to be the
    SI unit.
    """

    wire: Wire
    number: int = 0
    asked: float | None = None
    declared: bool = False

    @property
    def measures(self) -> bool:
        """Whether it leads to the controller."""
        return self.wire.target.startswith(f"{CONTROLLER}.")

    @property
    def name(self) -> str:
        """The plant's variable."""
        return (self.wire.source if self.measures else self.wire.target).partition(".")[2]

    @property
    def factor(self) -> float:
        """By which the value is multiplied."""
        return self.wire.factor

    @property
    def offset(self) -> float:
        """What is added then."""
        return self.wire.offset

    @property
    def unconverted(self) -> ComparedWire:
        """The wire as if it changed no value."""
        return replace(self, wire=Wire(self.wire.source, self.wire.target))

    @property
    def crossed(self) -> bool:
        """Whether its ends have different names."""
        return self.wire.source.partition(".")[2] != self.wire.target.partition(".")[2]

    def corrected(self, size: float) -> float:
        """Return the factor in place of which the controller's numbers are `size` times as large as in its model."""
        return self.factor / size if self.measures else self.factor * size

    def cost(self, size: float) -> int:
        """Return how unlikely it is that this wire is to be corrected by `size`."""
        new = self.corrected(size)
        if abs(size) == 1.0:
            return AGREES if new > 0.0 else UNKNOWN
        asked = 1.0 if self.asked is None else self.asked
        if _alike(abs(new), asked):
            return AGREES if new > 0.0 else UNKNOWN
        if self.asked is not None and _alike(abs(self.factor), asked):
            return CONTRADICTS if self.declared else DOUBTFUL
        return UNKNOWN

    def suspected(self) -> list[float]:
        """Return `size` where the factor is one too many, is the reciprocal of the right one, or is not what units ask.

        None that is so near to 1 that parameters may explain it.
        """
        factors = {self.factor, self.factor**2, self.factor / (self.asked or 1.0)}
        sizes = {abs(f if self.measures or f == 0.0 else 1.0 / f) for f in factors}
        return sorted(size for size in sizes if size > 0.0 and abs(math.log(size)) > math.log(SCALE_TOLERANCE))

    def advice(self, size: float) -> str:
        """Return which factor would fit, in words."""
        new = self.corrected(size)
        own = "" if self.factor == 1.0 else f" * {self.factor:.6g}"
        return f"{self.wire.source} -> {self.wire.target}{own} would fit " + (
            "without a factor" if _alike(new, 1.0) else f"with * {new:.6g}"
        )


def _alike(a: float, b: float) -> bool:
    return abs(a - b) <= ALIKE * abs(b)


@dataclass(frozen=True)
class Explanation:
    """What would make the design's model that of the plant.

    `said`: in words. `moved`: the names of quantities in another order. `sizes`: of others how many times as large, with the
    sign, the controller's numbers are as in its model.
    """

    said: tuple[str, ...]
    moved: tuple[str, ...] = ()
    sizes: tuple[tuple[str, float], ...] = ()

    def __add__(self, other: Explanation) -> Explanation:
        return Explanation(self.said + other.said, self.moved + other.moved, self.sizes + other.sizes)

    @property
    def changed(self) -> set[str]:
        """The names of all quantities that it changes."""
        return {*self.moved, *(name for name, _ in self.sizes)}

    @property
    def only_sizes(self) -> bool:
        """Whether it changes neither an order nor a sign."""
        return not self.moved and all(size > 0.0 for _, size in self.sizes)

    def cost(self, wires: Mapping[str, Sequence[ComparedWire]]) -> int:
        """Return how unlikely it is; `wires` by the controller's quantities."""
        joined = [wire for name in self.moved for wire in wires.get(name, ())]
        uncrosses = bool(joined) and all(wire.crossed for wire in joined)
        order = (AGREES if uncrosses else UNKNOWN) if self.moved else 0
        return order + sum(
            max((wire.cost(size) for wire in wires.get(name, ())), default=UNKNOWN) for name, size in self.sizes
        )

    def text(self, wires: Mapping[str, Sequence[ComparedWire]], joint: str) -> str:
        """Return it in words, its parts joined by `joint`, with the wires that it changes."""
        advice = [wire.advice(size) for name, size in self.sizes for wire in wires.get(name, ())]
        if len(advice) > MOST:
            advice[MOST - 1 :] = [f"{len(advice) - MOST + 1} more wires likewise"]
        return joint.join(self.said) + (f" ({'; '.join(advice)})" if advice else "")


def likeliest(explanations: Iterable[Explanation], wires: Mapping[str, Sequence[ComparedWire]]) -> str | None:
    """Return the likeliest explanation in words, or all that are about as likely; None where there is none.

    `wires` by the controller's quantities.
    """
    ranked = sorted(explanations, key=lambda e: (e.cost(wires), len(e.said), len(e.changed), e.said))
    if not ranked:
        return None
    least, kept = ranked[0].cost(wires), list[Explanation]()
    for one in ranked:
        if one.cost(wires) <= least + min(least, AS_LIKELY) and not any(k.changed <= one.changed for k in kept):
            kept.append(one)
    if len(kept) == 1:
        return kept[0].text(wires, "; ")
    return "either " + ", or ".join(one.text(wires, " and ") for one in kept[:MOST])
