"""The variables of the controller FMU `IhcController`: the one place where they are declared.

What a design or the nominal model decides (gains, Phi, P, nominal_...) has a neutral start value here and gets its own
from `start_values` at export.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from fmu_export.variables import Interface, Value, Variable

from ..homogeneity import MOST_BISECTIONS
from ..sampled_unit import FAULTS

ORDER = 4
"""The controller FMU is for two degrees of freedom: x = (theta, delta, theta', delta')."""
STATES = ("theta", "delta", "theta_dot", "delta_dot")

LAWS = ("LC", "SMC", "IHC", "STA")
NORM_SOLVERS = ("algorithm1", "exact")
DISCRETIZATIONS = ("explicit", "semi_implicit")
VELOCITY_SOURCES = ("filter", "inputs", "kalman")
MODES = ("idle", "swing_up", "stabilizing", "fault")

GAIN_UNITS = ("V/rad", "V/rad", "V.s/rad", "V.s/rad")
SURFACE_UNITS = ("V.s/rad", "V.s/rad", "V.s2/rad", "V.s2/rad")
"""Of c in s = c x: with c b = 1 the surface's rate is a voltage."""
BALL_UNITS = (*["1/rad2"] * 2, *["s/rad2"] * 2, "1/rad2", *["s/rad2"] * 2, *["s2/rad2"] * 3)
"""Of the upper triangle of P, x' P x being a number."""


def _input(name: str, unit: str, description: str) -> Variable:
    return Variable(name, "input", description, unit, start=0.0, fault_on_non_finite=True)


def _output(
    name: str, description: str, unit: str = "1", items: tuple[str, ...] = (), start: tuple[str, ...] = ()
) -> Variable:
    kind = "Enumeration" if items else "Real"
    return Variable(
        name, "output", description, unit, type=kind, variability="discrete", items=items, initial_dependencies=start
    )


def _fixed(name: str, start: Value, unit: str, description: str, **rest: object) -> Variable:
    return Variable(name, "parameter", description, unit, variability="fixed", start=start, **rest)  # type: ignore[arg-type]


def _tunable(name: str, start: Value, unit: str, description: str, **rest: object) -> Variable:
    return Variable(name, "parameter", description, unit, variability="tunable", start=start, **rest)  # type: ignore[arg-type]


def _choice(name: str, start: str, items: tuple[str, ...], description: str, *, tunable: bool = True) -> Variable:
    make = _tunable if tunable else _fixed
    return make(name, items.index(start) + 1, "1", description, type="Enumeration", items=items)


def vector(name: str) -> tuple[str, ...]:
    """Return the names of the entries of a gain row: name_1, ..., name_4."""
    return tuple(f"{name}_{i}" for i in range(1, ORDER + 1))


def matrix(name: str) -> tuple[str, ...]:
    """Return the names of a matrix's entries by rows: name_11, name_12, ..., name_44."""
    return tuple(f"{name}_{i}{j}" for i in range(1, ORDER + 1) for j in range(1, ORDER + 1))


def kalman_gains() -> tuple[str, ...]:
    """Return the names of the Kalman filter's gain M (6, 2) by rows: kalman_M_11, kalman_M_12, ..., kalman_M_62."""
    return tuple(f"kalman_M_{i}{j}" for i in range(1, 7) for j in (1, 2))


def upper_triangle(name: str) -> tuple[str, ...]:
    """Return the names of a symmetric matrix's entries on and above the diagonal, by rows."""
    return tuple(f"{name}_{i}{j}" for i in range(1, ORDER + 1) for j in range(i, ORDER + 1))


def _gain_row(name: str, text: str, units: tuple[str, ...] = GAIN_UNITS) -> list[Variable]:
    return [_fixed(n, 0.0, u, f"{text}, entry of {s}") for n, u, s in zip(vector(name), units, STATES, strict=True)]


