"""What a design puts into the controller FMU of any linear model: start values, nothing else. Offline."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fmu_export.errors import UserError
from fmu_export.variables import Interface, Value

from ..block_form import combination, scaling
from ..design import Design
from ..sliding_mode import certified_surface
from .interface import ESTIMATORS, UNLIMITED, Shape, numbered, shown_interface

Array = np.ndarray

_DEFAULT: Any = None
"""Stands for zeros, or for no limits, in a Regulator that is being made."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LinearFilter:
    """A Kalman filter for one sample time: x+ = F x + G (u + d), d+ = d, b+ = decay b, y = C x + b.

    F (n, n), G (n, m), C (p, n), M (n + m + p, p): corrections of x, d, b by the innovation y - (C x + b); rows of what is
    not estimated are 0. decay in [0, 1]. `counts` (p,): resolutions of the sensors, 0 for none, as by default.
    """

    F: Array
    G: Array
    C: Array
    M: Array
    decay: float = 1.0
    counts: Array = _DEFAULT


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Observer:
    """The homogeneous observer x' = A x + B u + S (C x - y), S = L_0 + q^(nu (I + G_0)) (L - L_0), q = |C x - y|.

    A (n, n), B (n, m), C (p, n) of the model. T (n, n), `exponents` (n,): block coordinates of (A', C'), in which
    G_0 = (T^-1 diag(e) T)'; L_0 (n, p) the transpose of their K_0: A + L_0 C is nilpotent. L (n, p): a linear observer's
    gain, A + L C Hurwitz. nu in [-1, 0]: its degree. q is limited to [q_min, q_max].
    """

    A: Array
    B: Array
    C: Array
    T: Array
    exponents: Sequence[int]
    L_0: Array
    L: Array
    nu: float
    q_min: float
    q_max: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Regulator:
    """All that the controller FMU of a design needs, in plain arrays.

    `shape`: names and units. Block coordinates z = T x, T (n, n), with `exponents` (n,); N (n, n) their superdiagonal
    blocks; B (n, m) = T times the model's B; K_0 (m, n); K (m, n) the linear gain u = K x; P (n, n) of the unit ball
    x' P x <= 1; mu in [0, 1]. `sample_time` [s]. `lower`, `upper` (m,): limits of the inputs, infinite for none. x_eq (n,),
    u_eq (m,), y_eq (p,): equilibrium of the model, 0 by default. `filter` estimates the state, None: it is measured. N_x
    (n, p), N_u (m, p): states and inputs at rest per set-point. K_i (m, n): integral action as in `ihc_fmu.integral`.

    Raises UserError for an array of another shape or with an entry that is not finite.
    """

    shape: Shape
    exponents: Sequence[int]
    T: Array
    N: Array
    B: Array
    K_0: Array
    K: Array
    P: Array
    mu: float
    sample_time: float
    lower: Array = _DEFAULT
    upper: Array = _DEFAULT
    x_eq: Array = _DEFAULT
    u_eq: Array = _DEFAULT
    y_eq: Array = _DEFAULT
    filter: LinearFilter | Observer | None = None
    N_x: Array = _DEFAULT
    N_u: Array = _DEFAULT
    K_i: Array = _DEFAULT

    def __post_init__(self) -> None:
        n, m, p = (len(names) for names in (self.shape.states, self.shape.inputs, self.shape.outputs))
        if isinstance(self.filter, LinearFilter) != self.shape.estimated:
            raise UserError("disturbances are estimated by a Kalman filter, and by nothing else")
        if self.filter is None and n != p:
            raise UserError(f"states that are measured need as many outputs, found {n} states and {p} outputs")
        shapes = dict.fromkeys(("T", "N", "P"), (n, n)) | dict.fromkeys(("K", "K_0", "K_i"), (m, n))
        shapes |= {"B": (n, m), "N_x": (n, p), "N_u": (m, p), "x_eq": (n,), "y_eq": (p,), "exponents": (n,)}
        shapes |= dict.fromkeys(("lower", "upper", "u_eq"), (m,))
        defaults = {"lower": -np.inf, "upper": np.inf}
        for name, shape in shapes.items():
            given = getattr(self, name)
            value = np.full(shape, defaults.get(name, 0.0)) if given is None else given
            object.__setattr__(self, name, _checked(name, value, shape, finite=name not in defaults))
        estimators: dict[type, dict[str, tuple[int, ...]]] = {
            LinearFilter: {"F": (n, n), "G": (n, m), "C": (p, n), "M": (n + m + p, p)},
            Observer: {
                "A": (n, n),
                "B": (n, m),
                "C": (p, n),
                "T": (n, n),
                "exponents": (n,),
                "L_0": (n, p),
                "L": (n, p),
            },
        }
        for name, shape in estimators.get(type(self.filter), {}).items():
            _checked(f"the estimator's {name}", getattr(self.filter, name), shape)

    @property
    def estimator(self) -> str:
        """Where the state comes from, one of ESTIMATORS."""
        return {LinearFilter: "kalman", Observer: "homogeneous_observer"}.get(type(self.filter), "measured_state")

    def values(self) -> dict[str, Value]:
        """Return the start values of the compiled table that the design decides."""
        n, m, p = (len(names) for names in (self.shape.states, self.shape.inputs, self.shape.outputs))
        values: dict[str, Value] = {"state_count": n, "input_count": m, "output_count": p}
        values |= {"mu": self.mu, "sample_time": self.sample_time}
        values |= {"estimator": ESTIMATORS.index(self.estimator) + 1}
        values |= {name: int(e) for name, e in zip(numbered("exponent", n), self.exponents, strict=True)}
        arrays = {"T": self.T, "N": self.N, "B": self.B, "K": self.K, "K0": self.K_0, "Ki": self.K_i}
        arrays |= {"Nx": self.N_x, "Nu": self.N_u, "P": self.P[np.triu_indices(n)]}
        arrays |= {"lower": _bounded(self.lower), "upper": _bounded(self.upper)}
        arrays |= {"output_equilibrium": self.y_eq, "input_equilibrium": self.u_eq, "state_equilibrium": self.x_eq}
        arrays |= {"setpoint": self.y_eq}
        surface = certified_surface(*self._model(), self.K, self.P)
        arrays |= {"S": surface.S, "Ks": surface.K_s, "sta_rate": surface.rates}
        f = self.filter
        if f is not None:
            arrays |= {"C": f.C, "first": np.linalg.pinv(f.C)}
        if isinstance(f, LinearFilter):
            arrays |= {"F": f.F, "G": f.G, "M": f.M}
            arrays |= {"count": np.zeros(p) if f.counts is None else f.counts}
            values |= {"bias_decay": f.decay, "filter_sample_time": self.sample_time}
        if isinstance(f, Observer):
            arrays |= {"F": f.A, "G": f.B, "To": f.T, "L0": f.L_0, "Lz": np.linalg.solve(f.T.T, f.L - f.L_0)}
            values |= {"observer_degree": f.nu, "q_min": f.q_min, "q_max": f.q_max}
            names = numbered("observer_exponent", n)
            values |= {name: int(e) for name, e in zip(names, f.exponents, strict=True)}
        for name, entries in arrays.items():
            flat = np.asarray(entries, dtype=float).ravel()
            values |= {entry: float(number) for entry, number in zip(numbered(name, flat.size), flat, strict=True)}
        return values

    def _model(self) -> tuple[Array, Array]:
        """Return A (n, n) and B (n, m) of the model, from its block form."""
        B = np.linalg.solve(self.T, self.B)
        return np.linalg.solve(self.T, self.N @ self.T) - B @ self.K_0, B

    def exported(self) -> tuple[Interface, dict[str, Value]]:
        """Return what the FMU shows, with the design's start values, and the start values of the rest by compiled names."""
        values = self.values()
        interface = shown_interface(self.shape)
        shown = [replace(v, start=values.pop(v.compiled, v.start)) for v in interface.variables]
        return replace(interface, variables=tuple(shown)), values


