"""The documentation says what the code does: derived tables are current, links lead somewhere, commands exist."""

import importlib.util
import re
import sys
import tomllib
from pathlib import Path

import pytest
import typer.main

from cosim.cli import app
from cosim.pendulum_export import export_units
from cosim.scenario import Scenario, load_scenario
from cosim.studies.experiments import Experiment, run_experiments
from ihc_fmu.pendulum.start_values import default_design
from ihc_fmu.system_entries import ENTRIES

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "fmus/README.md")]
PAGES += sorted((ROOT / "docs").glob("*.md"))


def load(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def load_make_tables():
    return load("make_tables")


NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")


def test_derived_tables_are_current():
    for path, text in load_make_tables().rendered().items():
        written = path.read_text(encoding="utf-8")
        assert NUMBER.sub("#", written) == NUMBER.sub("#", text), f"{path.name}: run docs/make_tables.py"
        numbers = zip(NUMBER.findall(written), NUMBER.findall(text), strict=True)  # a solver's last digits may differ
        assert all(float(a) == pytest.approx(float(b), rel=1e-3) for a, b in numbers), (
            f"{path.name}: run docs/make_tables.py"
        )


def cells(line):
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


@pytest.mark.parametrize("name", ["tilt", "tilt_kalman", "tilt_ideal", "disturbed"])
def test_comparisons_on_the_pages_have_the_form_that_make_tables_gives_them(name):
    """The numbers of many draws are made by hand with `make_tables.py --results`; their form is tested."""
    tables = load_make_tables()
    page = "".join(path.read_text(encoding="utf-8") for path in tables.COMPARED)
    printed = page.split(tables.START.format(f"comparison {name}"))[1].split(tables.END)[0].strip().splitlines()
    pair = [1.0, 0.1] if name != "tilt_ideal" else [1.0, None]
    numbers = dict.fromkeys(tables.COLUMNS, pair)
    laws = {law: {**numbers, "steady": True} for law in ("LC", "SMC", "IHC")}
    summary = {
        "draws": 1 if name == "tilt_ideal" else 128,
        "laws": laws,
        "change": dict.fromkeys(("SMC", "IHC"), numbers),
    }
    expected = tables.comparison(name, summary).strip().splitlines()
    assert [cells(line)[0] for line in printed] == [cells(line)[0] for line in expected]
    assert cells(printed[0]) == cells(expected[0])
    shown = r"[<×+-]? ?[\d.e+-]+( ± [\d.]+)?( %)?( (better|worse|open))?\*?|never|–|equal"
    assert all(re.fullmatch(shown, cell) for line in printed[2:] for cell in cells(line)[1:])


def test_the_readme_says_what_the_laws_do_without_sensors(tmp_path):
    export_units(default_design(), output=tmp_path)
    scenario, folder = load_scenario("tilt_ideal")
    (result,) = run_experiments([Experiment(scenario, folder)], tmp_path)
    tables = load_make_tables()
    rows = tables.comparison("tilt_ideal", result.summary()).splitlines()[2:5]
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    for row in rows:
        name, *values = cells(row)
        (said,) = [cells(line) for line in page.splitlines() if line.startswith(f"| {name} |") and "< 0.0002" in line]
        for value, old in list(zip(values, said[1:], strict=True))[:4]:
            assert value == old or float(value) == pytest.approx(float(old), rel=1e-2), name


def test_what_the_examples_tables_say_of_the_servo_is_so():
    """The other rows are made in the same way, by hand with `make_tables.py --examples`."""
    marks, examples = load_make_tables(), load("example_table")
    page = (ROOT / "docs" / "benefit.md").read_text(encoding="utf-8")
    printed = page.split(marks.START.format("examples"))[1].split(marks.END)[0].strip().splitlines()
    assert [cells(line)[0] for line in printed[2:7]] == [e.name for e in examples.ALL]
    (servo,) = [e for e in examples.ALL if e.name == "servo"]
    expected = examples.tables([servo]).strip().splitlines()
    said = [*printed[:2], printed[6], "", *printed[8:10], printed[14]]
    assert [NUMBER.sub("#", line) for line in said] == [NUMBER.sub("#", line) for line in expected]
    pairs = [zip(NUMBER.findall(a), NUMBER.findall(b), strict=True) for a, b in zip(said, expected, strict=True)]
    assert all(float(a) == pytest.approx(float(b), rel=0.05, abs=0.05) for line in pairs for a, b in line)


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


def test_every_entry_of_a_system_file_is_documented():
    page = (ROOT / "docs" / "system_file.md").read_text(encoding="utf-8")
    table = page.split("## All entries of a system file")[1].split("\n**")[0]
    rows = [line for line in table.splitlines() if line.startswith("| `")]
    named = {name for row in rows for cell in cells(row)[:2] for name in re.findall(r"`(\w+)`", cell)}
    assert named >= set(ENTRIES)


def test_the_example_scenario_is_valid():
    text = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    example = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)[0]
    assert Scenario.model_validate(tomllib.loads(example)).disturbance.gain == 60.0
