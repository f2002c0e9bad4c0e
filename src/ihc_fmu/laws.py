"""The stabilizing laws, one sample each: LC, first-order SMC, super-twisting, IHC (explicit and semi-implicit).

All take the state x (n,) and return the inputs u (m,) before any limit; the first-order sliding mode law is for one input,
the super-twisting algorithm is one input's share. What the homogeneous law takes of a design is prepared once, in
`BlockDesign`.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from math import isfinite, isnan, sqrt
from typing import NamedTuple

from fmu_export.errors import UserError

from .homogeneity import (
    Exponents,
    NormPolynomial,
    chain,
    inverse_power,
    norm_polynomial,
    radial_quotient,
    shift_of,
    to_blocks,
)
from .linear_algebra import Matrix, Vector, dot, exact_dot, indefinite_block, product, refined, solve, transpose

MOST = 2.0**400
"""Bound on an input that is then multiplied by 2^SHIFT: beyond any limit, within the numbers."""


PROPORTIONAL, INTEGRAL = 1.5, 1.1
"""k_1/sqrt(L) and k_2/L of the super-twisting algorithm, A. Levant, Int. J. Control 76 (2003), 924-941."""


class BlockDesign(NamedTuple):
    """A gain in the block coordinates z = T x, in which z_i' = N_i z_{i+1} (i < k) and z_k' = B_k (u - K_0 x).

    `exponents` (n,) of the coordinates; T (n, n); N (n, n) with the superdiagonal blocks N_i, 0 elsewhere; B (n, m) with B_k
    in its last rows, 0 elsewhere; K (m, n) the linear gain, u = K x; K_0 (m, n); Kz = (K - K_0) T^-1 and K_0z = K_0 T^-1;
    Pz = T^-T P T^-1; mu in [0, 1], minus the degree of homogeneity.
    """

    exponents: Exponents
    T: Matrix
    N: Matrix
    B: Matrix
    K: Matrix
    K_0: Matrix
    Kz: Matrix
    K_0z: Matrix
    Pz: Matrix
    mu: float


class BlockState(NamedTuple):
    """A state as the norm and the homogeneous law take it: x = 2^-shift times the state, z = T x."""

    shift: int
    x: Vector
    z: Vector
    polynomial: NormPolynomial


def block_design(
    exponents: Exponents, T: Matrix, N: Matrix, B: Matrix, K: Matrix, K_0: Matrix, P: Matrix, mu: float, name: str = "T"
) -> BlockDesign:
    """Return the prepared design for the unit ball x' P x <= 1; `name` is what its user calls T.

    K_0z is refined: entries that should be 0 would otherwise outweigh gains that fade. Raises UserError for a P that is not
    positive definite, for which there is no norm, and for a singular T.
    """
    indefinite = indefinite_block(P)
    if indefinite:
        raise UserError(f"P must be positive definite, found that its leading {indefinite} x {indefinite} block is not")
    T_t = transpose(T)
    m = len(K)
    columns = [[k - k_0 for k, k_0 in zip(k_j, k_0j, strict=True)] + k_0j for k_j, k_0j in _columns(K, K_0)]
    rows = transpose(solve(T_t, columns, name))
    K_0z = [refined(T_t, row, target) for row, target in zip(rows[m:], K_0, strict=True)]
    return BlockDesign(exponents, T, N, B, K, K_0, rows[:m], K_0z, to_blocks(T, P, name), mu)


def chain_design(Phi: Matrix, row: Vector, k_lin: Vector, P: Matrix, mu: float) -> BlockDesign:
    """Return the prepared design of one input in chain coordinates z = Phi x: N the shift, B = e_n, K_0 = -row."""
    n = len(Phi)
    N = [[float(j == i + 1) for j in range(n)] for i in range(n)]
    B = [[float(i == n - 1)] for i in range(n)]
    return block_design(chain(n), Phi, N, B, [k_lin], [[-entry for entry in row]], P, mu, "Phi")


def _columns(K: Matrix, K_0: Matrix) -> list[tuple[list[float], list[float]]]:
    return list(zip(transpose(K), transpose(K_0), strict=True))


def is_finite(design: BlockDesign) -> bool:
    """Whether what `block_design` computed is: it may leave the range of numbers for entries of extreme sizes."""
    return all(isfinite(entry) for M in (design.Kz, design.K_0z, design.Pz) for row in M for entry in row)


def block_state(design: BlockDesign, x: Vector) -> BlockState:
    """Return z = T x and the polynomial of the norm for the state x (n,), scaled where it is beyond reason."""
    shift = shift_of(x)
    if shift != 0:
        x = [entry * 2.0**-shift for entry in x]
    z = [exact_dot(row, x) for row in design.T]
    return BlockState(shift, x, z, norm_polynomial(design.Pz, z, design.exponents, design.mu, shift))


def linear(K: Matrix, x: Vector) -> list[float]:
    """Return the LC's u = K x."""
    return product(K, x)


