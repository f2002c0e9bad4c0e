"""The public names: where they come from, what they cost, and from a linear controller to a picture."""

import ast
import importlib
import inspect
import subprocess
import sys
import warnings
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

import cosim
import ihc_fmu

A, B, K = [[0, 1], [4, 0]], [[0], [1]], [[-8, -4]]

PACKAGES = pytest.mark.parametrize("package", [ihc_fmu, cosim], ids=lambda p: p.__name__)


def for_types(package):
    """The names that a package imports for type checkers, with their modules."""
    tree = ast.parse(Path(package.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    for node in block.body:
        if isinstance(node, ast.ImportFrom):
            module = f"{package.__name__}.{node.module}" if node.level else node.module
            yield from ((alias.name, module) for alias in node.names)


@PACKAGES
def test_public_names_are_those_that_type_checkers_see(package):
    homes = {name: module for module, names in package._HOMES.items() for name in names}
    assert dict(for_types(package)) == homes
    assert sorted(set(package.__all__) - {"__version__"}) == sorted(homes)
    assert set(package.__all__) <= set(dir(package))
    for name, module in homes.items():
        assert getattr(package, name) is getattr(importlib.import_module(module), name)
    with pytest.raises(AttributeError, match="has no attribute 'systme'"):
        _ = package.systme


def test_what_type_checkers_know_of_a_system_is_what_it_takes():
    tree = ast.parse(Path(inspect.getfile(ihc_fmu.System)).read_text(encoding="utf-8"))
    (declared,) = (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name == "__init__")
    entries = inspect.signature(ihc_fmu.System).parameters
    assert [a.arg for a in declared.args.kwonlyargs] == list(entries)
    defaults = [inspect.Parameter.empty if d is None else ast.literal_eval(d) for d in declared.args.kw_defaults]
    assert defaults == [entry.default for entry in entries.values()]


def test_the_version_is_the_distributions():
    assert ihc_fmu.__version__ == cosim.__version__ == version("qube-ihc")


def test_importing_the_packages_loads_no_library_and_what_a_run_needs_not_scipy():
    code = "import sys, ihc_fmu, cosim; print({'numpy', 'cvxpy', 'fmpy', 'matplotlib'} & sys.modules.keys())\n"
    code += "import cosim.scenario_run, cosim.remarks, cosim.plots; print({'cvxpy', 'scipy'} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\nset()\n"


def test_from_a_linear_controller_to_a_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    system = ihc_fmu.System(A=A, B=B, K=K, name="arm", sample_time=1e-3)
    design = ihc_fmu.synthesize(system)
    files = cosim.export(design, "fmus")
    result = cosim.run("fmus/arm.ssp", {"plant.start.x1_0": 0.1, "run.duration": 2.0})
    comparison = cosim.compare("fmus/arm.ssp", changes={"plant.start.x1_0": 0.1, "run.duration": 2.0})
    assert [file.name for file in files] == ["arm_linear_plant.fmu", "arm_controller.fmu", "arm.ssp"]
    assert len(result.plot().axes) > 1
    assert set(comparison.results) == {"LC", "IHC"}
    np.testing.assert_array_equal(comparison.results["IHC"]["plant.x1"], result["plant.x1"])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ihc_fmu.synthesize(None), "system must be a System, found None"),  # type: ignore[arg-type]
        (lambda: ihc_fmu.inverse_design(A), "system must be a System, found a list"),  # type: ignore[arg-type]
        (lambda: ihc_fmu.direct_design(None), "system must be a System, found None"),  # type: ignore[arg-type]
        (lambda: ihc_fmu.largest_alpha(None), "system must be a System, found None"),  # type: ignore[arg-type]
        (lambda: cosim.export(None), "design must be a Design, found None"),  # type: ignore[arg-type]
        (lambda: cosim.evaluate(None), "result must be a Result, found None"),  # type: ignore[arg-type]
        (lambda: cosim.linear_model("x.fmu", inputs="u1"), "inputs must be a list of texts, found 'u1'"),
        (lambda: cosim.linear_model("x.fmu", free="u1"), "free must be a list of texts, found 'u1'"),
        (lambda: cosim.compare("x.ssp", laws="LC"), "laws must be a list of texts, found 'LC'"),
        (lambda: cosim.compare("x.ssp", draws=-1), "draws must be a whole number from 0 on, found -1"),
        (lambda: cosim.compare("x.ssp", draws=1.5), "draws must be a whole number from 0 on, found 1.5"),  # type: ignore[arg-type]
        (lambda: cosim.compare("x.ssp", draws=True), "draws must be a whole number from 0 on, found true"),
        (lambda: cosim.compare("x.ssp", workers=0), "workers must be a whole number from 1 on, found 0"),
    ],
)
def test_an_argument_of_another_kind_is_refused_in_a_sentence(call, message):
    with pytest.raises(ihc_fmu.UserError) as refusal:
        call()
    assert str(refusal.value) == message


def test_what_is_to_be_known_of_a_run_is_a_warning(tmp_path):
    def warned(call, match, **changes):
        with pytest.warns(UserWarning, match=match) as caught:
            call(tmp_path / "arm.ssp", changes={"run.duration": 0.1} | changes)
        assert {warning.filename for warning in caught} == {__file__}

    system = ihc_fmu.System(A=A, B=B, K=K, name="arm", sample_time=1e-3)
    cosim.export(ihc_fmu.synthesize(system), tmp_path)
    far = {"plant.start.x1_0": 1e154, "controller.start.law": "LC"}
    for call, law in ((cosim.run, ""), (cosim.compare, "LC: ")):
        warned(call, "^nothing moved: all was at rest where it began")
        warned(call, f"^{law}the numbers overflow: controller.u1 is not finite, or beyond ", **far)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cosim.run(tmp_path / "arm.ssp", {"run.duration": 0.1, "plant.start.x1_0": 0.1})
        for call in (cosim.run, cosim.compare):
            with pytest.raises(cosim.UserError, match="plant has no variable named 'y1_0'; did you mean"):
                call(tmp_path / "arm.ssp", changes={"plant.start.y1_0": 0.1})
