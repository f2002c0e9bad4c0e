"""The closed loop of a linear controller as matrix inequalities in scaled block coordinates; a gain must stabilize it."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from fmu_export.errors import UserError

from .arrays import Array
from .block_form import BlockForm
from .lmi import Problem
from .system import System

MOST_ORDERED = 6
"""States up to which all orders of a gain's entries are tried for a hint."""
SIGNS = ((1.0, ""), (-1.0, " and the sign of u = -K x"))


def closed_loop(system: System, beta: float) -> tuple[Problem, float]:
    """Return the inequalities of an inverse design, and omega [1/s], in which its time is scaled.

    omega is the geometric mean of the closed loop's poles.
    """
    assert system.K is not None
    form = system.form
    closed = form.T @ (system.A + system.B @ system.K) @ form.T_inverse
    omega = float(np.exp(np.linalg.slogdet(closed)[1] / system.n))
    form = form.normal(omega)
    closed = form.T @ (system.A + system.B @ system.K) @ form.T_inverse / omega
    slowest = float(np.linalg.eigvals(closed).real.max()) * omega
    if slowest >= 0.0:
        raise UserError(
            "K must stabilize (A, B) whatever the rounding: the largest real part of the poles is "
            f"{_slowest(system, system.K):.4g} 1/s as given, but {slowest:.4g} 1/s in scaled block coordinates"
        )
    return problem_of(form, closed, beta), omega


def problem_of(form: BlockForm, closed: Array, beta: float) -> Problem:
    """Return the inequalities for a closed loop in the coordinates of a block form, in its time."""
    E = np.diag(np.array(form.exponents, dtype=float))
    return Problem(closed, E, form.Bz, form.T_inverse, form.T, beta)


def check_gain(system: System) -> None:
    """Raise UserError for a system without a gain, or with one that does not stabilize it, and what would."""
    if system.K is None:
        raise UserError("an inverse design needs a linear controller: K, k_lin or lqr in the system")
    slowest = _slowest(system, system.K)
    if slowest >= 0.0:
        _ = system.form  # refuses a pair for which no gain might
        raise UserError(
            f"K must stabilize (A, B): the largest real part of the poles is {slowest:.4g} 1/s{_hint(system)}"
        )


def _slowest(system: System, K: Array) -> float:
    return float(np.linalg.eigvals(system.A + system.B @ K).real.max())


def _hint(system: System) -> str:
    """Return what would make a gain that does not stabilize do so: its sign, or another order of its entries.

    That is a usual order, or of all orders of up to MOST_ORDERED states the only one, but for equal entries, that does.
    """
    K, n = system.K, system.n
    assert K is not None
    if _slowest(system, -K) < 0.0:
        return "; -K does: the law is u = +K x here, not u = -K x"
    # K for angle, rate, angle, rate and A for angle, angle, rate, rate, or the other way round
    for size in (n // 2, 2) if n % 2 == 0 else ():
        order = np.arange(n).reshape(-1, size).T.ravel()
        for sign, law in SIGNS:
            if _slowest(system, sign * K[:, np.argsort(order)]) < 0.0:
                return _order(system, order, law)
    if n <= MOST_ORDERED:
        orders = np.array(list(permutations(range(n))))
        gains = K[:, np.argsort(orders, axis=1)].swapaxes(0, 1)
        for sign, law in SIGNS:
            does = np.linalg.eigvals(system.A + sign * system.B @ gains).real.max(axis=1) < 0.0
            if does.any():
                only = len(np.unique(gains[does], axis=0)) == 1
                return _order(system, orders[does.argmax()], law) if only else ""
    return ""


def _order(system: System, order: Array, law: str) -> str:
    names = ", ".join(system.states[i].name for i in order)
    return f"; K seems to be in the order ({names}){law}, unlike A"
