"""The command line: help, one whole chain, refusals, failures."""

import csv
import importlib.metadata
import json
import math
import os
import pydoc
import re
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cosim.__main__ import main as entry_point
from cosim.fmu_files import describe
from cosim.metric_meanings import QUANTITIES
from cosim.metrics import evaluate
from cosim.results import Result
from cosim.scenario import Scenario
from cosim.scenario_run import run_scenario
from ihc_fmu.design import Design
from ihc_fmu.pendulum.interface import LAWS
from ihc_fmu.sliding_mode import linear_pole_smc
from tests.cosim.browser import Page, check_alone
from tests.cosim.command import ended, files, finished, sentence, started

OPTIONS = {
    "design": [
        "--system",
        "--method",
        "--mu",
        "--alpha",
        "--u-max",
        "--delta-max",
        "--beta",
        "--psi",
        "--d-max",
        "--residual",
        "-o",
    ],
    "export": ["--design", "--parameters", "--nominal", "--smc", "--output", "-o", "--set"],
    "run": ["--output", "-o", "--fmus", "--set", "--plot", "--no-plot", "--report", "--report-file"],
    "compare": ["--laws", "--draws", "--workers", "--output", "-o", "--fmus", "--set", "--report", "--report-file"],
    "demo": ["--output", "-o", "--fmus"],
}
SHORT = ("--set", "run.duration=0.3")


def accepted(*args, cwd):
    done = ended(*args, cwd=cwd)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip() == ""
    return done.stdout


