"""The documentation says what the code does: derived tables are current, links lead somewhere, commands exist."""

import importlib.util
import re
import tomllib
from pathlib import Path

import pytest
import typer.main

from cosim.cli import app
from cosim.scenario import Scenario

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "fmus" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def load_make_tables():
    spec = importlib.util.spec_from_file_location("make_tables", ROOT / "docs" / "make_tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")


def test_derived_tables_are_current():
    for path, text in load_make_tables().rendered().items():
        found = path.read_text(encoding="utf-8")
        assert NUMBER.sub("#", found) == NUMBER.sub("#", text), f"{path.name}: run docs/make_tables.py"
        numbers = zip(NUMBER.findall(found), NUMBER.findall(text), strict=True)  # a solver's last digits may differ
        assert all(float(a) == pytest.approx(float(b), rel=1e-3) for a, b in numbers), (
            f"{path.name}: run docs/make_tables.py"
        )


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_to_files(page):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert target.startswith("https://") or (page.parent / target).exists(), target


COMMANDS = {
    name: {flag for option in command.params for flag in (*option.opts, *option.secondary_opts)} | {"--help", "-h"}
    for name, command in typer.main.get_command(app).commands.items()  # type: ignore[attr-defined]
}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_commands_in_the_text_exist(page):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    text = page.read_text(encoding="utf-8")
    for command, rest in re.findall(r"qube-ihc ([a-z]+)\b(?! master)([^`#\n]*)", text):
        assert command in COMMANDS, command
        assert set(re.findall(r"(?<!\S)--?[a-z][\w-]*", rest)) <= COMMANDS[command], f"{command}{rest}"
    for target in re.findall(r"^make (\w+)", text, flags=re.MULTILINE):
        assert f"\n{target}:" in makefile


def test_the_example_scenario_is_valid():
    text = (ROOT / "docs" / "cosimulation.md").read_text(encoding="utf-8")
    example = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)[0]
    assert Scenario.model_validate(tomllib.loads(example)).disturbance.gain == 60.0
