"""The proof that a homogeneous observer's error vanishes: a Lyapunov function, checked for all errors within its reach.

Without noise and in continuous time the error e = z - x obeys e' = (A + S(q) C) e, q = |C e| limited to [q_min, q_max]. With
s = (q/q_linear)^nu, G = I + nu G_0, and d(ln r) = exp(G ln r) it is homogeneous:

    A + S(r q) C = r^nu d(ln r) (A + S(q) C) d(-ln r),      C d(ln r) = r C.

Let e = d(ln r) y with y' P y = 1, q* the largest |C y| there, and G' P + P G > 0, so that r is a norm. It decreases from
every error with r <= q_max/q*, if for each q in [q* q_min/q_max, q*] some lambda >= 0 gives

    (A + S(q) C)' P + P (A + S(q) C) + lambda (q^2 P - C' C) < 0:                          (S-lemma)

the limited q is at most q* r and at least |C y| r. Below r = q_min/q* the observer is linear and P its Lyapunov function, so
that e -> 0 exponentially. Between two values of q the inequality is a polynomial in s, which lies in the convex hull of
its Bernstein coefficients; it is checked at these, by eigenvalues in double precision, with a margin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_lyapunov

from .regulator.start_values import Observer

Array = np.ndarray

RATIO = 1.1
"""Of q from one interval to the next."""
SCALES = tuple(2.0 ** np.arange(-2, 3.5, 0.5))
"""Values of q* relative to q_max that are tried: the reach is q_max/q*."""
MULTIPLIERS = 60
"""Values of lambda that are tried."""
MARGIN = 1e-9
"""Of the inequalities relative to their largest term: above rounding."""


@dataclass(frozen=True, eq=False)
class ObserverProof:
    """Errors e with e' P e <= 1 vanish; P (n, n)."""

    P: Array

    @property
    def reach(self) -> Array:
        """The largest |e_i| in the ellipsoid, shape (n,)."""
        return np.sqrt(np.diag(np.linalg.inv(self.P)))


def prove(observer: Observer, sizes: Array) -> ObserverProof | None:
    """Return a proof for an observer, None where none is found; `sizes` (n,) of the states balance the tried P."""
    error = _Error(observer)
    best: ObserverProof | None = None
    for P in _candidates(error, observer, sizes):
        if np.linalg.eigvalsh(error.G.T @ P + P @ error.G)[0] <= 0.0:
            continue
        for share in SCALES:
            reached = error.proven(P, share)
            if reached is not None:
                proof = ObserverProof(reached)
                if best is None or np.linalg.slogdet(proof.P)[1] < np.linalg.slogdet(best.P)[1]:
                    best = proof
                break
    return best


def _candidates(error: _Error, observer: Observer, sizes: Array) -> list[Array]:
    """Return Lyapunov functions of the linear observer at q_max, of e and of the dual."""
    closed = error.closed(np.array([observer.q_max**observer.nu]))[0]
    M, n = closed * sizes / sizes[:, None], len(sizes)
    first = solve_continuous_lyapunov(M.T, -np.eye(n))
    second = np.linalg.inv(solve_continuous_lyapunov(M, -np.eye(n)))
    return [P / sizes / sizes[:, None] for P in (first, second, first @ np.linalg.inv(second) @ first)]


class _Error:
    """The error's dynamics A + S C = A_0 + sum over j of s^j M_j, s = q^nu."""

    def __init__(self, o: Observer) -> None:
        T_t = self.to_dual = np.asarray(o.T).T
        exponents = np.asarray(o.exponents)
        inverse = np.linalg.inv(T_t)
        A, self.C, L_0, L = (np.asarray(M) for M in (o.A, o.C, o.L_0, o.L))
        self.o, self.n = o, len(A)
        self.G = np.eye(self.n) + o.nu * T_t @ (exponents[:, None] * inverse)
        parts = [T_t @ ((exponents == j)[:, None] * (inverse @ (L - L_0))) @ self.C for j in range(max(exponents) + 1)]
        self.parts = [A + L_0 @ self.C, *parts]

    def closed(self, s: Array) -> Array:
        """Return A + S C for each s."""
        return sum((M * s[:, None, None] ** j for j, M in enumerate(self.parts)), np.zeros((len(s), self.n, self.n)))

    def proven(self, P: Array, share: float) -> Array | None:
        """Return P of the errors that vanish where the inequality holds with P scaled to q* = share * q_max."""
        o = self.o
        P = P * float(np.linalg.eigvalsh(self.C @ np.linalg.solve(P, self.C.T))[-1]) / (share * o.q_max) ** 2
        try:
            R = np.linalg.cholesky((P + P.T) / 2).T
        except LinAlgError:
            return None
        inverse = np.linalg.inv(R)
        parts, C = [R @ M @ inverse for M in self.parts], self.C @ inverse
        low = share * o.q_min
        qs = np.geomspace(share * o.q_max, low, 2 + int(np.log(o.q_max / o.q_min) / np.log(RATIO)))
        for high, following in zip(qs, [*qs[1:], low], strict=True):
            F = bernstein(parts, high**o.nu, following**o.nu)
            if not _negative(F + F.transpose(0, 2, 1), C.T @ C, float(high)):
                return None
        to_unit = np.asarray(o.T).T @ (
            share ** (1.0 + o.nu * np.asarray(o.exponents))[:, None] * np.linalg.inv(np.asarray(o.T).T)
        )
        return to_unit.T @ P @ to_unit


def _negative(sides: Array, told: Array, q: float) -> bool:
    """Return whether sides + lambda (q^2 I - C' C) < 0 for one lambda >= 0, C' C `told`, a margin included."""
    size = float(np.linalg.norm(sides, 2, axis=(1, 2)).max())
    multipliers = np.append(0.0, np.geomspace(1e-3, 1e7, MULTIPLIERS) * size / np.linalg.norm(told, 2))
    terms = multipliers[:, None, None] * (q**2 * np.eye(len(told)) - told)
    largest = np.linalg.eigvalsh(sides + terms[:, None])[..., -1].max(axis=1)
    return bool((largest < -MARGIN * (size + np.abs(terms).max(axis=(1, 2)))).any())


def bernstein(parts: Sequence[Array], a: float, b: float) -> Array:
    """Return the Bernstein coefficients of sum_j s^j parts[j] on [a, b]: its values lie in their convex hull.

    The i-th is the polar form at k - i times a and i times b: s^j becomes their elementary symmetric mean of degree j.
    """
    k = len(parts) - 1
    coefficients = []
    for i in range(k + 1):
        powers = np.polynomial.polynomial.polyfromroots([-1.0 / a] * (k - i) + [-1.0 / b] * i) * a ** (k - i) * b**i
        coefficients.append(sum(M * powers[j] / comb(k, j) for j, M in enumerate(parts)))
    return np.array(coefficients)
