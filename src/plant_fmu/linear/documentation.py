"""What the linear plant's FMU says about itself: HTML for its documentation."""

from __future__ import annotations

from html import escape

import numpy as np

from ihc_fmu.arrays import Array
from ihc_fmu.system import System


def notes(system: System) -> str:
    """Return the model's equations and the numbers of `system`."""
    equilibrium = "" if not _is_moved(system) else _matrices(x_eq=system.x_eq, u_eq=system.u_eq, y_eq=system.y_eq)
    return f"""<h2>Model</h2>
<pre>x' = A (x - x_eq) + B w,   y = y_eq + C (x - x_eq),   w = min(upper, max(lower, u + d)) - u_eq</pre>
<p>x: {_names(system.states)}. u: {_names(system.inputs)}. y: {_names(system.outputs)}. The disturbances d
add to the inputs u, and their sum is limited. A sensor reports r floor((y + bias)/r + offset), r its resolution, or y + bias
where r is 0. A step holds the inputs and is exact for every step length, x(t + h) = e<sup>A h</sup> x(t) + G w for
deviations x; outputs depend on states only. For model exchange the same states are integrated by the importing tool.</p>
<pre>{_matrices(A=system.A, B=system.B, C=system.C)}{equilibrium}</pre>"""


def _is_moved(system: System) -> bool:
    return any(np.any(v) for v in (system.x_eq, system.u_eq, system.y_eq))


def _names(quantities: tuple[object, ...]) -> str:
    return escape(", ".join(map(str, quantities)))


def _matrices(**named: Array | None) -> str:
    return "".join(f"{name} = {np.array2string(np.asarray(M), max_line_width=110)}\n" for name, M in named.items())
