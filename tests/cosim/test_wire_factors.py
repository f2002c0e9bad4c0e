"""A magnetic levitation whose wires have wrong factors: which are named, with or without declared units."""

from __future__ import annotations

import re

import numpy as np
import pytest

from cosim.model_match import remarks
from cosim.remarks import remarks_before as notes
from cosim.scenario import Scenario
from cosim.scenario_system import build_system
from cosim.structure import Wire
from cosim.system_export import export_system
from cosim.wire_factors import ComparedWire, Explanation, likeliest
from fmu_export.errors import UserError
from ihc_fmu.synthesis import synthesize
from ihc_fmu.system import System
from tests.cosim.linear_fmu import linear_fmu

GAP, CURRENT, RESISTANCE, INDUCTANCE = 0.014, 0.8, 2.0, 0.02  # m, A, Ohm, H
A = np.array([[0.0, 1.0, 0.0], [2 * 9.81 / GAP, 0.0, -2 * 9.81 / CURRENT], [0.0, 0.0, -RESISTANCE / INDUCTANCE]])
B = np.array([[0.0], [0.0], [1.0 / INDUCTANCE]])
C = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def maglev(name, length="m", current="A", *, at_rest=(GAP, 0.0, CURRENT)):
    """Return the design with lengths in m or mm and currents in A or mA about an equilibrium in m, m/s and A."""
    sizes = np.array([*[{"m": 1.0, "mm": 1e3}[length]] * 2, {"A": 1.0, "mA": 1e3}[current]])
    entries = {
        "name": name,
        "A": (A * sizes[:, None] / sizes).tolist(),
        "B": (B * sizes[:, None]).tolist(),
        "C": C.tolist(),
        "lqr": {"Q": (np.array([2.5e5, 100.0, 0.1]) / sizes**2).tolist(), "R": [0.01]},
        "states": [f"gap [{length}]", f"rate [{length}/s]", f"coil [{current}]"],
        "inputs": ["voltage [V]"],
        "outputs": [f"position [{length}]", f"current [{current}]"],
        "limits": [[-5.0, 5.0]],
        "equilibrium": {
            "states": (at_rest * sizes).tolist(),
            "inputs": [RESISTANCE * at_rest[2]],
            "outputs": (C @ (at_rest * sizes)).tolist(),
        },
    }
    return synthesize(System.from_dict(entries))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """FMUs of the design in SI units, of that in mm, of one about 0 in mm and mA, and plants without units."""
    place = tmp_path_factory.mktemp("maglev")
    export_system(maglev("si"), place)
    export_system(maglev("milli", "mm"), place)
    export_system(maglev("both", "mm", "mA", at_rest=(0.0, 0.0, 0.0)), place)
    export_system(maglev("zero", at_rest=(0.0, 0.0, 0.0)), place)
    states = [("position", None), ("rate", None), ("current", None)]
    starts = [f"{name}_0" for name, _ in states]
    for name, sizes in (("bare", np.ones(3)), ("bare_milli", np.full(3, 1e3))):
        matrices = A * sizes[:, None] / sizes, B * sizes[:, None], np.eye(3)
        linear_fmu(place / f"{name}.fmu", [("voltage", None)], states, *matrices, x0=(0.0,) * 3, starts=starts)
    return place


POSITION, AMPERES, BACK = (
    "plant.position -> controller.position",
    "plant.current -> controller.current",
    "controller.voltage -> plant.voltage",
)


def built(folder, controller, plant, factors, **changes):
    """Return the system with the wires POSITION, AMPERES and BACK with factors, 1 for none."""
    wires = [
        f"{wire} * {factor}" if factor != 1 else wire
        for wire, factor in zip((POSITION, AMPERES, BACK), factors, strict=True)
    ]
    parts = {"plant.fmu": f"{plant}.fmu", "controller.fmu": f"{controller}_controller.fmu", "wires": wires}
    return build_system(Scenario().changed({**parts, **changes}), folder)


