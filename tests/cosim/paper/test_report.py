"""A whole study, tiny: its files, the same again, one page that needs nothing else, and that page in a browser."""

import base64
import csv
import fcntl
import json
import math
import pickle
import re
import shlex
import shutil
from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from matplotlib.image import imread

from cosim.paper import figures, report
from cosim.paper.claims import Judge
from cosim.paper.report import EXPERIMENT_NAMES, make
from cosim.paper.study import COMPARED, GAINS, REFERENCE, Key, Study, numbers
from cosim.paper.verdicts import Claim
from cosim.pendulum_export import export_units
from cosim.report.motion import FRAME
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.pendulum.paper_system import paper_system
from tests.cosim.browser import Page, browse, check_alone, in_browser, played
from tests.cosim.command import journal_rows

FIGURES = [f"figure_{n}.png" for n in (3, 4, 5, 6)] + ["shares.png", "chattering.png", "swing_ups.png"]
TABLES = [
    *("main_claims", "claims", "table_1", "energy", "table_2", "shares", "lmse_readings", "onset", "swing_ups"),
    *("printed_k", "printed_P", "chattering", "controllers"),
]


class Made(NamedTuple):
    """The study, what `make` returned, what it reported, and the bytes of its files then."""

    study: Study
    claims: list[Claim]
    reported: list[tuple[str, int, int]]
    files: dict[str, bytes]


