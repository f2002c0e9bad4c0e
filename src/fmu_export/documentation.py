"""What travels inside an FMU for people: a page on what it is, its variables and its unit's notes, and the licences."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from .origin import Origin
from .variables import Interface, Value, Variable

_STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:.2rem .6rem;border-bottom:1px solid #ccc}"
    "pre{background:#f4f4f4;padding:1rem;overflow:auto}"
)


LICENSES = "documentation/licenses"


def documents(
    interface: Interface,
    start: Mapping[str, Value],
    notes: str,
    origin: Origin,
    licenses: Mapping[str, tuple[str, bytes]],
) -> dict[str, bytes]:
    """Return the files of the FMU's documentation by name: the page, the licence of its origin, and `licenses` of others.

    The latter map a file name to what it is for and its text.
    """
    others = "".join(f"{name}: the licence of {what}\n" for name, (what, _) in licenses.items())
    files = {f"{LICENSES}/{name}": text for name, (_, text) in licenses.items()}
    if origin.license_text:
        head = f"{interface.name} is under the licence below; it holds parts of others.\n{others}\n"
        files[f"{LICENSES}/license.txt"] = head.encode() + origin.license_text
    files["documentation/index.html"] = documentation(interface, start, notes).encode()
    return files


def documentation(interface: Interface, start: Mapping[str, Value], notes: str) -> str:
    """Return the page; `notes` is HTML that goes between the description and the variables."""
    groups = (
        ("Inputs", interface.of("input")),
        ("Outputs", interface.of("output")),
        ("Parameters", interface.of("parameter")),
    )
    sections = "".join(f"<h2>{title}</h2>\n{_table(variables, start)}\n" for title, variables in groups)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(interface.name)}</title>'
        f"<style>{_STYLE}</style></head>\n<body><h1>{escape(interface.name)}</h1>\n"
        f"<p>{escape(interface.description)}. FMI 2.0 for co-simulation; the default communication step is "
        f"{interface.default_step(start):g} s.</p>\n{notes}\n{sections}</body></html>\n"
    )


def _table(variables: tuple[Variable, ...], start: Mapping[str, Value]) -> str:
    rows = "\n".join(
        f"<tr><td><code>{escape(v.name)}</code></td><td>{escape(v.unit)}</td><td>{_start(v, start)}</td>"
        f"<td>{v.variability if v.causality == 'parameter' else ''}</td><td>{escape(v.description)}</td></tr>"
        for v in variables
    )
    return f"<table><tr><th>name</th><th>unit</th><th>start</th><th></th><th>description</th></tr>\n{rows}</table>"


def _start(variable: Variable, start: Mapping[str, Value]) -> str:
    value = start.get(variable.name)
    if value is None:
        return ""
    if variable.items:
        return escape(variable.items[int(value) - 1])
    return str(value).lower() if isinstance(value, bool) else f"{value:.10g}"
