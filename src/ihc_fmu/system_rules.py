"""What the fields of a system must be, and how it holds what was given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fmu_export.errors import UserError, counted, shown

from .arguments import as_names
from .arrays import LARGEST, Array, matrix, reals, size
from .observer_wish import ObserverWish
from .quantity import LONGEST_NAME, Quantity, check_unique, index_of

DIRECT = "direct"
"""In place of a gain of integral action: choose one."""
EQUILIBRIUM = {"states": "x_eq", "inputs": "u_eq", "outputs": "y_eq"}
"""Fields by the entries of a file's table `equilibrium`."""
IN_FILES = {"lower": "limits", "upper": "limits", **{name: f"equilibrium.{key}" for key, name in EQUILIBRIUM.items()}}
"""What files call a field, where that is not its name."""


def checked(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return all fields of a `System` as it holds them, from what was given; raise UserError as `System`."""
    values = {**given, **_matrices(given)}
    values |= _names(values)
    values |= _vectors(values)
    _check_scalars(values)
    return {**values, "observer": _observer(values)}


def _matrices(given: Mapping[str, Any]) -> dict[str, Any]:
    A = matrix("A", given["A"])
    n = len(A)
    if n == 0 or A.shape != (n, n):
        raise UserError(f"A must be a square matrix, found shape {A.shape}")
    B = matrix("B", given["B"], flat=True)
    B = B[:, None] if B.ndim == 1 else B
    m = B.shape[1]
    if len(B) != n or m == 0:
        empty = "" if m else " and columns"
        raise UserError(f"B must have {counted(n, 'row')}{empty} to fit A, found shape {B.shape}")
    measures_state = given["C"] is None
    C = np.eye(n) if measures_state else matrix("C", given["C"])
    if C.shape[1] != n or not len(C):
        raise UserError(f"C must have {counted(n, 'column')} to fit A, found shape {C.shape}")
    for i, row in enumerate(C):
        if not row.any():
            raise UserError(f"C must have no row of zeros, found that output {i + 1} measures nothing")
    K = None if given["K"] is None else _gain("K", given["K"], m, n)
    K_i = given["integral"]
    if isinstance(K_i, str) and K_i != DIRECT:
        raise UserError(f'integral must be rows of numbers or "{DIRECT}", found {shown(K_i)}')
    if K_i is not None and not isinstance(K_i, str):
        K_i = _gain("integral", K_i, m, n)
    return {"A": A, "B": B, "C": C, "measures_state": measures_state, "K": K, "integral": K_i}


def _gain(name: str, value: object, m: int, n: int) -> Array:
    K = matrix(name, value, flat=True)
    K = K[None, :] if K.ndim == 1 else K
    if K.shape != (m, n):
        raise UserError(f"{name} must have {size(m, n)} to fit B and A, found shape {K.shape}")
    return K


def _names(s: Mapping[str, Any]) -> dict[str, Any]:
    name = s["name"]
    if not name.isidentifier() or not name.isascii() or len(name) > LONGEST_NAME:
        raise UserError(f"name must be a short C identifier, found {shown(name)}")
    if s["measures_state"] and s["outputs"]:
        raise UserError("outputs must come with C; without C the states are measured")
    values: dict[str, Any] = {}
    counts = (len(s["A"]), s["B"].shape[1], len(s["C"]))
    for kind, letter, count in zip(("states", "inputs", "outputs"), "xuy", counts, strict=True):
        given = as_names(kind, s[kind], (str, Quantity)) or [f"{letter}{i}" for i in range(1, count + 1)]
        values[kind] = tuple(q if isinstance(q, Quantity) else Quantity.parse(q, f"each of {kind}") for q in given)
        if len(values[kind]) != count:
            raise UserError(f"{kind} must be {counted(count, 'name')} to fit the matrices, found {len(values[kind])}")
    if s["measures_state"]:
        values["outputs"] = values["states"]
    for kind, quantities in values.items():
        check_unique([q.name for q in quantities], kind)
    both = {q.name for q in values["inputs"]} & {q.name for q in (*values["states"], *values["outputs"])}
    if both:
        raise UserError(f"inputs must have other names than states and outputs, found {shown(min(both))} twice")
    for kind in ("set_points", "biases"):
        values[kind] = as_names(kind, s[kind])
        check_unique(values[kind], kind)
        for name in values[kind]:
            index_of(name, values["outputs"], kind, "outputs")
    return values


def _vectors(s: Mapping[str, Any]) -> dict[str, Array]:
    n, m, p = (len(s[kind]) for kind in ("states", "inputs", "outputs"))
    values: dict[str, Array] = {}
    for name, count, of, default in (
        ("x_eq", n, "state", 0.0),
        ("u_eq", m, "input", 0.0),
        ("y_eq", p, "output", 0.0),
        ("resolutions", p, "output", 0.0),
        ("deviations", p, "output", 0.0),
        ("lower", m, "input", -np.inf),
        ("upper", m, "input", np.inf),
    ):
        given = s[name]
        if name == "y_eq" and s["measures_state"]:
            given = _measured_equilibrium(given, values["x_eq"])
        value = (
            np.full(count, default) if given is None else reals(IN_FILES.get(name, name), given, "a list of numbers")
        )
        if value.shape != (count,):
            length = len(value) if value.ndim == 1 else f"shape {value.shape}"
            raise UserError(f"{IN_FILES.get(name, name)} must be as many as {of}s, {count}, found {length}")
        values[name] = value
    for name in ("x_eq", "u_eq", "y_eq", "resolutions", "deviations"):
        matrix(IN_FILES.get(name, name), values[name][None, :])
    for name in ("resolutions", "deviations"):
        if (values[name] < 0.0).any():
            raise UserError(f"{name} must not be negative, found {values[name].min():g}")
    for q, low, high, at_rest in zip(s["inputs"], values["lower"], values["upper"], values["u_eq"], strict=True):
        if not low < high:
            raise UserError(f"limits must be apart, lower below upper, found {low:g} and {high:g} for {q.name}")
        if not low < at_rest < high:
            raise UserError(
                f"limits must leave room around the inputs at the equilibrium, found {low:g} and {high:g} around "
                f"{q.name} = {at_rest:g}"
            )
    return values


def _measured_equilibrium(y_eq: object, x_eq: Array) -> Array:
    """Return y_eq of measured states, which is x_eq."""
    if y_eq is not None and not np.array_equal(reals("equilibrium.outputs", y_eq, "a list of numbers"), x_eq):
        raise UserError(
            "equilibrium.outputs must be left out without C, as the outputs are the states, found "
            f"{shown(np.asarray(y_eq).tolist())}"
        )
    return x_eq


def _check_scalars(s: Mapping[str, Any]) -> None:
    if not 0.0 < s["sample_time"] < LARGEST:
        raise UserError(f"sample_time must be positive and finite [s], found {s['sample_time']}")
    if s["bandwidth"] is not None and not 0.0 <= s["bandwidth"] < LARGEST:
        raise UserError(f"bandwidth must be 0 or more and finite [rad/s], found {s['bandwidth']}")


def _observer(s: Mapping[str, Any]) -> ObserverWish | None:
    """Return the wish with its gain as a matrix; refuse one beside what an observer does not do."""
    wish: ObserverWish | None = s["observer"]
    if s["integral"] is not None and (wish is not None or s["bandwidth"] == 0.0):
        raise UserError(
            "integral needs states that a disturbance does not falsify: measured, or of a Kalman filter that estimates "
            f"disturbances, found {'observer' if wish is not None else 'bandwidth = 0'}"
        )
    if wish is None:
        return None
    if s["measures_state"]:
        raise UserError("observer is for outputs y = C x; without C the states are measured")
    if s["biases"] or s["bandwidth"] is not None:
        name = "biases" if s["biases"] else "bandwidth"
        raise UserError(f"{name} must be left out with observer: only a Kalman filter estimates such")
    n, p = len(s["states"]), len(s["outputs"])
    if wish.L is None or wish.L.shape == (n, p):
        return wish
    if wish.L.shape != (n,) or p != 1:
        raise UserError(f"observer.L must have {size(n, p)} to fit A and C, found shape {wish.L.shape}")
    return replace(wish, L=wish.L[:, None])
