"""What the controller FMU of a design says about itself: HTML for its documentation. Offline."""

from __future__ import annotations

from html import escape

from ..design import Design
from .start_values import LinearFilter


def notes(design: Design, filter_: LinearFilter | None) -> str:
    """Return the law's equations, the design's certificate, and where the state comes from."""
    system, certificate = design.system, design.certificate
    found = {name: value for name, value in certificate.as_dict().items() if name != "identities"}
    margins = "\n".join(f"<tr><td>{escape(name)}</td><td>{value:.3g}</td></tr>" for name, value in found.items())
    states = ", ".join(map(str, system.states))
    inputs = ", ".join(map(str, system.inputs))
    source = "The states are measured." if filter_ is None else FILTER
    return f"""<h2>Law</h2>
<pre>LC    u = K x,   x = ({escape(states)}),   u = ({escape(inputs)})
IHC   u = K_0 x + r^(1-mu) (K - K_0) d(-ln r) x,   d(s) = exp(s G_d)
      r = ||x||_d, the root of ||d(-ln r) x||_P = 1, limited to [a_min, b_max]</pre>
<p>x is the deviation from the equilibrium, and from the steady state of the set-points where there are some; the input at
the equilibrium is added, and every input limited. D. Cruz-Ortiz et al., "Practical Realization of Implicit Homogeneous
Controllers for Linearized Systems", eqs. (8), (10), (11), Algorithm 1 (corrected), Remarks 1 and 5. With
a_min = b_max = 1 the IHC is the LC.</p>
<p>{source} The controller samples each sample_time and holds its outputs in between; the communication step must divide
sample_time, or be a multiple of it. Modes: idle (enabled is false), stabilizing, fault (latched until reset; a measurement
or a command that is not finite).</p>
<h2>Certificate ({escape(design.method)}, alpha = {design.alpha:g} 1/s, mu = {design.mu:g})</h2>
<p>Margins recomputed from the numbers, signs in exact arithmetic. From a state with norm r0 the ideal law reaches the
origin within r0^mu/(mu alpha). What is proven is the law in continuous time on the linear model with the true state: not
its sampling, its estimates or the limits of its inputs.</p>
<table><tr><th>margin</th><th></th></tr>
{margins}</table>"""


FILTER = (
    "The states are estimated by a Kalman filter for this sample time, with disturbances of the inputs as states, which are "
    "compensated while compensate_disturbance is true."
)
