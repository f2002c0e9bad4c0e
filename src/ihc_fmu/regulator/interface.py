"""The variables of the controller FMU of any linear model: the compiled table, and what an FMU of one design shows of it.

The table has the largest sizes and neutral names: `measurement_1`, `command_1`, ... A matrix (rows, columns) takes the first
rows times columns entries NAME_1, NAME_2, ... by rows. What a design decides has a neutral start value here and gets its own
from `start_values` at export; what an FMU does not show of it travels as a hidden start value.

Standard library only: this module travels inside the Python FMU.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fmu_export.errors import UserError, shown
from fmu_export.variables import Interface, Value, Variable

from ..homogeneity import LARGEST, MOST_BISECTIONS
from ..sampled_unit import FAULTS

STATES, INPUTS, OUTPUTS = 16, 8, 16
"""Most states n, inputs m of the plant and measured outputs p of it."""

LAWS = ("LC", "IHC", "STA")
NORM_SOLVERS = ("algorithm1", "exact")
DISCRETIZATIONS = ("explicit", "semi_implicit")
ESTIMATORS = ("measured_state", "kalman", "homogeneous_observer")
MODES = ("idle", "stabilizing", "fault")

UNLIMITED = LARGEST
"""Limit of an input that has none."""


def numbered(name: str, count: int) -> tuple[str, ...]:
    """Return NAME_1, ..., NAME_count: the compiled names of a vector's entries, or of a matrix's by rows."""
    return tuple(f"{name}_{i}" for i in range(1, count + 1))


def _inputs(name: str, description: str) -> list[Variable]:
    return [
        Variable(entry, "input", description, start=0.0, fault_on_non_finite=True) for entry in numbered(name, OUTPUTS)
    ]


def _output(name: str, description: str, items: tuple[str, ...] = (), start: tuple[str, ...] = ()) -> Variable:
    return Variable(
        name,
        "output",
        description,
        type="Enumeration" if items else "Real",
        variability="discrete",
        items=items,
        initial_dependencies=start,
    )


def _outputs(name: str, count: int, description: str, start: tuple[str, ...] = ()) -> list[Variable]:
    return [
        _output(entry, description, start=tuple(f"{other}_{i}" for other in start))
        for i, entry in enumerate(numbered(name, count), 1)
    ]


def _fixed(name: str, start: Value, description: str, unit: str = "1", **rest: object) -> Variable:
    return Variable(name, "parameter", description, unit, variability="fixed", start=start, **rest)  # type: ignore[arg-type]


def _tunable(name: str, start: Value, description: str, **rest: object) -> Variable:
    return Variable(name, "parameter", description, variability="tunable", start=start, **rest)  # type: ignore[arg-type]


def _choice(name: str, start: str, items: tuple[str, ...], description: str, *, tunable: bool = True) -> Variable:
    make = _tunable if tunable else _fixed
    return make(name, items.index(start) + 1, description, type="Enumeration", items=items)


def _entries(name: str, count: int, description: str) -> list[Variable]:
    return [_fixed(entry, 0.0, description) for entry in numbered(name, count)]


def _identity(name: str, description: str) -> list[Variable]:
    """Return the entries of a matrix that for one state, the neutral size, is the unit matrix."""
    return [_fixed(entry, float(k == 0), description) for k, entry in enumerate(numbered(name, STATES * STATES))]


def _count(name: str, most: int, description: str) -> Variable:
    return _fixed(name, 1, description, type="Integer", min=1, max=most)


_TRIANGLE = STATES * (STATES + 1) // 2
_NORM_START = (
    *(entry for name in ("measurement", "setpoint", "output_equilibrium") for entry in numbered(name, OUTPUTS)),
    *numbered("P", _TRIANGLE),
    "mu",
)

INTERFACE = Interface(
    name="HomogeneousController",
    description="Stabilization of a linear model by a linear, implicit homogeneous or super-twisting law",
    variables=(
        *_inputs("measurement", "measured output"),
        *_inputs("setpoint", "where this output is to be held"),
        *_outputs(
            "command", INPUTS, "command, held between samples; 0 within its limits before the first", ("lower", "upper")
        ),
        _output("homogeneous_norm", "canonical homogeneous norm of the estimated state's deviation", start=_NORM_START),
        _output(
            "homogeneous_norm_used", "value of the norm in force in the law: within [a_min, b_max]; 1 where none is"
        ),
        _output("mode", "what the controller is doing", MODES),
        *_outputs("state_estimate", STATES, "state that the law uses", ("state_equilibrium", "output_equilibrium")),
        *_outputs("disturbance_estimate", INPUTS, "what the Kalman filter takes for a disturbance of this input"),
        *_outputs("bias_estimate", OUTPUTS, "bias of this output that the Kalman filter found"),
        _output("fault", "why the controller has stopped; latched until reset", FAULTS),
        _choice("law", "IHC", LAWS, "stabilizing law: linear, implicit homogeneous, super-twisting"),
        _tunable(
            "a_min",
            0.5,
            "smallest value of the norm in the law; a_min = b_max = 1 is the linear law",
            min=1e-6,
            max=1e12,
        ),
        _tunable("b_max", 1.0, "largest value of the norm in the law", min=1e-6, max=1e12),
        _tunable("j_max", 3, "bisections per sample in Algorithm 1", type="Integer", min=1, max=MOST_BISECTIONS),
        _choice("norm_solver", "exact", NORM_SOLVERS, "how the norm in the law is computed"),
        _choice(
            "discretization", "semi_implicit", DISCRETIZATIONS, "state in the law: the present or the next sample's"
        ),
        _tunable(
            "enabled", True, "false holds the controller idle, its commands 0 within their limits", type="Boolean"
        ),
        _tunable("compensate_disturbance", True, "subtract the Kalman filter's disturbance estimates", type="Boolean"),
        *[_tunable(name, -UNLIMITED, "smallest value of the command") for name in numbered("lower", INPUTS)],
        *[_tunable(name, UNLIMITED, "largest value of the command") for name in numbered("upper", INPUTS)],
        _fixed("sample_time", 1e-3, "sample time of the controller", "s", min=1e-6, max=1e3),
        _fixed("mu", 1.0, "minus the degree of homogeneity; 1 rejects matched disturbances", min=0.0, max=1.0),
        *_entries("K", INPUTS * STATES, "gain of the linear controller u = K x"),
        *[
            _fixed(entry, float(k == 0), "unit ball x' P x <= 1 of the homogeneous norm; P is symmetric")
            for k, entry in enumerate(numbered("P", _TRIANGLE))
        ],
        *_entries("output_equilibrium", OUTPUTS, "measured output at the equilibrium of the model"),
        *_entries("input_equilibrium", INPUTS, "input at the equilibrium of the model"),
        *_entries("state_equilibrium", STATES, "state at the equilibrium of the model"),
        _count("state_count", STATES, "states n"),
        _count("input_count", INPUTS, "inputs m"),
        _count("output_count", OUTPUTS, "measured outputs p"),
        *[
            _fixed(entry, 0, "blocks behind that of this coordinate", type="Integer", min=0, max=STATES - 1)
            for entry in numbered("exponent", STATES)
        ],
        *_identity("T", "(n, n): block coordinates z = T x"),
        *_entries("N", STATES * STATES, "(n, n): superdiagonal blocks, z_i' = N_i z_(i+1)"),
        *_entries("B", STATES * INPUTS, "(n, m): T B, the last block's rows"),
        *_entries("K0", INPUTS * STATES, "(m, n): u = K_0 x makes the model nilpotent"),
        *_entries("Ki", INPUTS * STATES, "(m, n): gain of the integral action, 0 for none"),
        *_entries("Nx", STATES * OUTPUTS, "(n, p): states at rest per set-point"),
        *_entries("Nu", INPUTS * OUTPUTS, "(m, p): inputs at rest per set-point"),
        _choice("estimator", "measured_state", ESTIMATORS, "where the state comes from", tunable=False),
        *_entries("first", STATES * OUTPUTS, "(n, p): states that the first measurement is taken for"),
        *_entries("C", OUTPUTS * STATES, "(p, n): measured outputs y = C x"),
        *_entries(
            "F", STATES * STATES, "(n, n): states after a sample by the Kalman filter's model; A of the observer"
        ),
        *_entries("G", STATES * INPUTS, "(n, m): their change by held inputs; B of the observer"),
        *_entries("M", (STATES + INPUTS + OUTPUTS) * OUTPUTS, "(n + m + p, p): gain of the Kalman filter"),
        _fixed("bias_decay", 0.0, "what remains of a bias after a sample", min=0.0, max=1.0),
        _fixed(
            "filter_sample_time", 0.0, "sample time that the Kalman filter is for; 0 is none", "s", min=0.0, max=1e3
        ),
        *_identity("To", "(n, n): block coordinates of the homogeneous observer, of (A', C')"),
        *[
            _fixed(entry, 0, "blocks behind that of this coordinate", type="Integer", min=0, max=STATES - 1)
            for entry in numbered("observer_exponent", STATES)
        ],
        *_entries("L0", STATES * OUTPUTS, "(n, p): L_0 of the observer"),
        *_entries("Lz", STATES * OUTPUTS, "(n, p): To^-T (L - L_0) with its linear gain L"),
        _fixed("observer_degree", 0.0, "nu of the observer; 0 is the linear one", min=-1.0, max=0.0),
        _fixed("q_min", 1.0, "smallest output error in its gain", min=1e-12, max=1e12),
        _fixed("q_max", 1.0, "largest output error in its gain", min=1e-12, max=1e12),
        *_entries("S", INPUTS * STATES, "(m, n): sliding surfaces s = S x of the super-twisting law"),
        *_entries("Ks", INPUTS * STATES, "(m, n): linear part of the super-twisting law"),
        *[
            _tunable(entry, 0.0, "L of the super-twisting law: largest rate of a disturbance that it rejects", min=0.0)
            for entry in numbered("sta_rate", INPUTS)
        ],
        *_entries("count", OUTPUTS, "resolution of this output's sensor, 0 for none"),
        _fixed(
            "kalman_count_weight",
            1.0,
            "weight in the Kalman filter of what of an innovation is within half a count of its sensor",
            min=0.0,
            max=1.0,
        ),
    ),
    step_size=1e-3,
    stop_time=1.0,
    variable_step=False,
    step_parameter="sample_time",
)


Named = tuple[str, str]
"""A quantity: its name and its unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """The names and units of a design's quantities, and which of them its controller has.

    `set_points` and `biases` name outputs: those with a set-point, those whose bias the filter estimates. `estimated`: a
    Kalman filter estimates the state and disturbances of all inputs. Raises UserError for more quantities than the table
    has and for a name that is no output's.
    """

    name: str
    states: tuple[Named, ...]
    inputs: tuple[Named, ...]
    outputs: tuple[Named, ...]
    set_points: tuple[str, ...] = ()
    biases: tuple[str, ...] = ()
    estimated: bool = False

    def __post_init__(self) -> None:
        for kind, most in (("states", STATES), ("inputs", INPUTS), ("outputs", OUTPUTS)):
            names = getattr(self, kind)
            if not 1 <= len(names) <= most:
                raise UserError(f"a controller FMU is for 1 to {most} {kind}, found {len(names)}")
        for kind in ("set_points", "biases"):
            for name in getattr(self, kind):
                if name not in dict(self.outputs):
                    raise UserError(f"{kind} must name outputs, found {shown(name)}")


