"""The linear model of the plant with its motor at the upright equilibrium, for the motor voltage as input."""

from __future__ import annotations

from rotary_pendulum import linearization

from .dynamics import motor
from .parameters import QubeParameters

Array = linearization.Array


def linearize(p: QubeParameters, *, back_emf: bool = True) -> tuple[Array, Array]:
    """Return (A, b) of `rotary_pendulum.linearization`, for the motor voltage [V] as input.

    Back-EMF adds k_m^2/R_m to the arm's damping D_r; the paper's printed A and b are without it. The dry friction T_r is
    left out. (The FMU's directional derivatives at rest contain the slope T_r/v_s of its smoothed form.)
    """
    c, m = p.coefficients, motor(p, back_emf=back_emf)
    return linearization.linearize(c._replace(D_r=c.D_r + m.k_m * m.k_e / m.R_m), m.k_m / m.R_m)
