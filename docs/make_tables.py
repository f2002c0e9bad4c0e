"""Write the tables of the documentation that are derived: from the code, and with `--results FOLDER` from comparisons.

    qube-ihc demo && qube-ihc compare disturbed && python docs/make_tables.py --results results
    python docs/make_tables.py --examples

The first needs `comparison.json` of each scenario that README and results.md show; the second designs, exports and runs
what is in examples/, which takes a minute or two, for benefit.md.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

import typer.main
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from cosim.animation import BodySection
from cosim.cli import app
from cosim.hil.faults import KINDS
from cosim.inputs import KINDS as KINDS_OF_SIGNALS
from cosim.metric_meanings import QUANTITIES
from cosim.scenario import ComponentSection, Scenario
from cosim.studies.estimates import MeanEstimate, change_text, estimate_text
from cosim.wiring import WireSection
from fmu_export.variables import Interface, Variable
from ihc_fmu.pendulum.interface import INTERFACE as CONTROLLER
from ihc_fmu.pendulum.start_values import controller_start_values, default_design
from plant_fmu.interface import INTERFACE as PLANT
from plant_fmu.interface import start_values as plant_start_values

DOCS = Path(__file__).parent
COMPARED = DOCS.parent / "README.md", DOCS / "results.md"
"""Pages with tables of comparisons."""
START, END = "<!-- {}: made by docs/make_tables.py -->\n", "<!-- end -->"


def variables() -> str:
    """Return variables.md: every variable of both FMUs as exported by default."""
    parts = [
        "# Variables of the FMUs\n\nMade by `docs/make_tables.py`; start values as `qube-ihc export` writes them.\n"
    ]
    starts = ((PLANT, plant_start_values("ident")), (CONTROLLER, controller_start_values(default_design())))
    for interface, changes in starts:
        parts.append(f"## `{interface.name}`\n\n{interface.description}.\n")
        parts.append(_table(interface, interface.start_values(changes)))
    return "\n".join(parts)


def _table(interface: Interface, start: dict[str, Any]) -> str:
    lines = ["| name | causality | unit | start | limits | description |", "|---|---|---|---|---|---|"]
    for v in interface.variables:
        kind = v.variability if v.causality == "parameter" else v.causality
        lines.append(f"| `{v.name}` | {kind} | {v.unit} | {_start(v, start)} | {_limits(v)} | {v.description} |")
    return "\n".join(lines) + "\n"


def _start(v: Variable, start: dict[str, Any]) -> str:
    if v.name not in start:
        return ""
    value = start[v.name]
    if v.items:
        return v.items[int(value) - 1]
    return str(value).lower() if isinstance(value, bool) else f"{value:.5g}"


def _limits(v: Variable) -> str:
    if v.items:
        return ", ".join(v.items)
    if v.min is None and v.max is None:
        return ""
    return f"{'' if v.min is None else f'{v.min:g}'} ... {'' if v.max is None else f'{v.max:g}'}".strip()


def command_line() -> str:
    """Return command_line.md: every command with its arguments and options."""
    program: Any = typer.main.get_command(app)
    parts = [
        "# Command line\n\nMade by `docs/make_tables.py` of what `qube-ihc COMMAND --help` says. `python -m cosim` is the "
        "same program.\n",
        _parameters(program),
        "How a command ends, with which exit code and what is left, is told in "
        "[Co-simulation](cosimulation.md#how-a-command-ends).\n",
    ]
    for name, command in program.commands.items():
        arguments = [_argument(p) for p in command.params if p.param_type_name == "argument"]
        usage = " ".join(["qube-ihc", name, "[OPTIONS]", *arguments])
        parts += [f"## `{name}`\n\n{command.help}\n\n    {usage}\n", _parameters(command)]
    return "\n".join(parts)


def _parameters(command: Any) -> str:
    lines = ["| | default | meaning |", "|---|---|---|"]
    for p in command.params:
        if p.param_type_name == "argument":
            names, default = f"`{_argument(p)}`", "required" if p.required else _default(p.default)
        else:
            value = "" if p.metavar is None else f" {p.metavar}"
            names = ", ".join(f"`{flag}{value}`" for flag in (*p.opts, *p.secondary_opts))
            default = _default(p.default)
        lines.append(f"| {names} | {default} | {_plain(p.help or '')} |")
    return "\n".join(lines) + "\n"


def _argument(parameter: Any) -> str:
    return parameter.name.upper() + (" ..." if parameter.nargs == -1 else "")


def _default(value: Any) -> str:
    if value in (None, False, ""):
        return ""
    return "on" if value is True else f"`{getattr(value, 'value', value)}`"


def scenario_entries() -> str:
    """Return the table of a scenario's entries."""
    lines = ["| entry | default | meaning |", "|---|---|---|"]
    for name, section in Scenario.model_fields.items():
        models = MANY.get(name, {name: section.annotation})
        for place, model in models.items():
            if isinstance(model, type) and issubclass(model, BaseModel):
                lines += [_entry(f"{place}.{entry}", field) for entry, field in model.model_fields.items()]
    return "\n".join(lines) + "\n"


