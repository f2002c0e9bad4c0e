"""What all pages have in common: the template, the style, and the rule that nothing is loaded and no other script runs."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import ChoiceLoader, Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from filing.origin import WRITTEN
from fmu_export.files import FilePath

HERE = Path(__file__).parent

CHARTS = ("uplot/uPlot.iife.min.js", "colours.js", "charts.js")
"""Scripts of a page with plots."""
LICENCE = "uplot/LICENSE.txt"
"""Of the first of them, which wants to be in every copy."""
ANIMATION = ("colours.js", "animation.js", "unfold.js")
"""Scripts of a page with the rotary pendulum in motion, and folded parts that links lead to."""


def render(
    template: str, scripts: Iterable[str], styles: Iterable[str] = (), folder: Path = HERE, **context: Any
) -> str:
    """Return a page.

    `template`, in `folder`, extends base.html.j2. `scripts` and `styles` are files beside this module; the browser runs no
    other script (Content-Security-Policy, by their hashes) and loads nothing.
    """
    environment = Environment(
        loader=ChoiceLoader([FileSystemLoader(folder), FileSystemLoader(HERE)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    texts = [_file(name) for name in scripts]
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(t.encode()).digest()).decode()}'" for t in texts)
    return environment.get_template(template).render(
        written=WRITTEN,
        policy=f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {hashes}",
        style=Markup("".join(_file(name) for name in ("style.css", *styles))),
        scripts=[Markup(text) for text in texts],
        **context,
    )


@cache
def _file(name: str) -> str:
    text = (HERE / name).read_text(encoding="utf-8")
    return f"/* uPlot, whose licence is:\n\n{_file(LICENCE)}*/\n{text}" if name == CHARTS[0] else text


def data(contents: Mapping[str, Any]) -> Markup:
    """Return JSON that may stand inside a script element."""
    return Markup(json.dumps(contents, allow_nan=False).replace("<", "\\u003c"))


def link(file: FilePath, page: FilePath) -> tuple[str, str]:
    """Return the path of a file relative to a page's folder, and its address for a link there."""
    relative = Path(os.path.relpath(file, Path(page).parent)).as_posix()
    return relative, quote(relative)
