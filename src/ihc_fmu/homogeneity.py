"""The canonical homogeneous norm ||x||_d online: the root r of ||d(-ln r) x||_P = 1, eq. (12) of the paper.

In block coordinates z = T x (of one input: chain coordinates z = Phi x) coordinate j has the exponent e_j, the number of
blocks behind its own, and the weight w_j = 1 + mu e_j. With s = r^-mu, Remark 5 becomes

    N^2(r) = ||d(-ln r) x||_P^2 = r^-2 (c_0 + c_1 s + ... + c_{2e} s^(2e)),   e = e_1,

where c_m is the sum of z_i Pz_ij z_j over e_i + e_j = m and Pz = T^-T P T^-1. The coefficients are computed once per
sample; each evaluation is then one polynomial. Under G_d' P + P G_d > 0, N decreases strictly in r.

Squares leave the range of numbers long before states do. Where an entry of z is beyond ORDINARY, the coefficients are
those of the dilated state d(-e ln 2) z, whose norm is 2^-e times that of z and near 1.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, floor, frexp, inf, isfinite, isnan, ldexp, log, nan
from typing import NamedTuple

from .linear_algebra import Matrix, Vector, solve, transpose

Exponents = Sequence[int]
"""e_j of each coordinate: they fall from block to block by 1, to 0 for the last block."""

NEWTON_LIMIT = 100
"""Iterations after which the root search stops; more than ten are rare, and each two at least halve the bracket."""

MOST_BISECTIONS = 60
"""Of Algorithm 1 in a sample, at most."""

CONVERGED = 1e-9
"""Length in ln r of a Newton step that leaves an error of its square, far below rounding."""

GUESSES = (1e-12, 1e12)
"""Range of starting values that are used."""

ORDINARY = (2.0**-200, 2.0**200)
"""Magnitudes of block coordinates whose norm is computed without scaling; 0 is ordinary too."""

NEGLIGIBLE = 2.0**-500
"""A block coordinate of a scaled state below this, beside others near 1, counts as 0."""

FAR = 100
"""Binary orders of magnitude between r and the norm of a scaled state beyond which N(r) is taken for 0 or infinite."""

UNBOUNDED = 1e9
"""Stands for the logarithm of a norm that is not known yet."""

LARGEST = 1.7976931348623157e308
"""The largest number: what a norm beyond it is given as."""

SHIFT = 600
"""States beyond 2^-SHIFT or 2^SHIFT as a whole are computed with as 2^SHIFT or 2^-SHIFT times themselves."""


class NormPolynomial(NamedTuple):
    """c_0, ..., c_{2e} of Remark 5's polynomial for the state d(-exponent ln 2) z."""

    c: Vector
    exponent: int = 0


def chain(n: int) -> list[int]:
    """Return the exponents of the chain form of order n, n blocks of one coordinate: n - 1, ..., 1, 0."""
    return list(range(n - 1, -1, -1))


def to_blocks(T: Matrix, P: Matrix, name: str = "Phi") -> list[list[float]]:
    """Return Pz = T^-T P T^-1, both (n, n): the quadratic form x' P x in the coordinates z = T x; raises as `solve`."""
    T_t = transpose(T)
    return solve(T_t, transpose(solve(T_t, P, name)), name)


def shift_of(x: Vector) -> int:
    """Return the power of 2 to take out of the state x before products with it may leave the range of numbers."""
    size = max(map(abs, x))
    if size > 2.0**SHIFT:
        return SHIFT
    return -SHIFT if 0.0 < size < 2.0**-SHIFT else 0


