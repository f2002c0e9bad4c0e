"""The linear model x' = A x + b V at the upright equilibrium, eqs. (6) and (7), analytically.

x = (theta, delta, theta', delta'). The printed eqs. (6) and (7) contain misprints; the determinant of J(0) and eq. (5)
decide: J_T = J_p psi + J_r J_p + J_r zeta/4 (the first term is J_p psi, not J_p zeta), a_34 = -varpi D_p/2,
a_42 = m_p L_p g_p (J_r + psi)/2 and a_43 = -varpi D_r/2.
"""

from __future__ import annotations

import numpy as np

from .parameters import QubeParameters

Array = np.ndarray


def linearize(p: QubeParameters, *, back_emf: bool = True) -> tuple[Array, Array]:
    """Return (A, b): A of shape (4, 4), b of shape (4,), for the motor voltage [V] as input.

    Back-EMF adds k_m^2/R_m to the arm's damping D_r; the paper's printed A and b are without it. The dry friction T_r is
    left out: it is not linear about rest. (Its smoothed form has the slope T_r/v_s there, a damping that holds for
    |theta'| far below v_s = 0.05 rad/s only; the FMU's directional derivatives at rest contain it.)
    """
    zeta, psi, varpi = p.m_p * p.L_p**2, p.m_p * p.L_r**2, p.m_p * p.L_p * p.L_r
    J_T = p.J_p * psi + p.J_r * p.J_p + p.J_r * zeta / 4
    damping = p.D_r + (p.k_m**2 / p.R_m if back_emf else 0.0)
    A = np.zeros((4, 4))
    A[0, 2] = A[1, 3] = 1.0
    A[2, 1:] = p.m_p**2 * p.L_p**2 * p.L_r * p.g_p / 4, -(p.J_p + zeta / 4) * damping, -varpi * p.D_p / 2
    A[3, 1:] = (
        p.m_p * p.L_p * p.g_p * (p.J_r + psi) / 2,
        -varpi * damping / 2,
        -(p.J_r + psi) * p.D_p,
    )
    A[2:, 1:] /= J_T
    b = np.array([0.0, 0.0, p.J_p + zeta / 4, varpi / 2]) * (p.k_m / (p.R_m * J_T))
    return A, b