def design_regulator(design: Design, estimator: LinearFilter | Observer | None = None) -> Regulator:
    """Return what the controller FMU of a design needs; `estimator` as the filter of `Regulator`.

    The set-points of its system become matrices by `set_point_matrices`. Raises UserError where the states are not measured
    and there is no estimator, for set-points that cannot be held, and as `Regulator`.
    """
    system, form = design.system, design.form
    if estimator is None and not system.measures_state:
        raise UserError(f"{system.name} does not measure its states, so that its controller needs an estimator")
    A, B, C = system.A, system.B, _array(system.C)
    names = [q.name for q in system.outputs]
    N_x, N_u = set_point_matrices(A, B, C, [system.output(name) for name in system.set_points], names)
    shape = Shape(
        name=system.name,
        states=tuple((q.name, q.unit) for q in system.states),
        inputs=tuple((q.name, q.unit) for q in system.inputs),
        outputs=tuple((q.name, q.unit) for q in system.outputs),
        set_points=system.set_points,
        biases=system.biases if isinstance(estimator, LinearFilter) else (),
        estimated=isinstance(estimator, LinearFilter),
    )
    return Regulator(
        shape=shape,
        exponents=form.exponents,
        T=form.T,
        N=form.N,
        B=form.Bz,
        K_0=form.K_0,
        K=design.K,
        P=design.P,
        mu=design.mu,
        sample_time=system.sample_time,
        lower=_array(system.lower),
        upper=_array(system.upper),
        x_eq=_array(system.x_eq),
        u_eq=_array(system.u_eq),
        y_eq=_array(system.y_eq),
        filter=estimator,
        N_x=N_x,
        N_u=N_u,
        K_i=_DEFAULT if design.integral is None else design.integral.K_i,
    )


