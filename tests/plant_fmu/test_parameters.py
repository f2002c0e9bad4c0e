"""The named sets, their formulas, and the checks of every number."""

from dataclasses import FrozenInstanceError, fields, replace
from math import inf, nan

import pytest

from plant_fmu.parameters import PARAMETER_SETS, QubeParameters, parameter_set

IDENT = PARAMETER_SETS["ident"].parameters
FIELDS = {f.name: f for f in fields(QubeParameters)}
DAMPINGS = {"D_p", "D_r", "T_r"}


def test_common_constants_are_the_papers():
    common = {"m_p": 0.024, "L_p": 0.129, "L_r": 0.085, "g_p": 9.81, "R_m": 8.4, "k_m": 0.042, "L_m": 1.16e-3}
    for entry in PARAMETER_SETS.values():
        assert {name: getattr(entry.parameters, name) for name in common} == common


@pytest.mark.parametrize(
    ("name", "D_p", "D_r"),
    [
        ("matrices", 0.0, 1.05e-6),
        ("ident", 5e-5, 2.7e-4),
        ("hcs", 5e-5, 1e-3),
        ("listed", 1.5e-3, 5e-4),
        ("swapped", 5e-4, 1.5e-3),
    ],
)
def test_damping_of_each_set(name, D_p, D_r):
    p = parameter_set(name).parameters
    assert (p.D_p, p.D_r) == (D_p, D_r)


def test_no_named_set_has_dry_friction_and_none_is_the_default():
    assert [entry.parameters.T_r for entry in PARAMETER_SETS.values()] == [0.0] * len(PARAMETER_SETS)
    assert FIELDS["T_r"].default == 0.0


@pytest.mark.parametrize("name", ["matrices", "ident"])
def test_inertias_are_those_of_uniform_rods(name):
    p = parameter_set(name).parameters
    assert p.J_p == pytest.approx(0.024 * 0.129**2 / 12, rel=1e-14)
    assert p.J_r == pytest.approx(0.095 * 0.085**2 / 12, rel=1e-14)


def test_arm_of_the_toolbox_turns_about_its_end_without_the_pendulums_mass():
    p = parameter_set("hcs").parameters
    assert p.J_p == IDENT.J_p
    assert p.J_r == pytest.approx(0.095 * 0.085**2 / 3 - 0.024 * 0.085**2, rel=1e-14)


@pytest.mark.parametrize("name", ["listed", "swapped"])
def test_listed_inertias_are_the_rods_in_two_digits(name):
    p = parameter_set(name).parameters
    assert (p.J_p, p.J_r) == (3.3e-5, 5.7e-5) == (float(f"{IDENT.J_p:.1e}"), float(f"{IDENT.J_r:.1e}"))


def test_only_the_set_of_the_printed_matrices_is_without_back_emf():
    assert [name for name, entry in PARAMETER_SETS.items() if not entry.back_emf] == ["matrices"]


def test_sets_are_found_by_their_own_name_and_say_where_they_come_from():
    for name, entry in PARAMETER_SETS.items():
        assert parameter_set(name) is entry
        assert entry.name == name
        assert entry.source
        assert entry.use


def test_unknown_set_lists_the_known_ones():
    with pytest.raises(ValueError, match="one of matrices, ident, hcs, listed, swapped, found 'indent'"):
        parameter_set("indent")


@pytest.mark.parametrize("name", FIELDS)
def test_every_field_carries_unit_description_and_source(name):
    metadata = FIELDS[name].metadata
    assert all(metadata[key].strip() for key in ("unit", "description", "source"))
    assert metadata["positive"] == (name not in DAMPINGS)


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("value", [-1e-9, nan, inf, -inf])
def test_refused_value_is_named_with_field_rule_and_unit(name, value):
    rule = "non-negative" if name in DAMPINGS else "positive"
    with pytest.raises(
        ValueError, match=f"^{name} must be finite and {rule}, found {value} {FIELDS[name].metadata['unit']}$"
    ):
        replace(IDENT, **{name: value})


@pytest.mark.parametrize("name", FIELDS)
def test_zero_is_for_damping_only(name):
    if name in DAMPINGS:
        assert getattr(replace(IDENT, **{name: 0.0}), name) == 0.0
    else:
        with pytest.raises(ValueError, match=f"{name} must be finite and positive, found 0.0"):
            replace(IDENT, **{name: 0.0})


def test_parameters_and_sets_are_frozen():
    with pytest.raises(FrozenInstanceError):
        IDENT.m_p = 1.0  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        PARAMETER_SETS["ident"].back_emf = False  # type: ignore[misc]