def contents(folder):
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.fixture(scope="module")
def made(tmp_path_factory, worker_id, fmus, tiny_size):
    """The study, made once for all processes of the test run: the others wait for the one that comes first."""
    shared = tmp_path_factory.getbasetemp()
    shared = shared if worker_id == "master" else shared.parent
    known = shared / "made.pickle"
    with (shared / "made.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not known.exists():
            reported = []
            claims = make(Study(shared / "made" / "paper", fmus, tiny_size), lambda *counts: reported.append(counts))
            known.write_bytes(pickle.dumps((fmus, claims, reported, contents(shared / "made" / "paper"))))
    fmus, *rest = pickle.loads(known.read_bytes())
    return Made(Study(shared / "made" / "paper", fmus, tiny_size), *rest)


def table(made, name):
    return list(csv.DictReader(made.files[f"{name}.csv"].decode().splitlines()))


def text_keys(row):
    return Key(
        row["experiment"], row["parameters"], float(row["step"]), int(row["gain"]), row["variant"], int(row["draw"])
    )


@pytest.fixture(scope="module")
def found(made):
    """The numbers of every run, read from runs.csv."""
    rows = table(made, "runs")
    return {text_keys(row): {n: float(v) for n, v in row.items() if n not in Key._fields} for row in rows}


# Files


def test_all_files_are_there_and_no_other(made):
    expected = {"report.html", "runs.csv", "runs.sqlite", *FIGURES}
    expected |= {f"{name}.{suffix}" for name in TABLES for suffix in ("csv", "md")}
    designs = {f"scenarios/{name}" for name in made.study.designs}
    keys = made.study.keys()["reference"]
    expected |= designs | {f"scenarios/{made.study.scenario(key).name}.toml" for key in keys}
    assert made.files.keys() == expected
    assert all(made.files.values())


def test_figures_are_pictures_with_something_on_them(made):
    for name in FIGURES:
        picture = imread(made.study.folder / name)
        assert min(picture.shape[:2]) > 100, name
        assert picture[..., :3].std() > 0.02, name


def test_the_journal_has_every_run_once(made):
    digests = [digest for digest, _ in journal_rows(made.study.folder / "runs.sqlite")]
    assert len(set(digests)) == len(digests) == sum(map(len, made.study.keys().values()))


def test_progress_counts_every_experiment_to_its_end(made):
    totals = {EXPERIMENT_NAMES[name]: len(keys) for name, keys in made.study.keys().items()}
    totals["tables, figures, report"] = 4
    assert list(dict.fromkeys(what for what, _, _ in made.reported)) == list(totals)
    for what, total in totals.items():
        assert [counts for name, *counts in made.reported if name == what] == [[i, total] for i in range(total + 1)]


def test_the_table_of_runs_is_what_running_gives(made, found):
    keys = made.study.keys()
    assert list(found) == [key for some in keys.values() for key in some]
    study = made.study
    for key in (keys["reference"][1], keys["tilt"][0], keys["chattering"][-1]):
        result = run_scenario(study.scenario(key), study.fmus, study.scenarios)
        assert found[key] == pytest.approx(numbers(result), rel=0, abs=0, nan_ok=True)


def test_the_claims_are_judged_from_the_table_of_runs(made, found):
    judged = Judge(found).claims()
    rows = table(made, "claims")
    assert [(c.section, c.text, c.verdict) for c in made.claims] == [
        (row["section"], row["claim"], row["verdict"]) for row in rows
    ]
    np.testing.assert_array_equal([c.ours for c in made.claims], [float(row["ours"]) for row in rows])
    assert [str(c) for c in judged] == [str(c) for c in made.claims[: len(judged)]]
    assert {c.section for c in made.claims[len(judged) :]} == {"Model and design"}
    assert table(made, "main_claims") == [row for row, c in zip(rows, made.claims, strict=True) if c.main]
    assert any(c.share is not None and c.share.draws for c in made.claims)


def test_every_claim_of_the_report_has_a_verdict_and_a_text_of_its_own(made):
    assert {c.verdict for c in made.claims} <= {"holds", "does not hold", "undecided"}
    assert len({(c.section, c.text) for c in made.claims}) == len(made.claims)


def test_claims_without_draws_are_what_is_known(made):
    verdicts = {c.text.partition(":")[0]: c.verdict for c in made.claims if c.section == "Model and design"}
    assert verdicts["a_min = b_max = 1 is the LC"] == "holds"
    assert verdicts["eq. (11) has a solution at the printed α"] == "holds"
    assert verdicts["some reading of the printed k stabilizes A, b"] == "does not hold"
    assert verdicts["some reading of the printed P solves eq. (11)"] == "does not hold"
    (alpha,) = (c.ours for c in made.claims if "α" in c.text)
    assert alpha == pytest.approx(0.2715, abs=1e-3)


def test_tables_one_and_two_have_the_reference_runs(made, found):
    rows = table(made, "table_1") + table(made, "table_2")
    assert [(int(row["gain"]), row["controller"]) for row in rows] == [(gain, v) for gain in GAINS for v in COMPARED]
    for row in rows:
        key = Key("reference", *REFERENCE, int(row["gain"]), row["controller"], 0)
        assert float(row["ours"]) == found[key]["integral_q2"]
        assert int(row["draws"]) == made.study.size.draws


def test_a_saved_scenario_repeats_its_row_of_the_tables(made, found):
    for gain, variant in ((0, "LC"), (200, "IHC, KF"), (60, "SMC1")):
        key = Key("reference", *REFERENCE, gain, variant, 0)
        path = made.study.scenarios / f"{made.study.scenario(key).name}.toml"
        scenario, folder = load_scenario(str(path))
        assert numbers(run_scenario(scenario, made.study.fmus, folder)) == pytest.approx(found[key], rel=0, nan_ok=True)


# The same again


@pytest.fixture
def pictures_drawn_before(made, monkeypatch):
    """Take the pictures of the first time: drawing them takes longer than the runs, and they are not compared."""

    def copied(folder, *_):
        for name in FIGURES:
            if folder != made.study.folder:
                shutil.copy(made.study.folder / name, folder)

    monkeypatch.setattr(figures, "save_all", copied)


@pytest.mark.usefixtures("pictures_drawn_before")
def test_made_again_in_its_folder_nothing_is_run_and_all_is_the_same(made):
    reported = []
    claims = make(made.study, lambda *counts: reported.append(counts))
    assert contents(made.study.folder) == made.files  # the journal, the CSVs and the page
    assert [str(c) for c in claims] == [str(c) for c in made.claims]
    runs = [counts for what, *counts in reported if what in EXPERIMENT_NAMES.values()]
    assert runs == [[len(keys)] * 2 for keys in made.study.keys().values()]  # all known from the start


@pytest.mark.usefixtures("pictures_drawn_before")
def test_made_in_a_fresh_folder_by_one_worker_the_numbers_are_the_same(made, tmp_path):
    fresh = Study(tmp_path / "paper", made.study.fmus, made.study.size, workers=1)
    make(fresh)
    files = contents(fresh.folder)
    assert files.keys() == made.files.keys()
    for name in files:
        if name not in ("runs.sqlite", "report.html"):  # in the order in which runs finished; names the FMUs' folder
            assert files[name] == made.files[name], name
    command = re.compile(rb"<pre>qube-ihc run [^<]*</pre>")
    assert command.sub(b"", files["report.html"]) == command.sub(b"", made.files["report.html"])
    assert sorted(journal_rows(fresh.folder / "runs.sqlite")) == sorted(journal_rows(made.study.folder / "runs.sqlite"))


# The page


@pytest.fixture(scope="module")
def page(made):
    return Page(made.files["report.html"].decode())


def test_the_page_needs_no_other_file(made):
    text = made.files["report.html"].decode()
    page = check_alone(text)
    assert Counter(tag for tag, _ in page.tags)["html"] == 1
    text = re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]+", "", text)
    wanted = r"https?://|file:|@import|url\(|fetch\(|XMLHttpRequest|WebSocket|\bimport[ (]"
    assert re.findall(wanted, text) == []


