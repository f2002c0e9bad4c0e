"""Is the model that a design was made for that of a plant, as both answer the controller's commands?

Both are compared by their transfer functions from the controller's outputs u to its inputs y,

    G(s) = C (s I - A)^-1 B + D,

which do not depend on what a plant calls its states, at the points s = w exp(i pi/4) of the s-plane, w from the slowest to
the fastest pole of A + B K: damped there, so that a resonance or a pole beside the imaginary axis does not decide. u counts
in the largest homogeneous control on the unit ball. At each s a row of G has the size 1 for the plant, and then rows, over
all u and s, and columns, over all y and s, are compared: by the gain Re <G_plant, G> / |G_plant|^2 and by the sine of
the angle between both.

What is allowed is so wide that the plants in `examples` fit their designs with all their parameters drawn within 20 %
(gains of 0.57 to 1.71, sines up to 0.38 in 3000 draws of each), and so narrow that no other order of states, outputs or
inputs, sign or unit does (of those the nearest have a gain of 4.4 or below 0), and none of these plants that hangs in
place of standing, or stands in place of hanging (gains below 0.28 or sines from 0.70 on). An equilibrium half a radian
beside is not told from other parameters (sines of 0.15 and 0.36 for crane and arm, 0.70 for the double pendulum).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations, product

import numpy as np

from ihc_fmu.quantity import Quantity
from ihc_fmu.system import System

from .poles import alike, poles_text, sorted_poles
from .unit_slips import nearest, slips
from .wire_factors import ComparedWire, Explanation, likeliest

Array = np.ndarray

GAINS = (0.4, 2.5)
"""Of a row or a column of the design's G along the plant's."""
LARGEST_SINE = 0.5
"""Of the angle between both."""
NOTABLE = 0.12
"""Difference of a row, relative, that is said, as for the pendulum."""

COUNT = 6
"""Points of the s-plane."""
DEAD = 1e-10
"""An output or an input without effect on the plant, relative to what it has in the design, says nothing.

A factor of 1000 that is taken the wrong way around leaves 1e-6, and with another one 1e-9.
"""
SAME = 0.01
"""By which part sizes may differ and be taken for the same."""
MOST_INPUTS, MOST_STATES = 4, 6
"""Up to which all orders are tried."""


@dataclass(frozen=True, eq=False)
class Expected:
    """What a controller was designed for.

    `system`: with the gain K of its linear controller. `extent` (n,), `u_size` (m,): how far states and inputs go, in which
    the model is to hold: the largest on the unit ball.
    """

    system: System
    extent: Array
    u_size: Array


@dataclass(frozen=True, eq=False)
class Seen:
    """A plant as its controller sees it, behind the wires.

    A (n, n), B (n, q) from the controller's outputs that `columns` number, C (r, n), D (r, q) to its inputs that `rows`
    number.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    rows: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class ResponseDistance:
    """How far the design's answers are from the plant's, row by row and then column by column.

    `gain`, `sine`, `error` (r + q,): the last is the relative difference.
    """

    gain: Array
    sine: Array
    error: Array

    @property
    def fits(self) -> bool:
        """Whether the two may be one system with somewhat different parameters."""
        near = (GAINS[0] <= self.gain) & (self.gain <= GAINS[1]) & (self.sine <= LARGEST_SINE)
        return bool(near.all())


@dataclass(frozen=True, eq=False)
class Answers:
    """G of a design and of a plant, each (r, COUNT, q), and x of the design's states, (n, COUNT, q); u_size (q,)."""

    design: Array
    plant: Array
    states: Array
    u_size: Array
    rows: tuple[int, ...]
    columns: tuple[int, ...]


def points(system: System) -> Array:
    """Return where G is compared, shape (COUNT,)."""
    assert system.K is not None
    sizes = np.abs(np.linalg.eigvals(system.A + system.B @ system.K))
    return np.geomspace(sizes.min(), max(sizes.max(), 2.0 * sizes.min()), COUNT) * np.exp(0.25j * np.pi)


