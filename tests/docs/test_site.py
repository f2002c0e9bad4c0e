"""The site: it is built without a warning, every public name is on it, and nothing of it is fetched from a network."""

import importlib
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LISTS = ("index", "tutorial", "how_to", "explanation", "reference")


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda p: p.name)
def test_every_page_is_listed_once(page):
    lists = [(ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8") for name in LISTS]
    items = [item for text in lists for item in re.findall(r"^- \[[^\n]+?\]\(([\w./]+)\)", text, flags=re.MULTILINE)]
    assert items.count(page.name) == (0 if page.name == "index.md" else 1)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site as `make docs` builds it."""
    folder = tmp_path_factory.mktemp("site")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (command,) = re.findall(r"^\t\$\(BIN\)/python (-m sphinx .*)$", makefile, flags=re.MULTILINE)
    moved = command.replace("build/site-cache", str(folder / "cache")).replace("build/site", str(folder / "site"))
    done = subprocess.run([sys.executable, *moved.split()], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "site"


class Fetched(HTMLParser):
    """What a page loads by itself, and the links that it offers."""

    def __init__(self):
        super().__init__()
        self.loaded, self.links = [], []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag == "a":
            self.links.append(values.get("href") or "")
        else:
            self.loaded += [values[name] or "" for name in ("src", "href") if name in values]


def parsed(page):
    fetched = Fetched()
    fetched.feed(page.read_text(encoding="utf-8"))
    return fetched


def test_the_site_needs_no_network(site):
    pages = [*site.glob("*.html"), *site.glob("docs/*.html"), *site.glob("examples/*.html")]
    assert len(pages) > 20
    assert {path for page in pages for path in parsed(page).loaded if re.match("(https?:)?//", path)} == set()
    sheets = [path.read_text(encoding="utf-8") for path in site.rglob("*.css")]
    assert not any(re.search(r"@import[^;]*//|url\(.?https?:", sheet) for sheet in sheets)


def test_the_first_page_leads_to_the_start(site):
    assert (site / "index.html").read_text(encoding="utf-8").count("docs/index.html") == 2


@pytest.mark.parametrize("package", ["ihc_fmu", "cosim"])
def test_every_public_name_is_on_the_site(site, package):
    page = (site / "docs" / f"api_{package}.html").read_text(encoding="utf-8")
    names = getattr(importlib.import_module(package), "__all__", [])
    assert [name for name in names if not name.startswith("__") and f"{name}</span>" not in page] == []


def test_pages_are_grouped_as_the_start_page_lists_them(site):
    header = (site / "docs" / "index.html").read_text(encoding="utf-8").split("</header>")[0]
    titles = re.findall(r'<a class="nav-link nav-internal" href="(\w+)\.html">', header)
    assert list(dict.fromkeys(titles)) == ["five_minutes", *LISTS[1:]]


def test_equations_are_mathml(site):
    for source in (ROOT / "docs").glob("*.md"):
        page = (site / "docs" / f"{source.stem}.html").read_text(encoding="utf-8")
        assert page.count('<div class="equation"><math') == source.read_text(encoding="utf-8").count("\n$$\n") // 2