def norm_polynomial(Pz: Matrix, z: Vector, exponents: Exponents, mu: float, shift: int = 0) -> NormPolynomial:
    """Return Remark 5's polynomial for the state 2^shift z, z (n,) in block coordinates with their exponents."""
    exponent = 0
    if shift != 0 or not all(ORDINARY[0] <= abs(entry) <= ORDINARY[1] or entry == 0.0 for entry in z):
        z, exponent = scaled(Pz, z, exponents, mu, shift)
    n = len(z)
    c = [0.0] * (2 * exponents[0] + 1)
    for i in range(n):
        z_i, row, e_i = z[i], Pz[i], exponents[i]
        c[2 * e_i] += row[i] * z_i * z_i
        for j in range(i + 1, n):
            c[e_i + exponents[j]] += 2.0 * row[j] * z_i * z[j]
    return NormPolynomial(c, exponent)


def scaled(Pz: Matrix, z: Vector, exponents: Exponents, mu: float, shift: int) -> tuple[list[float], int]:
    """Return d(-e ln 2) 2^shift z and e, a multiple of 4 near the binary logarithm of the norm.

    Exact where 4 mu is an integer: all factors are powers of 2. A state that is not finite is returned as it is.
    """
    weights = [1.0 + mu * e_j for e_j in exponents]
    sizes = [
        (frexp(entry)[1] + shift + 0.5 * frexp(Pz[j][j])[1]) / weights[j] for j, entry in enumerate(z) if entry != 0.0
    ]
    if not sizes or not all(map(isfinite, z)):
        return list(z), 0
    e = 4 * floor(max(sizes) / 4.0 + 0.5)
    entries = []
    for z_j, weight in zip(z, weights, strict=True):
        power = shift - e * weight
        whole = floor(power)
        entry = ldexp(z_j * 2.0 ** (power - whole), whole)
        entries.append(entry if abs(entry) >= NEGLIGIBLE else 0.0)
    return entries, e


def inverse_power(r: float, mu: float) -> float:
    """Return s = r^-mu; where that is a division, by a division, which is faster and rounds once."""
    return 1.0 / r if mu == 1.0 else r**-mu


def radial_quotient(polynomial: NormPolynomial, mu: float, r: float) -> float:
    """Return y' P y / (y' P G_d y), y = d(-ln r) x, of the state with this polynomial; 1 where r is far from its norm.

    It is sum c_m s^m / sum (1 + mu m/2) c_m s^m, s = r^-mu: 1 at mu = 0, and for r = ||x||_d what a change of x along the
    normal of the unit ball does to ln r.
    """
    c, exponent = polynomial
    if exponent != 0:
        if abs(frexp(r)[1] - exponent) > FAR:
            return 1.0
        r = ldexp(r, -exponent)
    s = inverse_power(r, mu)
    total = weighted = 0.0
    for m in range(len(c) - 1, -1, -1):
        total = total * s + c[m]
        weighted = weighted * s + (1.0 + 0.5 * mu * m) * c[m]
    return total / weighted if 0.0 < weighted < inf else 1.0


def squared_norm(polynomial: NormPolynomial, mu: float, r: float) -> float:
    """Return N^2(r) = ||d(-ln r) x||_P^2 for the polynomial of x; 0 or infinity far from the norm of a scaled state."""
    c, exponent = polynomial
    if exponent != 0:
        distance = frexp(r)[1] - exponent
        if abs(distance) > FAR:
            return 0.0 if distance > 0 else inf
        r = ldexp(r, -exponent)
    s = inverse_power(r, mu)
    total = 0.0
    for coefficient in reversed(c):
        total = total * s + coefficient
    return total / (r * r)


def bisection_update(
    polynomial: NormPolynomial, mu: float, interval: tuple[float, float], a_min: float, b_max: float, j_max: int
) -> tuple[float, float]:
    """Return the interval [a, b] after one run of Algorithm 1 (corrected); ||x||_d is estimated by b.

    The interval is carried from sample to sample: it doubles or halves towards the root by one step a sample, and is
    bisected `j_max` times once it holds the root. As printed, lines 3 and 4 of the algorithm test b twice and never
    lower it, so that inside the unit ball the estimate would stay at b_max and the controller be linear.
    """
    a, b = interval
    if squared_norm(polynomial, mu, b) > 1.0:
        a, b = b, min(2.0 * b, b_max)
    elif squared_norm(polynomial, mu, a) < 1.0:
        a, b = max(a / 2.0, a_min), a
    else:
        for _ in range(j_max):
            middle = (a + b) / 2.0
            if squared_norm(polynomial, mu, middle) < 1.0:
                b = middle
            else:
                a = middle
    return a, b


