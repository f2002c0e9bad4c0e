"""Regions of attraction: what counts as attracted, against the full grid and single runs; the certified ball; refusals."""

import csv
import json
import math

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.judged_signals import kept_upright
from cosim.metric_meanings import QUANTITIES
from cosim.running import export
from cosim.scenario import Scenario, load_scenario
from cosim.scenario_run import run_scenario
from cosim.studies.certified_section import certified
from cosim.studies.journal import Journal
from cosim.studies.numbers import PURPOSE
from cosim.studies.ranges import Range
from cosim.studies.region import RegionProblem, region
from cosim.studies.region_files import save
from cosim.studies.region_map import Judge
from ihc_fmu.certificate import norm_of
from ihc_fmu.synthesis import synthesize
from ihc_fmu.system import System
from tests.cosim.command import ended, journal_rows, sentence

DELTA, DELTA_DOT = "plant.delta_0", "plant.delta_dot_0"
MAP = {DELTA: Range(-1.0, 1.0), DELTA_DOT: Range(-8.0, 8.0)}
LINE = {DELTA: Range(-1.0, 1.0)}


@pytest.fixture
def find(fmus, tmp_path):
    """Find regions of a built-in scenario of 3 s, with changes."""

    def at(over, name="tilt_ideal", changes=None, **options):
        scenario, folder = load_scenario(name)
        problem = RegionProblem(
            scenario.changed({"run.duration": 3.0, **(changes or {})}), folder, fmus, over, **options
        )
        with Journal(tmp_path / "runs.sqlite", PURPOSE) as journal:
            return region(problem, journal)

    return at


@pytest.fixture(scope="module")
def lever(tmp_path_factory):
    """A folder with an unstable lever's FMUs, its plant also in degrees."""
    folder = tmp_path_factory.mktemp("lever")
    for name, unit, scale in (("lever", "rad", 1.0), ("turned", "deg", 180.0 / math.pi)):
        states = (f"angle [{unit}]", f"rate [{unit}/s]")
        B, K = [[0], [scale]], [[-8 / scale, -4 / scale]]
        system = System(A=[[0, 1], [4, 0]], B=B, K=K, states=states, name=name, lower=[-2], upper=[2])
        export(synthesize(system), folder)
    return folder


def levers(**changes):
    named = {"plant.fmu": "lever_linear_plant.fmu", "controller.fmu": "lever_controller.fmu", "run.duration": 6.0}
    return Scenario().changed({**named, **{name.replace("__", "."): value for name, value in changes.items()}})


# What counts as attracted


def numbers(**changes):
    named = dict.fromkeys(QUANTITIES, 1.0) | {"settling_time": 2.0, "kept": 1.0, "capture_time": 0.001}
    return named | changes


@pytest.mark.parametrize(
    ("run", "outcome"),
    [
        (numbers(), "attracted"),
        (numbers(settling_time=8.999), "attracted"),
        (numbers(settling_time=9.001), "unsettled"),
        (numbers(settling_time=math.nan), "unsettled"),
        (numbers(kept=0.0), "lost"),
        (numbers(capture_time=0.4), "lost"),
        (numbers(capture_time=math.nan), "lost"),
        (numbers(integral_q2=math.inf), "lost"),
        (numbers(energy=math.nan), "lost"),
        ({}, "failed"),
    ],
)
def test_attracted_is_what_settles_under_the_law_from_the_first_sample_on(run, outcome):
    assert Judge(QUANTITIES, 10.0, 0.0025).outcome(run) == outcome


def test_a_pendulum_that_is_swung_up_is_not_attracted_unless_the_supervisor_stays(find):
    over = {DELTA: Range(0.6, 0.7)}
    options = {"name": "tilt_kalman", "changes": {"run.duration": 8.0}, "coarse": 2, "finest": 2, "laws": ("IHC",)}
    opened, left = find(over, **options), find(over, supervisor=True, **options)
    assert set(opened.laws["IHC"].outcomes.values()) == {"lost"}
    assert set(left.laws["IHC"].outcomes.values()) == {"attracted"}
    assert [any("the pendulum's supervisor is open" in said for said in r.remarks()) for r in (opened, left)] == [
        True,
        False,
    ]