def shown_interface(shape: Shape) -> Interface:
    """Return what the controller FMU of a design shows: its quantities, gains and choices under their own names."""
    table = INTERFACE.by_name
    shared = [v for v in INTERFACE.variables if v.name in _SHARED]
    variables = [
        *_named(shape.outputs, "measurement", "{}", "measured {}"),
        *_named(shape.outputs, "setpoint", "{}_setpoint", "where {} is to be held", shape.set_points),
        *_named(
            shape.inputs, "command", "{}", "commanded {}, held between samples; 0 within its limits before the first"
        ),
        *[v for v in shared if v.calculated and v.name != "fault"],
        *_named(shape.states, "state_estimate", "{}_estimate", "{} that the law uses"),
        table["fault"],
        *[v for v in shared if not v.calculated],
        *_named(shape.inputs, "lower", "{}_lower", "smallest {} that is commanded"),
        *_named(shape.inputs, "upper", "{}_upper", "largest {} that is commanded"),
        *_rates(shape),
        *_gain(shape),
        *_ball(shape),
        *_named(shape.outputs, "output_equilibrium", "{}_equilibrium", "{} at the equilibrium of the model"),
        *_named(shape.inputs, "input_equilibrium", "{}_equilibrium", "{} at the equilibrium of the model"),
    ]
    if shape.estimated:
        variables += [
            *_named(shape.inputs, "disturbance_estimate", "{}_disturbance_estimate", "disturbance that adds to {}"),
            *_named(shape.outputs, "bias_estimate", "{}_bias_estimate", "bias of the measured {}", shape.biases),
            table["compensate_disturbance"],
            table["kalman_count_weight"],
        ]
    _check_names([v.name for v in variables], shape.name)
    place = {v.name: i for i, v in enumerate(INTERFACE.variables)}
    variables.sort(key=lambda v: place[v.compiled])
    return INTERFACE.showing(
        variables, name=f"{shape.name}_controller", description=f"{INTERFACE.description}: {shape.name}"
    )


