"""What is public is documented: every argument, what is returned, and an example that prints what it says."""

import doctest
import importlib
import inspect

import pytest
from numpydoc.docscrape import get_doc_object
from numpydoc.validate import validate

import cosim
import ihc_fmu

WANTED = {
    "GL08": "has no docstring",
    "PR01": "leaves arguments out",
    "PR02": "documents arguments that are not there",
    "PR07": "says nothing of an argument",
    "RT01": "does not say what is returned",
    "RT03": "does not describe what is returned",
    "SS01": "has no summary",
}


def methods(thing):
    """The public methods of a public class that are this project's, by name."""
    if inspect.isclass(thing):
        for name, member in inspect.getmembers(thing):
            module = getattr(member, "__module__", "") or ""
            if not name.startswith("_") and callable(member) and module.split(".")[0] in ("ihc_fmu", "cosim"):
                yield name, member


PUBLIC = {
    f"{package.__name__}.{name}": getattr(package, name)
    for package in (ihc_fmu, cosim)
    for name in package.__all__
    if not name.startswith("__")
}
DOCUMENTED = [*PUBLIC, *(f"{name}.{method}" for name, thing in PUBLIC.items() for method, _ in methods(thing))]
HOMES = sorted({"cosim", "ihc_fmu", *(thing.__module__ for thing in PUBLIC.values())})


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The folder that examples run in, with an arm's FMUs."""
    folder = tmp_path_factory.mktemp("examples")
    A, B, K = [[0, 1], [4, 0]], [[0], [1]], [[-8, -4]]
    arm = ihc_fmu.System(A=A, B=B, K=K, states=("angle [rad]", "rate [rad/s]"), name="arm")
    cosim.export(ihc_fmu.synthesize(arm), folder / "fmus")
    return folder


def examples(thing):
    return "\n".join(get_doc_object(thing)["Examples"])


@pytest.mark.parametrize("name", DOCUMENTED)
def test_it_is_documented(name):
    assert [text for code, text in validate(name)["errors"] if code in WANTED] == []


@pytest.mark.parametrize("name", PUBLIC)
def test_it_has_an_example_and_so_have_its_methods(name):
    shown = examples(PUBLIC[name])
    assert ">>>" in shown
    assert [method for method, member in methods(PUBLIC[name]) if f".{method}(" not in shown + examples(member)] == []


@pytest.mark.parametrize("name", HOMES)
def test_examples_print_what_they_say(name, exported, monkeypatch):
    monkeypatch.chdir(exported)
    results = doctest.testmod(importlib.import_module(name))
    assert results.failed == 0
    assert results.attempted > 0
