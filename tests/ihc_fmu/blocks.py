"""Random linear systems of any order and number of inputs, whose block form is known by construction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ihc_fmu.laws import block_design


def random_blocks(rng, n, m):
    """Return sizes n_1 <= ... <= n_k <= m with the sum n: the sizes of a controllable pair's blocks."""
    sizes, most = [], m
    while n:
        most = int(rng.integers(1, min(most, n) + 1))
        sizes.append(most)
        n -= most
    return sizes[::-1]


def exponents_of(sizes):
    """Return the number of blocks behind that of each coordinate."""
    return [len(sizes) - 1 - i for i, size in enumerate(sizes) for _ in range(size)]


@dataclass(frozen=True)
class BlockSystem:
    """x' = A x + B u with T A_0 T^-1 = N, T B = B_z, A_0 = A + B K_0; a gain K; P > 0 whose dilation is monotone for mu."""

    e: list[int]
    T: Any
    N: Any
    B_z: Any
    K_0: Any
    K: Any
    P: Any
    mu: float

    @property
    def B(self):
        return np.linalg.solve(self.T, self.B_z)

    @property
    def A(self):
        return np.linalg.solve(self.T, self.N @ self.T) - self.B @ self.K_0

    def generator(self):
        """G_d = T^-1 diag(w) T."""
        return np.linalg.solve(self.T, (1 + self.mu * np.array(self.e))[:, None] * self.T)

    def design(self):
        T, N, B_z, K, K_0, P = (M.tolist() for M in (self.T, self.N, self.B_z, self.K, self.K_0, self.P))
        return block_design(self.e, T, N, B_z, K, K_0, P, self.mu)


def random_system(n, m, mu=1.0, seed=0):
    """Return a system whose inputs may be more than the rank of B; gains of order 1 in block coordinates."""
    rng = np.random.default_rng([n, m, seed])
    sizes = random_blocks(rng, n, m)
    e = exponents_of(sizes)
    N, B_z = np.zeros((n, n)), np.zeros((n, m))
    start = np.cumsum([0, *sizes])
    for i in range(len(sizes) - 1):
        rows, columns = slice(start[i], start[i + 1]), slice(start[i + 1], start[i + 2])
        N[rows, columns] = regular(rng, sizes[i + 1])[: sizes[i]]
    B_z[start[-2] :] = regular(rng, m)[: sizes[-1]]
    T = regular(rng, n)
    L = rng.normal(size=(n, n))
    w = 1 + mu * np.array(e)
    Pz = (L @ L.T + np.eye(n)) / (w[:, None] + w)
    K_0, Kz = rng.normal(size=(m, n)), rng.normal(size=(m, n))
    return BlockSystem(e, T, N, B_z, K_0, K_0 + Kz @ T, T.T @ Pz @ T, mu)


def regular(rng, n):
    """Return a random matrix with singular values in [0.5, 2]."""
    U, _ = np.linalg.qr(rng.normal(size=(n, n)))
    V, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return U @ np.diag(rng.uniform(0.5, 2.0, n)) @ V
