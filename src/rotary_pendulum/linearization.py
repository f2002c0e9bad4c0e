"""The linear model x' = A x + b V at the upright equilibrium, eqs. (6) and (7), analytically.

x = (theta, delta, theta', delta'). The printed eqs. (6) and (7) contain misprints; the determinant of J(0) and eq. (5)
decide: J_T = J_p psi + J_r J_p + J_r zeta/4 (the first term is J_p psi, not J_p zeta), a_34 = -varpi D_p/2,
a_42 = m_p L_p g_p (J_r + psi)/2 and a_43 = -varpi D_r/2.
"""

from __future__ import annotations

import numpy as np

from .equation import Coefficients

Array = np.ndarray


def linearize(c: Coefficients, torque_per_volt: float) -> tuple[Array, Array]:
    """Return (A, b): A of shape (4, 4), b of shape (4,), for a torque of `torque_per_volt` V [N.m/V] on the arm.

    A motor's back-EMF adds to the arm's damping D_r. The dry friction T_r is left out: it is not linear about rest. (Its
    smoothed form has the slope T_r/v_s there, a damping that holds for |theta'| far below v_s only.)
    """
    determinant = c.J_11 * c.J_22 - c.varpi_2**2
    from_arm = np.array([c.J_22, c.varpi_2]) / determinant  # accelerations per torque on the arm
    from_pendulum = np.array([c.varpi_2, c.J_11]) / determinant
    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2:, 1] = c.gravity * from_pendulum
    A[2:, 2] = -c.D_r * from_arm
    A[2:, 3] = -c.D_p * from_pendulum
    return A, np.concatenate([[0.0, 0.0], torque_per_volt * from_arm])