def test_every_table_has_its_file_beside_the_page(made, page):
    beside = [target for target in page.all("href") if not target.startswith("#")]
    assert sorted(beside) == sorted(f"{name}.csv" for name in TABLES)
    assert set(beside) <= made.files.keys()


def test_images_are_the_figures(made, page):
    images = [attributes for tag, attributes in page.tags if tag == "img"]
    prefix = "data:image/png;base64,"
    assert all(image["src"].startswith(prefix) for image in images)
    inside = [base64.b64decode(image["src"].removeprefix(prefix), validate=True) for image in images]
    assert sorted(inside) == sorted(made.files[name] for name in FIGURES)
    texts = [image["alt"] for image in images]
    assert len(set(texts)) == len(texts)
    assert not any(".png" in text for text in texts)


def test_links_lead_to_places_on_the_page_and_ids_are_unique(page):
    ids = page.all("id")
    assert len(set(ids)) == len(ids)
    assert all(ids)
    assert not any(re.search(r"\s", name) for name in ids)
    targets = {target[1:] for target in page.all("href") if target.startswith("#")}
    assert targets <= set(ids)
    assert {"movie", "figure-3", "table-i", "chattering", "assumptions", "scenarios"} <= targets


def test_every_claim_and_verdict_is_on_the_page(made, page):
    cells = [data for tag, data in page.texts if tag == "td"]
    for claim in made.claims:
        assert claim.text in cells
    verdicts = [attributes["class"] for tag, attributes in page.tags if tag == "td" and "class" in attributes]
    shown = Counter(c.verdict for c in made.claims)
    counts = re.findall(r'<li><b class="[a-z-]+">(\d+)</b> ([a-z ]+)</li>', made.files["report.html"].decode())
    assert {verdict: int(count) for count, verdict in counts} == {**dict.fromkeys(dict(shown), 0), **shown}
    for verdict, count in shown.items():
        assert verdicts.count(f"verdict {verdict.replace(' ', '-')}") >= count


