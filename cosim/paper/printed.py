"""What the paper prints in section V, to compare with; everything else in this package is computed.

D. Cruz-Ortiz, M. Ballesteros, A. Polyakov, D. Efimov, I. Chairez, A. Poznyak, "Practical Realization of Implicit
Homogeneous Controllers for Linearized Systems". Numbers as printed, misprints included.
"""

from __future__ import annotations

import numpy as np

LMSE = {
    0: {"IHC": 11.06, "LC": 11.23, "SMC": 11.43},
    1: {"IHC": 11.08, "LC": 11.26, "SMC": 11.47},
    60: {"IHC": 11.14, "LC": 11.83, "SMC": 11.85},
    200: {"IHC": 11.47, "LC": 12.14, "SMC": 12.13},
}
"""Table I (gain 0: no artificial disturbance) and Table II, by the disturbance's gain G. The unit is not given."""

ENERGY_OVER = {"LC": 0.0148, "SMC": -0.179}
"""Control energy of the IHC relative to the other law's, without disturbance: text below Table I."""

SINES = ({"amplitude": 0.02, "frequency": 10.0}, {"amplitude": 0.01, "frequency": 3.0})
"""The disturbance is G times the sum of these [V, rad/s], coupled to the control signal."""

SWITCH_TIME = 1.5
"""The stabilizing law takes over after about this time [s]."""

SETTLED_BY = 4.0
"""Figure 4: |q| of the IHC has converged in less than this time [s]."""

WINDOW = (5.0, 7.0)
"""Insets of Figure 3 [s]."""

SAMPLE_TIME = 1e-4
"""Step of the integration in the real-time application [s]."""

MU, ALPHA = 1.0, 1e-3
A_MIN, B_MAX, J_MAX = 0.88, 1.0, 3

K = np.array([-113.4482, -108.1254, -13.7505, -0.2833])
"""The gain said to be k_lin + row by eq. (10)."""

P = np.array(
    [
        [0.1304, 0.0053, 0.0213, 0.0844],
        [0.0053, 0.1729, 0.0344, 0.1168],
        [0.0213, 0.0344, 0.3037, 0.2127],
        [0.0844, 0.1168, 0.2127, 0.3930],
    ]
)
"""The matrix said to solve eq. (11)."""
