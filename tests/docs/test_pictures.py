"""The pictures of docs/images: shown on a page, and those that explain the law say what it does."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from ihc_fmu import Controller, norm_of, settling_time_bound

from .test_docs import PAGES, ROOT, load


def test_every_picture_is_shown_on_a_page():
    shown = {name for page in PAGES for name in re.findall(r"images/([\w.]+)\)", page.read_text(encoding="utf-8"))}
    assert shown == {path.name for path in (ROOT / "docs/images").iterdir()}


def test_the_pictures_of_the_law_are_drawn_and_true(tmp_path, monkeypatch):
    pictures = load("make_pictures")
    monkeypatch.setattr(pictures, "IMAGES", tmp_path)
    pictures.main()
    assert {path.name for path in tmp_path.iterdir()} == {"homogeneous_law.png", "gains.png"}
    made = pictures.design()
    time, states = pictures.run(made, "IHC")
    norms = np.array([norm_of(made, x) for x in states])
    assert np.all(norms[time >= settling_time_bound(made, pictures.START)] < 0.01)
    _, linear = pictures.run(made, "LC")
    assert norm_of(made, linear[-1]) > 0.03
    for x, power in (([0.4, 0.0], 2.0 * made.mu), ([0.0, 0.4], made.mu)):
        command = Controller(made, discretization="explicit", a_min=0.001)(x)
        assert command == pytest.approx(made.K @ x * norm_of(made, x) ** -power, rel=1e-9)


def test_the_animation_is_of_the_run_as_it_is_now():
    animation, number = load("make_animation"), re.compile(r"-?\d+\.?\d*")
    held, made = animation.PICTURE.read_text(encoding="utf-8"), animation.picture(animation.run())
    assert number.sub("#", held) == number.sub("#", made), "run docs/make_animation.py"
    numbers = zip(number.findall(held), number.findall(made), strict=True)
    assert all(float(a) == pytest.approx(float(b), abs=0.2) for a, b in numbers), "run docs/make_animation.py"
    assert ElementTree.fromstring(held).tag == "{http://www.w3.org/2000/svg}svg"
    assert len(held) < 100_000
