"""The page in a browser, served by the command."""

import re
import signal
import time

import pytest

import cosim
from tests.cosim.browser import Tab, in_browser
from tests.cosim.command import started
from tests.cosim.explore.studied import write_front, write_region

NUMBER = "document.querySelector('input[type=number][aria-label=\"{}\"]').value"
A_MIN = "document.querySelector('input[type=range][aria-label=a_min]')"
RESET = "[...document.querySelectorAll('button')].find(one => one.innerText === 'reset').click()"
CELLS = "[...document.querySelectorAll('table.numbers tr')].map(row => [...row.children].map(cell => cell.innerText))"
CURVES = "[...document.querySelectorAll('.plots canvas')].map(canvas => canvas.toDataURL())"
DRAWN = "Number(document.querySelector('.seen')?.dataset.drawn)"


@pytest.fixture(scope="module")
def served(fmus, tmp_path_factory):
    """The command with its page: the process, the address, the folder that it writes to."""
    folder = tmp_path_factory.mktemp("explored")
    write_region(folder / "results" / "region_tilt")
    write_front(folder / "results" / "tune_tilt")
    arguments = ("explore", "tilt", "--set", "run.duration=1", "--fmus", fmus, "--no-browser")
    process = started(*arguments, cwd=folder)
    assert process.stdout is not None
    said = process.stdout.readline()
    assert said.startswith("tilt on http://127.0.0.1:"), said
    yield process, said.split()[2].rstrip(";"), folder
    process.kill()
    process.communicate()


@pytest.fixture(scope="module")
def opened(served, tmp_path_factory):
    """The page in a browser."""
    with Tab(tmp_path_factory.mktemp("browser"), served[1]) as one:
        one.wait(f"{DRAWN} && document.querySelectorAll('.map').length === 2")
        yield one


@pytest.fixture
def tab(opened):
    """The page as it is at first."""
    yield opened
    drawn = opened.value(DRAWN)
    opened.value(RESET)
    opened.wait(f"{DRAWN} > {drawn}")


def moved(tab, key, count=1):
    """Press a key at the slider of a_min; return the table and the curves before and after."""
    before, drawn = (tab.value(CELLS), tab.value(CURVES)), tab.value(DRAWN)
    tab.value(f"{A_MIN}.focus()")
    tab.press(key, count)
    tab.wait(f"{DRAWN} > {drawn}")
    time.sleep(0.3)
    return *before, tab.value(CELLS), tab.value(CURVES)


@in_browser
def test_a_slider_moves_the_curves_and_the_metrics_of_the_ihc(tab):
    cells, curves, other_cells, other_curves = moved(tab, "Home")
    assert cells[0] == ["", "LC", "IHC", "IHC over LC"]
    assert [row[1] for row in cells] == [row[1] for row in other_cells]  # the LC has no a_min
    assert [row[2] for row in cells[1:4]] != [row[2] for row in other_cells[1:4]]
    assert len(curves) == 4
    assert all(a != b for a, b in zip(curves, other_curves, strict=True))
    assert tab.value("document.querySelector('input[aria-label=a_min][type=number]').value") == "0.05"
    assert (tab.said, [url for url in tab.asked if not url.startswith(("http://127.0.0.1:", "data:"))]) == ([], [])


@in_browser
def test_a_click_in_the_map_moves_the_initial_state_and_the_curves(tab):
    curves, drawn = tab.value(CURVES), tab.value(DRAWN)
    left, top, width, height = tab.value(
        "(box => [box.left, box.top, box.width, box.height])(document.querySelector('.map .frame').getBoundingClientRect())"
    )
    tab.click(left + 0.6 * width, top + 0.25 * height)
    tab.wait(f"{DRAWN} > {drawn}")
    assert float(tab.value(NUMBER.format("delta_0 [rad]"))) == pytest.approx(0.2, abs=0.02)
    assert float(tab.value(NUMBER.format("delta_dot_0 [rad/s]"))) == pytest.approx(4.0, abs=0.2)
    assert all(a != b for a, b in zip(curves, tab.value(CURVES), strict=True))
    cross = tab.value("document.querySelector('.map .cross').getAttribute('transform')")
    assert [float(n) for n in re.findall(r"[\d.]+", cross)] == pytest.approx([50 + 0.6 * 180, 8 + 0.25 * 160], abs=2.0)


@in_browser
def test_a_click_on_a_point_of_the_front_sets_its_parameters(tab):
    left, top = tab.value(
        "(box => [box.left + box.width / 2, box.top + box.height / 2])"
        "(document.querySelector('.point[aria-label^=chosen] path').getBoundingClientRect())"
    )
    tab.click(left + 3, top - 3)
    tab.wait(f"{NUMBER.format('a_min')} === '0.4'")
    assert [tab.value(NUMBER.format(name)) for name in ("b_max", "scale of P [V]")] == ["1.5", "2"]
    tab.wait("!!document.querySelector('.point[aria-label^=chosen] .now')")


