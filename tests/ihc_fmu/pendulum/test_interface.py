"""The declared interface: complete, consistent, without a dead parameter, and free of other libraries."""

import itertools
import subprocess
import sys
from collections import Counter

import pytest

from fmu_export.units import base_unit
from ihc_fmu.pendulum.interface import INTERFACE, LAWS, STATES, kalman_gains, matrix, upper_triangle, vector
from ihc_fmu.pendulum.unit import IhcControllerUnit


def test_inputs_and_outputs_come_in_the_order_of_the_fmu():
    assert [v.name for v in INTERFACE.of("input")] == ["theta", "delta", "theta_dot", "delta_dot", "theta_setpoint"]
    outputs = [v.name for v in INTERFACE.of("output")]
    assert outputs[:4] == ["voltage", "homogeneous_norm", "homogeneous_norm_used", "mode"]
    assert outputs[4:6] == ["theta_dot_estimate", "delta_dot_estimate"]
    assert outputs[-1] == "fault"


def test_gain_and_matrix_entries_are_named_by_row_and_column():
    assert vector("k") == ("k_1", "k_2", "k_3", "k_4")
    assert matrix("M")[:5] == ("M_11", "M_12", "M_13", "M_14", "M_21")
    assert upper_triangle("P") == tuple(f"P_{ij}" for ij in (11, 12, 13, 14, 22, 23, 24, 33, 34, 44))


def test_neutral_matrices_are_the_identity():
    values = INTERFACE.start_values()
    assert [values[n] for n in matrix("Phi")] == [float(i == j) for i in range(4) for j in range(4)]
    assert [values[n] for n in upper_triangle("P")] == [1.0, 0, 0, 0, 1, 0, 0, 1, 0, 1]


def test_every_start_value_obeys_its_own_rule_and_every_variable_is_described():
    for v in INTERFACE.variables:
        assert v.description
        if v.start is not None:
            assert v.check(v.start) == v.start


def base_units(unit):
    base = base_unit(unit)
    assert base is not None
    assert (base.factor, base.offset) == (1.0, 0.0)
    return base.powers


def times(*units):
    """Return the exponents of a product of units."""
    total = Counter()
    for unit in units:
        total.update(base_units(unit))
    return {base: power for base, power in total.items() if power}


def test_units_are_those_of_the_equations():
    """x in rad and rad/s, u in V, b = x''/u, z_n' = u, z_i' = z_(i+1), c b = 1, x' P x and k_e E/(rad/s^2) numbers."""
    unit = {v.name: v.unit for v in INTERFACE.variables}
    x, z = [unit[name] for name in STATES], ["V.s4", "V.s3", "V.s2", "V.s"]
    for i, j in itertools.product(range(4), repeat=2):
        assert times(unit[f"Phi_{i + 1}{j + 1}"], x[j]) == base_units(z[i])
        if i <= j:
            assert times(unit[f"P_{i + 1}{j + 1}"], x[i], x[j]) == {}
    for j in range(4):
        for row in ("k_lin", "row", "smc_k", "sta_k"):
            assert times(unit[f"{row}_{j + 1}"], x[j]) == base_units("V")
        for surface in ("smc_c", "sta_c"):
            assert times(unit[f"{surface}_{j + 1}"], x[j], "1/s") == base_units("V")
    assert times(unit["swing_up_energy_gain"], "J") == base_units(unit["swing_up_acceleration_limit"])
    assert times(unit["swing_up_arm_stiffness"], "rad") == base_units(unit["swing_up_acceleration_limit"])
    assert times(unit["swing_up_arm_damping"], "rad/s") == base_units(unit["swing_up_acceleration_limit"])
    assert times(unit["sta_rate"], "s") == base_units("V")
    assert unit["smc_rho"] == unit["disturbance_estimate"] == "V"
    corrected = ("rad", "rad", "rad/s", "rad/s", "V", "rad")
    for name in kalman_gains():
        assert times(unit[name], "rad") == base_units(corrected[int(name[-2]) - 1])
    assert unit["capture_level"] == unit["mu"] == unit["homogeneous_norm"] == unit["swing_up_energy_offset"] == "1"


def test_only_measured_inputs_turn_a_non_finite_value_into_a_fault():
    assert {v.name for v in INTERFACE.variables if v.fault_on_non_finite} == {v.name for v in INTERFACE.of("input")}


def test_what_the_estimators_are_built_from_is_fixed_and_what_an_operator_tunes_is_tunable():
    variability = {v.name: v.variability for v in INTERFACE.of("parameter")}
    fixed = {"sample_time", "mu", "velocity_source", "velocity_filter_cutoff", "nominal_coupling", *matrix("Phi")}
    tunable = {"a_min", "b_max", "j_max", "law", "norm_solver", "discretization", "enabled", "voltage_limit"}
    assert {variability[name] for name in fixed} == {"fixed"}
    assert {variability[name] for name in tunable} == {"tunable"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"a_min": 0.0}, r"a_min must lie in \[1e-06, 1e\+12\], found 0.0"),
        ({"mu": 1.5}, r"mu must lie in \[0, 1\], found 1.5"),
        ({"law": "PID"}, f"law must be one of {', '.join(LAWS)}, found 'PID'"),
        ({"law": 5}, r"law must lie in \[1, 4\], found 5"),
        ({"j_max": 2.5}, "j_max must be an integer of 32 bits, found 2.5"),
        ({"sample_time": 0.0}, "sample_time must lie in .* s, found 0.0"),
        ({"k_lin_1": float("nan")}, "k_lin_1 must be finite, found nan"),
        ({"a_mim": 0.5}, "no parameter or input named 'a_mim'; did you mean a_min"),
        ({"voltage": 1.0}, "no parameter or input named 'voltage'"),
    ],
)
def test_start_value_against_its_rule_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        INTERFACE.start_values(changes)


class Recorder(dict):
    """Values that remember which of them were read."""

    def __init__(self, values):
        super().__init__(values)
        self.read = set()

    def __getitem__(self, key):
        self.read.add(key)
        return super().__getitem__(key)


def test_unit_reads_every_parameter(start_values):
    values = Recorder(INTERFACE.start_values(start_values))
    unit = IhcControllerUnit(values)
    unit.initialize(0.0, (0.0, 3.0, 0.0, 0.0, 0.0))
    unit.step(0.0, 1e-3, (0.0, 3.0, 0.0, 0.0, 0.0))
    assert values.read == {v.name for v in INTERFACE.of("parameter")}


def test_outputs_match_the_interface_in_number_and_codes(controller):
    outputs = dict(zip([v.name for v in INTERFACE.of("output")], controller().outputs(), strict=True))
    assert outputs["mode"] == INTERFACE.by_name["mode"].items.index("idle") + 1
    assert outputs["fault"] == INTERFACE.by_name["fault"].items.index("none") + 1


def test_online_part_needs_nothing_but_the_standard_library():
    """It travels inside the FMU; importing it in a fresh interpreter brings no other package along."""
    script = (
        "import ihc_fmu.pendulum.unit, sys; print({m.partition('.')[0] for m in sys.modules} - sys.stdlib_module_names)"
    )
    process = subprocess.run([sys.executable, "-S", "-c", f"import sys; sys.path[:0] = {sys.path!r}; {script}"],
                           capture_output=True, text=True, check=True)  # fmt: skip
    names = set(process.stdout.strip("{}\n").replace("'", "").split(", "))
    assert names == {"__main__", "ihc_fmu", "fmu_export", "rotary_pendulum"}