def sliding_mode(c: Vector, k_eq: Vector, rho: float, x: Vector) -> float:
    """Return the first-order SMC's u = k_eq x - rho sign(c x), with sign(0) = 0.

    `c` (n,) is the surface with c b = 1 and k_eq = -(c A + kappa c) its equivalent control and linear reaching term.
    """
    surface = dot(c, x)
    switching = rho if surface > 0.0 else -rho if surface < 0.0 else 0.0
    return dot(k_eq, x) - switching


def super_twisting(s: float, v: float, rate: float, h: float, implicit: bool) -> tuple[float, float]:
    """Return w and the next v of w = -k_1 |s|^(1/2) sign(s) + v, v' = -k_2 sign(s), for s' = w + d and samples of `h` [s].

    k_1 = 1.5 sqrt(L), k_2 = 1.1 L with L the `rate`, the largest |d'|: s comes to 0 in finite time, and v to -d (A. Levant,
    Int. J. Control 58 (1993), 1247-1263). Explicit Euler's method chatters. The `implicit` one takes the root of the next s
    for |s|^(1/2), next s = s - h k_1 |next s|^(1/2) sign(next s), as if v = -d; and where |s| < 4 h^2 k_2, s/(4 h^2 k_2)
    for sign(s): near 0 next s = h (v + d), next v = v - s/(4 h), both poles are 1/2, and without noise it comes to rest.
    """
    k_1, turn = PROPORTIONAL * sqrt(rate), h * (INTEGRAL * rate)
    size = abs(s)
    if implicit:
        half = 0.5 * (h * k_1)
        root = size / (half + sqrt(half * half + size)) if size > 0.0 else 0.0
        change = turn if size >= 4.0 * (h * turn) else size / (4.0 * h)
    else:
        root, change = sqrt(size), turn
    if s > 0.0:
        return v - k_1 * root, v - change
    return v + k_1 * root, v + change if s < 0.0 else v


def winds_up(wanted: float, change: float, low: float, high: float) -> bool:
    """Whether a change of an input's integral would push the wanted input farther beyond its limits."""
    return (wanted > high and change > 0.0) or (wanted < low and change < 0.0)


def gains(Kz: Matrix, exponents: Exponents, mu: float, r: float) -> list[list[float]]:
    """Return g (m, n), g_ij = Kz_ij s^(e_j + 1), s = r^-mu: the IHC's state-dependent gains in block coordinates."""
    s = inverse_power(r, mu)
    powers, power = [], s
    for _ in range(exponents[0] + 1):
        powers.append(power)
        power *= s
    return [[gain * powers[e] for gain, e in zip(row, exponents, strict=True)] for row in Kz]


def implicit_homogeneous(design: BlockDesign, r: float, x: Vector, z: Vector) -> list[float]:
    """Return the IHC's u = K_0 x + r^(1-mu) (K - K_0) d(-ln r) x, eq. (8), for the norm r and z = T x.

    For r <= 1 it is written as K x + (g - Kz) z with the gains g, which is the same and at r = 1 is the LC to the last bit;
    beyond, where the gains fade, that would cancel.
    """
    g = gains(design.Kz, design.exponents, design.mu, r)
    if r > 1.0:
        return [dot(g_i, z) + dot(k_0, x) for g_i, k_0 in zip(g, design.K_0, strict=True)]
    return [
        dot(k, x) + dot([g_ij - kz_ij for g_ij, kz_ij in zip(g_i, kz, strict=True)], z)
        for k, g_i, kz in zip(design.K, g, design.Kz, strict=True)
    ]