def answers(expected: Expected, plant: Seen) -> Answers | None:
    """Return what both answer; without outputs and inputs that have no effect on the plant, None where none is left."""
    system = expected.system
    s, columns = points(system), list(plant.columns)
    u = expected.u_size[columns]
    states = _transfer(system.A, system.B[:, columns] * u, s)
    design = np.tensordot(np.asarray(system.C)[list(plant.rows)], states, 1)
    real = np.tensordot(plant.C, _transfer(plant.A, plant.B * u, s), 1) + (plant.D * u)[:, None, :]
    live = [np.linalg.norm(real, axis=axes) > DEAD * np.linalg.norm(design, axis=axes) for axes in ((1, 2), (0, 1))]
    if not (live[0].any() and live[1].any()) or not np.isfinite(real).all():
        return None
    rows, kept = np.flatnonzero(live[0]), np.flatnonzero(live[1])
    return Answers(
        design=design[rows][:, :, kept],
        plant=real[rows][:, :, kept],
        states=states[:, :, kept],
        u_size=u[kept],
        rows=tuple(plant.rows[i] for i in rows),
        columns=tuple(columns[j] for j in kept),
    )


def _transfer(A: Array, B: Array, s: Array) -> Array:
    """Return (s I - A)^-1 B, shape (n, COUNT, q)."""
    return np.stack([np.linalg.solve(z * np.eye(len(A)) - A, B) for z in s], axis=1)


def distance(design: Array, plant: Array) -> ResponseDistance:
    """Return how far G of a design is from that of a plant, both (r, COUNT, q)."""
    sizes = np.linalg.norm(plant, axis=2, keepdims=True)
    a, b = (np.divide(M, sizes, out=np.zeros_like(M), where=sizes > 0.0) for M in (plant, design))
    gains, sines, errors = [], [], []
    for axis in (0, 2):
        x, y = (np.moveaxis(M, axis, 0).reshape(M.shape[axis], -1) for M in (a, b))
        inner, squares, others = (np.sum(x.conj() * y, axis=1).real, _squares(x), _squares(y))
        gains.append(inner / squares)
        cosines = np.divide(inner, np.sqrt(squares * others), out=np.zeros_like(inner), where=others > 0.0)
        sines.append(np.sqrt(np.maximum(0.0, 1.0 - cosines**2)))
        errors.append(np.sqrt(_squares(y - x) / squares))
    return ResponseDistance(*map(np.concatenate, (gains, sines, errors)))


def _squares(M: Array) -> Array:
    return np.sum(np.abs(M) ** 2, axis=1)


def fits(expected: Expected, plant: Seen) -> bool | None:
    """Whether the design's model may be the plant's; None where nothing can be said."""
    both = answers(expected, plant)
    return None if both is None else distance(both.design, both.plant).fits


def explained(
    expected: Expected, plant: Seen, wires: Mapping[str, Sequence[ComparedWire]], *, only_sizes: bool = False
) -> str | None:
    """Return what would make a model that does not fit that of the plant; None where nothing does that is tried.

    `wires` by the controller's outputs and inputs. Of several the likeliest is said, see `wire_factors`. `only_sizes`: of
    those that change neither an order nor a sign.
    """
    both = answers(expected, plant)
    if both is None:
        return None
    system = expected.system
    known = {q.name: _known(q, wires.get(q.name, ())) for q in (*system.outputs, *system.inputs)}
    candidates = explanations(system, both, known)
    return likeliest((one for one in candidates if not only_sizes or one.only_sizes), wires)


def _known(quantity: Quantity, wires: Sequence[ComparedWire]) -> dict[float, str]:
    """Return sizes by which numbers are mistaken, by units or by the wires' factors, with the unit in words, else ""."""
    sizes = slips(quantity.unit)
    for size in (size for wire in wires for size in wire.suspected()):
        if all(abs(size / other - 1.0) > SAME for other in sizes):
            sizes[size] = ""
    return sizes


def remarks(expected: Expected, plant: Seen) -> list[str]:
    """Return what is to be known of a design that fits: answers that differ, a K that does not stabilize."""
    both = answers(expected, plant)
    if both is None:
        return []
    said, system = [], expected.system
    error = distance(both.design, both.plant).error[: len(both.rows)]
    if error.max() > NOTABLE:
        worst = system.outputs[both.rows[int(np.argmax(error))]].name
        said.append(
            f"the controller's model is not quite the plant's: {worst} answers otherwise by {100 * error.max():.0f} %"
        )
    slowest = _slowest(system, plant)
    if slowest is not None and slowest >= 0.0:
        said.append(f"K does not stabilize this plant: the largest real part of its poles is {slowest:.3g} 1/s")
    return said