def test_every_claim_links_the_scenarios_of_its_runs(made, page):
    details = {attributes["id"] for tag, attributes in page.tags if tag == "details" and "id" in attributes}
    assert details == {made.study.scenario(key).name for claim in made.claims for key in claim.runs}
    linked = Counter(target.removeprefix("#") for target in page.all("href"))
    expected = Counter(made.study.scenario(key).name for c in made.claims for key in c.runs * (2 if c.main else 1))
    assert {name: linked[name] for name in expected} == expected


def test_the_scenarios_on_the_page_are_the_files_beside_it(made, page):
    on_page = {data for tag, data in page.texts if tag == "pre"}
    for claim in made.claims:
        for key in claim.runs:
            name = made.study.scenario(key).name
            assert made.files[f"scenarios/{name}.toml"].decode() in on_page


def test_every_table_is_on_the_page_with_its_rows(made, page):
    tables = [attributes["id"] for tag, attributes in page.tags if tag == "table"]
    assert sorted(tables) == sorted(f"table-{name}" for name in TABLES)
    rows = sum(len(table(made, name)) + 1 for name in TABLES)
    assert [tag for tag, _ in page.tags].count("tr") == rows


def test_the_animation_has_the_samples_of_the_runs(made, page):
    """The runs of the scenario files, every 20 ms, rounded as they are written."""
    (text,) = (data for tag, data in page.texts if tag == "script" and data.startswith("{"))
    data = json.loads(text, parse_constant=pytest.fail)
    assert (data["step"], data["voltage_limit"]) == (FRAME, 10)
    assert [run["name"] for run in data["runs"]] == ["LC", "IHC"]
    for run in data["runs"]:
        scenario = made.study.scenario(Key("reference", *REFERENCE, 0, run["name"], 0))
        result = run_scenario(scenario, made.study.fmus, made.study.scenarios)
        rows = slice(None, None, round(FRAME / scenario.run.step))
        assert result.time[rows] == pytest.approx(FRAME * np.arange(501))
        assert run["theta"] == pytest.approx(result["plant.theta"][rows], abs=0.5001e-5)
        assert run["delta"] == pytest.approx(result["plant.delta"][rows], abs=0.5001e-5)
        assert run["voltage"] == pytest.approx(result["controller.voltage"][rows], abs=0.5001e-3)
        assert run["mode"] == result["controller.mode"][rows].tolist()


def test_what_the_printed_P_does_depends_on_no_exported_design(made, tmp_path):
    """Everything else in a study names its design, so that FMUs exported from another one change nothing."""
    export_units(inverse_design(paper_system(), Options(mu=0.5, alpha=0.2, u_max=1.5)), output=tmp_path)
    _, runs = report._theory(replace(made.study, fmus=tmp_path))
    rows = table(made, "printed_k") + table(made, "printed_P")
    found = {row["reading"]: float(row["steady_rms"]) for row in rows if row["kept"] == "True"}
    assert len(found) == 7
    assert {name: runs[name]["steady_rms"] for name in found} == found


def test_the_command_that_repeats_a_run_names_folders_that_exist(made, page):
    (command,) = (data for tag, data in page.texts if tag == "pre" and data.startswith("qube-ihc run"))
    parts = shlex.split(command)
    folder = made.study.folder
    assert (folder / parts[2]).parent == made.study.scenarios
    assert (folder / parts[parts.index("--fmus") + 1]).resolve() == made.study.fmus.resolve()


# The page in a browser

AFTER = """(() => {
  const root = document.getElementById("animation");
  const [slider, button, speed] = ["input.time", "button.play", "select"].map((what) => root.querySelector(what));
  const seek = (t) => { slider.value = t; slider.dispatchEvent(new Event("input")); };
  const shown = () => [...root.querySelectorAll(".facts dd, .mode")].map((element) => element.textContent).join("; ");
  keep("begin", root.dataset.time);
  keep("first", shown());
  seek(3);
  keep("sought", root.dataset.time);
  keep("third", shown());
  seek(99);
  keep("beyond", root.dataset.time);
  seek(3);
  button.click();
  keep("pressed", root.dataset.state);
  setTimeout(() => {
    keep("played", root.dataset.time);
    button.click();
    keep("paused", root.dataset.state);
    const paused = root.dataset.time;
    setTimeout(() => {
      keep("still", root.dataset.time === paused);
      seek(9.5);
      speed.value = 2;
      button.click();
      setTimeout(() => {
        keep("end", root.dataset.time);
        keep("ended", root.dataset.state);
        location.hash = document.querySelector("td a").getAttribute("href");
        setTimeout(() => keep("unfolded", document.querySelector("details:target")?.open), 100);
      }, 1500);
    }, 300);
  }, 1000);
})();"""


