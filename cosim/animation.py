"""What a scenario says of the bodies that its report shows in motion."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Sequence
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from fmu_export.variables import did_you_mean

from .errors import UserError
from .typed import Positive

ZERO = {"right": 0.0, "up": 0.5 * math.pi, "down": -0.5 * math.pi}
"""Directions [rad] that an angle of 0 may have."""


class BodySection(BaseModel):
    """A body of the animation."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(description="by which other bodies name it")
    shape: Literal["cart", "rod", "beam", "wheel"] = Field(
        description="cart: a box at its place; rod: from its place on; beam: with its place in the middle; wheel: about its "
        "place, with a mark"
    )
    size: Positive = Field(description="length of a rod or a beam, width of a cart, radius of a wheel [m]")
    on: str | None = Field(
        None,
        description="body before it, at whose place (of a rod: end) it begins; none: it stands by itself",
    )
    x: float | str = Field(
        0.0, description="its place to the right of there [m]: a signal component.variable, or a number"
    )
    z: float | str = Field(0.0, description="its place above there [m], as x")
    angle: float | str = Field(0.0, description="how far it is turned [rad]: a signal, or a number")
    zero: Literal["up", "down", "right"] = Field(
        "right", description="where it points with the angle 0: right, up or down"
    )
    turns: Literal["anticlockwise", "clockwise"] = Field("anticlockwise", description="the sense of its angle")
    relative: bool = Field(False, description="true: the angle counts from the direction of the body that it begins on")

    @property
    def sign(self) -> int:
        """1 for an angle that counts anticlockwise, else -1."""
        return 1 if self.turns == "anticlockwise" else -1

    @property
    def reach(self) -> float:
        """How far from its place others begin on it [m]: at the end of a rod."""
        return self.size if self.shape == "rod" else 0.0

    @property
    def signals(self) -> list[tuple[str, str]]:
        """The entries that are signals, and the signals."""
        entries = {"x": self.x, "z": self.z, "angle": self.angle}
        return [(entry, value) for entry, value in entries.items() if isinstance(value, str)]


def _checked(bodies: tuple[BodySection, ...]) -> tuple[BodySection, ...]:
    """Return the bodies; raise ValueError for names that are not different, or that a body begins on before it is there."""
    names: list[str] = []
    for number, body in enumerate(bodies):
        if body.name in names:
            raise ValueError(f"must have bodies of different names, found {body.name!r} twice")
        if body.on is not None and body.on not in names:
            raise ValueError(f"{number}.on must name a body before it{_one_of(names)}, found {body.on!r}")
        if body.relative and body.on is None:
            raise ValueError(f"{number}.relative needs a body that it begins on, found none")
        names.append(body.name)
    return bodies


Bodies = Annotated[tuple[BodySection, ...], AfterValidator(_checked)]
"""Bodies of different names, each that another begins on before that one."""


def _one_of(names: Iterable[str]) -> str:
    listed = ", ".join(names)
    return f", one of {listed}" if listed else ""


def check_signals(bodies: Sequence[BodySection], recorded: Container[str]) -> None:
    """Raise UserError for a signal of the animation that is not `recorded`."""
    for number, body in enumerate(bodies):
        for entry, signal in body.signals:
            if signal not in recorded:
                close = did_you_mean(signal, recorded) if isinstance(recorded, Iterable) else ""
                raise UserError(f"animation.{number}.{entry} names {signal!r}, which is no signal of the run{close}")
