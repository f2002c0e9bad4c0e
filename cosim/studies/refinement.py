"""Adaptive refinement: a line or a plane is divided where a yes or no of its points changes, and nowhere else.

Points are those of a lattice with `finest` cells along each axis, cells are its intervals or squares. All begin with the
same coarse size; a cell is halved along each axis as long as two known points of its border differ, its corners or
those that a smaller neighbour has on their common side. So an edge that a coarse cell's corners show is followed through
all cells that it crosses; one that no corner shows, such as a hole smaller than a coarse cell, can be missed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from ..errors import UserError

Array = np.ndarray

Point = tuple[int, ...]
"""A point of the lattice: a number from 0 to `finest` for each axis."""

MOST_CELLS = 2**20
"""Along an axis."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of the lattice: its lowest corner, and its size along each axis."""

    corner: Point
    size: int

    @property
    def corners(self) -> list[Point]:
        """Its corners; the last axis changes fastest."""
        return [tuple(c + s for c, s in zip(self.corner, step, strict=True)) for step in self._steps(0, self.size)]

    @property
    def halves(self) -> list[Cell]:
        """The cells of half its size that it consists of."""
        half = self.size // 2
        steps = self._steps(0, half)
        return [Cell(tuple(c + s for c, s in zip(self.corner, step, strict=True)), half) for step in steps]

    @property
    def border(self) -> Iterator[Point]:
        """The lattice's points on its border, corners more than once."""
        spans = [range(c, c + self.size + 1) for c in self.corner]
        for axis, c in enumerate(self.corner):
            yield from product(*spans[:axis], (c, c + self.size), *spans[axis + 1 :])

    def _steps(self, *values: int) -> list[Point]:
        return list(product(values, repeat=len(self.corner)))


@dataclass
class Refinement:
    """Cells of `axes` axes, `coarse` and at last `finest` along each, and the points whose answer is known.

    Raises UserError for numbers of cells of which none divides the other by halving.
    """

    axes: int
    coarse: int
    finest: int
    known: dict[Point, bool] = field(default_factory=dict)
    cells: list[Cell] = field(default_factory=list)

    def __post_init__(self) -> None:
        ratio, rest = divmod(self.finest, self.coarse) if self.coarse > 0 else (0, 0)
        if rest or ratio < 1 or ratio & (ratio - 1) or not 2 <= self.coarse <= self.finest <= MOST_CELLS:
            raise UserError(
                "the finest cells along an axis must be the coarse ones times a power of two, both from 2 to "
                f"{MOST_CELLS}, found {self.finest} and {self.coarse}"
            )
        lowest = product(range(0, self.finest, ratio), repeat=self.axes)
        self.cells = [Cell(corner, ratio) for corner in lowest]

    @property
    def wanted(self) -> list[Point]:
        """The points that are to be known next; none when all is refined."""
        corners = dict.fromkeys(point for cell in self.cells for point in cell.corners)
        return [point for point in corners if point not in self.known]

    def tell(self, answers: Mapping[Point, bool]) -> None:
        """Take the answers of the points that were wanted, and divide the cells that these cross."""
        self.known.update(answers)
        while not self.wanted:
            cells = [part for cell in self.cells for part in (cell.halves if self._divides(cell) else [cell])]
            if len(cells) == len(self.cells):
                return
            self.cells = cells

    def _divides(self, cell: Cell) -> bool:
        if cell.size == 1:
            return False
        answers = {self.known[point] for point in cell.border if point in self.known}
        return len(answers) > 1

    def all_of(self, cell: Cell) -> bool:
        """Return whether all corners of a cell are answered yes."""
        return all(self.known[point] for point in cell.corners)

    def any_of(self, cell: Cell) -> bool:
        """Return whether a corner of a cell is answered yes."""
        return any(self.known[point] for point in cell.corners)

    @property
    def bounds(self) -> tuple[float, float]:
        """The share of the whole that lies in cells with all corners yes, and in those with any.

        The share that is yes lies between both where the cells with equal corners are all yes or all no.
        """
        inner = sum(self._share(cell) for cell in self.cells if self.all_of(cell))
        return inner, sum(self._share(cell) for cell in self.cells if self.any_of(cell))

    @property
    def share(self) -> float:
        """The share of the whole that is yes, each cell counted by the share of its corners: the trapezoidal rule."""
        return sum(self._share(cell) * float(np.mean([self.known[p] for p in cell.corners])) for cell in self.cells)

    def _share(self, cell: Cell) -> float:
        return (cell.size / self.finest) ** self.axes

    def grid(self) -> Array:
        """Return the answers at all points of the lattice, (finest + 1,) * axes: inside a cell those of its corners."""
        answers = np.zeros((self.finest + 1,) * self.axes, dtype=bool)
        for cell in self.cells:
            if self.all_of(cell):
                answers[tuple(slice(c, c + cell.size + 1) for c in cell.corner)] = True
        for point, answer in self.known.items():
            answers[point] = answer
        return answers

    def interpolated(self, values: Mapping[Point, float]) -> Array:
        """Return values at the middle of each finest cell, (finest,) * axes: linear between the corners of their cell.

        Only of cells with all corners yes, elsewhere NaN.
        """
        middle = np.full((self.finest,) * self.axes, np.nan)
        for cell in self.cells:
            if not self.all_of(cell):
                continue
            corners = np.array([values[point] for point in cell.corners]).reshape((2,) * self.axes)
            t = (np.arange(cell.size) + 0.5) / cell.size
            for axis in range(self.axes):
                low, high = np.take(corners, [0], axis), np.take(corners, [1], axis)
                shape = [-1 if k == axis else 1 for k in range(self.axes)]
                corners = low + (high - low) * t.reshape(shape)
            middle[tuple(slice(c, c + cell.size) for c in cell.corner)] = corners
        return middle

    def averaged(self, values: Mapping[Point, float]) -> Array:
        """Return the mean of the corners' values in each finest cell, (finest,) * axes, that of its cell everywhere."""
        means = np.zeros((self.finest,) * self.axes)
        for cell in self.cells:
            means[tuple(slice(c, c + cell.size) for c in cell.corner)] = np.mean([values[p] for p in cell.corners])
        return means
