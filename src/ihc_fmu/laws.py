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


def implicit_homogeneous(k_lin: Vector, kz: Vector, mu: float, r: float, x: Vector, z: Vector) -> float:
    """Return the IHC's u = r^(1-mu) k d(-ln r) x - row x, eq. (8), with k = k_lin + row, eq. (10).

    `kz` = k Phi^-1 and z = Phi x. It is written as k_lin x + sum (kz_i s^(n-i+1) - kz_i) z_i, which is the same and at
    r = 1 is the LC to the last bit.
    """
    gains = chain_gains(kz, mu, r)
    return dot(k_lin, x) + dot([g - k for g, k in zip(gains, kz, strict=True)], z)


def implicit_homogeneous_semi(kz: Vector, row_z: Vector, mu: float, r: float, h: float, z: Vector) -> float:
    """Return the semi-implicit IHC u = K (I - h (A + b K))^-1 x, K = r^(1-mu) k d(-ln r) - row, sample time h [s].

    The gain is that of the present state, the state that of the next sample as the linear model predicts it (the variant
    of the authors' toolbox). In chain coordinates A + b K is a companion matrix with last row g = kz o (s^n, ..., s), so
    the system is solved by one sweep: y_i = a_i + h^(n-i) y_n with a_n = 0, a_i = z_i + h a_{i+1}. `row_z` = row Phi^-1.
    For a Hurwitz companion matrix the denominator 1 - sum g_i h^(n-i+1) is greater than 1.
    """
    g = chain_gains(kz, mu, r)
    n = len(z)
    a, powers = [0.0] * n, [1.0] * n
    for i in range(n - 2, -1, -1):
        a[i] = z[i] + h * a[i + 1]
        powers[i] = h * powers[i + 1]
    last = (z[-1] + h * dot(g, a)) / (1.0 - h * dot(g, powers))
    y = [a_i + p_i * last for a_i, p_i in zip(a, powers, strict=True)]
    return dot([g_i - r_i for g_i, r_i in zip(g, row_z, strict=True)], y)