_SHARED = (
    *("homogeneous_norm", "homogeneous_norm_used", "mode", "fault", "law", "a_min", "b_max", "j_max", "norm_solver"),
    *("discretization", "enabled", "sample_time", "mu"),
)
"""Variables that every FMU shows, under the table's names."""


def _check_names(names: Sequence[str], system: str) -> None:
    """Raise UserError for a name of the system that the FMU gives to something else."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UserError(
            f"the controller of {system} has a variable named {twice[0]!r} of its own; the state, input or output that "
            "needs this name must get another"
        )


def _named(
    quantities: Sequence[Named], compiled: str, name: str, text: str, only: Sequence[str] | None = None
) -> list[Variable]:
    """Return the compiled variables of the quantities, or of those named in `only`, under names made of theirs."""
    return [
        INTERFACE.by_name[f"{compiled}_{i}"].shown_as(name.format(quantity), text.format(quantity), unit)
        for i, (quantity, unit) in enumerate(quantities, 1)
        if only is None or quantity in only
    ]


def _gain(shape: Shape) -> list[Variable]:
    n = len(shape.states)
    return [
        INTERFACE.by_name[f"K_{n * i + j + 1}"].shown_as(
            f"K_{i + 1}_{j + 1}", f"gain of the linear controller u = K x: {u} by {x}", quotient(u_unit, x_unit)
        )
        for i, (u, u_unit) in enumerate(shape.inputs)
        for j, (x, x_unit) in enumerate(shape.states)
    ]


def _rates(shape: Shape) -> list[Variable]:
    return [
        INTERFACE.by_name[f"sta_rate_{i}"].shown_as(
            f"{u}_sta_rate", f"L of the super-twisting law: largest rate of what disturbs {u}", quotient(unit, "s")
        )
        for i, (u, unit) in enumerate(shape.inputs, 1)
    ]


def _ball(shape: Shape) -> list[Variable]:
    n = len(shape.states)
    pairs = [(i, j) for i in range(n) for j in range(i, n)]
    return [
        INTERFACE.by_name[f"P_{k}"].shown_as(
            f"P_{i + 1}_{j + 1}", unit=quotient("1", shape.states[i][1], shape.states[j][1])
        )
        for k, (i, j) in enumerate(pairs, 1)
    ]


def quotient(unit: str, *divisors: str) -> str:
    """Return a unit divided by others, in Modelica's notation: N.s/m of N and m/s."""
    above, below = _fraction(unit)
    for divisor in divisors:
        over, under = _fraction(divisor)
        above, below = above + under, below + over
    product = ".".join(above) or "1"
    return product if not below else f"{product}/{below[0]}" if len(below) == 1 else f"{product}/({'.'.join(below)})"


def _fraction(unit: str) -> tuple[list[str], list[str]]:
    above, _, below = unit.partition("/")
    return tuple([f for f in part.strip("()").split(".") if f not in ("", "1")] for part in (above, below))  # type: ignore[return-value]