# Against the full grid and single runs


def test_the_map_is_that_of_the_full_grid_with_fewer_runs(find):
    found, full = (find(MAP, coarse=coarse, finest=16, laws=("LC",)).laws["LC"] for coarse in (4, 16))
    np.testing.assert_array_equal(found.cells.grid(), full.cells.grid())
    assert len(full.runs) == 17**2
    assert len(found.runs) < 0.75 * 17**2
    assert found.bounds == pytest.approx(full.bounds)
    inner, outer = found.bounds
    assert inner < found.area < outer
    assert np.isfinite(found.settling_map).sum() == pytest.approx(inner / (2.0 / 16 * 16.0 / 16))


def test_on_a_line_the_radius_is_bracketed_by_runs(find, fmus):
    found = find(LINE, "tilt_kalman", {"run.duration": 6.0}, coarse=8, finest=256)
    for law in ("LC", "IHC"):
        line = found.line(law)
        assert line is not None
        within, beyond = line.radius
        assert beyond is not None
        assert beyond - within == pytest.approx(2.0 / 256)
        for delta, kept in ((line.high[0], True), (line.high[1], False)):
            changes = {"plant.start.delta_0": delta, "controller.start.law": law}
            result = run_scenario(load_scenario("tilt_kalman")[0].changed(opened() | changes), fmus)
            assert kept_upright(result) == kept
    assert 0.35 < found.line("LC").radius[0] <= found.line("IHC").radius[0] < 0.45
    assert found.table()[2][0][0] == "LC"


def opened():
    far = {"capture_level": 1e300, "capture_velocity": 1e300, "capture_angle": 0.8, "swing_up_enabled": False}
    return {f"controller.start.{name}": value for name, value in far.items()}


def test_where_the_range_ends_first_it_is_said(find):
    found = find({DELTA: Range(-0.1, 1.0)}, coarse=4, finest=16, laws=("LC",))
    line = found.line("LC")
    assert line is not None
    assert line.low == (-0.1, None)
    assert line.radius == (0.1, None)
    assert found.table()[2][0][1] == "-0.100 or beyond"
    assert "LC: the region goes on beyond plant.delta_0 = -0.1" in found.remarks()


def test_the_same_question_runs_nothing_again_and_a_finer_one_goes_on(find, tmp_path):
    counts = []
    for finest in (16, 16, 64):
        runs = sum(len(law.runs) for law in find(LINE, coarse=8, finest=finest).laws.values())
        counts.append((runs, len(journal_rows(tmp_path / "runs.sqlite"))))
    assert counts == [(22, 22), (22, 22), (30, 30)]


def test_with_draws_attracted_is_what_is_so_in_all_of_them(find):
    found = find({DELTA: Range(0.3, 0.5)}, "tilt", coarse=4, finest=8, laws=("LC",), draws=3).laws["LC"]
    shares = {point: found.share(point) for point in found.cells.known}
    assert found.cells.known == {point: share == 1.0 for point, share in shares.items()}
    assert len(found.runs) == 3 * len(shares)
    assert {round(3 * share) / 3 for share in shares.values()} == set(shares.values())


# Any system


def test_any_system_has_a_region_and_one_of_its_law_s_own_where_it_has_no_choice(lever, tmp_path):
    over = {"plant.angle_0": Range(-1.0, 1.0)}
    with Journal(tmp_path / "runs.sqlite", PURPOSE) as journal:
        found = region(
            RegionProblem(levers(plant__start__angle_0=0.1), None, lever, over, coarse=8, finest=256), journal
        )
        assert list(found.laws) == ["LC", "IHC"]
        line = found.line("LC")
        assert line is not None
        # 4 angle < 2 is all that the limited input can hold at rest
        assert 0.3 < line.radius[0] < 0.5
        alone = levers(controller__fmu="none", evaluate__errors=["plant.angle"], evaluate__tolerance=0.1)
        found = region(RegionProblem(alone, None, lever, over, coarse=2, finest=2), journal)
        assert {law: one.count("attracted") for law, one in found.laws.items()} == {"controller": 1}
        assert found.certified.why_not == "the controller has no design of this project"


