"""Pages as they are written, and as a browser without a window shows them."""

from __future__ import annotations

import base64
import contextlib
import json
import re
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

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


class Tab:
    """A page in a browser without a window, in real time: told by the DevTools protocol what to do."""

    def __init__(self, folder: Path, address: str, width: int = 1200, height: int = 900, *options: str) -> None:
        if BROWSER is None:
            pytest.skip("no browser")
        from websockets.sync.client import connect

        profile = folder / "profile of a tab"
        options = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", *options)
        sizes = (f"--window-size={width},{height}", "--remote-debugging-port=0", f"--user-data-dir={profile}")
        self.process = subprocess.Popen(
            [BROWSER, *options, *sizes, "about:blank"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self.open = contextlib.ExitStack()
        self.said: list[str] = []
        self.asked: list[str] = []
        self.count = 0
        try:
            port = self._until(lambda: (profile / "DevToolsActivePort").read_text().split()[0], OSError, IndexError)
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=10) as listed:
                target = next(one for one in json.load(listed) if one["type"] == "page")
            self.socket = self.open.enter_context(connect(target["webSocketDebuggerUrl"], max_size=None))
            for domain in ("Page", "Runtime", "Network", "Log"):
                self.do(f"{domain}.enable")
            self.do("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
            self.do("Page.navigate", url=address)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Tab:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the browser with all its processes."""
        with contextlib.suppress(Exception):
            self.do("Browser.close")
            self.process.wait(timeout=10)
            self.open.close()
        self.process.kill()
        self.process.wait(timeout=30)

    def do(self, method: str, **parameters: object) -> dict[str, Any]:
        """Send a command of the protocol; return its result."""
        self.count += 1
        self.socket.send(json.dumps({"id": self.count, "method": method, "params": parameters}))
        while True:
            message = json.loads(self.socket.recv(timeout=60))
            if message.get("id") == self.count:
                assert "error" not in message, message
                return message["result"]
            self._keep(message.get("method"), message.get("params", {}))

    def _keep(self, method: str, parameters: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            self.said.append(str(parameters["exceptionDetails"].get("exception", parameters)))
        elif method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.said.append(parameters["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.asked.append(parameters["request"]["url"])

    def value(self, script: str) -> Any:
        """Return what an expression in the page is, awaited where it is a promise."""
        result = self.do("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait(self, script: str, seconds: float = 30.0) -> Any:
        """Return what an expression in the page is as soon as that is truthy; a page that is being loaded has no value."""
        end = time.monotonic() + seconds
        while True:
            try:
                found = self.value(script)
            except AssertionError as error:
                found, said = None, str(error)
            else:
                said = ""
            if found:
                return found
            assert time.monotonic() < end, (script, said, self.said)
            time.sleep(0.02)

    def click(self, x: float, y: float) -> None:
        """Click at a place of what is seen [CSS px]."""
        for kind in ("mousePressed", "mouseReleased"):
            self.do("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def press(self, key: str, count: int = 1) -> None:
        """Press a key, where the focus is."""
        for _ in range(count):
            for kind in ("rawKeyDown", "keyUp"):
                self.do("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=KEYS[key])

    def picture(self, path: Path) -> None:
        """Write what is seen as a PNG."""
        path.write_bytes(base64.b64decode(self.do("Page.captureScreenshot", format="png")["data"]))

    def _until(self, found: Callable[[], str], *missing: type[Exception]) -> str:
        end = time.monotonic() + 30.0
        while True:
            try:
                return found()
            except missing:
                assert time.monotonic() < end
                assert self.process.poll() is None
                time.sleep(0.05)


KEYS = {"ArrowLeft": 37, "ArrowRight": 39, "Home": 36, "End": 35}