@pytest.mark.parametrize(
    ("controller", "plant", "factors"),
    [
        ("si", "si_linear_plant", (1, 1, 1)),
        ("milli", "si_linear_plant", (1000, 1, 1)),
        ("si", "milli_linear_plant", (0.001, 1, 1)),
        ("both", "bare", (1000, 1000, 1)),
        ("zero", "bare", (1, 1, 1)),
        ("zero", "bare_milli", (0.001, 0.001, 1)),
    ],
)
def test_right_factors_pass_without_a_remark(folder, controller, plant, factors):
    assert remarks(built(folder, controller, plant, factors)) == []


def without(wire):
    return f"{wire} would fit without a factor"


def having(wire, factor):
    return f"{wire} would fit with * {factor}"


@pytest.mark.parametrize(
    ("controller", "plant", "factors", "said"),
    [
        # a factor that does not belong there, in a metre as in a volt
        ("si", "si", (1000, 1, 1), f"position arrives in thousandths of m ({without(f'{POSITION} * 1000')})"),
        (
            "si",
            "si",
            (57.3, 1, 1),
            f"position arrives 57.3 times as large as in the model ({without(f'{POSITION} * 57.3')})",
        ),
        (
            "si",
            "si",
            (1, 1, 57.3),
            f"voltage acts 57.3 times as strongly as in the model ({without(f'{BACK} * 57.3')})",
        ),
        # the way around
        (
            "milli",
            "si",
            (0.001, 1, 1),
            f"position arrives 1e-06 times as large as in the model ({having(f'{POSITION} * 0.001', 1000)})",
        ),
        # mended by declared units, where the third quantity alone would do too
        (
            "si",
            "si",
            (1000, 1000, 1),
            "position arrives in thousandths of m; current arrives in thousandths of A "
            f"({without(f'{POSITION} * 1000')}; {without(f'{AMPERES} * 1000')})",
        ),
        (
            "si",
            "si",
            (1000, 1, 0.001),
            "voltage acts in thousandths of V; position arrives in thousandths of m "
            f"({without(f'{BACK} * 0.001')}; {without(f'{POSITION} * 1000')})",
        ),
        (
            "milli",
            "si",
            (0.001, 1, 0.001),
            "voltage acts in thousandths of V; position arrives 1e-06 times as large as in the model "
            f"({without(f'{BACK} * 0.001')}; {having(f'{POSITION} * 0.001', 1000)})",
        ),
    ],
)
def test_wrong_factors_are_named_with_their_wires(folder, controller, plant, factors, said):
    with pytest.raises(UserError, match=refusal(said)):
        built(folder, controller, f"{plant}_linear_plant", factors)


def refusal(said, *, wired=", as it is wired"):
    start = f"the controller was designed for another model than the plant's{wired}: "
    return re.escape(f"{start}{said}; controller.other_model = true runs it all the same")


def test_a_plant_without_units_is_taken_to_count_in_si_units(folder):
    position, amperes = having(POSITION, 1000), having(AMPERES, 1000)
    for factors, wired, said in (
        ((1, 1000, 1), ", as it is wired", f"position arrives in thousands of mm ({position})"),
        (
            (1, 1, 1),
            "",
            f"position arrives in thousands of mm; current arrives in thousands of mA ({position}; {amperes})",
        ),
    ):
        with pytest.raises(UserError, match=refusal(said, wired=wired)):
            built(folder, "both", "bare", factors)


def test_where_nothing_tells_which_wires_lack_a_factor_both_are_said(folder):
    wires = having(POSITION, 0.001), having(AMPERES, 0.001)
    said = (
        f"either voltage acts in thousands of V ({having(BACK, 0.001)}), or position arrives in thousandths of m and "
        f"current arrives in thousandths of A ({'; '.join(wires)})"
    )
    with pytest.raises(UserError, match=refusal(said, wired="")):
        built(folder, "zero", "bare_milli", (1, 1, 1))


