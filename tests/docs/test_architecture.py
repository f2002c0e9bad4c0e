"""The pages on how it is built say what the code does: packages, imports, online modules, files that are named."""

import ast
import re
import sys
from pathlib import Path

import pytest

from tests.test_imports import graph, modules

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PARTS = (
    "cosim.cli",
    "cosim.explore",
    "cosim.hil",
    "cosim.paper",
    "cosim.studies",
    "ihc_fmu.pendulum",
    "ihc_fmu.regulator",
    "plant_fmu.linear",
)
SLAVES = ("ihc_fmu.pendulum.slave", "ihc_fmu.regulator.slave", "plant_fmu.linear.slave", "plant_fmu.slave")
FILES = modules()


def package_of(module):
    """The package of the table that a module is in: one of PARTS, or the one at the top."""
    return next((part for part in PARTS if f"{module}.".startswith(f"{part}.")), module.split(".")[0])


def libraries(module):
    """The libraries that a module imports, wherever in it."""
    nodes = list(ast.walk(ast.parse(FILES[module].read_text(encoding="utf-8"))))
    names = {alias.name.split(".")[0] for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {str(n.module).split(".")[0] for n in nodes if isinstance(n, ast.ImportFrom) and not n.level}
    return names - set(sys.stdlib_module_names) - {package_of(known).split(".")[0] for known in FILES}


def rows(heading):
    """The rows of the table under a heading, each cell as the names in it."""
    table = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in table.splitlines() if line.startswith("| `")]
    return [[re.findall(r"`([\w.]+)`", cell) for cell in line.split("|")[1:-1]] for line in lines]


def test_packages_import_what_the_page_says():
    said = {package: (imports, names) for (package,), _, imports, names in rows("Packages")}
    imported = {package_of(module): (set(), set()) for module in FILES}
    for module, needs in graph().items():
        imported[package_of(module)][0].update(map(package_of, needs))
        imported[package_of(module)][1].update(libraries(module))
    imported["cosim"][0].remove("cosim.cli")  # by `python -m cosim`, see test_imports.py
    assert said == {name: (sorted(needs - {name}), sorted(names)) for name, (needs, names) in imported.items()}


def online():
    """The slaves and the modules that they import; a package's own module is empty in an FMU."""
    imports, reached = graph(), set()
    queue: list[str] = list(SLAVES)
    while queue:
        module = queue.pop()
        if module not in reached and FILES[module].name != "__init__.py":
            reached.add(module)
            queue += imports[module]
    return reached


def test_online_modules_are_those_of_the_page():
    said = {f"{package}.{name}" for (package,), names in rows("Online and offline") for name in names}
    assert said == online()


def test_online_modules_need_the_standard_library_only():
    assert {module: libraries(module) for module in online() if libraries(module)} == {
        "fmu_export.guarded_slave": {"pythonfmu"}
    }


def test_the_picture_names_every_package():
    picture = (ROOT / "docs" / "images" / "data_flow.svg").read_text(encoding="utf-8")
    named = set(re.findall(r">([\w.]+)</(?:tspan|text)>", picture))
    assert named >= {package for (package,), *_ in rows("Packages")}


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md"])
def test_files_that_are_named_exist(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    tops = [path.name for path in ROOT.iterdir() if path.is_dir()]
    named = [name for name in re.findall(r"`([\w./]+)`", text) if name.split("/")[0] in tops and "/" in name]
    made = ("build/", "dist/", "results/")
    assert named
    assert [name for name in named if not name.startswith(made) and not (ROOT / name).exists()] == []
