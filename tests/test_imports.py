"""Who imports whom: no circle among the modules, be it for types or in functions; libraries know no commands."""

from __future__ import annotations

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = [*(ROOT / "src").iterdir(), ROOT / "cosim"]


def modules():
    """The files of the project's modules by their names."""
    files = {}
    for package in PACKAGES:
        for path in package.rglob("*.py"):
            parts = path.relative_to(package.parent).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


def imported(name, path, known):
    """The known modules that a module imports, wherever in it."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            origin = [*package[: len(package) - node.level + 1], *([node.module] if node.module else [])]
            source = ".".join(origin) if node.level else str(node.module)
            for alias in node.names:
                yield from (module for module in (f"{source}.{alias.name}", source) if module in known)


@cache
def graph():
    known = modules()
    return {name: set(imported(name, path, known)) - {name} for name, path in known.items()}


def test_no_modules_import_each_other():
    imports = graph()
    assert imports["cosim.cli.run"] >= {"cosim.cli.display", "cosim.scenario"}
    # a package's own module re-exports what is below it
    TopologicalSorter(
        {name: {m for m in needs if not name.startswith(m + ".")} for name, needs in imports.items()}
    ).prepare()


def test_libraries_do_not_know_the_command_line():
    beyond = {name: {m for m in needs if m.startswith("cosim.cli")} for name, needs in graph().items()}
    assert [name for name, needs in beyond.items() if needs and not name.startswith("cosim.cli")] == ["cosim.__main__"]


def test_the_device_and_the_paper_are_known_to_their_commands_only():
    """Libraries can do without either, and neither knows the other."""
    for part in ("cosim.hil", "cosim.paper"):
        users = [name for name, needs in graph().items() if any(f"{m}.".startswith(f"{part}.") for m in needs)]
        assert f"cosim.cli.{part.split('.')[1]}" in users
        assert [name for name in users if not f"{name}.".startswith((f"{part}.", "cosim.cli."))] == []
