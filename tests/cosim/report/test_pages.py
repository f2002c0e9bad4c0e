"""Pages of runs and comparisons: whole, alone, readable on a telephone and in the dark; what foreign files say is text."""

import json
import re

import numpy as np
import pytest

import cosim
from cosim.errors import UserError
from cosim.results import Result
from tests.cosim.browser import Page, browse, check_alone, in_browser, played

HOSTILE = '</script><script>window.keep("error", "ran")</script><img src=x onerror=\'keep("error", "ran")\'>'
CART = {"name": "cart", "shape": "cart", "size": 0.2, "x": "controller.u"}
ROD = {"name": HOSTILE, "shape": "rod", "size": 0.5, "on": "cart", "angle": f"plant.{HOSTILE}"}
DARK = "--blink-settings=preferredColorScheme=0"

PLAY = """
const button = (text) => [...document.querySelectorAll(".toolbar button")].find((one) => one.textContent === text);
const shown = () => document.querySelector(".toolbar output").textContent;
document.querySelectorAll("details").forEach((part) => { part.open = true; });
const slider = document.querySelector(".animation input.time");
slider.value = 0.3;
slider.dispatchEvent(new Event("input"));
keep("sought", document.querySelector(".animation").dataset.time);
keep("resources", performance.getEntriesByType("resource").length);
setTimeout(() => {
  keep("plots", document.querySelectorAll(".uplot").length);
  keep("width", document.documentElement.scrollWidth);
  keep("page", getComputedStyle(document.body).backgroundColor);
  const [name] = document.querySelectorAll(".legend button");
  const canvas = document.querySelector(".uplot canvas");
  const before = canvas.toDataURL();
  name.click();
  button("zoom in").click();
  keep("pressed", name.getAttribute("aria-pressed"));
  keep("shown", shown());
  const over = document.querySelector(".u-over");
  const { left, top, width } = over.getBoundingClientRect();
  for (const [kind, part] of [["mousemove", 0.25], ["mousedown", 0.25], ["mousemove", 0.75], ["mouseup", 0.75]]) {
    const at = { clientX: left + part * width, clientY: top + 20, bubbles: true, button: 0, movementX: 1 };
    (kind === "mouseup" ? document : over).dispatchEvent(new MouseEvent(kind, at));
  }
  setTimeout(() => {
    keep("drawn", canvas.toDataURL() !== before);
    keep("dragged", shown());
    const touch = (kind, pointerId, part) => over.dispatchEvent(new PointerEvent(kind, {
      pointerType: "touch", pointerId, clientX: left + part * width, clientY: top + 20, bubbles: true,
    }));
    for (const [kind, finger, part] of [["down", 1, 0.25], ["down", 2, 0.75], ["move", 1, 0], ["move", 2, 1]]) {
      touch(`pointer${kind}`, finger, part);
    }
    keep("pinched", shown());
    keep("read", [...document.querySelectorAll(".legend output")].some((one) => one.textContent !== ""));
    URL.createObjectURL = (blob) => { blob.text().then((text) => keep("saved", text)); return "#"; };
    document.querySelector("[data-download]").click();
  }, 300);
}, 600);
"""


@pytest.fixture(scope="session")
def comparison(fmus):
    return cosim.compare("tilt", changes={"run.duration": 0.5}, fmus=fmus, draws=2)


@pytest.fixture(scope="session")
def compared(comparison, tmp_path_factory):
    """The page of a comparison, in its folder."""
    folder = tmp_path_factory.mktemp("compared")
    comparison.save(folder)
    return comparison.report(folder / "report.html", notes=["a note"], folder=folder)


@pytest.fixture(scope="module")
def page_of_run(tmp_path_factory):
    """The page of a run of somebody else's FMUs, whose names are scripts."""
    time = np.arange(4001) * 1e-3
    signals = {f"plant.{HOSTILE}": np.sin(time), "controller.u": np.cos(time)}
    signals["controller.norm"] = np.where(time < 3.9, 10.0 ** (-15.0 * time), 0.0)  # down to 1e-58
    evaluation = {"errors": [{"signal": f"plant.{HOSTILE}", "unit": HOSTILE, "label": HOSTILE}]}
    evaluation["controls"] = [{"signal": "controller.u", "unit": "N"}]
    metadata = {
        "scenario": {"name": "run", "description": HOSTILE, "animation": [CART, ROD]},
        "evaluation": evaluation | {"norm": "controller.norm"},
        "messages": {"plant": [HOSTILE]},
        "step": 1e-3,
    }
    run = Result(time, signals, {f"plant.{HOSTILE}": HOSTILE, "controller.u": "N"}, metadata)
    folder = tmp_path_factory.mktemp("a run")
    run.save(folder / "run.csv")
    return run.report(folder / "pages" / "run.html", notes=[HOSTILE], table=folder / "run.csv")