def test_states_of_other_names_are_looked_at_where_the_plant_starts(folder):
    sizes = np.full(3, 1e3)
    names = [("position", None), ("v", None), ("current", None)]
    starts = [f"{name}_0" for name, _ in names]
    matrices = A * sizes[:, None] / sizes, B * sizes[:, None], np.eye(3)
    linear_fmu(folder / "own.fmu", [("voltage", None)], names, *matrices, x0=(0.0,) * 3, starts=starts)
    assert remarks(built(folder, "si", "own", (0.001, 0.001, 1))) == []
    said = (
        f"either position arrives in thousandths of m ({having(POSITION, 0.001)}), or voltage acts in thousands of V and "
        f"current arrives in thousands of A ({having(BACK, 0.001)}; {without(f'{AMPERES} * 0.001')})"
    )
    with pytest.raises(UserError, match=refusal(said)):
        built(folder, "si", "own", (1, 0.001, 1))
    unknown, moves = remarks(built(folder, "si", "own", (0.001, 0.001, -1)))  # another equilibrium may have that sign
    assert unknown == (
        "the controller's model could not be compared with the plant's, because where its states belong that do not have "
        "the design's names is not known"
    )
    assert moves.startswith("the plant does not rest at the design's equilibrium: ")


def test_all_signs_turned_are_remarked(folder):
    mirrored, resting = remarks(built(folder, "si", "si_linear_plant", (-1, -1, -1)))
    assert mirrored == (
        "the wires turn the signs of all measurements and of all commands: that answers as without, but the controller "
        "holds the plant at the mirrored equilibrium, and its set-points and limits are mirrored too"
    )
    assert resting == "the plant does not rest at the design's equilibrium: coil' is -160 A/s there"
    assert remarks(built(folder, "zero", "zero_linear_plant", (-1, -1, -1))) == [mirrored]
    said = (
        f"either the sign of voltage is the opposite and the sign of position is the opposite ({without(f'{BACK} * -1')}; "
        f"{without(f'{POSITION} * -1')}), or the sign of current is the opposite ({having(AMPERES, -1)})"
    )
    with pytest.raises(UserError, match=refusal(said)):
        built(folder, "zero", "zero_linear_plant", (-1, 1, -1))


def test_a_plant_that_does_not_answer_is_noted(folder):
    names = [("position", None), ("rate", None), ("current", None)]
    starts = [f"{name}_0" for name, _ in names]
    numb = A, np.zeros((3, 1)), np.eye(3)
    linear_fmu(folder / "numb.fmu", [("voltage", None)], names, *numb, x0=(0.0,) * 3, starts=starts)
    said = "the controller's model could not be compared with the plant's, because nothing that is measured answers to its "
    assert remarks(built(folder, "zero", "numb", (1, 1, 1))) == [f"{said}commands there"]


def test_factors_that_cancel_are_remarked(folder):
    mirrored = built(folder, "zero", "zero_linear_plant", (0.001, 0.001, 1000))
    assert remarks(mirrored) == [
        "the wires multiply all measurements by 0.001 and all commands by 1000 besides their units: that answers as "
        "without, but the controller weighs and limits other numbers than it was designed for"
    ]
    assert remarks(built(folder, "zero", "bare", (0.001, 0.001, 1000))) == []  # which units the plant has is not known


def test_a_controller_of_another_model_is_run_without_starting_the_plant_before(folder, monkeypatch):
    system = built(folder, "si", "si_linear_plant", (1000, 1, 1), **{"controller.other_model": True})
    monkeypatch.setattr("cosim.plant_as_wired.open_plant", lambda *_: pytest.fail("the plant was opened"))
    assert notes(system, Scenario().changed({"controller.other_model": True})) == []


def test_what_is_as_likely_is_said_beside_and_what_includes_it_is_not():
    wires = {name: [ComparedWire(Wire(f"plant.{name}", f"controller.{name}"))] for name in "abc"}
    one, other, more = (
        Explanation((f"{', '.join(names)} wrong",), sizes=tuple((name, 1e3) for name in names))
        for names in ("a", "bc", "ab")
    )
    said = likeliest([more, other, one], wires)
    assert said is not None
    assert said.startswith("either a wrong (")
    assert ", or b, c wrong (" in said
    assert "a, b" not in said
    assert likeliest([], wires) is None
    declared = {**wires, "a": [ComparedWire(Wire("plant.a", "controller.a"), asked=1.0, declared=True)]}
    assert (likeliest([one, other], declared) or "").startswith("b, c wrong (")
