"""Is the model that the pendulum's controller was designed for that of its plant?

The controller FMU's Phi and row hold its design's model, since z = Phi x obeys z' = N z + e_n (u + row x) with the upper
shift N:

    A = Phi^-1 (N Phi + e_n row),   b = Phi^-1 e_n.

The plant's is its linearization at upright with its start values. The two need not be equal: damping is left out of
designs and differs among pendulums of a kind by orders of magnitude, so that it is only remarked; the rest is known to
some per cent.
What is allowed is so wide that every named parameter set with all its numbers drawn within 20 % passes with the default
design (at most 0.64, 0.53 to 1.90 and 0.19 in 5000 draws of each), and so narrow that no other order of states, unit, sign
or system does (a cart-pole: 0.86 to 0.94 and a gain of -0.05 to 0.09).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import permutations
from typing import Any

import numpy as np

from fmu_export.errors import UserError
from ihc_fmu.pendulum.interface import STATES, matrix, vector
from plant_fmu.linearization import linearize
from plant_fmu.parameters import QubeParameters

from .poles import alike, poles_text, sorted_poles
from .unit_slips import nearest, slips

Array = np.ndarray

LARGEST_DISTANCE = 0.75
"""Of the stiffness from the plant's, relative, Frobenius norm; it is what A says of accelerations by angles."""
GAINS = (0.4, 2.5)
"""Of b along the plant's, relative."""
LARGEST_ANGLE = 0.3
"""Sine of the angle between b and the plant's."""
KINEMATICS = 0.05
"""Largest error of an entry of A's first two rows, which say that the last two states are the rates of the first two."""

NOTABLE_DISTANCE, NOTABLE_GAINS = 0.12, (0.9, 1.1)
"""What is said, since the named sets differ less from the default design."""

UNITS = slips("rad/s") | slips("rad")
SCALES = (1.0, *UNITS)
"""Factors between units that are tried."""

_NUMBERS = tuple(f.name for f in fields(QubeParameters))


@dataclass(frozen=True, eq=False)
class Model:
    """x' = A x + b u with A (n, n) and b (n,)."""

    A: Array
    b: Array


@dataclass(frozen=True)
class ModelDistance:
    """How far a model is from the plant's: A, and its stiffness, relative; b's gain and sine of the angle; kinematics."""

    A: float
    stiffness: float
    gain: float
    angle: float
    kinematics: float

    @property
    def fits(self) -> bool:
        """Whether the two may be one system with somewhat different parameters."""
        near = self.stiffness <= LARGEST_DISTANCE and self.angle <= LARGEST_ANGLE and self.kinematics <= KINEMATICS
        return near and GAINS[0] <= self.gain <= GAINS[1]


def design_model(controller: Mapping[str, Any]) -> Model | None:
    """Return the model that a controller FMU with these start values was designed for; None where they hold none.

    Numbers beyond reason are left to the FMU, which says what is wrong.
    """
    if not {*matrix("Phi"), *vector("row")} <= controller.keys():
        return None
    n = len(STATES)
    Phi = np.array([controller[name] for name in matrix("Phi")], dtype=float).reshape(n, n)
    row = np.array([controller[name] for name in vector("row")], dtype=float)
    e_n = np.eye(n)[-1]
    with np.errstate(all="ignore"):
        try:
            model = Model(np.linalg.solve(Phi, np.eye(n, k=1) @ Phi + np.outer(e_n, row)), np.linalg.solve(Phi, e_n))
        except np.linalg.LinAlgError:
            return None
    return _finite(model)


def plant_model(plant: Mapping[str, Any]) -> Model | None:
    """Return the linearization at upright of a plant FMU with these start values; None where it is another plant.

    Numbers beyond reason are left to the FMU, which says what is wrong.
    """
    if not {*_NUMBERS, "back_emf"} <= plant.keys():
        return None
    with np.errstate(all="ignore"):
        try:
            parameters = QubeParameters(**{name: float(plant[name]) for name in _NUMBERS})
            model = Model(*linearize(parameters, back_emf=bool(plant["back_emf"])))
        except (UserError, ArithmeticError):
            return None
    return _finite(model)


def _finite(model: Model) -> Model | None:
    return model if np.isfinite(model.A).all() and np.isfinite(model.b).all() and model.b.any() else None


def distance(model: Model, plant: Model) -> ModelDistance:
    """Return how far `model` is from `plant`."""
    squares, inner = float(plant.b @ plant.b), float(plant.b @ model.b)
    size = math.sqrt(squares) * float(np.linalg.norm(model.b))
    half = len(plant.b) // 2

    def relative(rows: slice, columns: slice) -> float:
        real = plant.A[rows, columns]
        return float(np.linalg.norm(model.A[rows, columns] - real) / np.linalg.norm(real))

    return ModelDistance(
        A=relative(slice(None), slice(None)),
        stiffness=relative(slice(half, None), slice(half)),
        gain=inner / squares,
        angle=math.sqrt(max(0.0, 1.0 - (inner / size) ** 2)) if size else 1.0,
        kinematics=float(np.abs(model.A[:half] - plant.A[:half]).max()),
    )


def misfit(controller: Mapping[str, Any], plant: Mapping[str, Any]) -> str | None:
    """Return how the model that the controller was designed for differs from the plant's; None where it fits.

    Both are all start values of the two FMUs. None too where one of them does not say.
    """
    design, real = design_model(controller), plant_model(plant)
    return None if design is None or real is None else misfit_of(design, real)