def accepted_with_notes(*args, cwd):
    done = ended(*args, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


def refused(*args, cwd, code=2):
    """Return the one sentence that the command says before it ends with `code`."""
    return sentence(ended(*args, cwd=cwd), code)


# Help


@pytest.mark.parametrize("command", OPTIONS)
def test_help_names_every_option(tmp_path, command):
    text = accepted(command, "--help", cwd=tmp_path)
    missing = [option for option in OPTIONS[command] if not re.search(rf"(?<![\w-]){option}\b", text)]
    assert missing == []
    assert files(tmp_path) == []


def test_without_arguments_there_is_help(tmp_path):
    shown = ended(cwd=tmp_path)
    text = accepted("-h", cwd=tmp_path)
    assert shown.returncode in (0, 2)
    for command in OPTIONS:
        assert re.search(rf"\b{command}\b", shown.stdout + shown.stderr)
        assert re.search(rf"\b{command}\b", text)


def test_a_process_of_its_own_is_the_same_program(tmp_path):
    done = finished(started("--version", cwd=tmp_path))
    said = f"qube-ihc {importlib.metadata.version('qube-ihc')}\n"
    assert (done.returncode, done.stdout, done.stderr) == (0, said, "")
    assert accepted("--version", cwd=tmp_path) == said
    assert finished(started("walk", cwd=tmp_path)).returncode == 2


# The chain


def test_direct_design_tells_its_control(tmp_path):
    said = accepted("design", "--method", "direct", "--alpha", "1", "--u-max", "10", cwd=tmp_path)
    design = Design.load(tmp_path / "design.json")
    most = float(np.sqrt((design.K @ np.linalg.solve(design.P, design.K.T)).item()))
    assert f"on the unit ball |voltage| <= {most:.4g} V; any alpha has a solution" in " ".join(said.split())
    assert "largest feasible" not in said


def test_a_system_with_the_pendulums_name_that_is_none_is_told_that_the_name_is_why(tmp_path):
    system = "A = [[0, 1, 0], [0, 0, 1], [0, 0, 0]]\nb = [0, 0, 1]\nk_lin = [-6, -11, -6]\n"
    (tmp_path / "rotary_pendulum.toml").write_text(system, "utf-8")
    said = (
        "the rotary pendulum's controller takes designs of 4 states and 1 input, found 3 and 1; without the name "
        "rotary_pendulum the system is exported for itself"
    )
    designed = ended("design", "--system", "rotary_pendulum.toml", "-o", "mine.json", cwd=tmp_path)
    assert (designed.returncode, " ".join(designed.stderr.split())) == (0, f"note: export will refuse this: {said}")
    assert refused("export", "--design", "mine.json", cwd=tmp_path) == said


def test_design_export_run_compare(tmp_path):
    wanted = ("--mu", "0.5", "--alpha", "0.3", "--u-max", "3", "--residual", "0.8")
    said = accepted("design", *wanted, "-o", "my design.json", cwd=tmp_path)
    assert re.search(
        r"what counting leaves with a_min = 0.8\s.*theta_dot \[rad/s\].*the bound is proven: ", said, re.DOTALL
    )
    assert re.search(r"largest feasible alpha for this gain and mu: 0\.43\d* 1/s", said)
    design = Design.load(tmp_path / "my design.json")
    assert (design.mu, design.alpha, design.u_max[0]) == (0.5, 0.3, pytest.approx(3.0, rel=1e-4))

    options = ("--design", "my design.json", "--smc", "linear-poles", "--set", "controller.a_min=0.7")
    said = accepted("export", *options, cwd=tmp_path)
    fmus = ["fmus/IhcController.fmu", "fmus/QubeServo2.fmu", "fmus/QubeWithController.ssp"]
    assert files(tmp_path / "fmus") == [name.removeprefix("fmus/") for name in fmus]
    assert all(f"wrote {name}" in said for name in fmus)
    variables = describe(tmp_path / fmus[0]).modelVariables
    sliding = linear_pole_smc(design.A, design.b, design.k_lin)
    exported = {
        v.name: float(v.start or "nan") for v in variables if v.name.startswith(("smc_", "mu", "k_lin", "a_min"))
    }
    assert (exported["mu"], exported["a_min"]) == (0.5, 0.7)
    for name, row in (("smc_c", sliding.c), ("smc_k", sliding.k_eq), ("k_lin", design.k_lin)):
        assert [exported[f"{name}_{i}"] for i in (1, 2, 3, 4)] == row.tolist()

    said = accepted("run", "tilt", *SHORT, "--set", "run.seed=7", cwd=tmp_path)
    assert files(tmp_path / "results") == ["tilt.csv", "tilt.json", "tilt.png"]
    result = Result.load(tmp_path / "results" / "tilt.csv")
    assert (len(result.time), result.metadata["complete"], result.metadata["messages"]) == (301, True, {})
    assert result.metadata["scenario"]["run"]["seed"] == 7
    for name, value in evaluate(result).as_dict().items():
        q = QUANTITIES[name]
        assert re.search(rf"^  {re.escape(q.symbol)} +{re.escape(q.text(value))}( |\\*|$)", said, re.MULTILINE), name
    assert "* no steady state can be told: the run is shorter than 3 s" in said

    options = ("--draws", "1", "--laws", "IHC, LC", "--workers", "1", "-o", "compared", "--report")
    said = accepted("compare", "tilt", *SHORT, *options, cwd=tmp_path)
    pictures = ["angles.png", "homogeneous_norm.png", "norm.png", "voltage.png"]
    tables = ["IHC.csv", "IHC.json", "LC.csv", "LC.json", "comparison.csv", "comparison.json"]
    assert files(tmp_path / "compared" / "tilt") == sorted([*tables, *pictures, "report.html"])
    rows = list(csv.DictReader((tmp_path / "compared" / "tilt" / "comparison.csv").open(encoding="utf-8")))
    assert [(row["law"], row["draw"]) for row in rows] == [("IHC", "1"), ("LC", "1")]
    assert re.search(r"│ settling \[s\] +│ +never │ +never │", said)
    assert re.search(
        r"│ ∫\|q\|² dt \[rad² s\] +│ +" + " │ +".join(f"{float(r['integral_q2']):.4g}" for r in rows), said
    )
    assert "* not steady: |q| of IHC, LC has a trend over the last 3 s, or the run is shorter" in said


def test_results_are_compared_side_by_side(elsewhere):
    for name, a_min in (("first", "0.88"), ("second", "0.5")):
        change = ("--set", f"controller.start.a_min={a_min}")
        accepted("run", "tilt", *SHORT, *change, "--no-plot", "-o", f"{name}.csv", cwd=elsewhere)
    said = accepted("compare", "first.csv", "second.csv", "-o", "pictures", "--report-file", "both.html", cwd=elsewhere)
    page = Page((elsewhere / "both.html").read_text(encoding="utf-8"))
    assert {"first.csv", "second.csv"} <= set(page.all("href"))
    assert files(elsewhere / "pictures" / "compared") == [
        f"{n}.png" for n in ("angles", "homogeneous_norm", "norm", "voltage")
    ]
    energies = [evaluate(Result.load(elsewhere / f"{name}.csv")).energy for name in ("first", "second")]
    assert energies[0] != energies[1]
    assert re.search(rf"∫V² dt \[V² s\] +│ +{energies[0]:.4g} │ +{energies[1]:.4g} │", said)


def test_a_report_is_written_beside_its_table_or_where_it_is_wanted(elsewhere):
    mu = ("--set", "controller.start.mu=0.3")
    said = accepted_with_notes("run", "tilt", *SHORT, *mu, "--no-plot", "--report", cwd=elsewhere)
    assert "wrote results/tilt.html" in said
    page = check_alone((elsewhere / "results" / "tilt.html").read_text(encoding="utf-8"))
    assert "tilt.csv" in page.all("href")
    notes = [text for tag, text in page.texts if tag == "li" and "certificate" in text]
    assert notes == ["mu differs from the design's: its certificate does not cover it"]
    assert "decrease" in str([text for tag, text in page.texts if tag == "th"])
    said = accepted("run", "tilt", *SHORT, "--no-plot", "--report-file", "pages/mine.html", cwd=elsewhere)
    assert "removed results/tilt.html, the report of an earlier run" not in said
    said = accepted("run", "tilt", *SHORT, "--no-plot", cwd=elsewhere)
    assert "removed results/tilt.html, the report of an earlier run" in said
    assert files(elsewhere / "results") == ["tilt.csv", "tilt.json"]
    (elsewhere / "pages" / "mine.html").write_text("mine", encoding="utf-8")
    stays = refused("run", "tilt", *SHORT, "--report-file", "pages/mine.html", "-o", "new.csv", cwd=elsewhere)
    assert stays.startswith("pages/mine.html was not written by qube-ihc and stays")
    assert not (elsewhere / "new.csv").exists()


def test_a_run_is_the_same_again_and_knows_where_to_write(elsewhere):
    for name in ("first", "second"):
        accepted("run", "tilt_ideal", *SHORT, "--no-plot", "-o", f"new folder/{name}.csv", cwd=elsewhere)
    folder = elsewhere / "new folder"
    assert files(folder) == ["first.csv", "first.json", "second.csv", "second.json"]
    for suffix in (".csv", ".json"):
        assert (folder / f"first{suffix}").read_bytes() == (folder / f"second{suffix}").read_bytes()


def test_a_scenario_file_with_its_own_design_and_another_folder_of_fmus(elsewhere, design_file):
    design_file("mine.json")
    (elsewhere / "fmus").rename(elsewhere / "other fmus")
    (elsewhere / "mine.toml").write_text('[run]\nduration = 0.01\n[controller]\ndesign = "mine.json"\n', "utf-8")
    accepted("run", "mine.toml", "--fmus", "other fmus", "--no-plot", cwd=elsewhere)
    about = Result.load(elsewhere / "results" / "mine.csv").metadata
    assert about["start_values"]["controller"]["k_lin_2"] == -30.0


# Refusals


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("run", "nowhere.toml"), "scenario file nowhere.toml does not exist"),
        (("run", "tilt", "--fmus", "nowhere"), "FMU nowhere/IhcController.fmu does not exist; `qube-ihc export`"),
        (("compare", "tilt", "--fmus", "nowhere"), "FMU nowhere/IhcController.fmu does not exist; `qube-ihc export`"),
        (("run", "tilt", "--report-file", "a.pdf"), "a report goes into a file named *.html, found a.pdf"),
        (("run", "tilt", "--set", "run.duration"), "--set takes NAME=VALUE, found 'run.duration'"),
        (("run", "tilt", "--set", "run.durration=1"), "tilt: there is no entry run.durration; did you mean duration?"),
        (("run", "tilt", "--set", "run.step=nan"), "tilt: run.step must be a finite number, found nan"),
        (("run", "tilt", "--set", "run.duration=-1"), "tilt: run.duration must be greater than 0, found -1"),
        (("run", "tilt", "--set", "plant.start.delta_0=nan"), "plant.delta_0 must be finite, found nan"),
        (("run", "tilt", "--set", "plant.start.m_p=-1"), "plant.m_p must lie in [1e-12, 1e+12] kg, found -1"),
        (
            ("run", "tilt", "--set", "controller.start.lwa=LC"),
            "controller has no variable named 'lwa'; did you mean law",
        ),
        (
            ("run", "tilt", "--set", "controller.start.law=PID"),
            f"controller.law must be one of {', '.join(LAWS)}, found 'PID'",
        ),
        (("compare", "tilt", "--laws", "LC,LC"), f"--laws must be different ones of {', '.join(LAWS)}, found 'LC,LC'"),
        (("compare", "tilt", "swing_up"), "compare takes one scenario, or results (*.csv), found tilt, swing_up"),
        (("compare", "a.csv", "tilt"), "compare takes one scenario, or results (*.csv), found a.csv, tilt"),
        (("compare", "a.csv", "a.csv"), "results to compare must be different files, found a.csv, a.csv"),
        (("compare", "a.csv"), "result file a.csv does not exist"),
        (("run", "tilt", "--set", "controller.start.j_max=nan"), "controller.j_max must be finite, found nan"),
        (("run", "tilt", "--set", "controller.start.j_max=inf"), "controller.j_max must be finite, found inf"),
        (
            ("run", "tilt", "--set", "plant.start.m_p=[1]"),
            "tilt: plant.start.m_p must be a number, true, false or a name, found [1]",
        ),
        (("export", "--set", "plant.m_p=[1]"), "m_p must be a number, found [1]"),
        (("export", "--design", "nowhere.json"), "design file nowhere.json does not exist"),
        (("export", "--set", "a_min=1"), "--set must name plant.VARIABLE or controller.VARIABLE, found 'a_min'"),
        (("export", "--set", "plant.delta_0=inf"), "delta_0 must be finite, found inf"),
        (("design", "--system", "nowhere.toml"), "system file nowhere.toml does not exist"),
        (("design", "--residual", "0"), "a_min must lie in [1e-06, 1e+12], found 0"),
        (("design", "--mu", "nan"), "mu must lie in (0, 1], found nan"),
        (("design", "--alpha", "-1"), "alpha must be positive and finite [1/s], found -1.0"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_a_mistake_is_one_sentence(fmus, tmp_path, arguments, sentence):
    if arguments[0] in ("run", "compare") and "--fmus" not in arguments:
        arguments = (*arguments, "--fmus", str(fmus))
    assert refused(*arguments, cwd=tmp_path).startswith(sentence)
    assert files(tmp_path) == []


@pytest.mark.parametrize(
    "arguments", [("run", "tilt", "--durration", "1"), ("compare", "tilt", "--draws", "-1"), ("walk",)]
)
def test_a_wrong_flag_ends_with_code_2(tmp_path, arguments):
    done = ended(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert arguments[-2 if len(arguments) > 1 else -1] in done.stderr
    assert "Traceback" not in done.stderr
    assert files(tmp_path) == []


def test_an_infeasible_alpha_names_the_largest_feasible_one(tmp_path):
    said = refused("design", "--mu", "0.5", "--alpha", "0.6", cwd=tmp_path)
    found = re.search(
        r"alpha = 0\.6 1/s is too large .*, the largest feasible one is ([\d.]+) 1/s with mu = 0\.5", said
    )
    assert found
    assert float(found.group(1)) == pytest.approx(0.437, abs=1e-3)
    assert files(tmp_path) == []


def test_ten_integrators_are_designed_and_exported(tmp_path):
    """What is not given is chosen and explained; both FMUs are named after the file."""
    rows = [[float(j == i + 1) for j in range(10)] for i in range(10)]
    gain = [-float(math.comb(10, i)) for i in range(10)]
    (tmp_path / "ten.toml").write_text(f"A = {rows}\nb = {[0.0] * 9 + [1.0]}\nk_lin = {gain}\n", "utf-8")
    said = accepted("design", "--system", "ten.toml", "-o", "ten.json", cwd=tmp_path)
    assert re.search(r"chosen: alpha = 0\.01\d* 1/s: half of the largest", said)
    accepted("export", "--design", "ten.json", cwd=tmp_path)
    assert files(tmp_path / "fmus") == ["ten.ssp", "ten_controller.fmu", "ten_linear_plant.fmu"]
    quiet = ("--set", "run.duration=0.01", "--no-plot")
    beside = ("--set", "controller.start.K_1_1=-2", "--set", "controller.start.P_1_1=1e9")
    for options, note in (
        (
            (),
            "nothing moved: all was at rest where it began; change a start value, as with --set plant.start.x1_0=..., ",
        ),
        (
            ("--set", "plant.start.x2_0=1e-9", *beside),
            "K_1_1, P_1_1 differ from the design's: its certificate does not ",
        ),
        (("--set", "plant.start.x2_0=1e-9"), ""),
    ):
        done = ended("run", "fmus/ten.ssp", *quiet, *options, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stderr.strip().startswith(f"note: {note}" if note else "")
        assert done.stderr.count("note: ") == bool(note)
    changed = ("--kind", "python", "-o", "python", "--set", "controller.mu=0.75")
    done = ended("export", "--design", "ten.json", *changed, cwd=tmp_path)
    assert done.stderr == "note: mu differs from the design's: its certificate does not cover it\n"
    moved = ("-o", "moved", "--set", "controller.x3_equilibrium=0.5", "--set", "controller.u1_equilibrium=0")
    done = ended("export", "--design", "ten.json", *moved, cwd=tmp_path)
    assert done.stderr == (
        "note: x3_equilibrium differs from the design's: the controller holds another equilibrium than its model's\n"
    )
    accepted("export", "--design", "ten.json", "--kind", "python", "-o", "python", cwd=tmp_path)
    assert files(tmp_path / "python") == files(tmp_path / "fmus")
    start = {"plant.fmu": "ten_linear_plant.fmu", "plant.start.x1_0": 1e-3, "controller.fmu": "ten_controller.fmu"}
    short = Scenario().changed({**start, "run.duration": 0.05})
    native, python = (run_scenario(short, tmp_path / folder).signals for folder in ("fmus", "python"))
    assert native.keys() == python.keys()
    assert all(np.array_equal(native[name], python[name]) for name in native)
    assert native["plant.x10"][-1] != 0.0
    said = refused("export", "--design", "ten.json", "--nominal", "hcs", cwd=tmp_path)
    assert said.startswith("--nominal is for the rotary pendulum's units, found with a design of the system ten")


def test_a_pair_that_is_not_controllable_is_not_blamed_on_the_gain(tmp_path):
    system = "A = [[1, 0], [0, 2]]\nb = [1, 0]\nk_lin = [-3, 0]\n"
    (tmp_path / "mine.toml").write_text(system, "utf-8")
    assert "(A, B) must be controllable; no input moves x2" in refused("design", "--system", "mine.toml", cwd=tmp_path)


def test_a_gain_that_does_not_stabilize_is_refused_with_its_pole(tmp_path):
    system = "A = [[0, 1], [1, 0]]\nb = [0, 1]\nk_lin = [0, -1]\n"
    (tmp_path / "mine.toml").write_text(system, "utf-8")
    assert "K must stabilize (A, B): the largest real part" in refused("design", "--system", "mine.toml", cwd=tmp_path)
    (tmp_path / "mine.toml").write_text(system.replace("k_lin", "gain"), "utf-8")
    said = refused("design", "--system", "mine.toml", cwd=tmp_path)
    assert said.startswith("mine.toml: a system has no entry 'gain'")


@pytest.mark.parametrize("case", ["NaN", "tampered", "not JSON"])
def test_a_design_that_proves_nothing_is_not_exported(tmp_path, design, design_file, case):
    P = design.P.tolist()
    if case == "NaN":
        P[0][0] = math.nan
    path = design_file(P=P if case == "NaN" else (-design.P).tolist())
    if case == "not JSON":
        path.write_text("{", "utf-8")
    said = refused("export", "--design", "design.json", cwd=tmp_path)
    assert said.startswith("design.json: ")
    assert {"NaN": "finite numbers, found NaN", "tampered": "P", "not JSON": "not JSON"}[case] in said
    assert files(tmp_path) == ["design.json"]


def test_a_design_whose_proof_is_stretched_is_not_exported(tmp_path, design, design_file):
    assert design.alpha == 0.2
    design_file(alpha=2.0)
    assert refused("export", "--design", "design.json", cwd=tmp_path).startswith("design.json: ")
    assert json.loads((tmp_path / "design.json").read_text("utf-8"))["alpha"] == 2.0
    assert files(tmp_path) == ["design.json"]


# Failures


def test_a_run_that_fails_ends_with_code_1_and_leaves_its_rows(elsewhere):
    """A bearing so stiff that the solver's step is unstable: the state leaves the range of numbers."""
    done = ended("run", "tilt", "--set", "plant.start.D_r=1", "-o", "failed.csv", "--report", cwd=elsewhere)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    last, result = done.stderr.strip().splitlines()[-1], Result.load(elsewhere / "failed.partial.csv")
    assert re.match(r"error: at t = [\d.e-]+ s: plant: doStep\(", last)
    assert f"{len(result.time)} rows, to failed.partial.csv" in done.stdout + done.stderr
    assert 2 <= len(result.time) < 100
    assert result.metadata["complete"] is False
    assert re.search(r"\nat t = [\d.e-]+ s, voltage = -?10, ", "".join(result.metadata["messages"]["plant"]))
    page = check_alone((elsewhere / "failed.partial.html").read_text(encoding="utf-8"))
    assert ("b", "failed") in page.texts
    assert last.removeprefix("error: ") in "".join(text for tag, text in page.texts if tag == "li")
    assert "failed.partial.csv" in page.all("href")
    done = ended("run", "tilt", "--set", "plant.start.D_r=1", "-o", "failed.csv", cwd=elsewhere)
    assert "removed failed.partial.html, the report of an earlier run" in done.stdout + done.stderr
    assert not (elsewhere / "failed.png").exists()


def test_a_failed_run_without_rows_leaves_nothing(elsewhere):
    before = files(elsewhere)
    said = refused("run", "tilt", *SHORT, "--set", "controller.start.a_min=2", cwd=elsewhere, code=1)
    assert "controller: " in said
    assert said.endswith("a_min must not exceed b_max, found a_min = 2 and b_max = 1")
    assert files(elsewhere) == before


def test_what_an_fmu_reports_is_shown_beside_the_result(elsewhere):
    """A control beyond the range of numbers is a fault of the controller; the run itself goes on with 0 V."""
    changes = {"law": "SMC", "smc_k_1": 1.7e308, "capture_level": 1e300}
    flags = [f"--set=controller.start.{name}={value}" for name, value in changes.items()]
    flags += ["--set=plant.start.theta_0=10", "--set=run.duration=0.01", "--no-plot"]
    done = ended("run", "tilt", *flags, cwd=elsewhere)
    assert done.returncode == 0, done.stderr
    result = Result.load(elsewhere / "results" / "tilt.csv")
    (message,) = result.metadata["messages"]["controller"]
    assert "fault non_finite_control" in message
    assert (done.returncode, done.stderr.strip()) == (0, f"controller: {message}")
    assert result["controller.mode"].tolist()[1:] == [4] * 10


# Ctrl-C


def session(pid):
    """Return the process ids of the session of `pid`, without those that have ended."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, leader = stat.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue  # it has ended since
        if int(leader) == pid and state != "Z":
            found.append(int(stat.parent.name))
    return found


def wait_until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


LONG = ("--set", "run.duration=20000", "--set", "record.every=1000")


def loads_the_plant(pid):
    try:
        return "QubeServo2" in Path(f"/proc/{pid}/maps").read_text()
    except OSError:
        return False


def interrupted_after(function):
    """Return a function that does as `function` does, and then ends as Ctrl-C makes it, as a writing one does."""

    def interrupted(*arguments, **options):
        function(*arguments, **options)
        raise KeyboardInterrupt

    return interrupted


@pytest.mark.parametrize(
    ("step", "command", "written"),
    [
        ("cosim.designing.system_and_wish", ["design"], []),
        ("cosim.designing.find", ["design"], []),
        ("ihc_fmu.design.Design.save", ["design"], ["design.json"]),
        ("cosim.designing.prospect", ["design"], ["design.json"]),
        ("cosim.linearize.linear_model", ["linearize", "QubeServo2.fmu", "--input", "voltage"], []),
        ("cosim.system_file.write", ["linearize", "QubeServo2.fmu", "--input", "voltage"], ["QubeServo2.toml"]),
        ("ihc_fmu.pendulum.start_values.default_design", ["export"], []),
        ("cosim.new._check_name", ["new", "cart"], []),
        ("cosim.new.new", ["new", "cart"], ["cart/cart.py", "cart/cart.toml", "cart/cart_run.toml"]),
    ],
)
def test_an_interrupted_command_says_what_was_written(tmp_path, monkeypatch, fmus, step, command, written):
    module, _, name = step.rpartition(".")
    monkeypatch.setattr(step, interrupted_after(pydoc.locate(module).__dict__[name]))
    (tmp_path / "QubeServo2.fmu").symlink_to(fmus / "QubeServo2.fmu")
    done = ended(*command, cwd=tmp_path)
    assert done.returncode == 130, done.stderr
    said = done.stderr.splitlines()[-1]
    assert said.startswith("interrupted; ")
    assert sorted(said.removeprefix("interrupted; ").removeprefix("wrote ").split(", ")) == (
        written or ["no file was written"]
    )
    assert [name for name in files(tmp_path) if name != "QubeServo2.fmu"] == written


def test_ctrl_c_while_the_command_line_is_loaded_is_told_too(monkeypatch, capsys):
    class Loading:
        def __getattr__(self, name):
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "cosim.cli", Loading())
    with pytest.raises(SystemExit) as end:
        entry_point()
    assert (end.value.code, capsys.readouterr().err) == (130, "interrupted; no file was written\n")


@pytest.mark.parametrize(
    ("step", "command", "said"),
    [
        ("cosim.scenario.load_located", ["sweep", "tilt", "--vary", "plant.m_p=±10%"], "no file was written"),
        ("cosim.remarks.remarks_before", ["region", "tilt", "--over", "plant.delta_0=-1..1"], "no file was written"),
        ("cosim.scenario_run.with_tolerances", ["tune", "tilt"], "no file was written"),
        ("cosim.scenario.load_located", ["compare", "tilt"], "no file was written"),
        ("cosim.studies.journal.Journal.digests", ["sweep", "tilt", "--vary", "plant.m_p=±10%"], "no run was finished"),
        (
            "cosim.studies.sweep_files.save",
            ["sweep", "tilt", "--vary", "plant.m_p=±10%", "--draws", "1"],
            "finished runs",
        ),
    ],
    ids=str,
)
def test_ctrl_c_before_between_and_after_the_runs_of_a_study_is_told_in_a_line(
    elsewhere, monkeypatch, step, command, said
):
    module, _, name = step.rpartition(".")
    monkeypatch.setattr(step, interrupted_after(pydoc.locate(module).__dict__[name]))
    done = ended(*command, *SHORT, cwd=elsewhere)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr.splitlines()[-1].startswith(f"interrupted; {said}")


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found in /proc")
@pytest.mark.parametrize("moment", [0.3, 0.52])
def test_an_interrupted_run_ends_with_code_130_and_leaves_its_rows(elsewhere, moment):
    process = started("run", "tilt", *LONG, "-o", "cut.csv", cwd=elsewhere)
    try:
        wait_until(lambda: loads_the_plant(process.pid))
        time.sleep(moment)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=10)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert "Traceback" not in err
    result = Result.load(elsewhere / "cut.partial.csv")
    assert len(result.time) > 1
    assert result.metadata["complete"] is False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found in /proc")
def test_an_interrupted_comparison_of_long_runs_ends_soon_with_code_130_and_leaves_nothing(elsewhere):
    process = started("compare", "tilt", *LONG, "--draws", "50", "--workers", "2", cwd=elsewhere)
    try:
        wait_until(lambda: any(map(loads_the_plant, session(process.pid))))
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=10)
        wait_until(lambda: session(process.pid) == [], 5.0)  # no worker goes on
    finally:
        for pid in session(process.pid):
            os.kill(pid, signal.SIGKILL)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert not (elsewhere / "results").exists()


@pytest.mark.parametrize("outputs", [["mode", "voltage"], ["mode", "voltage", "homogeneous_norm"]])
def test_a_run_that_records_too_little_for_metrics_is_no_failure(elsewhere, outputs):
    recorded = json.dumps([f"controller.{name}" for name in outputs])
    accepted("run", "tilt", *SHORT, "--set", f"record.outputs={recorded}", cwd=elsewhere)


def test_an_output_that_is_no_csv_is_refused(elsewhere):
    assert "cut.json" in refused("run", "tilt", *SHORT, "--no-plot", "-o", "cut.json", cwd=elsewhere)


def test_a_comparison_takes_fmus_of_other_names(elsewhere):
    for old, new in (("QubeServo2", "Mine"), ("IhcController", "Mine2")):
        (elsewhere / "fmus" / f"{old}.fmu").rename(elsewhere / "fmus" / f"{new}.fmu")
    (elsewhere / "mine.toml").write_text('[plant]\nfmu = "Mine.fmu"\n[controller]\nfmu = "Mine2.fmu"\n', "utf-8")
    said = accepted("compare", "mine.toml", *SHORT, "--draws", "0", "--laws", "LC", "--workers", "1", cwd=elsewhere)
    assert all(unit in said for unit in ("[s]", "[rad² s]", "[rad]", "[V² s]", "[V]"))


def test_a_refused_export_writes_nothing(tmp_path):
    assert refused("export", "--set", "controller.a_min=inf", cwd=tmp_path) == "a_min must be finite, found inf"
    assert files(tmp_path) == []