def _slowest(system: System, plant: Seen) -> float | None:
    """Return the largest real part of the plant's poles under u = K x; None where it has not the design's states."""
    whole = plant.rows == tuple(range(system.n)) and plant.columns == tuple(range(system.m))
    if not (system.measures_state and whole and len(plant.A) == system.n):
        return None
    closed = plant.A + plant.B @ np.asarray(system.K) @ plant.C
    return float(np.linalg.eigvals(closed).real.max()) if np.isfinite(closed).all() else None


def unlike(expected: Expected, plant: Seen) -> str:
    """Return what differs most in a model that does not fit."""
    system, both = expected.system, answers(expected, plant)
    assert both is not None
    r = len(both.rows)
    d = distance(both.design, both.plant)
    far = np.maximum(np.abs(np.log(np.maximum(d.gain, 1e-9))) / np.log(GAINS[1]), d.sine / LARGEST_SINE)
    i = int(np.argmax(far))
    what = (
        f"{system.outputs[both.rows[i]].name} answers" if i < r else f"{system.inputs[both.columns[i - r]].name} acts"
    )
    if GAINS[0] <= d.gain[i] <= GAINS[1]:
        differs = f"in its model {what} otherwise by {100 * d.error[i]:.0f} %"
    else:
        differs = f"in its model {what} {d.gain[i]:.3g} times as strongly"
    design, real = (sorted_poles(A) for A in (system.A, plant.A))
    if alike(design, real):
        return f"{differs}, although the poles are the same"
    return f"{differs}; poles {poles_text(design)} instead of {poles_text(real)} 1/s"


Known = Mapping[str, Mapping[float, str]]
"""Sizes by which numbers are mistaken, of each output and input, and the unit that they are in then."""


def explanations(system: System, both: Answers, known: Known) -> Iterator[Explanation]:
    """Yield what would make the design's model that of the plant."""
    yield from _orders_of_states(system, both)
    inputs = [system.inputs[j] for j in both.columns]
    for order, factors in _changes(inputs, known):
        turned = (both.design / both.u_size)[:, :, list(order)] * factors * both.u_size
        assigned = _assigned(system, both, turned, known)
        if assigned is not None:
            yield _said(inputs, order, 1.0 / factors, "inputs", known) + assigned


def _orders_of_states(system: System, both: Answers) -> Iterator[Explanation]:
    """Yield the orders of the states of A and B that would do where C was written for another; measured ones are rows."""
    if system.measures_state or system.n > MOST_STATES:
        return
    C = np.asarray(system.C)[list(both.rows)]
    for order in permutations(range(system.n)):
        if distance(np.tensordot(C[:, list(order)], both.states, 1), both.plant).fits:
            yield _said(system.states, np.argsort(order), np.ones(system.n), "states", {})


def _changes(inputs: Sequence[Quantity], known: Known) -> Iterator[tuple[tuple[int, ...], Array]]:
    """Yield orders of inputs and factors of their effects: signs, and units in the same order."""
    m = len(inputs)
    same = tuple(range(m))
    orders: Iterable[tuple[int, ...]] = permutations(same)
    signs: Iterable[tuple[float, ...]] = product((1.0, -1.0), repeat=m)
    if m > MOST_INPUTS:
        orders = [same, *(_swapped(same, i, j) for i, j in combinations(same, 2))]
        signs = [(1.0,) * m, (-1.0,) * m, *(tuple(-1.0 if i == j else 1.0 for i in same) for j in same)]
    signs = list(signs)
    yield from ((order, np.array(sign)) for order in orders for sign in signs)
    units = list(_units(inputs, known))
    yield from ((same, np.array(sign) / sizes) for sign in signs for sizes in units)