def _chain_unit(i: int, j: int) -> str:
    """Return the unit of Phi_ij: z_n' is a voltage and z_i' = z_(i+1), so z_i is in V s^(n-i+1)."""
    power = ORDER - i + 1 + (j > ORDER // 2)
    return f"V.s{power if power > 1 else ''}/rad"


def _kalman_unit(name: str) -> str:
    """Return the unit of an entry of M, corrections of the states, the voltage and the bias by an angle."""
    return {"3": "1/s", "4": "1/s", "5": "V/rad"}.get(name[-2], "1")


_NOMINAL = (
    ("arm_inertia", "kg.m2", "J_r + m_p L_r^2", 1.0, 1e-12),
    ("pendulum_inertia", "kg.m2", "J_p + m_p L_p^2/4", 1.0, 1e-12),
    ("swing_inertia", "kg.m2", "m_p L_p^2/4", 1.0, 0.0),
    ("coupling", "kg.m2", "m_p L_p L_r/2; its square is below the product of the inertias", 0.5, 0.0),
    ("gravity_torque", "N.m", "m_p g_p L_p/2", 1.0, 0.0),
    ("arm_damping", "N.m.s/rad", "D_r", 1.0, 0.0),
    ("pendulum_damping", "N.m.s/rad", "D_p", 1.0, 0.0),
    ("torque_per_volt", "N.m/V", "k_m/R_m", 1.0, 1e-12),
    ("motor_damping", "N.m.s/rad", "k_m^2/R_m", 1.0, 0.0),
)
"""Name, unit, meaning, neutral start value, smallest value of the nominal model's numbers."""

_NORMS = "canonical homogeneous norm of the estimated state, the arm's angle less its set-point"

INTERFACE = Interface(
    name="IhcController",
    description="Swing-up and stabilization of a rotary pendulum by a linear, sliding mode or implicit homogeneous law",
    variables=(
        _input("theta", "rad", "measured angle of the rotary arm"),
        _input("delta", "rad", "measured angle of the pendulum from upright; may be wrapped or not"),
        _input("theta_dot", "rad/s", "angular velocity of the arm, used with velocity_source inputs"),
        _input("delta_dot", "rad/s", "angular velocity of the pendulum, used with velocity_source inputs"),
        _output("voltage", "commanded motor voltage, held between samples; 0 before the first sample", "V"),
        _output(
            "homogeneous_norm",
            _NORMS,
            start=(*STATES, *matrix("Phi"), *upper_triangle("P"), "mu", "velocity_source", "theta_setpoint"),
        ),
        _output(
            "homogeneous_norm_used", "value of the norm in force in the law: within [a_min, b_max]; 1 where none is"
        ),
        _output("mode", "what the controller is doing", items=MODES),
        _output("theta_dot_estimate", "velocity of the arm that the law uses", "rad/s"),
        _output("delta_dot_estimate", "velocity of the pendulum that the law uses", "rad/s"),
        _output("disturbance_estimate", "voltage that the Kalman filter takes the disturbance for", "V"),
        _output("bias_estimate", "bias of the measured pendulum angle that the Kalman filter found", "rad"),
        _output("fault", "why the controller has stopped; latched until reset", items=FAULTS),
        _choice(
            "law",
            "IHC",
            LAWS,
            "stabilizing law: linear, first-order sliding mode, implicit homogeneous, super-twisting",
        ),
        *_gain_row("k_lin", "gain of the linear controller u = k_lin x"),
        *_gain_row("row", "row of the chain form, e_n' Phi A"),
        *[
            _fixed(
                name,
                float(name[-1] == name[-2]),
                _chain_unit(int(name[-2]), int(name[-1])),
                "transformation z = Phi x to chain coordinates",
            )
            for name in matrix("Phi")
        ],
        *[
            _fixed(
                name, float(name[-1] == name[-2]), unit, "unit ball x' P x <= 1 of the homogeneous norm; P is symmetric"
            )
            for name, unit in zip(upper_triangle("P"), BALL_UNITS, strict=True)
        ],
        _fixed("mu", 1.0, "1", "minus the degree of homogeneity; 1 rejects matched disturbances", min=0.0, max=1.0),
        _tunable(
            "a_min",
            0.88,
            "1",
            "smallest value of the norm in the law; a_min = b_max = 1 is the linear law",
            min=1e-6,
            max=1e12,
        ),
        _tunable("b_max", 1.0, "1", "largest value of the norm in the law", min=1e-6, max=1e12),
        _tunable("j_max", 3, "1", "bisections per sample in Algorithm 1", type="Integer", min=1, max=MOST_BISECTIONS),
        _choice("norm_solver", "algorithm1", NORM_SOLVERS, "how the norm in the law is computed"),
        _choice("discretization", "explicit", DISCRETIZATIONS, "state in the law: the present or the next sample's"),
        *_gain_row("smc_c", "sliding surface s = c x, c b = 1", SURFACE_UNITS),
        *_gain_row("smc_k", "linear part of the sliding mode law"),
        _tunable("smc_rho", 1.0, "V", "switching gain of the sliding mode law", min=0.0),
        _fixed("sample_time", 1e-3, "s", "sample time of the controller", min=1e-6, max=1.0),
        _tunable("voltage_limit", 10.0, "V", "the command is limited to plus and minus this voltage", min=0.0),
        _choice(
            "velocity_source",
            "filter",
            VELOCITY_SOURCES,
            "velocities: estimated or taken from the inputs",
            tunable=False,
        ),
        _fixed("velocity_filter_cutoff", 50.0, "rad/s", "w of the velocity filter w s/(s + w)", min=0.1, max=1e9),
        _tunable("enabled", True, "1", "false holds the controller idle at 0 V", type="Boolean"),
        _tunable("swing_up_enabled", True, "1", "false waits idle until the pendulum is lifted", type="Boolean"),
        _tunable("swing_up_energy_gain", 43000.0, "rad/(s2.J)", "k_e, arm acceleration per energy error", min=0.0),
        _tunable(
            "swing_up_acceleration_limit", 150.0, "rad/s2", "bound on the pumping acceleration of the arm", min=0.0
        ),
        _tunable("swing_up_arm_stiffness", 50.0, "1/s2", "k_th, returns the arm to its centre", min=0.0),
        _tunable("swing_up_arm_damping", 10.0, "1/s", "k_d, damps the arm", min=0.0),
        _tunable("swing_up_energy_offset", 0.1, "1", "e_o, target energy above upright in m_p g_p L_p/2"),
        _tunable("swing_up_velocity_scale", 0.375, "rad/s", "v_s, pendulum velocity of full pumping", min=1e-6),
        _tunable("capture_level", 1.0, "1", "the stabilizing law takes over where x' P x is below this", min=0.0),
        _tunable("capture_angle", 0.5, "rad", "and the pendulum within this angle of upright", min=0.0),
        _tunable("capture_velocity", 6.3, "rad/s", "and slower than this", min=0.0),
        _tunable("fall_back_angle", 0.8, "rad", "beyond this angle the stabilizing law gives up", min=0.0),
        *[
            _fixed(f"nominal_{name}", start, unit, f"nominal model: {text}", min=low, max=1e12)
            for name, unit, text, start, low in _NOMINAL
        ],
        *[
            _fixed(name, 0.0, _kalman_unit(name), "gain of the Kalman filter, for kalman_sample_time")
            for name in kalman_gains()
        ],
        _fixed("kalman_sample_time", 0.0, "s", "sample time that the Kalman filter's gain is for; 0 is none", min=0.0),
        _fixed("kalman_angle", 0.6, "rad", "beyond it the swing-up observer's gains are used", min=0.0),
        _tunable(
            "compensate_disturbance", True, "1", "subtract the Kalman filter's disturbance estimate", type="Boolean"
        ),
        _fixed(
            "observer_acceleration_noise",
            1.0,
            "rad2/s3",
            "trust in the nominal model during swing-up",
            min=1e-12,
            max=1e12,
        ),
        _fixed(
            "observer_resolution",
            2 * 3.141592653589793 / 2048,
            "rad",
            "resolution of the encoders",
            min=1e-12,
            max=10.0,
        ),
        # last, so that a value reference of earlier versions means what it meant
        _input(
            "theta_setpoint", "rad", "where the arm is to be held: law, norm and swing-up act on theta - theta_setpoint"
        ),
        *_gain_row("sta_c", "sliding surface s = c x of the super-twisting law, c b = 1", SURFACE_UNITS),
        *_gain_row("sta_k", "linear part of the super-twisting law"),
        _tunable(
            "sta_rate",
            10.0,
            "V/s",
            "L of the super-twisting law: largest rate of a disturbance that it rejects",
            min=0.0,
        ),
        _fixed(
            "kalman_count_weight",
            1.0,
            "1",
            "weight in the Kalman filter of what of an innovation is within half a count of the encoders",
            min=0.0,
            max=1.0,
        ),
    ),
    step_size=1e-3,
    stop_time=1.0,
    variable_step=False,
    step_parameter="sample_time",
)