@pytest.mark.parametrize(
    ("start", "sentence"),
    [
        (0.0, "the tolerance of |e angle| is a share of its largest in the scenario as it stands, where it is 0; give"),
        (0.9, "the scenario as it stands, by whose errors settling is judged, does not settle itself; give evaluate."),
    ],
)
def test_a_scenario_that_says_no_tolerance_is_refused(lever, tmp_path, start, sentence):
    problem = RegionProblem(levers(plant__start__angle_0=start), None, lever, {"plant.angle_0": Range(-1.0, 1.0)})
    with Journal(tmp_path / "runs.sqlite", PURPOSE) as journal, pytest.raises(UserError) as refusal:
        region(problem, journal)
    assert str(refusal.value).startswith(sentence)


# The certified ball


@pytest.mark.parametrize("others", [(0.0, 0.0), (0.2, 0.1)])
def test_on_the_outline_the_homogeneous_norm_is_1(fmus, design, others):
    scenario, folder = load_scenario("tilt")
    scenario = scenario.changed({"plant.start.theta_0": others[0], "plant.start.theta_dot_0": others[1]})
    section = certified(scenario, fmus, folder, ["plant.start.delta_dot_0", "plant.start.delta_0"]).section
    assert section is not None
    points = section.outline(24)
    norms = [norm_of(design, [others[0], delta, others[1], delta_dot]) for delta_dot, delta in points]
    np.testing.assert_allclose(norms, 1.0, rtol=1e-8)
    middle = section.centre
    assert section.has(middle + 0.999 * (points - middle)).all()
    assert not section.has(middle + 1.001 * (points - middle)).any()
    np.testing.assert_allclose(np.abs(section.outline(3601) - middle).max(axis=0), section.extent, rtol=1e-5)
    assert section.reaches == ()


def test_on_a_line_the_ball_is_an_interval(fmus, design):
    section = certified(*at_tilt(fmus), ["plant.start.delta_0"]).section
    assert section is not None
    assert section.outline(2)[:, 0].tolist() == pytest.approx([-(design.P[1, 1] ** -0.5), design.P[1, 1] ** -0.5])


def at_tilt(fmus, **changes):
    scenario, folder = load_scenario("tilt")
    return scenario.changed({name.replace("__", "."): value for name, value in changes.items()}), fmus, folder


def test_units_of_the_plant_are_those_of_the_axes(lever):
    entries = ["plant.start.angle_0", "plant.start.rate_0"]
    degree = math.pi / 180.0
    wires = [{"source": f"plant.{q}", "target": f"controller.{q}", "factor": degree} for q in ("angle", "rate")]
    wires += [{"source": "controller.u1", "target": "plant.u1"}]
    own, turned = levers(), levers(plant__fmu="turned_linear_plant.fmu", wires=wires)
    plain, other = (certified(scenario, lever, None, entries).section for scenario in (own, turned))
    assert plain is not None
    assert other is not None
    np.testing.assert_allclose(other.extent * degree, plain.extent)


@pytest.mark.parametrize(
    ("changes", "entries", "reason"),
    [
        ({}, ["plant.start.m_p"], "plant.start.m_p sets no state of the design's model"),
        ({"controller__other_model": True}, [DELTA], "controller.other_model lets the design be of another model"),
        ({"controller__start__k_lin_1": 2.1}, [DELTA], "k_lin_1 differs from the design's"),
        ({"controller__start__b_max": 0.9}, [DELTA], "a_min = 0.88 and b_max = 0.9 do not enclose 1"),
        ({"controller__start__theta_setpoint": 0.1}, [DELTA], "the set-point controller.theta_setpoint moves"),
        ({"plant__start__theta_0": 3.0}, [DELTA], "the other states start outside of it"),
    ],
)
def test_where_the_certificate_is_not_about_what_runs_nothing_is_drawn(fmus, changes, entries, reason):
    entries = ["plant.start.delta_0" if entry == DELTA else entry for entry in entries]
    found = certified(*at_tilt(fmus, **changes), entries)
    assert found.section is None
    assert found.why_not.startswith(reason)


