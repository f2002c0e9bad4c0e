"""What the controller FMU says about itself: HTML for its documentation."""

from __future__ import annotations

from html import escape

from ..design import Design


def notes(design: Design, nominal: str) -> str:
    """Return the law's equations, the design's certificate and what the modes do."""
    margins = {k: v for k, v in design.certificate.as_dict().items() if k != "identities"}  # digits of rounding alone
    rows = "\n".join(f"<tr><td>{escape(name)}</td><td>{value:.3g}</td></tr>" for name, value in margins.items())
    return f"""<h2>Law</h2>
<pre>LC    u = k_lin x,   x = (theta, delta, theta', delta')
IHC   u = r^(1-mu) k d(-ln r) x - row x,   k = k_lin + row,   d(s) = exp(s Phi^-1 diag(1 + mu (n-i)) Phi)
      r = ||x||_d, the root of ||d(-ln r) x||_P = 1, limited to [a_min, b_max]
SMC   u = smc_k x - smc_rho sign(smc_c x)
STA   u = sta_k x - k_1 |s|^(1/2) sign(s) + v,   v' = -k_2 sign(s),   s = sta_c x
      k_1 = 1.5 sqrt(sta_rate), k_2 = 1.1 sta_rate; v stands still where the voltage is limited, and begins at 0</pre>
<p>D. Cruz-Ortiz et al., "Practical Realization of Implicit Homogeneous Controllers for Linearized Systems", eqs. (8),
(10), (11), Algorithm 1 (corrected) and Remark 5. With a_min = b_max = 1 the IHC is the LC.</p>
<p>The controller samples each sample_time, the communication step must divide it, and holds its voltage in between. A
sample that falls on the start of a step acts in that step. Modes: idle, swing_up (energy law on an observer with the
nominal model), stabilizing, fault (0 V, latched; a measurement that is not finite).</p>
<h2>Certificate ({escape(design.method)}, alpha = {design.alpha:g} 1/s, mu = {design.mu:g})</h2>
<p>Margins recomputed from the numbers by eigenvalues; all are positive, and the relative residual of the identities (1)
is at most 1e-8. From a state with norm r0 the ideal law reaches the origin within r0^mu/(mu alpha).</p>
<table><tr><th>margin</th><th></th></tr>
{rows}</table>
<p>Nominal model of swing-up and observer: parameter set <code>{escape(nominal)}</code>.</p>"""
