"""The site: `make docs` builds it from the Markdown pages, and what is reference from the code itself.

The source folder is the project's root, so that links among pages, to examples and to files are the same here and on a Git
host. Nothing of the site is fetched from a network: pictures, fonts, search and mathematics (as MathML) are in its files.
"""

from __future__ import annotations

import importlib.metadata
import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

from notebooks import page  # noqa: E402 - beside this file
from public_names import listing  # noqa: E402 - beside this file

project = "qube-ihc"
author = "The qube-ihc developers"
version = release = importlib.metadata.version("qube-ihc")

root_doc = "docs/index"
include_patterns = ["docs/*.md", "examples/README.md", "examples/notebooks/*.ipynb", "CONTRIBUTING.md", "CHANGELOG.md"]
source_suffix = {".md": "markdown", ".ipynb": "markdown"}
exclude_patterns = [".*", "build", "dist", "results", "fmus", "src", "cosim", "tests", "benchmarks"]
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
napoleon_google_docstring = False
napoleon_use_ivar = True  # attributes in a docstring and in the class are one
default_role = "py:obj"

smartquotes = False  # x' is a derivative

highlight_language = "text"  # what is indented; fenced blocks say their language

nitpicky = True
nitpick_ignore_regex = [
    (r"py:obj", r".*"),  # single backquotes in docstrings: a link where it is a public name, otherwise code
    (
        r"py:.*",
        r"(?!(ihc_fmu|cosim)\.\w+$).*",
    ),  # names in signatures that are not public, or other libraries' (no network)
]

html_theme = "pydata_sphinx_theme"
html_title = "qube-ihc"
html_theme_options = {
    "logo": {"text": "qube-ihc"},
    "navbar_align": "left",
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": [],
    "footer_end": [],
}
html_sidebars = {"docs/index": []}
html_copy_source = False
html_show_sourcelink = False
html_static_path = ["static"]
html_css_files = ["site.css"]
html_additional_pages = {"index": "to_start.html"}
templates_path = ["templates"]
html_math_renderer = "mathml"

LISTS = ("docs/index", "docs/tutorial", "docs/how_to", "docs/explanation", "docs/reference")
"""Pages that list others: the links that begin the items of their lists are the navigation, in that order."""

ITEM = re.compile(r"^- \[[^\n]+?\]\(([^)#\n]+)\.(?:md|ipynb)\)", re.MULTILINE)


def add_navigation(app: Sphinx, docname: str, source: list[str]) -> None:
    """Add the tree of pages to a page that lists them."""
    if docname in LISTS:
        entries = [f"{'' if target.startswith('../') else 'docs/'}{target}" for target in ITEM.findall(source[0])]
        tree = "\n".join("/" + entry.removeprefix("../") for entry in entries)
        source[0] += f"\n```{{toctree}}\n:hidden:\n\n{tree}\n```\n"


def add_notebook(app: Sphinx, docname: str, source: list[str]) -> None:
    """Make a page of a notebook, with the outputs that it holds."""
    if docname.startswith("examples/notebooks/"):
        source[0] = page(source[0])


PUBLIC_NAMES = re.compile(r"^<!-- public names: (\w+) -->$", re.MULTILINE)


def add_public_names(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put the names of a package's `__all__`, with signatures and docstrings, where a page has the mark for them."""
    source[0] = PUBLIC_NAMES.sub(lambda mark: listing(mark[1]), source[0])


NOT_RUN = re.compile(r"  +# not run: [^\n]+$", re.MULTILINE)


def hide_marks(app: Sphinx, docname: str, source: list[str]) -> None:
    """Leave out the marks of commands that no test runs; they are for the tests and for those who read the source."""
    source[0] = NOT_RUN.sub("", source[0])


def shield_bars(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Make |x| in a docstring an absolute value and not a substitution of reStructuredText."""
    lines[:] = [line if line.startswith(("    ", ">>>")) else re.sub(r"(?<!\\)\|", r"\\|", line) for line in lines]


def visit_math(self: Any, node: nodes.math) -> None:
    """Write an equation as MathML; an equation that docutils cannot read is a warning."""
    is_block = isinstance(node, nodes.math_block)
    begin, end = ('<div class="equation">', "</div>") if is_block else ("", "")
    try:
        self.body.append(begin + tex2mathml(node.astext(), as_block=is_block) + end)
    except MathError as error:
        logging.getLogger(__name__).warning("%s", error, location=node)
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Add what this file defines."""
    app.connect("source-read", add_notebook)
    app.connect("source-read", add_navigation)
    app.connect("source-read", add_public_names)
    app.connect("source-read", hide_marks)
    app.connect("autodoc-process-docstring", shield_bars)
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
