"""Pages as they are written, and as a browser without a window shows them."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
in_browser = pytest.mark.skipif(BROWSER is None, reason="needs chromium, chromium-browser or google-chrome on the PATH")

VOID = {"area", "base", "br", "col", "embed", "hr", "img", "input", "link", "meta", "source", "track", "wbr"}

POLICY = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')

WATCHED = """<script>
window.keep = (name, value) => parent.postMessage([name, String(value)], "*");
window.onerror = (message) => keep("error", message);
window.onunhandledrejection = (event) => keep("error", event.reason);
console.error = console.warn = (...said) => keep("error", said.join(" "));
window.requestAnimationFrame = (f) => setTimeout(() => f(performance.now()), 16); // virtual time draws few frames
</script>"""

FRAME = """<!doctype html><meta charset="utf-8"><script>
onmessage = ({{ data: [name, value] }}) => document.documentElement.setAttribute(`data-${{name}}`, value);
</script><iframe src="page.html" style="border: 0; width: {width}px; height: 900px"></iframe>"""


class Page(HTMLParser):
    """Collects tags with their attributes and texts; an end tag must close the innermost open one."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.texts, self.wrong = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open[-1] != tag:
            self.wrong.append((tag, self.getpos()))
        else:
            self.open.pop()

    def handle_data(self, data):
        self.texts.append((self.open[-1] if self.open else "", data))

    def all(self, attribute):
        return [attributes[attribute] for _, attributes in self.tags if attribute in attributes]


def check_alone(text):
    """Assert that a page loads nothing, by its tags, its texts and its own policy, and that its tags are closed."""
    page = Page(text)
    assert (page.open, page.wrong) == ([], [])
    assert [tag for tag, _ in page.tags if tag in ("link", "iframe", "object", "embed", "base", "form")] == []
    assert all(source.startswith("data:") for source in page.all("src"))
    assert not [target for target in page.all("href") if ":" in target or target.startswith("/")]
    assert not {"srcset", "action", "poster", "background"} & {name for _, tags in page.tags for name in tags}
    policy = next(tags["content"] for tag, tags in page.tags if tag == "meta" and "http-equiv" in tags)
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-")
    return page


def browse(folder, page, *options):
    """Open `page` in a browser without a window, five virtual seconds long; return what it prints."""
    options = ("--headless=new", "--hide-scrollbars", "--no-sandbox", "--disable-gpu", *options)
    command = [str(BROWSER), f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=5000", *options]
    done = subprocess.run(
        [*command, page.as_uri()], capture_output=True, text=True, timeout=60, check=False, cwd=folder
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def played(folder: Path, text: str, script: str, *options: str, width: int = 1280) -> dict[str, str]:
    """Open a page in a frame of so many pixels, run `script` after its own; return what that keeps by `keep(name, value)`.

    What the page says of errors is kept as "error". Its policy, which would not let the script run, is left out.
    """
    if BROWSER is None:
        pytest.skip("no browser")
    text, count = POLICY.subn("", text)
    assert (count, text.count("<head>"), text.count("</body>")) == (1, 1, 1)
    text = text.replace("<head>", "<head>" + WATCHED).replace("</body>", f"<script>{script}</script></body>")
    (folder / "page.html").write_text(text, encoding="utf-8")
    (folder / "frame.html").write_text(FRAME.format(width=width), encoding="utf-8")
    shown = Page(browse(folder, folder / "frame.html", "--dump-dom", "--window-size=1400,900", *options))
    (root,) = (attributes for tag, attributes in shown.tags if tag == "html")
    return {name.removeprefix("data-"): value for name, value in root.items() if name.startswith("data-")}
