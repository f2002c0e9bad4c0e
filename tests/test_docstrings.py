"""What is public is documented: every argument, what is returned, and what its examples print."""

import doctest
import importlib
import inspect

import pytest
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


def public():
    """The public names, and the methods of public classes that are this project's."""
    for package in (ihc_fmu, cosim):
        for name in package.__all__:
            thing = getattr(package, name)
            if name.startswith("__"):
                continue
            yield f"{package.__name__}.{name}"
            if inspect.isclass(thing):
                for method, member in inspect.getmembers(thing):
                    module = getattr(member, "__module__", "") or ""
                    if not method.startswith("_") and callable(member) and module.split(".")[0] in ("ihc_fmu", "cosim"):
                        yield f"{package.__name__}.{name}.{method}"


@pytest.mark.parametrize("name", public())
def test_it_is_documented(name):
    assert [text for code, text in validate(name)["errors"] if code in WANTED] == []


@pytest.mark.parametrize("name", ["ihc_fmu", "ihc_fmu.controller", "cosim"])
def test_examples_print_what_they_say(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = doctest.testmod(importlib.import_module(name))
    assert found.failed == 0
    assert found.attempted > 0


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The folder that the examples of cosim run in, with an arm's FMUs."""
    folder = tmp_path_factory.mktemp("examples")
    A, B, K = [[0, 1], [4, 0]], [[0], [1]], [[-8, -4]]
    arm = ihc_fmu.System(A=A, B=B, K=K, states=("angle [rad]", "rate [rad/s]"), name="arm")
    cosim.export(ihc_fmu.synthesize(arm), folder / "fmus")
    return folder


@pytest.mark.parametrize("name", [name for name in cosim.__all__ if name != "UserError"])
def test_a_public_name_of_cosim_has_an_example_that_runs(name, exported, monkeypatch):
    monkeypatch.chdir(exported)
    (example,) = doctest.DocTestFinder(recurse=False).find(getattr(cosim, name), name, module=False, globs={})
    assert example.examples
    assert doctest.DocTestRunner().run(example).failed == 0
