"""Block controllability form of x' = A x + B u with any number of inputs: the coordinates in which the dilation is diagonal.

    z = T x,   z_i' = N_i z_{i+1} (i < k),   z_k' = B_k (u - K_0 x),

for blocks z_1, ..., z_k of n_1 <= ... <= n_k coordinates, N_i and B_k of full row rank. So T (A + B K_0) T^-1 = N is
zero but for its superdiagonal blocks, and A_0 = A + B K_0 is nilpotent. For one input it is the chain form up to the
scale of each coordinate. Source: A. Polyakov, Generalized Homogeneity in Systems and Control, Springer 2020, chapter 8, in
an orthogonal variant: staircase by singular values, then each block row freed of what stands left of its superdiagonal
block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise

import numpy as np

from fmu_export.errors import UserError

Array = np.ndarray

RANK = 1e-8
"""Singular values below this, of a matrix scaled to entries near 1, count as 0."""
NEGLIGIBLE = 1e-11
"""Entries below this, of a scaled matrix, have no say in the scaling."""
ROUNDS = 4
"""Of scaling, each without the entries that the one before found negligible."""


@dataclass(frozen=True, eq=False)
class BlockForm:
    """The form of one (A, B): T (n, n) and its inverse, the blocks' sizes, N (n, n), Bz = T B (n, m), K_0 (m, n)."""

    T: Array
    T_inverse: Array
    sizes: tuple[int, ...]
    N: Array
    Bz: Array
    K_0: Array

    @property
    def exponents(self) -> tuple[int, ...]:
        """K - i for each coordinate of block i: how often it is integrated after the first one."""
        k = len(self.sizes)
        return tuple(k - 1 - i for i, size in enumerate(self.sizes) for _ in range(size))

    @property
    def blocks(self) -> list[slice]:
        """The coordinates of each block."""
        return slices(self.sizes)

    def weights(self, mu: float) -> Array:
        """Return w_j = 1 + mu (k - i) for each coordinate j, the exponents of the dilation."""
        return 1.0 + mu * np.array(self.exponents)

    def generator(self, mu: float) -> Array:
        """Return G_d = T^-1 diag(w) T: A_0 G_d - G_d A_0 = -mu A_0 and G_d B = B."""
        return self.T_inverse @ (self.weights(mu)[:, None] * self.T)

    def scaled(self, factors: Sequence[float]) -> BlockForm:
        """Return the form with the coordinates of block i multiplied by factors[i]."""
        d = np.repeat(np.asarray(factors, dtype=float), self.sizes)
        return replace(
            self,
            T=d[:, None] * self.T,
            T_inverse=self.T_inverse / d,
            N=d[:, None] * self.N / d,
            Bz=d[:, None] * self.Bz,
        )

    def normal(self, omega: float) -> BlockForm:
        """Return the form with blocks scaled so that N has blocks of norm omega."""
        factors = [1.0]
        for here, following in reversed(list(pairwise(self.blocks))):
            factors.insert(0, factors[0] * omega / float(np.linalg.norm(self.N[here, following], 2)))
        return self.scaled(factors)


def slices(sizes: Sequence[int]) -> list[slice]:
    """Return the places of consecutive blocks of these sizes."""
    return [slice(a, b) for a, b in pairwise(accumulate(sizes, initial=0))]


@dataclass(frozen=True, eq=False)
class Scaling:
    """x = diag(states) x_s, u = diag(inputs) u_s, time t = t_s / omega."""

    states: Array
    inputs: Array
    omega: float


def scaling(A: Array, B: Array) -> Scaling:
    """Return the scaling that brings the entries of A and B near 1, in the mean of the squares of their logarithms.

    It follows any scaling of states, inputs and time, and is so far free of the units that somebody chose. Method: A. R.
    Curtis and J. K. Reid, J. Inst. Maths Applics 10 (1972), 118-124; entries that come out negligible are left out.
    """
    n, m = B.shape
    joint = np.hstack([A, B])
    used = joint != 0.0
    logs = np.log2(np.abs(np.where(used, joint, 1.0)))
    unknowns = np.zeros(n + m + 1)
    for _ in range(ROUNDS):
        rows, columns = np.nonzero(used)
        equations = np.zeros((len(rows), n + m + 1))
        each = np.arange(len(rows))
        np.add.at(equations, (each, rows), 1.0)
        np.add.at(equations, (each, columns), -1.0)
        equations[:, -1] = 1.0
        unknowns = np.linalg.lstsq(equations, logs[rows, columns], rcond=1e-10)[0]
        left = logs - unknowns[:n, None] + unknowns[None, : n + m] - unknowns[-1]
        fewer = used & (left > np.log2(NEGLIGIBLE))
        if (fewer == used).all():
            break
        used = fewer
    powers = 2.0**unknowns
    return Scaling(powers[:n], powers[n : n + m], float(powers[-1]))