@in_browser
def test_two_pages_have_settings_of_their_own(tab, served, tmp_path):
    moved(tab, "Home")
    (tmp_path / "other").mkdir()
    with Tab(tmp_path / "other", served[1]) as other:
        other.wait(DRAWN)
        assert other.value(f"{A_MIN}.value") == "0.05"  # a page begins with what was set last
        moved(other, "End")
        assert tab.value(f"{A_MIN}.value") == "0.05"
        before, _, after, _ = moved(tab, "ArrowRight", 40)
        assert other.value(f"{A_MIN}.value") == "1"
        assert [row[2] for row in before[1:4]] != [row[2] for row in after[1:4]]
        assert [row[2] for row in other.value(CELLS)[1:4]] == [
            row[1] for row in other.value(CELLS)[1:4]
        ]  # a_min 1: the LC


@in_browser
def test_a_law_can_be_taken_away_and_what_is_set_survives_a_reload(tab):
    moved(tab, "Home")
    tab.value("document.querySelector('[role=checkbox][aria-label=LC]').click()")
    tab.wait(f"{CELLS}[0].length === 2")
    assert tab.value("document.querySelectorAll('.legend')[0].innerText").split() == ["arm", "θ"]
    tab.value("window.before = true")
    tab.do("Page.reload")
    tab.wait(f"!window.before && {DRAWN} && {CELLS}[0]?.join() === ',IHC'")
    assert tab.value(f"{A_MIN}.value") == "0.05"
    tab.value("document.querySelector('[role=checkbox][aria-label=LC]').click()")
    tab.wait(f"{CELLS}[0].length === 4")


@in_browser
def test_what_is_written_runs(tab, served, fmus):
    _, _, folder = served
    moved(tab, "Home")
    tab.value("[...document.querySelectorAll('button')].find(one => one.innerText === 'write scenario').click()")
    said = tab.wait("document.querySelector('[role=status]').innerText")
    assert said.startswith(f"wrote {folder / 'tilt_explored.toml'}; it runs by: qube-ihc run tilt_explored.toml")
    metrics = cosim.evaluate(cosim.run(folder / "tilt_explored.toml", fmus=fmus))
    assert f"{metrics.integral_q2:.4g}" in [row[2] for row in tab.value(CELLS)]


def typed(tab, name, text):
    """Type into the field of a number, and leave it."""
    tab.value(f"document.querySelector('input[aria-label=\"{name}\"][type=number]').focus()")
    tab.value("document.execCommand('selectAll')")
    tab.do("Input.insertText", text=text)
    tab.value("document.activeElement.blur()")


@in_browser
def test_a_value_that_is_refused_is_a_sentence_on_the_page(tab):
    for name, text, sentence in (
        ("a_min", "-1", "controller.a_min must lie in [1e-06, 1e+12], found -1.0"),
        ("mu", "1.5", "mu must lie in (0, 1], found 1.5"),
    ):
        typed(tab, name, text)
        assert tab.wait("document.querySelector('[role=alert]').innerText").startswith(sentence)
        tab.value(RESET)
        tab.wait(f"document.querySelector('[role=alert]').innerText === '' && {NUMBER.format(name)} !== '{text}'")


@in_browser
def test_what_is_no_number_is_taken_back(tab):
    before = tab.value(NUMBER.format("a_min"))
    for text in ("NaN", "1e", "1e999", "-1e300"):
        typed(tab, "a_min", text)
        tab.wait(f"{NUMBER.format('a_min')} === '{before}'")


@in_browser
def test_a_run_that_takes_long_is_said_to_be_computed(tab):
    drawn = tab.value(DRAWN)
    typed(tab, "duration [s]", "900")
    tab.wait("document.querySelector('.seen.earlier .note').innerText === 'computing …'")
    tab.wait(f"{DRAWN} > {drawn} && !document.querySelector('.seen.earlier')")


@in_browser
def test_the_page_fits_a_telephone_and_every_field_has_a_name(served, tmp_path):
    with Tab(tmp_path, served[1], 390, 844) as opened:
        opened.wait(DRAWN)
        assert opened.value("document.documentElement.scrollWidth") == 390
        named = "one.ariaLabel || one.labels.length || one.closest('[aria-hidden=true]')"
        unnamed = f"[...document.querySelectorAll('input')].filter(one => !({named})).length"
        assert opened.value(unnamed) == 0


def test_ctrl_c_ends_it_well(served):
    process, _, _ = served
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (0, "", "")
