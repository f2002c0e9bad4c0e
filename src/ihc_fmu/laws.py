"""The three stabilizing laws, one sample each: LC, first-order SMC, IHC (explicit and semi-implicit).

All take the state x (n,) and return the motor voltage before any limit.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Sequence

from .homogeneity import dot, inverse_power

Vector = Sequence[float]


def linear(k_lin: Vector, x: Vector) -> float:
    """Return the LC's u = k_lin x."""
    return dot(k_lin, x)


def sliding_mode(c: Vector, k_eq: Vector, rho: float, x: Vector) -> float:
    """Return the first-order SMC's u = k_eq x - rho sign(c x), with sign(0) = 0.

    `c` (n,) is the surface with c b = 1 and k_eq = -(c A + kappa c) its equivalent control and linear reaching term.
    """
    surface = dot(c, x)
    switching = rho if surface > 0.0 else -rho if surface < 0.0 else 0.0
    return dot(k_eq, x) - switching


def chain_gains(kz: Vector, mu: float, r: float) -> list[float]:
    """Return kz_i s^(n-i+1), s = r^-mu: the IHC's state-dependent gains in chain coordinates (Remark 5)."""
    s = inverse_power(r, mu)
    gains, power = [], s
    for gain in reversed(kz):
        gains.append(gain * power)
        power *= s
    return gains[::-1]


def implicit_homogeneous(k_lin: Vector, row: Vector, kz: Vector, mu: float, r: float, x: Vector, z: Vector) -> float:
    """Return the IHC's u = r^(1-mu) k d(-ln r) x - row x, eq. (8), with k = k_lin + row, eq. (10).

    `kz` = k Phi^-1, `row` (n,) and z = Phi x. For r <= 1 it is written as k_lin x + sum (kz_i s^(n-i+1) - kz_i) z_i, which
    is the same and at r = 1 is the LC to the last bit; beyond, where the gains fade, that would cancel.
    """
    gains = chain_gains(kz, mu, r)
    if r > 1.0:
        return dot(gains, z) - dot(row, x)
    return dot(k_lin, x) + dot([g - k for g, k in zip(gains, kz, strict=True)], z)


def implicit_homogeneous_semi(kz: Vector, row_z: Vector, mu: float, r: float, h: float, z: Vector) -> float:
    """Return the semi-implicit IHC u = K (I - h (A + b K))^-1 x, K = r^(1-mu) k d(-ln r) - row, sample time h [s].

    The gain is that of the present state, the state that of the next sample as the linear model predicts it (the variant
    of the authors' toolbox). In chain coordinates A + b K is a companion matrix with last row g = kz o (s^n, ..., s). With
    f_i = z_i + h f_{i+1}, f_n = z_n, the state ahead is y_i = f_i + h^(n-i+1) v, v = g y = g f/(1 - sum g_i h^(n-i+1)), and
    u = v - row_z y, `row_z` = row Phi^-1. For a Hurwitz companion matrix the denominator is greater than 1 and no sum with
    g cancels.
    """
    g = chain_gains(kz, mu, r)
    n = len(z)
    f, powers = list(z), [h] * n
    for i in range(n - 2, -1, -1):
        f[i] = z[i] + h * f[i + 1]
        powers[i] = h * powers[i + 1]
    v = dot(g, f) / (1.0 - dot(g, powers))
    return v - dot(row_z, [f_i + p_i * v for f_i, p_i in zip(f, powers, strict=True)])
