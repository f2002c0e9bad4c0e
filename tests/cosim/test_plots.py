"""Figures: files that open, the same bytes for the same result, modes without gaps, no lines across jumps."""

import struct
from itertools import pairwise

import matplotlib.image
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from cosim import plots
from cosim.errors import UserError
from cosim.plots import (
    COLOURS,
    MODE_COLOURS,
    colours,
    mode_colours,
    mode_names,
    mode_spans,
    save_comparison,
    save_figure,
    save_overview,
)
from cosim.results import Result
from ihc_fmu.pendulum.interface import MODES

TIME = np.arange(201) * 0.01


@pytest.fixture
def swing(made_result):
    """A made-up swing-up: the pendulum turns, is captured at 1 s, and the voltage switches."""
    mode = np.where(TIME < 1.0, 2, 3)
    voltage = 3.0 * np.sign(np.sin(9 * TIME))
    norm = np.exp(-3 * TIME) * (TIME > 0.0)  # 0 at first, which a logarithmic axis cannot show
    return made_result(
        TIME,
        np.sin(TIME),
        plant_delta=3.1 - 7.0 * TIME,
        controller_voltage=voltage,
        controller_mode=mode,
        controller_homogeneous_norm=norm,
    )


@pytest.fixture
def figures(monkeypatch):
    """Collect the figures that would be saved, by their file's name."""
    collected = {}

    def collect(figure, path, title):
        collected[path.stem] = figure
        return path

    monkeypatch.setattr(plots, "save_figure", collect)
    return collected


def png_size(path):
    content = path.read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", content[16:24])


def check_picture(path):
    width, height = png_size(path)
    assert 800 <= width <= 1600
    assert 400 <= height <= 1600
    pixels = matplotlib.image.imread(path)
    assert pixels.shape[:2] == (height, width)
    assert len(np.unique(pixels[..., 0])) > 20  # shades of red: something is drawn


def test_the_overview_is_a_picture_and_the_same_bytes_again(swing, tmp_path):
    path = save_overview(swing, tmp_path / "new folder" / "run.png", "title")
    check_picture(path)
    again = save_overview(swing, tmp_path / "again.png", "title")
    assert again.read_bytes() == path.read_bytes()


def test_a_comparison_is_four_pictures_and_the_same_bytes_again(swing, tmp_path):
    results = {"LC": swing, "IHC": swing}
    paths = save_comparison(results, tmp_path / "one", "title")
    assert [p.name for p in paths] == ["angles.png", "norm.png", "voltage.png", "homogeneous_norm.png"]
    for path in paths:
        check_picture(path)
    again = save_comparison(results, tmp_path / "two", "title")
    assert [p.read_bytes() for p in again] == [p.read_bytes() for p in paths]
    assert sorted(p.name for p in (tmp_path / "one").iterdir()) == sorted(p.name for p in paths)


@pytest.mark.parametrize("mode", [1, 4])
def test_a_result_in_a_single_mode_has_its_pictures(made_result, tmp_path, mode):
    result = made_result(TIME, np.cos(TIME), controller_mode=mode)
    assert mode_spans(result) == [(mode, 0.0, 2.0)]
    check_picture(save_overview(result, tmp_path / "run.png", "one"))


def test_a_failed_picture_leaves_the_earlier_one(tmp_path, monkeypatch):
    path = tmp_path / "run.png"
    path.write_bytes(before := b"the earlier one")
    monkeypatch.setattr(Figure, "draw", lambda *_, **__: (_ for _ in ()).throw(MemoryError))
    with pytest.raises(MemoryError):
        save_figure(Figure(), path, "title")
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (before, [path])


@given(st.lists(st.integers(1, 4), min_size=2, max_size=30))
def test_mode_spans_cover_the_whole_time_without_gaps(modes):
    time = np.cumsum(1.0 + np.arange(len(modes)) % 3)
    result = Result(time, {"controller.mode": np.array(modes)}, {}, {})
    spans = mode_spans(result)
    assert (spans[0][1], spans[-1][2]) == (time[0], time[-1])
    for (mode, _, end), (following, start, _) in pairwise(spans):
        assert end == start
        assert mode != following
    starts = [start for _, start, _ in spans]
    assert [spans[i][0] for i in np.searchsorted(starts, time, side="right") - 1] == modes


def test_modes_have_the_controllers_names_and_a_colour_each(made_result):
    assert list(MODE_COLOURS) == list(MODES)
    result = made_result(TIME)
    assert mode_names(result) == dict(enumerate((mode.replace("_", "-") for mode in MODES), start=1))
    assert mode_colours(result) == dict(enumerate(MODE_COLOURS.values(), start=1))
    assert len(set(MODE_COLOURS.values())) == 4


def test_no_line_crosses_a_jump_from_pi_to_minus_pi(swing, figures):
    before = swing["plant.delta"].copy()
    save_overview(swing, plots.Path("run.png"), "title")
    save_comparison({"IHC": swing}, plots.Path(), "title")
    curves = [figures["run"].axes[1].lines[0], figures["angles"].axes[2].lines[0]]
    for curve in curves:
        drawn = np.asarray(curve.get_ydata())
        expected = np.remainder(swing["plant.delta"] + np.pi, 2 * np.pi) - np.pi
        jumps = 1 + np.flatnonzero(abs(np.diff(expected)) > np.pi)
        assert len(jumps) == 2
        assert np.flatnonzero(np.isnan(drawn)).tolist() == jumps.tolist()
        np.testing.assert_allclose(np.delete(drawn, jumps), np.delete(expected, jumps), atol=1e-12)
    assert swing["plant.delta"].tolist() == before.tolist()


