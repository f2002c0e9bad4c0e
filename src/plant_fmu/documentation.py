"""What the plant FMU says about itself: HTML for its documentation."""

from __future__ import annotations

from html import escape

from .parameters import ParameterSet, parameter_set


def notes(parameters: str | ParameterSet) -> str:
    """Return the model's equations and the origin of the parameter set, given or named."""
    named = parameter_set(parameters)
    return f"""<h2>Model</h2>
<pre>J(q) q'' + C(q, q') q' + w(q) = [tau, pendulum_torque]',   q = [theta, delta]',   delta = 0 upright

J = [ J_r + psi + zeta/4 sin^2 delta    -varpi/2 cos delta ]    zeta  = m_p L_p^2
    [ -varpi/2 cos delta                J_p + zeta/4       ]    psi   = m_p L_r^2
C = [ zeta/2 sin delta cos delta delta' + D_r    varpi/2 sin delta delta' ]
    [ -zeta/4 sin delta cos delta theta'         D_p                      ]
w = [ 0, -m_p g_p L_p/2 sin delta ]'                            varpi = m_p L_p L_r

V   = voltage + disturbance_voltage, limited to plus and minus voltage_limit
In place of D_r the arm has D_r + T_r/(|theta'| + 0.05 rad/s), viscous and dry friction.
tau = k_m i,   i = (V - k_e theta')/R_m,   or L_m i' = V - R_m i - k_e theta' (motor_model inductance)
k_e = k_m with back_emf, 0 without</pre>
<p>Eq. (5) and section III of D. Cruz-Ortiz et al., "Practical Realization of Implicit Homogeneous Controllers for
Linearized Systems". Integrated by the classical Runge-Kutta method with steps of at most solver_step, inputs held.
Outputs depend on states only. Encoders report r floor(angle/r + offset), r = 2 pi/encoder_counts.</p>
<h2>Parameter set <code>{escape(named.name)}</code></h2>
<p>{escape(named.use)}. Source: {escape(named.source)}.</p>"""