class NormSearch(NamedTuple):
    """How the norm in the law is found: the exact norm limited to [a_min, b_max], or Algorithm 1 with j_max bisections."""

    exact: bool
    a_min: float
    b_max: float
    j_max: int


def norm_in_law(
    search: NormSearch, polynomial: NormPolynomial, mu: float, norm: float, interval: tuple[float, float]
) -> tuple[float, tuple[float, float]]:
    """Return (r in the law, the new interval of Algorithm 1), given the exact norm; NaN for a norm that is none.

    The last interval is brought within bounds that may have been tuned since.
    """
    _, a_min, b_max, j_max = search
    if search.exact:
        return (norm if isnan(norm) else min(b_max, max(a_min, norm))), interval
    low, high = interval
    held = min(b_max, max(a_min, low)), min(b_max, max(a_min, high))
    bracket = bisection_update(polynomial, mu, held, a_min, b_max, j_max)
    return bracket[1], bracket


def homogeneous_norm(polynomial: NormPolynomial, mu: float, guess: float = 1.0) -> float:
    """Return the canonical homogeneous norm of the state with this polynomial: the root of N(r) = 1.

    Newton's method on ln N(e^sigma), whose slope is negative, kept inside a bracket that it tightens as it goes; the
    bracket is bisected where a Newton step would leave it or is longer than half the step before. `guess` is a start,
    such as the norm a sample ago; one beyond all reason is not used. The result is 0 for x = 0 and NaN for a state that
    is not finite. For a P and a dilation without G_d' P + P G_d > 0 there may be several roots, and the search ends after
    NEWTON_LIMIT iterations; where P is not positive definite there may be none, and the result may be NaN.
    """
    c, exponent = polynomial
    if not all(map(isfinite, c)):
        return nan
    if not any(c):
        return 0.0
    root = _root(c, mu, _scaled_guess(guess, exponent))
    if exponent == 0 or isnan(root):
        return root
    return LARGEST if frexp(root)[1] + exponent > 1024 else ldexp(root, exponent)


def _scaled_guess(guess: float, exponent: int) -> float:
    """Return the start of the search in the coordinates of the polynomial; 1 where the guess is of no use."""
    if exponent != 0:
        near = 0.0 < guess < inf and abs(frexp(guess)[1] - exponent) < FAR
        guess = ldexp(guess, -exponent) if near else 1.0
    return guess if GUESSES[0] < guess < GUESSES[1] else 1.0


def _root(c: Vector, mu: float, guess: float) -> float:
    low, high, last = -UNBOUNDED, UNBOUNDED, UNBOUNDED
    sigma = log(guess)
    for _ in range(NEWTON_LIMIT):
        s = exp(-mu * sigma)
        value, weighted = 0.0, 0.0
        for coefficient in reversed(c):
            weighted = weighted * s + value
            value = value * s + coefficient
        if not 0.0 < value < inf:  # no norm: P is not positive definite, or far from it in rounding
            return nan
        error = log(value) - 2.0 * sigma
        if error > 0.0:
            low = sigma
        else:
            high = sigma
        slope = 2.0 + mu * s * weighted / value
        step = error / slope if slope > 0.0 else UNBOUNDED
        if abs(step) <= CONVERGED:
            return exp(sigma + step)
        following = sigma + max(-4.0, min(4.0, step))
        if (
            low > -UNBOUNDED
            and high < UNBOUNDED
            and not (low < following < high and abs(following - sigma) <= 0.5 * last)
        ):
            following = 0.5 * (low + high)
        last = abs(following - sigma)
        if last <= 1e-15 * max(1.0, abs(sigma)):
            return exp(following)
        sigma = following
    return exp(sigma)