MANY: dict[str, dict[str, type[BaseModel]]] = {
    "wires": {"wires.N": WireSection},
    "components": {"components.NAME": ComponentSection},
    "animation": {"animation.N": BodySection},
    "signals": {f"signals.N ({kind})": model for kind, model in KINDS_OF_SIGNALS.items()},
}
"""Entries of which a scenario may have several, and how they are named."""


def _entry(name: str, field: FieldInfo) -> str:
    default = {} if field.default_factory else field.default
    text = "required" if field.is_required() else "none" if default is None else str(default)
    return f"| `{name}` | {text} | {_plain(field.description or '')} |"


def fault_kinds() -> str:
    """Return the table of a simulated device's faults."""
    lines = ["| kind | value | without a duration |", "|---|---|---|"]
    for kind, (value, duration, text) in KINDS.items():
        default = "" if value is None else f"; {value:g} if none is given"
        lasting = {0.0: "one sample", math.inf: "for ever"}.get(duration, f"{duration:g} s")
        lines.append(f"| `{kind}` | {text}{default} | {lasting} |")
    return "\n".join(lines) + "\n"


def metrics() -> str:
    """Return the table of metrics: names in files and options, symbols, units."""
    lines = ["| metric | unit | in files and options | |", "|---|---|---|---|"]
    for q in QUANTITIES.values():
        lines.append(f"| {_plain(q.symbol)} | {q.unit} | `{q.name}` | {_plain(q.meaning)} |")
    return "\n".join(lines) + "\n"


SHOWN = {
    "tilt": ("encoders and velocity filter", "IHC, a_min 0.88 as in the paper"),
    "tilt_kalman": ("encoders and Kalman filter", "IHC, a_min 0.5, exact norm, semi-implicit"),
    "tilt_ideal": ("ideal sensors", "IHC, a_min 0.2"),
    "disturbed": ("encoders, velocity filter, disturbance of G = 60", "IHC, a_min 0.88"),
}
"""The scenarios that the pages show: what is measured with, and which IHC it is."""

COLUMNS = ("settling_time", "integral_q2", "steady_rms", "energy", "voltage_variation")


def comparison(name: str, about: dict[str, Any]) -> str:
    """Return the table of a comparison, from its comparison.json."""
    chain, ihc = SHOWN[name]
    count = about["draws"]
    drawn = f", {count} draws" if count > 1 else ""
    headings = [f"`{name}`: {chain}{drawn}", *(QUANTITIES[c].heading for c in COLUMNS)]
    lines = [f"| {' | '.join(map(_plain, headings))} |", "|---" * len(headings) + "|"]

    def estimate(pair: list[float | None]) -> MeanEstimate:
        return MeanEstimate(*(math.nan if value is None else value for value in pair))

    for law, found in about["laws"].items():
        mark = "" if found["steady"] else "*"
        cells = [
            estimate_text(estimate(found[c]), QUANTITIES[c].text) + (mark if QUANTITIES[c].of_window else "")
            for c in COLUMNS
        ]
        lines.append(f"| {ihc if law == 'IHC' else law} | {' | '.join(cells)} |")
    for law, found in about["change"].items():
        lines.append(f"| {law} over LC | {' | '.join(change_text(estimate(found[c])) for c in COLUMNS)} |")
    return "\n".join(lines) + "\n"


def compared(page: Path, results: Path) -> str:
    """Return a page's text with the tables of the comparisons in `results` that it shows."""
    text = page.read_text(encoding="utf-8")
    for name in SHOWN:
        if START.format(f"comparison {name}") in text:
            about = json.loads((results / name / "comparison.json").read_text(encoding="utf-8"))
            text = _between(text, f"comparison {name}", comparison(name, about))
    return text


def _plain(text: str) -> str:
    return text.replace("|", "\\|")


def _with_table(page: str, mark: str, table: str) -> str:
    """Return the page's text with the table between its marks."""
    return _between((DOCS / page).read_text(encoding="utf-8"), mark, table)


def _between(text: str, mark: str, table: str) -> str:
    start = START.format(mark)
    head, rest = text.split(start)
    return f"{head}{start}\n{table}\n{END}{rest.split(END, 1)[1]}"


def rendered() -> dict[Path, str]:
    """Return each file's whole text, as it should be."""
    return {
        DOCS / "variables.md": variables(),
        DOCS / "command_line.md": command_line(),
        DOCS / "scenarios.md": _with_table("scenarios.md", "scenario entries", scenario_entries()),
        DOCS / "metrics.md": _with_table("metrics.md", "metrics", metrics()),
        DOCS / "hil.md": _with_table("hil.md", "fault kinds", fault_kinds()),
    }


def main() -> int:
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, help="folder of the comparisons; none: their tables stay as they are")
    parser.add_argument("--examples", action="store_true", help="run the examples for benefit.md")
    given = parser.parse_args()
    files = rendered() | ({} if given.results is None else {page: compared(page, given.results) for page in COMPARED})
    if given.examples:
        from example_table import tables  # noqa: PLC0415 - beside this file, and heavy

        files[DOCS / "benefit.md"] = _with_table("benefit.md", "examples", tables())
    for path, text in files.items():
        path.write_text(text, encoding="utf-8")
        print(path.name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
