"""The gain of the linear-quadratic regulator, in coordinates without units, refined until rounding ends it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, solve_continuous_are, solve_continuous_lyapunov

from fmu_export.errors import UserError, counted, shown

from .arrays import QUIET, Array, reals
from .block_form import block_form, scaling

STEPS = 100
"""Of Kleinman's iteration at most; far from the solution each halves the gain, near it each doubles its digits."""
SETTLED, ACCEPTED = 1e-13, 1e-6
"""Relative change of the gain in a step: that ends the iteration, and that the last step may have."""
UNSEEN = 1e-8
"""Smallest singular value of (A - i w I, sqrt(Q)), scaled to entries near 1, that counts as 0."""


@QUIET
def lqr_gain(A: Array, B: Array, Q: ArrayLike, R: ArrayLike, states: Sequence[str]) -> Array:
    """Return `regulator_gain` for weights as matrices or their diagonals.

    Raises UserError for weights without a stabilizing solution, where (A, B) is not controllable, which names one of the
    `states`, and where no gain is found in double precision.
    """
    weights = _checked(Q, R, *B.shape)
    unseen = unseen_frequency(A, B, weights[0])
    if unseen is None:
        K = regulator_gain(A, B, *weights)
        if K is not None and np.linalg.eigvals(A + B @ K).real.max() < 0.0:
            return K
    block_form(A, B, states)  # refuses a pair that is not controllable, by its state
    if unseen is not None:
        raise UserError(
            "lqr has no stabilizing solution: Q must weigh all that neither grows nor decays, found a motion at "
            f"{unseen:.4g} rad/s that it does not"
        )
    raise UserError(
        "lqr could not be decided in double precision: no gain that stabilizes was found, although (A, B) is "
        "controllable; other weights, or states in other units, may do"
    )


def _checked(Q: ArrayLike, R: ArrayLike, n: int, m: int) -> tuple[Array, Array]:
    """Return Q (n, n) and R (m, m) from matrices or their diagonals; raise UserError unless Q >= 0 and R > 0."""
    Q, R = _weight("Q", Q, n), _weight("R", R, m)
    for name, W, least, rule in (("Q", Q, 0.0, "positive semidefinite"), ("R", R, 1e-300, "positive definite")):
        smallest = float(np.linalg.eigvalsh(W)[0])
        if smallest < least:
            raise UserError(f"lqr.{name} must be {rule}, found the eigenvalue {smallest:g}")
    return Q, R


def _weight(name: str, value: ArrayLike, size: int) -> Array:
    W = reals(f"lqr.{name}", value, "rows of numbers or a list of them")
    W = np.diag(W) if W.ndim == 1 else W
    if W.shape != (size, size) or not np.isfinite(W).all() or np.abs(W - W.T).max() > 1e-9 * np.abs(W).max():
        raise UserError(
            f"lqr.{name} must be {counted(size, 'number')}, or a symmetric matrix of that size, found {shown(value)}"
        )
    return W


def regulator_gain(A: Array, B: Array, Q: Array, R: Array) -> Array | None:
    """Return K = -R^-1 B' S (m, n), A' S + S A - S B R^-1 B' S + Q = 0, A + B K Hurwitz; None where none is found.

    A (n, n), B (n, m), Q (n, n) positive semidefinite, R (m, m) positive definite. SciPy's gain for scaled states, inputs
    and time is refined by D. L. Kleinman's iteration (IEEE Trans. Automatic Control 13(1), 1968, 114-115). Where that does
    not stabilize, both are tried in block coordinates, in which the fastest motion has entries near 1, and there the
    iteration from R. W. Bass's gain.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is found is judged by its poles and by its last step
        for coordinates, first in ((_scaled, _by_riccati), (_in_blocks, _by_riccati), (_in_blocks, _by_bass)):
            try:
                S, inputs, omega = coordinates(A, B)
                inverse = np.linalg.inv(S)
                pair = inverse @ A @ S / omega, inverse @ B * inputs / omega
                weights = S.T @ Q @ S, inputs[:, None] * R * inputs
                K = _refined(*pair, *weights, first(*pair, *weights))
            except (LinAlgError, ValueError):  # of a pair that is not controllable too: it has no block form
                continue
            if K is not None:
                return inputs[:, None] * K @ inverse
    return None


def _scaled(A: Array, B: Array) -> tuple[Array, Array, float]:
    """Return S (n, n), the units (m,) of inputs, and omega, with x = S y and time in 1/omega, as `scaling` finds them."""
    s = scaling(A, B)
    return np.diag(s.states), s.inputs, s.omega


def _in_blocks(A: Array, B: Array) -> tuple[Array, Array, float]:
    """Return the same for block coordinates whose time is that of the fastest pole of A, or of the scaling."""
    s = scaling(A, B)
    omega = max(float(np.abs(np.linalg.eigvals(A)).max()), s.omega)
    form = block_form(A, B, metric=s).normal(omega)
    return form.T_inverse, omega / np.linalg.norm(form.Bz, axis=0), omega


def unseen_frequency(A: Array, B: Array, Q: Array) -> float | None:
    """Return the w [rad/s] of a motion that neither grows nor decays and has no weight in Q; None where there is none.

    With one no gain that minimizes the cost stabilizes. B (n, m) has a say in the scaling only.
    """
    s = scaling(A, B)
    A_s, Q_s = A * s.states / s.states[:, None] / s.omega, s.states[:, None] * Q * s.states
    values, vectors = np.linalg.eigh(Q_s / (np.abs(Q_s).max() or 1.0))
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    for w in np.abs(np.linalg.eigvals(A_s).imag):
        if np.linalg.svd(np.vstack([A_s - 1j * w * np.eye(len(A)), root]), compute_uv=False)[-1] < UNSEEN:
            return float(w) * s.omega
    return None


def _by_riccati(A: Array, B: Array, Q: Array, R: Array) -> Array:
    return -np.linalg.solve(R, B.T @ solve_continuous_are(A, B, Q, R))


def _by_bass(A: Array, B: Array, *_: Array) -> Array:
    """Return -B' Z^-1, (A + c I) Z + Z (A + c I)' = 2 B B', which stabilizes every controllable pair for c > |A|."""
    shifted = A + 2.0 * float(np.linalg.norm(A, 2)) * np.eye(len(A))
    return -np.linalg.solve(solve_continuous_lyapunov(shifted, 2.0 * B @ B.T), B).T


def _refined(A: Array, B: Array, Q: Array, R: Array, K: Array) -> Array | None:
    """Return the limit of Kleinman's iteration from K; None where K does not stabilize or rounding ends it too early."""
    last = np.inf
    for _ in range(STEPS):
        closed = A + B @ K
        if not np.isfinite(closed).all() or np.linalg.eigvals(closed).real.max() >= 0.0:
            return None
        following = -np.linalg.solve(R, B.T @ solve_continuous_lyapunov(closed.T, -(Q + K.T @ R @ K)))
        change = float(np.linalg.norm(following - K) / (np.linalg.norm(following) or 1.0))
        if change <= SETTLED or (last <= ACCEPTED and change >= last):
            return K
        K, last = following, change
    return K if last <= ACCEPTED else None