def block_form(A: Array, B: Array, names: Sequence[str] = (), metric: Scaling | None = None) -> BlockForm:
    """Return the block form of (A, B), A (n, n) and B (n, m) of finite numbers.

    With blocks of different sizes it is not unique: what is orthogonal and smallest is meant in scaled states and inputs,
    those of `scaling` unless `metric` gives others. Raises UserError for a pair that is not controllable, or so nearly not
    that rounding decides; the message tells the combination of the states, by their `names`, that no input moves.
    """
    s = metric or scaling(A, B)
    A_s = A * s.states / s.states[:, None] / s.omega
    B_s = B * s.inputs / s.states[:, None] / s.omega
    bases = _staircase(A_s, B_s, s.states, names)
    sizes = tuple(basis.shape[1] for basis in bases)
    T = np.hstack(bases).T
    blocks = slices(sizes)
    for here, following in pairwise(blocks):
        M = T @ A_s @ np.linalg.inv(T)
        T[following] += np.linalg.pinv(M[here, following]) @ M[here, : here.stop] @ T[: here.stop]
    T = T / s.states
    inverse = np.linalg.inv(T)
    M, Bz = T @ A @ inverse, np.zeros_like(B)
    Bz[blocks[-1]] = T[blocks[-1]] @ B
    N = np.zeros_like(A)
    for here, following in pairwise(blocks):
        N[here, following] = M[here, following]
    scaled_Bk = Bz[blocks[-1]] * s.inputs
    K_0 = -s.inputs[:, None] * (np.linalg.pinv(scaled_Bk) @ M[blocks[-1]] @ T)
    return BlockForm(T, inverse, sizes, N, Bz, K_0)


def _staircase(A: Array, B: Array, units: Array, names: Sequence[str]) -> list[Array]:
    """Return orthonormal bases of the blocks, the last one's range being that of B, for a scaled pair."""
    n = len(A)
    bases: list[Array] = []
    rest, reached = np.eye(n), B
    while rest.shape[1]:
        U, values, _ = np.linalg.svd(rest.T @ reached)
        rank = int((values > RANK * max(1.0, float(values[0]) if len(values) else 1.0)).sum())
        if rank == 0:
            raise UserError(f"(A, B) must be controllable; no input moves {combination(_simple(rest, units), names)}")
        bases.append(rest @ U[:, :rank])
        rest = rest @ U[:, rank:]
        reached = A @ bases[-1]
    return bases[::-1]


def _simple(basis: Array, units: Array) -> Array:
    """Return a combination of the columns of an orthonormal basis that leaves out as many states as the columns allow."""
    from scipy.linalg import qr  # noqa: PLC0415 - heavy, and a run needs none of it

    *_, pivots = qr(basis.T, mode="r", pivoting=True)
    reduced = basis @ np.linalg.inv(basis[pivots[: basis.shape[1]]])
    fewest = int(np.argmin((np.abs(reduced) > RANK).sum(axis=0)))
    return np.where(np.abs(reduced[:, fewest]) > RANK, reduced[:, fewest], 0.0) / units


def combination(direction: Array, names: Sequence[str]) -> str:
    """Return a linear combination of states, by their names or x1, x2, ..., as text, its largest coefficient 1."""
    sizes = np.abs(direction)
    direction = direction / direction[int(np.argmax(sizes > sizes.max() * (1.0 - 1e-6)))]  # the first of equals
    names = names or [f"x{i}" for i in range(1, len(direction) + 1)]
    parts = [
        ("- " if c < 0.0 else "+ ") + ("" if abs(abs(c) - 1.0) < 1e-6 else f"{abs(c):.3g} ") + name
        for c, name in zip(direction, names, strict=True)
        if abs(c) > 1e-6
    ]
    return " ".join(parts).removeprefix("+ ")
