"""The notebooks: each gives the outputs that it holds, and holds nothing of the machine that it ran on."""

import json
import re
import sys

import pytest

from tests.docs.test_docs import NUMBER, ROOT, load

NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))


def outputs(notebook):
    """What each cell has put out: its kind and text, of a picture only that it is one."""
    found = []
    for cell in notebook["cells"]:
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            (kind,) = data or [output["name"]]
            found.append((kind, "" if kind == "image/png" else "".join(data.get(kind, output.get("text", "")))))
    return found


def without_outputs(notebook):
    cells = [{name: value for name, value in cell.items() if name != "outputs"} for cell in notebook["cells"]]
    return {**notebook, "cells": cells}


@pytest.mark.skipif(sys.platform != "linux", reason="the outputs are those of Linux, and some cells are for bash")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_gives_the_outputs_that_it_holds(path, tmp_path):
    held = json.loads(path.read_text(encoding="utf-8"))
    made = load("notebooks").executed(path, tmp_path)
    assert without_outputs(held) == without_outputs(made)
    assert {kind for kind, _ in outputs(made)} <= {"stdout", "text/plain", "text/html", "image/png"}
    assert not any(str(tmp_path) in text for _, text in outputs(made))
    for (kind, said), (again, text) in zip(outputs(held), outputs(made), strict=True):
        assert (kind, NUMBER.sub("#", said)) == (again, NUMBER.sub("#", text))
        numbers = zip(NUMBER.findall(said), NUMBER.findall(text), strict=True)
        assert all(float(a) == pytest.approx(float(b), rel=2e-2, abs=1e-4) for a, b in numbers), (said, text)


@pytest.mark.parametrize(
    ("page", "folder"), [("examples/README.md", "notebooks"), ("docs/tutorial.md", "../examples/notebooks")]
)
def test_notebooks_are_listed_where_they_are_looked_for(page, folder):
    links = re.findall(r"\]\(([^)#]+\.ipynb)\)", (ROOT / page).read_text(encoding="utf-8"))
    assert sorted(links) == [f"{folder}/{path.name}" for path in NOTEBOOKS]
