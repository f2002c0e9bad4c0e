"""What `region` and `tune --pareto` have left is read as they wrote it; a file that is not so is a sentence."""

import math
import re

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.explore.study_files import read_front, read_region
from cosim.scenario import load_scenario
from cosim.studies.journal import Journal
from cosim.studies.numbers import PURPOSE
from cosim.studies.ranges import Range
from cosim.studies.region import RegionProblem, region
from cosim.studies.region_files import save
from tests.cosim.explore.studied import write_front, write_region


@pytest.mark.parametrize("axes", [("plant.delta_0",), ("plant.delta_0", "plant.theta_0")])
def test_what_region_leaves_is_read_as_it_was_found(axes, fmus, tmp_path):
    scenario, folder = load_scenario("tilt_ideal")
    scenario = scenario.changed({"run.duration": 2.0, "evaluate.tolerance": 0.1})
    over = {name: Range(-0.7, 0.7) for name in axes}
    problem = RegionProblem(scenario, folder, fmus, over, ["LC"], 2, 4 if len(axes) == 2 else 8)
    with Journal(tmp_path / "runs.sqlite", PURPOSE) as journal:
        found = region(problem, journal)
    save(found, tmp_path)
    read = read_region(tmp_path)
    assert read is not None
    assert [(axis.name, axis.unit, axis.low) for axis in read.axes] == [(name, "rad", -0.7) for name in axes]
    law = found.laws["LC"]
    if len(axes) == 2:
        np.testing.assert_array_equal(read.settling["LC"], law.settling_map)
    else:
        starts, times = read.settling["LC"]
        assert starts == pytest.approx([found.at(point)[0] for point in sorted(law.cells.known)])
        assert list(times[~np.isnan(times)]) == [law.settling[point] for point in sorted(law.settling)]
    assert read.ball is not None
    assert found.certified.section is not None
    assert np.ptp(read.ball[:, 0]) == pytest.approx(2.0 * found.certified.section.extent[0], rel=1e-2)
    assert read.scenario == scenario.model_dump(mode="json")


def test_a_front_is_its_points_with_what_they_set(tmp_path):
    write_front(tmp_path)
    front = read_front(tmp_path)
    assert front is not None
    assert (front.objectives, front.names) == (["settling_time", "energy"], ["a_min", "b_max", "u_max"])
    assert [(p.kind, p.chosen, dict(p.values)) for p in front.points[:2]] == [
        ("LC", False, {}),
        ("front", True, {"a_min": 0.4, "b_max": 1.5, "u_max": 2.0}),
    ]
    assert [math.isnan(p.objectives[0]) for p in front.points] == [False, False, False, True]


def test_where_there_is_none_none_is_read(tmp_path):
    assert read_region(tmp_path) is None
    assert read_front(tmp_path) is None


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"format": "qube-ihc region 9"}, "format must be qube-ihc region 1, found 'qube"),
        ({"axes": []}, "axes"),
        ({"axes": [{"name": "a", "entry": "b", "low": 1.0, "high": 1.0, "unit": ""}]}, "the axis 'a' must go up"),
        ({"axes": [{"name": "a", "entry": "b", "low": math.nan, "high": 1.0, "unit": ""}]}, "axes.0.low"),
        ({"axes": [{"name": "a", "entry": "b", "low": 10**400, "high": 1.0, "unit": ""}]}, "axes.0.low"),
        ({"cells": {"coarse": 2**20, "finest": 2**20}}, "cells.coarse"),
        ({"cells": {"coarse": 3, "finest": 4}}, "the coarse ones times a power of two"),
        ({"cells": {"coarse": 4, "finest": 8}}, "lacks runs of LC"),
        ({"cells": {"coarse": 1024, "finest": 1024}}, "the start is no point of the map|lacks runs of LC"),
        ({"cells": {"coarse": 2, "finest": 2}}, "line 3: the start is no point of the map"),
        ({"laws": {"IHC": {}}}, "line 2: the law must be one of region.json's, found 'LC'"),
        ({"certified": {"Q": [[1.0, 2.0], [2.0, 1.0]], "centre": [0.0, 0.0]}}, "certified.Q must be symmetric"),
        ({"certified": {"Q": [[1.0], [2.0, 1.0]], "centre": [0.0, 0.0]}}, "certified.Q must be symmetric"),
        ({"certified": {"Q": [], "centre": []}}, "certified.Q must be symmetric"),
    ],
)
def test_a_region_that_is_not_so_is_a_sentence(tmp_path, changes, sentence):
    write_region(tmp_path, **changes)
    with pytest.raises(UserError, match=rf"^{re.escape(str(tmp_path))}.*({sentence})"):
        read_region(tmp_path)


SPOILT = [b"", b"[]", b"null", b"{" * 5000, b"\xff\xfe\x00", b"[" * 100000, b'{"format": 1}', b"9" * 5000]


@pytest.mark.parametrize("content", SPOILT)
def test_files_of_anything_are_sentences(tmp_path, content):
    write_region(tmp_path)
    write_front(tmp_path)
    for name, read in (("region.csv", read_region), ("region.json", read_region), ("front.csv", read_front)):
        before = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(content)
        with pytest.raises(UserError, match=name):
            read(tmp_path)
        (tmp_path / name).write_bytes(before)
    (tmp_path / "region.json").unlink()
    (tmp_path / "region.json").mkdir()
    with pytest.raises(UserError, match=r"region.json cannot be read: Is a directory"):
        read_region(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("front,1", "best,1", "line 3: kind must be one of LC, rule, front"),
        ("0.4,1.5", "nan,1.5", "line 3: a_min must be 0 or of a size from 1e-50 to 1e\\+50, found 'nan'"),
        ("0.4,1.5", "0.4,1,5", "line 3: it must have 17 cells, found 18"),
        ("energy in the search", "energy", "two objectives or more"),
        ("kind,chosen", '"kind,chosen', "is no CSV"),
        ("kind,chosen", "chosen,kind", "has no column|kind must be one of"),
        (",draws", ",drawn", "has no column 'draws'"),
        ("1.7,1.7", "1.7,never", "line 2: settling_time must be a number, found 'never'"),
    ],
)
def test_a_front_that_is_not_so_is_a_sentence(tmp_path, old, new, sentence):
    write_front(tmp_path)
    text = (tmp_path / "front.csv").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "front.csv").write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(UserError, match=sentence):
        read_front(tmp_path)


def test_starts_and_times_that_are_no_numbers_are_sentences(tmp_path):
    write_region(tmp_path)
    path = tmp_path / "region.csv"
    text = path.read_text(encoding="utf-8")
    for old, new in (("-1.0,-8.0", "-1.0,x"), ("attracted,0.5", "attracted,"), ("LC,,-1.0,-8.0", "LC,,-1e308,-8.0")):
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        with pytest.raises(UserError, match=r"region.csv, line \d+"):
            read_region(tmp_path)