@pytest.fixture(scope="module")
def seen(made, tmp_path_factory):
    """What is kept of the page after it has been played with."""
    return played(tmp_path_factory.mktemp("browser"), made.files["report.html"].decode(), AFTER)


@in_browser
def test_the_scripts_run_without_an_error(seen):
    assert seen.get("error") is None
    assert seen["begin"] == "0.000"


@in_browser
def test_the_slider_goes_to_a_moment_of_the_run(seen):
    assert (seen["sought"], seen["beyond"]) == ("3.000", "10.000")


@in_browser
def test_the_numbers_shown_are_those_of_the_runs(made, seen):
    """Mode, both angles [°] and the voltage of LC and IHC, at the beginning and after 3 s; hanging is ±180°."""
    for name, row in (("first", 0), ("third", 30_000)):
        shown = seen[name].replace("−", "-").split("; ")
        for law, (mode, *facts) in {"LC": shown[:4], "IHC": shown[4:]}.items():
            scenario = made.study.scenario(Key("reference", *REFERENCE, 0, law, 0))
            result = run_scenario(scenario, made.study.fmus, made.study.scenarios)
            assert mode == {1: "idle", 2: "swing-up", 3: "stabilizing"}[int(result["controller.mode"][row])]
            theta, delta, voltage = (float(re.sub("[^0-9.-]", "", number)) for number in facts)
            assert theta == pytest.approx(np.degrees(result["plant.theta"][row]), abs=0.0511)
            assert math.remainder(delta - np.degrees(result["plant.delta"][row]), 360.0) == pytest.approx(
                0.0, abs=0.0511
            )
            assert voltage == pytest.approx(result["controller.voltage"][row], abs=0.0056)


@in_browser
def test_playing_advances_the_time_as_fast_as_the_clock_and_stops_when_paused(seen):
    assert (seen["pressed"], seen["paused"], seen["still"]) == ("playing", "paused", "true")
    assert 3.5 < float(seen["played"]) < 4.1


@in_browser
def test_playing_ends_at_the_end_of_the_run(seen):
    assert (seen["end"], seen["ended"]) == ("10.000", "paused")


@in_browser
def test_a_link_to_a_scenario_unfolds_it(seen):
    assert seen["unfolded"] == "true"


@in_browser
def test_the_scripts_run_under_the_pages_own_policy(made, tmp_path):
    shown = Page(browse(tmp_path, made.study.folder / "report.html", "--dump-dom"))
    assert [tags["data-state"] for _, tags in shown.tags if tags.get("id") == "animation"] == ["paused"]


@in_browser
def test_verdicts_are_in_view_on_a_telephone_in_the_dark(made, tmp_path):
    seen = played(
        tmp_path,
        made.files["report.html"].decode(),
        """document.querySelectorAll("details").forEach((part) => { part.open = true; });
        const right = (all) => Math.max(...[...all].map((element) => element.getBoundingClientRect().right));
        keep("width", document.documentElement.scrollWidth);
        keep("right", right(document.querySelectorAll("td.verdict")));
        keep("page", getComputedStyle(document.body).backgroundColor);""",
        "--blink-settings=preferredColorScheme=0",
        width=390,
    )
    assert seen["width"] == "390"
    assert 0 < float(seen["right"]) <= 390
    assert seen["page"] == "rgb(20, 24, 29)"
