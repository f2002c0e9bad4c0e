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