def _array(value: Array | None) -> Array:
    """Return what a system has made an array of."""
    assert value is not None
    return value


def _checked(name: str, value: object, shape: tuple[int, ...], *, finite: bool = True) -> Array:
    numbers = np.asarray(value, dtype=float)
    if numbers.shape != shape:
        raise UserError(f"{name} must have the shape {shape}, found {numbers.shape}")
    if not (np.isfinite(numbers).all() if finite else not np.isnan(numbers).any()):
        raise UserError(f"{name} must be finite, found {numbers[~np.isfinite(numbers)].flat[0]}")
    return numbers


def _bounded(limits: Array) -> Array:
    return np.clip(limits, -UNLIMITED, UNLIMITED)


def set_point_matrices(
    A: Array, B: Array, C: Array, held_outputs: Collection[int], names: Sequence[str] = ()
) -> tuple[Array, Array]:
    """Return N_x (n, p), N_u (m, p): x = N_x r and u = N_u r are at rest and hold the outputs `chosen` at r.

    A x + B u = 0, y_i = r_i for i in `chosen`; of several solutions the smallest. Columns of other outputs are 0. Raises
    UserError where the chosen outputs cannot all be held at will, with the combination of them, by the `names` (p,) of the
    outputs, that is 0 in every such equilibrium.
    """
    (n, m), p = B.shape, len(C)
    rows = sorted(held_outputs)
    s = scaling(A, B)
    A_s, B_s = A * s.states / s.states[:, None] / s.omega, B * s.inputs / s.states[:, None] / s.omega
    C_s = C[rows] * s.states
    sizes = np.maximum(np.abs(C_s).max(axis=1, initial=0.0), 1e-300)
    M = np.block([[A_s, B_s], [C_s / sizes[:, None], np.zeros((len(rows), m))]])
    wanted = np.vstack([np.zeros((n, len(rows))), np.eye(len(rows))])
    at_rest = np.linalg.lstsq(M, wanted, rcond=1e-12)[0]
    left = wanted - M @ at_rest  # orthogonal to what M reaches: in every equilibrium its last rows times y are 0
    if np.abs(left).max(initial=0.0) > 1e-8:
        names = names or [f"y{i}" for i in range(1, p + 1)]
        fixed = left[n:, np.abs(left).max(axis=0).argmax()] / sizes
        held = [names[i] for i in rows]
        raise UserError(
            f"set_points must be outputs that can be held at any values together, found {', '.join(held)}: at rest "
            f"{combination(fixed, held)} stays where it is at the equilibrium, whatever the inputs"
        )
    at_rest = at_rest / sizes * np.concatenate([s.states, s.inputs])[:, None]
    N = np.zeros((n + m, p))
    N[:, rows] = at_rest
    return N[:n], N[n:]