def test_the_page_of_a_run_is_alone_and_says_everything_as_text(page_of_run):
    page = check_alone(page_of_run.read_text(encoding="utf-8"))
    assert sum(tag == "script" for tag, _ in page.tags) == 6  # uPlot, three of its own, and the data of both
    assert not any(tag == "img" for tag, _ in page.tags)
    assert [text for tag, text in page.texts if tag == "h1"] == [HOSTILE]
    assert [text for tag, text in page.texts if tag == "li" and HOSTILE in text] == [HOSTILE, f"plant: {HOSTILE}"]
    assert "../run.csv" in page.all("href")
    assert "On the lower edge, where it is 0 or below 1e-16: ‖x‖_d." in [text for _, text in page.texts]
    assert [tags["aria-label"] for _, tags in page.tags if tags.get("class") == "plot"][1] == (
        "controller.u [N] over time; controller.u: from 1 to -0.654 N, between -1 and 1 N"
    )


def test_the_page_of_a_comparison_has_its_tables_remarks_and_links(comparison, compared):
    page = check_alone(compared.read_text(encoding="utf-8"))
    cells = [text for tag, text in page.texts if tag in ("td", "th")]
    for _, headings, rows in comparison.tables():
        assert {*filter(None, headings), *(cell for row in rows for cell in row)} <= set(cells)
    paragraphs = {text for tag, text in page.texts if tag in ("p", "li")}
    assert {*comparison.remarks(), "a note"} <= paragraphs
    links = [target for target in page.all("href") if not target.startswith("#")]
    assert links == ["LC.csv", "SMC.csv", "IHC.csv"]
    assert all((compared.parent / link).is_file() for link in links)


def test_the_same_run_gives_the_same_page(comparison, compared):
    again = compared.with_name("again.html")
    assert comparison.report(again, notes=["a note"], folder=compared.parent) == again
    different = compared.read_text(encoding="utf-8").replace("report_", "again_")
    assert again.read_text(encoding="utf-8") == different


def test_a_design_is_shown_with_its_certificate(comparison, design, tmp_path):
    run = comparison.results["IHC"]
    page = Page(run.report(tmp_path / "run.html", design=design).read_text(encoding="utf-8"))
    cells = [text for tag, text in page.texts if tag in ("td", "th")]
    assert {cell for row in design.summary() for cell in row} <= set(cells)


def test_a_run_without_rows_has_a_page_too(tmp_path):
    page = Result(np.zeros(0), {}, {}, {}).report(tmp_path / "nothing.html")
    check_alone(page.read_text(encoding="utf-8"))


def test_pages_replace_pages_only(comparison, tmp_path):
    mine = tmp_path / "mine.html"
    mine.write_text("<p>mine</p>", encoding="utf-8")
    with pytest.raises(UserError, match="was not written by qube-ihc and stays"):
        comparison.report(mine)
    assert mine.read_text(encoding="utf-8") == "<p>mine</p>"
    with pytest.raises(UserError, match=r"a report goes into a file named \*.html, found .*mine.txt"):
        comparison.results["LC"].report(tmp_path / "mine.txt")


# In a browser


@in_browser
def test_the_page_of_a_run_can_be_played_with_on_a_telephone_in_the_dark(page_of_run, tmp_path):
    text = page_of_run.read_text(encoding="utf-8")
    seen = played(tmp_path, text, PLAY, DARK, width=390)
    assert seen.get("error") is None
    assert (seen["width"], seen["resources"], seen["page"]) == ("390", "0", "rgb(20, 24, 29)")
    assert int(seen["plots"]) == len(re.findall('<figure class="chart"', text))
    assert (seen["pressed"], seen["drawn"], seen["read"]) == ("false", "true", "true")
    assert seen["sought"] == "0.300"
    assert seen["shown"] == "shown: 1 to 3 s"
    for act, limits in (("dragged", [1.5, 2.5]), ("pinched", [1.75, 2.25])):
        assert [float(word) for word in seen[act].split()[1:4:2]] == pytest.approx(limits, abs=0.02)  # a pixel
    rows = seen["saved"].strip().splitlines()
    assert len(rows) == 4002
    assert [float(value) for value in rows[2].split(",")[:1]] == [1e-3]


@in_browser
def test_the_page_of_a_comparison_fits_a_telephone(compared, tmp_path):
    seen = played(tmp_path, compared.read_text(encoding="utf-8"), PLAY, width=390)
    assert seen.get("error") is None
    assert (seen["width"], seen["resources"], seen["page"]) == ("390", "0", "rgb(255, 255, 255)")
    assert (seen["pressed"], seen["drawn"]) == ("false", "true")


@in_browser
def test_its_own_scripts_run_under_its_policy(compared, tmp_path):
    shown = Page(browse(tmp_path, compared, "--dump-dom"))
    assert sum(tags.get("class", "").startswith("uplot") for _, tags in shown.tags) > 1
    (found,) = (text for tag, text in shown.texts if tag == "script" and text.startswith('{"tables"'))
    assert json.loads(found)["tables"][0]["file"] == "report_LC_plotted.csv"
