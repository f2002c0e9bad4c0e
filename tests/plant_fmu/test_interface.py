"""The declared variables against the dataclass of parameters, and the named sets as start values."""

from dataclasses import fields
from math import pi

import pytest

from plant_fmu.interface import INTERFACE, start_values
from plant_fmu.parameters import PARAMETER_SETS, QubeParameters
from plant_fmu.unit import QubePlant


@pytest.mark.parametrize("field", fields(QubeParameters), ids=lambda f: f.name)
def test_every_physical_constant_is_a_fixed_parameter_with_its_unit_and_description(field):
    variable = INTERFACE.by_name[field.name]
    assert (variable.causality, variable.variability, variable.type) == ("parameter", "fixed", "Real")
    assert variable.unit == field.metadata["unit"]
    assert variable.description == field.metadata["description"]


def test_default_plant_is_the_set_ident():
    assert INTERFACE.start_values() == INTERFACE.start_values(start_values("ident"))


def test_defaults_are_the_device_at_rest_with_its_recommended_voltage():
    values = INTERFACE.start_values()
    expected = {"voltage_limit": 10.0, "encoder_counts": 2048, "back_emf": True, "motor_model": 1, "noise_std": 0.0}
    expected |= {"theta_0": 0.0, "delta_0": pi, "theta_dot_0": 0.0, "delta_dot_0": 0.0, "measurement_delay": 0.0}
    assert {name: values[name] for name in expected} == expected


@pytest.mark.parametrize("name", PARAMETER_SETS)
def test_named_set_becomes_a_plant_with_its_constants(name):
    parameters = PARAMETER_SETS[name]
    values = INTERFACE.start_values(start_values(name))
    assert QubeParameters(**{f.name: values[f.name] for f in fields(QubeParameters)}) == parameters.parameters
    plant = QubePlant(values)
    c = plant.coefficients
    assert plant.motor.k_e == (parameters.parameters.k_m if parameters.back_emf else 0.0)
    assert (c.D_p, c.D_r) == (parameters.parameters.D_p, parameters.parameters.D_r)


def test_set_matrices_turns_back_emf_and_pendulum_damping_off():
    values = start_values("matrices")
    assert values["back_emf"] is False
    assert values["D_p"] == 0.0
    assert values["D_r"] == 1.05e-6
    assert start_values("ident")["back_emf"] is True


def test_unknown_set_is_refused_with_the_known_names():
    with pytest.raises(ValueError, match="one of matrices, ident, hcs, listed, swapped, found 'paper'"):
        start_values("paper")


def test_inputs_and_outputs_are_named_in_the_order_of_the_unit():
    assert [v.name for v in INTERFACE.of("input")] == ["voltage", "disturbance_voltage", "pendulum_torque"]
    units = {v.name: v.unit for v in INTERFACE.calculated}
    assert list(units.items()) == [
        ("theta", "rad"),
        ("delta", "rad"),
        ("theta_dot", "rad/s"),
        ("delta_dot", "rad/s"),
        ("theta_encoder", "rad"),
        ("delta_encoder", "rad"),
        ("current", "A"),
        ("motor_torque", "N.m"),
        ("energy", "J"),
        ("theta_ddot", "rad/s2"),
        ("delta_ddot", "rad/s2"),
        ("current_dot", "A/s"),
    ]


def test_outputs_declare_no_direct_dependence_on_inputs():
    assert all(v.dependencies == () for v in INTERFACE.calculated)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("voltage_limit", -1.0),
        ("encoder_counts", -1),
        ("theta_encoder_offset", 1.1),
        ("noise_std", -1e-9),
        ("noise_seed", -1),
        ("measurement_delay", -1e-3),
        ("solver_step", 0.0),
        ("motor_model", 3),
        ("motor_model", "dynamic"),
        ("D_p", -1e-6),
    ],
)
def test_value_outside_its_rule_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"^{name} must "):
        INTERFACE.start_values({name: value})
