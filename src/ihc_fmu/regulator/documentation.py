"""What the controller FMU of any linear model says about itself: HTML for its documentation."""

from __future__ import annotations

from html import escape

from ..design import Design

ESTIMATES = {
    "measured_state": "The states are the measured outputs.",
    "kalman": "A Kalman filter estimates the states, what adds to each input, and biases of chosen outputs.",
    "homogeneous_observer": "A homogeneous observer estimates the states.",
}

INTEGRAL = """
<p>Integral action: v adds to u, and v' = q r^(1-2 mu) K_i d(-ln r) x, with q = 1/(y' P G_d y), y = d(-ln r) x, where r is
the norm, and q = 1 at its limits and in the LC. K_i = -Gamma B' P with Gamma &gt; 0: under a constant disturbance of the
inputs the ideal law brings x to 0. v stands still where its command is beyond a limit and v would move farther.</p>"""


def notes(design: Design, estimator: str) -> str:
    """Return the law's equations, what the modes do, and the design's certificate; `estimator` as in the FMU's table."""
    margins = {k: v for k, v in design.certificate.as_dict().items() if k != "identities"}  # digits of rounding alone
    rows = "\n".join(f"<tr><td>{escape(name)}</td><td>{value:.3g}</td></tr>" for name, value in margins.items())
    states = ", ".join(escape(q.name) for q in design.system.states)
    inputs = ", ".join(escape(q.name) for q in design.system.inputs)
    integral = "" if design.integral is None else INTEGRAL
    return f"""<h2>Law</h2>
<pre>LC    u = K x,   x = ({states}), u = ({inputs}), deviations from the equilibrium
IHC   u = K_0 x + r^(1-mu) (K - K_0) d(-ln r) x,   d(s) = exp(s G_d)
      r = ||x||_d, the root of ||d(-ln r) x||_P = 1, limited to [a_min, b_max]
STA   u = -S A x - kappa S x - k_1 |s|^(1/2) sign(s) + v,   v' = -k_2 sign(s),   s = S x,   S = (B' P B)^-1 B' P
      for each input, k_1 = 1.5 sqrt(L), k_2 = 1.1 L, L its sta_rate; v stands still where the command is limited</pre>
<p>D. Cruz-Ortiz et al., "Practical Realization of Implicit Homogeneous Controllers for Linearized Systems", eqs. (8),
(10), (11), Algorithm 1 (corrected) and Remark 5, for any order and several inputs. With a_min = b_max = 1 the IHC is the LC.
With set-points x is the deviation from the states at rest for them. {ESTIMATES[estimator]}</p>{integral}
<p>The controller samples each sample_time, the communication step must divide it, and holds its commands in between. A
sample that falls on the start of a step acts in that step. Modes: idle (enabled false; commands 0 within their limits),
stabilizing, fault (the same commands, latched until reset; a measurement or a command that is not finite).</p>
<h2>Certificate ({escape(design.method)}, alpha = {design.alpha:g} 1/s, mu = {design.mu:g})</h2>
<p>Margins recomputed from the numbers, their signs in exact arithmetic. From a state with norm r0 the ideal law reaches the
origin within r0^mu/(mu alpha). What is proven is the law in continuous time on the linear model with the true state: not
its sampling, its estimates or the limits of its inputs.</p>
<table><tr><th>margin</th><th></th></tr>
{rows}</table>"""