def implicit_homogeneous_semi(design: BlockDesign, r: float, h: float, z: Vector) -> list[float]:
    """Return the semi-implicit IHC u = K_r (I - h (A + B K_r))^-1 x, K_r = K_0 + r^(1-mu) (K - K_0) d(-ln r), h in s.

    The gain is that of the present state, the state that of the next sample as the linear model predicts it (the variant
    of the authors' toolbox). In block coordinates that state is y = f + H v with v = g y, f_i = z_i + h N_i f_{i+1},
    f_k = z_k, H_i = h N_i H_{i+1}, H_k = h B_k; so v = (I - g H)^-1 g f, and u = v + K_0z y. In chain coordinates of one
    input 1 - g H is greater than 1 for a Hurwitz A + b k, and no sum with g cancels. Raises UserError, a ValueError, or
    ArithmeticError where I - g H is singular.
    """
    g = gains(design.Kz, design.exponents, design.mu, r)
    f, H = _ahead(design, h, z)
    columns = transpose(H)
    gf = product(g, f)
    remainder = [
        [(1.0 if i == j else 0.0) - dot(g_i, column) for j, column in enumerate(columns)] for i, g_i in enumerate(g)
    ]
    if len(g) == 1:
        v = [gf[0] / remainder[0][0]]
    else:
        v = [v_i for (v_i,) in solve(remainder, [[entry] for entry in gf], "I - g H")]
    y = [f_i + dot(H_i, v) for f_i, H_i in zip(f, H, strict=True)]
    return [v_i + dot(k_0z, y) for v_i, k_0z in zip(v, design.K_0z, strict=True)]


def _ahead(design: BlockDesign, h: float, z: Vector) -> tuple[list[float], list[list[float]]]:
    """Return f (n,) and H (n, m): the next sample's z under v = u - K_0 x is f + H v."""
    n, e = len(z), design.exponents
    f = list(z)
    H = [[h * entry for entry in row] for row in design.B]
    begin = end = n  # of the block behind that of coordinate i
    for i in range(n - 1, -1, -1):
        if e[i] == 0:
            continue
        if e[i] != e[i + 1]:
            begin, end = i + 1, begin
        links = design.N[i][begin:end]
        f[i] = z[i] + h * dot(links, f[begin:end])
        H[i] = [h * dot(links, column) for column in zip(*H[begin:end], strict=True)]
    return f, H


def controls(design: BlockDesign, state: BlockState, r: float, h: float | None) -> list[float]:
    """Return the IHC's inputs for the norm r in the law, semi-implicit for the sample time `h` [s], explicit for None."""
    z = state.z
    u = implicit_homogeneous(design, r, state.x, z) if h is None else implicit_homogeneous_semi(design, r, h, z)
    return u if state.shift == 0 else [unshifted(entry, state.shift) for entry in u]


def integrand(design: BlockDesign, Kiz: Matrix, r: float, state: BlockState, free: bool) -> list[float]:
    """Return v' = q r^(1-2 mu) K_i d(-ln r) x of the integral action with Kiz = K_i T^-1 (m, n), for the norm r in the law.

    q = y' P y / (y' P G_d y), y = d(-ln r) x, where r is the norm of x (`free`); q = 1 where r is a limit in its place or
    the law is linear. In block coordinates: v'_i = q s sum over j of Kiz_ij s^(e_j + 1) z_j, s = r^-mu.
    """
    s = inverse_power(r, design.mu)
    if free:
        s *= radial_quotient(state.polynomial, design.mu, r)
    rates = [s * dot(g_i, state.z) for g_i in gains(Kiz, design.exponents, design.mu, r)]
    return rates if state.shift == 0 else [unshifted(rate, state.shift) for rate in rates]


def unshifted(value: float, shift: int) -> float:
    """Return 2^shift times a value computed of a state taken 2^-shift times, bounded so that none overflows; NaN for NaN."""
    return value if isnan(value) else min(MOST, max(-MOST, value)) * 2.0**shift
