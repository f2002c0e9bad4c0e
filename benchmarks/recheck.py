"""A design's proof again, from A, B, K, P, mu and alpha alone, in 60 digits."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import mpmath
import numpy as np

from ihc_fmu.block_form import Scaling, scaling, slices
from ihc_fmu.design import Design

DIGITS = 60


@dataclass(frozen=True)
class Recheck:
    """Margins relative to P, of (11) in 1/alpha and of the monotone dilation, both positive if the design is proven.

    `identities`: the largest entry of T (A + B K_0) T^-1 - N and T B - [0; B_k], relative to these matrices. `generator`:
    how far the certificate's G_d is from that of 60 digits, relative to P. For blocks of one size both are rounding.
    """

    decrease: float
    monotone: float
    identities: float
    generator: float

    @property
    def holds(self) -> bool:
        return self.decrease > 0.0 and self.monotone > 0.0


def recheck(design: Design) -> Recheck:
    """Return the margins in 60 digits: block form, dilation and inequalities are computed anew from the same doubles.

    The block form's sizes, which rounding of the doubles blurs, and its scaling, which is a choice, are taken over.
    """
    with mpmath.workdps(DIGITS):
        A, B, K, P = (_matrix(M) for M in (design.A, design.B, design.K, design.P))
        T, inverse, identities = _block_form(A, B, design.form.sizes, scaling(design.A, design.B))
        w = mpmath.diag([1 + mpmath.mpf(design.mu) * e for e in design.form.exponents])
        G, alpha = inverse * w * T, mpmath.mpf(design.alpha)
        L = mpmath.cholesky((P + P.T) / 2)
        to_y, to_x = L.T, mpmath.inverse(L.T)  # y = L' x, in which P is the unit matrix
        G_y = to_y * G * to_x
        closed = to_y * (A + B * K) * to_x / alpha + G_y
        given = to_y * _matrix(design.form.generator(design.mu)) * to_x
        return Recheck(
            decrease=-float(max(_eigenvalues(closed))),
            monotone=float(min(_eigenvalues(G_y))),
            identities=identities,
            generator=float(mpmath.norm(given - G_y) / mpmath.norm(G_y)),
        )


def _block_form(A: Any, B: Any, sizes: tuple[int, ...], s: Scaling) -> tuple[Any, Any, float]:
    """Return T, its inverse and the residual of the form; the method of ihc_fmu.block_form in other numbers."""
    x, omega = mpmath.diag(list(map(mpmath.mpf, s.states))), mpmath.mpf(s.omega)
    scaled_A = mpmath.inverse(x) * A * x / omega
    scaled_B = mpmath.inverse(x) * B * mpmath.diag(list(map(mpmath.mpf, s.inputs))) / omega
    T = _staircase(scaled_A, scaled_B, sizes)
    blocks = slices(sizes)
    for here, following in pairwise(blocks):
        M = T * scaled_A * mpmath.inverse(T)
        right = M[here, following]
        left = M[here, : here.stop]
        T[following, :] = T[following, :] + right.T * mpmath.inverse(right * right.T) * left * T[: here.stop, :]
    inverse = mpmath.inverse(T)
    M, last = T * scaled_A * inverse, blocks[-1]
    Bz = T * scaled_B
    residual, size = 0.0, float(max(_size(M[: last.start, :]) if last.start else 0, 1e-300))
    for i, here in enumerate(blocks[:-1]):
        for j, there in enumerate(blocks):
            if j != i + 1:
                residual = max(residual, float(_size(M[here, there])) / size)
    if last.start:
        residual = max(residual, float(_size(Bz[: last.start, :]) / _size(Bz)))
    return T * mpmath.inverse(x), x * inverse, residual


def _staircase(A: Any, B: Any, sizes: tuple[int, ...]) -> Any:
    """Return the orthogonal staircase's T."""
    rest: Any = mpmath.eye(A.rows)
    reached, bases = B, []
    for size in reversed(sizes):
        projected = rest.T * reached
        U, _, _ = mpmath.svd_r(_widened(projected), full_matrices=False)
        bases.append(rest * U[:, :size])
        rest = rest * U[:, size:] if size < U.cols else None
        reached = A * bases[-1]
    n = A.rows
    T = mpmath.matrix(n, n)
    for basis, place in zip(reversed(bases), slices(sizes), strict=True):
        T[place, :] = basis.T
    return T


def _widened(M: Any) -> Any:
    """Return M with columns of 0 up to its height, so that its left singular vectors are a whole basis."""
    if M.cols >= M.rows:
        return M
    wide = mpmath.matrix(M.rows, M.rows)
    wide[:, : M.cols] = M
    return wide


def _matrix(M: np.ndarray) -> Any:
    return mpmath.matrix([[mpmath.mpf(entry) for entry in row] for row in M.tolist()])


def _size(M: Any) -> Any:
    return max(abs(entry) for entry in M)


def _eigenvalues(M: Any) -> Any:
    """Return the eigenvalues of M + M'."""
    return mpmath.eigsy(M + M.T, eigvals_only=True)