# What is written


def test_what_is_written_has_every_run(find, tmp_path):
    found = find(MAP, coarse=4, finest=8)
    paths = save(found, tmp_path / "out")
    assert [path.name for path in paths] == ["region.csv", "region.png", "region.json"]
    with paths[0].open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(len(law.runs) for law in found.laws.values())
    counted = [(law, row["outcome"]) for law in found.laws for row in rows if row["law"] == law]
    assert all(counted.count((law, "attracted")) == one.count("attracted") > 0 for law, one in found.laws.items())
    assert all((row["settled"] != "") == (row["settling_time"] != "") for row in rows)
    data = json.loads(paths[2].read_text())
    assert data["laws"]["IHC"]["area"]["value"] == pytest.approx(found.laws["IHC"].area)
    assert data["certified"]["held"] == {"LC": None, "IHC": None}
    assert sum(" of the map in the certified ball, too few" in said for said in found.remarks()) == 2
    save(found, tmp_path / "out")  # over its own files


# The command


def test_the_command_says_the_radii_and_writes_three_files(elsewhere):
    done = ended(
        "region", "tilt_ideal", "--over", "plant.delta_0=-1..1", "--coarse=8", "--resolution=64", cwd=elsewhere
    )
    assert done.returncode == 0, done.stderr
    assert "tilt_ideal: attracted over plant.delta_0" in done.stdout
    assert "(not 0.4" in done.stdout
    assert "IHC: the region holds all of the certified ball" in done.stdout
    assert [line.split("/")[-1] for line in done.stdout.splitlines() if line.startswith("wrote")] == [
        "region.csv",
        "region.png",
        "region.json",
    ]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["plant.delta_0"], "--over takes ENTRY=LOW..HIGH, found 'plant.delta_0'"),
        (
            ["plant.delta_0=1..-1"],
            "--over plant.delta_0 takes a range LOW..HIGH of finite numbers, LOW below HIGH, found",
        ),
        (["plant.delta_0=0..1", "plant.delta_0=0..2"], "--over takes different entries, found plant.delta_0 twice"),
        (
            ["plant.delta_0=0..1", "plant.start.delta_0=0..2"],
            "a region is over two different entries, found plant.delta_0",
        ),
        (["plant.delta_0=0..1", "plant.theta_0=0..1", "plant.m_p=0..1"], "a region is over one or two entries, found"),
        (["run.foo=0..1"], "tilt: there is no entry run.foo"),
        (["plant.m_p=-1..1"], "plant.m_p must lie in [1e-12, 1e+12] kg, found -1.0"),
        (
            ["controller.law=1..2"],
            "a region is over real numbers, found controller.law, which is of the type Enumeration",
        ),
        (
            ["plant.delta_0=0..1", "--laws=LC,PID"],
            "the laws must be different ones of LC, SMC, IHC, STA, found LC, PID",
        ),
        (
            ["plant.delta_0=0..1", "--coarse=6", "--resolution=16"],
            "the finest cells along an axis must be the coarse ones",
        ),
    ],
)
def test_a_mistake_is_one_sentence_and_leaves_no_file(elsewhere, options, said):
    over = [part for text in options for part in ([text] if text.startswith("--") else ["--over", text])]
    assert sentence(ended("region", "tilt", *over, cwd=elsewhere)).startswith(said)
    assert not (elsewhere / "results").exists()


def test_a_file_of_somebody_else_stays(elsewhere):
    there = elsewhere / "out" / "region.csv"
    there.parent.mkdir()
    there.write_text("mine\n")
    said = sentence(ended("region", "tilt", "--over", "plant.delta_0=0..1", "-o", "out", cwd=elsewhere))
    assert said.startswith("out/region.csv was not written by qube-ihc and stays")
    assert there.read_text() == "mine\n"