def remarks(controller: Mapping[str, Any], plant: Mapping[str, Any]) -> list[str]:
    """Return what is to be known of a controller that fits; nothing where one of the FMUs does not say."""
    design, real = design_model(controller), plant_model(plant)
    return [] if design is None or real is None else remarks_of(design, real, k_lin_of(controller))


def k_lin_of(controller: Mapping[str, Any]) -> Array:
    """Return the gain (n,) of the linear controller of an FMU with these start values."""
    return np.array([controller.get(name, 0.0) for name in vector("k_lin")], dtype=float)


def misfit_of(design: Model, plant: Model) -> str | None:
    """Return how the design's model differs from the plant's; None where it fits."""
    return _misfit(_key(design), _key(plant))


def remarks_of(design: Model, plant: Model, k_lin: Array) -> list[str]:
    """Return what is to be known although they fit: parameters that differ, a k_lin that does not stabilize."""
    said = []
    d = distance(design, plant)
    if d.A > NOTABLE_DISTANCE or not NOTABLE_GAINS[0] <= d.gain <= NOTABLE_GAINS[1]:
        numbers = f"A differs by {100 * d.A:.0f} %, b by {100 * (d.gain - 1):+.0f} %"
        said.append(f"the controller's model is not quite the plant's: {numbers}")
    with np.errstate(all="ignore"):
        closed = plant.A + np.outer(plant.b, k_lin)
    slowest = float(np.linalg.eigvals(closed).real.max()) if np.isfinite(closed).all() else -math.inf
    if slowest >= 0.0:
        said.append(f"k_lin does not stabilize this plant: the largest real part of its poles is {slowest:.3g} 1/s")
    return said


_Key = tuple[tuple[float, ...], tuple[float, ...]]


def _key(model: Model) -> _Key:
    return tuple(model.A.ravel().tolist()), tuple(model.b.tolist())


def _model(key: _Key) -> Model:
    b = np.array(key[1])
    return Model(np.array(key[0]).reshape(len(b), len(b)), b)


@lru_cache(maxsize=64)  # a study's runs have few models
def _misfit(design_key: _Key, plant_key: _Key) -> str | None:
    design, plant = _model(design_key), _model(plant_key)
    d = distance(design, plant)
    if d.fits:
        return None
    explanation = min(_explanations(design, plant), key=len, default=None)
    if explanation is not None:
        return f"the controller was designed for another model than the plant's: {'; '.join(explanation)}"
    near = d.stiffness <= LARGEST_DISTANCE and d.angle <= LARGEST_ANGLE and GAINS[0] <= d.gain <= GAINS[1]
    if near and d.kinematics > KINEMATICS:
        return "the controller was designed for another model than the plant's: its last two states are no rates"
    poles = [sorted_poles(model.A) for model in (design, plant)]
    if alike(*poles):
        return "the controller was designed for this plant in other coordinates: the poles are the same, the states are not"
    return (
        f"the controller was designed for another system than this plant: A differs by {100 * d.A:.0f} %, b by a factor of "
        f"{d.gain:.3g}; poles {poles_text(poles[0])} instead of {poles_text(poles[1])} 1/s"
    )


def _explanations(design: Model, plant: Model) -> Iterator[list[str]]:
    """Yield what would make the design's model that of the plant, each as a list of differences.

    The design's state is x_d = S Pi x: Pi permutes, S scales and turns signs.
    """
    hanging = Model(plant.A * np.where(np.arange(len(STATES)) == 1, -1.0, 1.0), plant.b)  # gravity the other way
    for place, real in ((), plant), (("it is linearized about the hanging pendulum",), hanging):
        for order in permutations(range(len(STATES))):
            A, b = real.A[np.ix_(order, order)], real.b[list(order)]
            S = _scaling(design, A, b)
            if S is None:
                continue
            back = np.argsort(order)
            turned = Model((design.A / np.outer(S, 1.0 / S))[np.ix_(back, back)], (design.b / S)[back])
            if distance(turned, real).fits:
                yield [*place, *_differences(order, S)]


def _scaling(design: Model, A: Array, b: Array) -> Array | None:
    """Return the factors of the design's states, taken from SCALES, for a plant A, b in their order; None where none fit.

    Rates, on which the input acts, by b; each angle by the row that says which rate is its own.
    """
    S = np.ones(len(b))
    rates = np.flatnonzero(b)
    for i in rates:
        S[i] = design.b[i] / b[i]
    for j in np.flatnonzero(b == 0.0):
        own = rates[np.argmax(np.abs(A[j, rates]))]
        S[j] = design.A[j, own] / A[j, own] * S[own]
    snapped = np.array([nearest(s, SCALES) for s in S])
    return None if np.isnan(snapped).any() else snapped


def _differences(order: tuple[int, ...], S: Array) -> list[str]:
    names = [STATES[i] for i in order]
    said = []
    if names != list(STATES):
        said.append(f"its states are in the order {', '.join(names)}, not {', '.join(STATES)}")
    sign, size = np.sign(S), np.abs(S)
    if np.all(sign < 0.0):
        said.append("the sign of its input is the opposite")
    elif np.any(sign < 0.0):
        said.append(
            f"the signs of {', '.join(n for n, s in zip(names, sign, strict=True) if s < 0.0)} are the opposite"
        )
    if np.all(size == 1e-3):
        said.append("its input is in mV instead of V")
    else:
        for scale, unit in UNITS.items():
            which = [n for n, s in zip(names, size, strict=True) if s == scale]
            if which:
                said.append(f"{', '.join(which)} {'is' if len(which) == 1 else 'are'} in {unit}")
    return said