def _units(inputs: Sequence[Quantity], known: Known) -> Iterator[Array]:
    """Yield sizes of inputs: of two any; of more one for all, or of one alone."""
    m, sizes = len(inputs), [list(known[q.name]) for q in inputs]
    if m <= 2:
        yield from (np.array(one) for one in product(*([1.0, *own] for own in sizes)) if set(one) != {1.0})
        return
    yield from (np.where(np.arange(m) == j, size, 1.0) for j, own in enumerate(sizes) for size in own)
    yield from (np.full(m, size) for size in sorted(set(sizes[0]).intersection(*sizes)))


def _swapped(order: tuple[int, ...], i: int, j: int) -> tuple[int, ...]:
    swapped = list(order)
    swapped[i], swapped[j] = swapped[j], swapped[i]
    return tuple(swapped)


def _assigned(system: System, both: Answers, design: Array, known: Known) -> Explanation | None:
    """Return which order, signs and units of the outputs make G of the design that of the plant; None where none do."""
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - heavy

    outputs = [system.outputs[i] for i in both.rows]
    r, sizes = len(outputs), [(1.0, *known[q.name]) for q in outputs]
    inner, squares, others = _products(design, both.plant)
    with np.errstate(all="ignore"):  # rows that nothing is like
        ratios = squares[:, None] / inner
        factors = np.array([[nearest(ratios[i, k], sizes[i]) for k in range(r)] for i in range(r)])
        gain = factors / ratios
        sine = np.sqrt(np.maximum(0.0, 1.0 - inner**2 / (squares[:, None] * others)))
        possible = (GAINS[0] <= gain) & (gain <= GAINS[1]) & (sine <= LARGEST_SINE)
    changes = 2.0 * (np.abs(factors) != 1.0) + 2.0 * (factors < 0.0) + ~np.eye(r, dtype=bool)
    order = linear_sum_assignment(np.where(possible, np.abs(gain - 1.0) + sine + changes, 1e6))[1]
    S = factors[np.arange(r), order]
    if not possible[np.arange(r), order].all() or not distance(design[order] * S[:, None, None], both.plant).fits:
        return None
    return _said(outputs, order, S, "states" if system.measures_state else "outputs", known)


def _products(design: Array, plant: Array) -> tuple[Array, Array, Array]:
    """Return Re <plant_i, design_k> (r, r), |plant_i|^2 (r,), |design_k|^2 (r, r), weighed as in row i of `distance`."""
    squares = np.sum(np.abs(plant) ** 2, axis=2)
    weights = np.divide(1.0, squares, out=np.zeros_like(squares), where=squares > 0.0)
    inner = np.einsum("isq,ksq,is->ik", plant.conj(), design, weights).real
    return inner, np.sum(squares * weights, axis=1), weights @ np.sum(np.abs(design) ** 2, axis=2).T


def _said(
    quantities: Sequence[Quantity], order: Sequence[int] | Array, factors: Array, what: str, known: Known
) -> Explanation:
    """Return order, signs and units in words: the plant's quantity i is the design's number order[i].

    The controller's numbers of it are factors[i] times as large as its unit in the design says.
    """
    names, said = [q.name for q in quantities], []
    given = [names[i] for i in np.argsort(order)]
    moved = [name for name, other in zip(names, given, strict=True) if name != other]
    if moved:
        said.append(f"its {what} are in the order {', '.join(given)}, not {', '.join(names)}")
    turned = [name for name, factor in zip(names, factors, strict=True) if factor < 0.0]
    if turned:
        said.append(
            f"the sign{_number(turned, '', 's')} of {', '.join(turned)} {_number(turned, 'is', 'are')} the opposite"
        )
    units: dict[str, list[str]] = {}
    for name, factor in zip(names, np.abs(factors), strict=True):
        if factor != 1.0:
            unit = known[name][nearest(factor, known[name])]
            times = f"{1.0 / factor:.3g} times as strongly" if what == "inputs" else f"{factor:.3g} times as large"
            units.setdefault(f"in {unit}" if unit else f"{times} as in the model", []).append(name)
    verb = "act" if what == "inputs" else "arrive"
    said += [f"{', '.join(which)} {verb}{_number(which, 's', '')} {how}" for how, which in units.items()]
    sizes = [(name, float(factor)) for name, factor in zip(names, factors, strict=True) if factor != 1.0]
    return Explanation(tuple(said), tuple(moved), tuple(sizes))


def _number(names: Sequence[str], one: str, more: str) -> str:
    return more if len(names) > 1 else one
