"""What a scenario may say of the bodies that its report shows in motion."""

import pytest

from cosim.animation import BodySection
from cosim.errors import UserError
from cosim.scenario import Scenario, load_scenario
from cosim.scenario_system import build_system

CART = {"name": "cart", "shape": "cart", "size": 0.1, "x": "plant.theta"}
ROD = {"name": "rod", "shape": "rod", "size": 0.3, "on": "cart", "angle": "plant.delta"}


@pytest.mark.parametrize(
    ("bodies", "sentence"),
    [
        ([CART, CART], "animation must have bodies of different names, found 'cart' twice"),
        ([ROD], "animation 0.on must name a body before it, found 'cart'"),
        ([CART, {**ROD, "on": "crat"}], "animation 1.on must name a body before it, one of cart, found 'crat'"),
        ([{**CART, "relative": True}], "animation 0.relative needs a body that it begins on, found none"),
        ([{**CART, "size": 0.0}], "animation.0.size must be greater than 0, found 0.0"),
        ([{**CART, "shape": "box"}], "animation.0.shape must be 'cart', 'rod', 'beam' or 'wheel', found 'box'"),
    ],
)
def test_a_mistake_is_one_sentence(tmp_path, bodies, sentence):
    listed = [f"[[animation]]\n{''.join(f'{k} = {v!r}'.lower() + chr(10) for k, v in body.items())}" for body in bodies]
    (tmp_path / "mine.toml").write_text("\n".join(listed), encoding="utf-8")
    with pytest.raises(UserError) as refusal:
        load_scenario(tmp_path / "mine.toml")
    assert str(refusal.value).removeprefix(f"{tmp_path / 'mine.toml'}: ") == sentence


def test_a_signal_must_be_one_of_the_run(fmus):
    bodies = tuple(BodySection.model_validate(body) for body in (CART, ROD))
    build_system(Scenario(animation=bodies), fmus)
    wrong = Scenario(animation=(bodies[0].model_copy(update={"x": "plant.tetha"}),))
    with pytest.raises(
        UserError, match=r"^animation\.0\.x names 'plant\.tetha', which is no signal of the run; did you"
    ):
        build_system(wrong, fmus)
    with pytest.raises(UserError, match=r"^animation\.1\.angle names 'plant\.delta'"):
        build_system(Scenario(animation=bodies).changed({"record.outputs": ["plant.theta"]}), fmus)