def test_held_voltages_are_drawn_as_steps_up_to_their_row(swing, figures):
    save_overview(swing, plots.Path("run.png"), "title")
    save_comparison({"LC": swing}, plots.Path(), "title")
    for curve in (figures["run"].axes[3].lines[0], figures["voltage"].axes[0].lines[0]):
        assert curve.get_drawstyle() == "steps-pre"
        assert np.asarray(curve.get_ydata()).tolist() == swing["controller.voltage"].tolist()


def test_controls_of_all_laws_have_one_scale(swing, figures, made_result):
    save_comparison({"LC": swing, "IHC": made_result(TIME, 0.1, controller_voltage=0.5 + TIME)}, plots.Path(), "title")
    one, other = (axis.get_ylim() for axis in figures["voltage"].axes[:2])
    assert one == other
    assert one[0] < -3.0
    assert one[1] > 3.0


def test_every_law_has_a_curve_and_a_row_of_modes(swing, figures, made_result):
    results = {"LC": swing, "IHC": made_result(TIME, 0.1)}
    save_comparison(results, plots.Path(), "title")
    for name in ("angles", "norm", "homogeneous_norm"):
        legend = figures[name].axes[0].get_legend()
        assert [text.get_text() for text in legend.get_texts()] == ["LC", "IHC"]
    ribbon = figures["norm"].axes[-1]
    assert len(ribbon.collections) == len(mode_spans(swing)) + 1
    assert [label.get_text() for label in ribbon.get_yticklabels()] == ["LC", "IHC"]
    assert (np.asarray(figures["norm"].axes[0].lines[1].get_ydata()) == 0.1).all()


def test_nothing_is_clipped_and_a_zero_is_marked(swing, figures, made_result):
    """A law that converges to 1e-18 is drawn down to there; the axis holds all that is drawn."""
    save_comparison({"LC": swing, "IHC": made_result(TIME, 0.1 * np.exp(-20.0 * TIME))}, plots.Path(), "title")
    axis = figures["norm"].axes[0]
    curve = np.asarray(axis.lines[1].get_ydata())
    np.testing.assert_array_equal(curve, 0.1 * np.exp(-20.0 * TIME))
    assert axis.get_ylim()[0] < curve.min()
    norm = figures["homogeneous_norm"].axes[0]
    drawn = np.asarray(norm.lines[0].get_ydata())
    np.testing.assert_array_equal(np.isnan(drawn), swing["controller.homogeneous_norm"] == 0.0)
    assert [line.get_marker() for line in norm.lines].count("v") == 1
    assert [text.get_text() for text in norm.texts] == ["▾ 0"]


def test_the_end_has_a_panel_of_its_own_and_covers_nothing(swing, figures):
    save_comparison({"LC": swing, "IHC": swing}, plots.Path(), "title")
    for name in ("angles", "norm", "voltage", "homogeneous_norm"):
        assert all(axis.child_axes == [] for axis in figures[name].axes)
        assert all((legend := axis.get_legend()) is None or not legend.get_frame_on() for axis in figures[name].axes)
    whole, end = (np.asarray(figures["angles"].axes[i].lines[0].get_xdata()) for i in (0, 1))
    assert (whole[0], end[0], end[-1]) == (0.0, pytest.approx(1.2), 2.0)


def test_a_law_has_its_colour_everywhere_and_other_names_have_others(swing, figures):
    assert colours(["IHC", "first", "LC", "second"]) | COLOURS == {
        **COLOURS,
        "first": plots.OTHERS[0],
        "second": plots.OTHERS[1],
    }
    assert not set(plots.OTHERS) & set(COLOURS.values())
    for number, law in enumerate(("LC", "SMC", "IHC"), start=1):
        swing.metadata["start_values"] = {"controller": {"law": number}}
        save_overview(swing, plots.Path("run.png"), "title")
        assert figures["run"].axes[0].lines[0].get_color() == COLOURS[law]


def test_encoders_are_drawn_where_the_true_angles_are_missing(made_result, figures):
    result = made_result(TIME, plant_theta_encoder=0.25, plant_delta_encoder=-0.5)
    del result.signals["plant.theta"], result.signals["plant.delta"]
    save_overview(result, plots.Path("run.png"), "title")
    top, second = (np.asarray(figures["run"].axes[i].lines[0].get_ydata()) for i in (0, 1))
    assert (set(top), set(second)) == ({0.25}, {-0.5})


def test_a_result_without_the_signals_is_refused(made_result, tmp_path):
    result = made_result(TIME)
    del result.signals["controller.homogeneous_norm"]
    with pytest.raises(UserError, match=r"no signal 'controller\.homogeneous_norm'"):
        save_overview(result, tmp_path / "run.png", "title")
    assert list(tmp_path.iterdir()) == []
